"""The folder of a run: what is in it, and how it is written so that nothing is ever half there."""

from __future__ import annotations

import json
import shlex
import zlib
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from neatq_envs.sensors import SCHEMAS
from neatq_torch.atomic import write_atomic
from neatq_torch.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from neatq_torch.genome import save_genome
from neatq_trainers.build import Run, build
from neatq_trainers.config import ConfigError, RunConfig
from neatq_trainers.loggers import RunLogger
from neatq_trainers.metrics import HEADER, Row
from neatq_trainers.workers import Snapshot, State

CONFIG, METRICS, CHECKPOINT = "config.json", "metrics.csv", "checkpoint.npz"
CHAMPION, CURVES, ARENA, ANIMATION = "champion.json", "curves.png", "arena.png", "team.gif"


class RunFolderError(ConfigError):
    """A folder cannot be used for a run."""


def life_ticks(config: RunConfig) -> int:
    """How much of a run its pictures show: one life, or 1000 ticks where lives have no end."""
    return config.scenario.lifetime_ticks or 1000


def _unbegun(path: Path) -> bool:
    """Whether `path` holds only what `create` wrote: a run that failed before its first tick."""
    if not path.is_dir() or {entry.name for entry in path.iterdir()} - {CONFIG, METRICS}:
        return False
    metrics = path / METRICS
    return not metrics.exists() or metrics.read_bytes() == HEADER.encode()


@dataclass(kw_only=True)
class RunFolder:
    """A run on disk.

    `metrics.csv` grows by whole lines; the checkpoint says how long it was, so that a run that
    goes on first cuts off what came later. All other files are replaced as a whole.

    Attributes:
        path: The folder.
        logger: TorchRL's logger beside the CSV, or nothing.
        track: Poses [robots, ticks, 3] of the latest batches of arena 0, one life of them.
        metrics_bytes: Length of `metrics.csv`.
        metrics_crc: CRC-32 of `metrics.csv`.
    """

    path: Path
    logger: RunLogger
    track: deque[np.ndarray] = field(default_factory=deque)
    metrics_bytes: int = len(HEADER)
    metrics_crc: int = zlib.crc32(HEADER.encode())

    @staticmethod
    def create(path: Path, config: RunConfig) -> RunFolder:
        """Make the folder of a new run.

        Raises:
            RunFolderError: If there is something in it.
            OSError: If it cannot be written.
        """
        if path.exists() and (not path.is_dir() or any(path.iterdir())) and not _unbegun(path):
            instead = "choose another --out"
            if (path / CHECKPOINT).is_file():
                command = f"neatq resume {shlex.quote(str(path))}"
                instead += f", or go on with the run in it: {command}"
            raise RunFolderError(f"{path}: exists and is not empty; {instead}")
        path.mkdir(parents=True, exist_ok=True)
        write_atomic(path / CONFIG, json.dumps(config.to_dict(), indent=2) + "\n")
        write_atomic(path / METRICS, HEADER)
        return RunFolder(path=path, logger=RunLogger(config.logger, path))

    @staticmethod
    def open(path: Path) -> RunFolder:
        """Open the folder of a run that was begun.

        Raises:
            RunFolderError: If there is no checkpoint in it.
        """
        if not (path / CHECKPOINT).is_file():
            raise RunFolderError(f"{path}: no run to go on with; there is no {CHECKPOINT} in it")
        return RunFolder(path=path, logger=RunLogger(None, path))

    def load(self, *, ticks: int | None = None) -> tuple[RunConfig, list[State]]:
        """The run as the checkpoint has it, and the folder's files cut back to that moment.

        Args:
            ticks: Another length for the run.

        Returns:
            Its configuration, and the state of each part that had a worker of its own.

        Raises:
            RunFolderError: If it has more ticks than that already.
            CheckpointError: If the checkpoint is damaged, of another version or does not fit the
                folder's other files.
        """
        config, state = self._read()
        if ticks is not None:
            config = replace(config, ticks=ticks)
            done = state["runs"][0]["tick"]
            if ticks < done:
                raise RunFolderError(
                    f"ticks: the run in {self.path} has {done} already, got "
                    f"{ticks}; give more, or begin a new run with another --out"
                )
        self._cut_metrics(state["metrics_bytes"], state["metrics_crc"])
        if ticks is not None:
            write_atomic(self.path / CONFIG, json.dumps(config.to_dict(), indent=2) + "\n")
        self.logger = RunLogger(config.logger, self.path)
        self.track = deque([state["track"]] if state["track"].size else [])
        return config, state["runs"]

    def read(self) -> Run:
        """The run as the checkpoint has it, of the arenas of its first worker.

        Nothing in the folder changes.
        """
        config, state = self._read()
        return build(config.split(len(state["runs"]))[0], state["runs"][0])

    def _read(self) -> tuple[RunConfig, dict[str, Any]]:
        path = self.path / CONFIG
        try:
            config = RunConfig.from_dict(json.loads(path.read_bytes()))
        except FileNotFoundError as error:
            raise CheckpointError(f"{path}: there is no such file") from error
        except ValueError as error:
            raise CheckpointError(f"{path}: altered or damaged: {error}") from error
        schema = SCHEMAS[config.scenario.sensors].name
        state = load_checkpoint(self.path / CHECKPOINT, observation_schema=schema)
        try:
            made_with = RunConfig.from_dict(state["config"])
        except (KeyError, TypeError, ConfigError) as error:
            raise CheckpointError(
                f"{self.path / CHECKPOINT}: not a run of this version of neatq ({error})"
            ) from error
        if replace(made_with, ticks=config.ticks) != config:
            raise CheckpointError(
                f"{path}: not the configuration that the run was made with; restore the file, or "
                "begin a new run with another --out"
            )
        return config, state

    def _cut_metrics(self, length: int, crc: int) -> None:
        path = self.path / METRICS
        content = path.read_bytes()[:length] if path.is_file() else b""
        if len(content) < length or zlib.crc32(content) != crc:
            raise CheckpointError(
                f"{path}: altered: its first {length} bytes are not those that it had when the "
                "checkpoint was made; restore the file, or begin a new run with another --out"
            )
        write_atomic(path, content)
        self.metrics_bytes, self.metrics_crc = length, crc

    def record(self, config: RunConfig, poses: np.ndarray, rows: Sequence[Row]) -> None:
        """Add rows to the metrics and poses [robots, ticks, 3] of arena 0 to the track."""
        self.track.append(poses)
        life = life_ticks(config)
        while sum(poses.shape[1] for poses in self.track) - self.track[0].shape[1] >= life:
            self.track.popleft()
        if rows:
            self._append("".join(row.csv() for row in rows).encode())
            self.logger.log(rows)

    def _append(self, text: bytes) -> None:
        path = self.path / METRICS
        try:
            with path.open("ab") as file:
                file.write(text)
        except OSError as error:
            error.filename = str(path)  # a full disk does not say which file
            raise
        self.metrics_bytes += len(text)
        self.metrics_crc = zlib.crc32(text, self.metrics_crc)

    def latest_track(self, life: int) -> np.ndarray:
        """Poses [robots, ticks, 3] of the latest `life` ticks, float32, or of as many as there are.

        The same whether the run was interrupted or not.
        """
        if not self.track:
            return np.zeros((0, 0, 3), np.float32)
        return np.concatenate(list(self.track), 1)[:, -life:].astype(np.float32)

    def checkpoint(self, config: RunConfig, parts: Sequence[Snapshot]) -> None:
        """Write the checkpoint and the champion of arena 0.

        Args:
            config: The whole run.
            parts: Its arenas as they stand, as the workers have them.
        """
        state = {
            "config": config.to_dict(),
            "runs": [part.state for part in parts],
            "metrics_bytes": self.metrics_bytes,
            "metrics_crc": self.metrics_crc,
            "track": self.latest_track(life_ticks(config)),
        }
        schema = SCHEMAS[config.scenario.sensors].name
        save_checkpoint(self.path / CHECKPOINT, state, observation_schema=schema)
        if parts[0].champion is not None:
            save_genome(parts[0].champion, self.path / CHAMPION)
