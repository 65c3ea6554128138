"""The folder of a run: what is in it, and how it is written so that nothing is ever half there."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from neatq_envs.sensors import SCHEMAS
from neatq_torch.atomic import write_atomic
from neatq_torch.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from neatq_torch.genome import save_genome
from neatq_trainers.build import Run, build
from neatq_trainers.config import ConfigError, RunConfig
from neatq_trainers.loggers import RunLogger
from neatq_trainers.metrics import HEADER, Row

CONFIG, METRICS, CHECKPOINT = "config.json", "metrics.csv", "checkpoint.npz"
CHAMPION, CURVES, ARENA, ANIMATION = "champion.json", "curves.png", "arena.png", "team.gif"


class RunFolderError(ConfigError):
    """A folder cannot be used for a run."""


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
    """

    path: Path
    logger: RunLogger
    track: deque[np.ndarray] = field(default_factory=deque)
    metrics_bytes: int = 0

    @staticmethod
    def create(path: Path, config: RunConfig) -> RunFolder:
        """Make the folder of a new run.

        Raises:
            RunFolderError: If there is something in it.
            OSError: If it cannot be written.
        """
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise RunFolderError(
                f"{path}: exists and is not empty; choose another --out, or go on with the run "
                f"in it: neatq resume {path}"
            )
        path.mkdir(parents=True, exist_ok=True)
        write_atomic(path / CONFIG, json.dumps(config.to_dict(), indent=2) + "\n")
        write_atomic(path / METRICS, HEADER)
        return RunFolder(
            path=path, logger=RunLogger(config.logger, path), metrics_bytes=len(HEADER)
        )

    @staticmethod
    def open(path: Path) -> RunFolder:
        """Open the folder of a run that was begun.

        Raises:
            RunFolderError: If there is no checkpoint in it.
        """
        if not (path / CHECKPOINT).is_file():
            raise RunFolderError(f"{path}: no run to go on with; there is no {CHECKPOINT} in it")
        return RunFolder(path=path, logger=RunLogger(None, path))

    def load(self, *, ticks: int | None = None) -> Run:
        """The run as the checkpoint has it, and the folder's files cut back to that moment.

        Args:
            ticks: Another length for the run.

        Raises:
            CheckpointError: If the checkpoint is damaged, of another version or does not fit the
                folder's other files.
        """
        config, state = self._read()
        if ticks is not None:
            config = replace(config, ticks=ticks)
            write_atomic(self.path / CONFIG, json.dumps(config.to_dict(), indent=2) + "\n")
        self._cut_metrics(state["metrics_bytes"])
        self.logger = RunLogger(config.logger, self.path)
        self.track = deque([state["track"]])
        return build(config, state["run"])

    def read(self) -> Run:
        """The run as the checkpoint has it; nothing in the folder changes."""
        config, state = self._read()
        return build(config, state["run"])

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
        made_with = RunConfig.from_dict(state["run"]["config"])
        if replace(made_with, ticks=config.ticks) != config:
            raise CheckpointError(
                f"{path}: not the configuration that the run was made with; restore the file, or "
                "begin a new run with another --out"
            )
        return config, state

    def _cut_metrics(self, length: int) -> None:
        path = self.path / METRICS
        content = path.read_bytes() if path.is_file() else b""
        if len(content) < length:
            raise CheckpointError(
                f"{path}: {len(content)} bytes, but the checkpoint was made when it had {length}; "
                "it was altered"
            )
        write_atomic(path, content[:length])
        self.metrics_bytes = length

    def record(self, run: Run, batch: TensorDictBase, rows: Sequence[Row]) -> None:
        """Add a batch: its rows to the metrics, its poses to the track."""
        self.track.append(batch.get("pose")[0].numpy())
        life = run.config.scenario.lifetime_ticks or 1000
        while sum(poses.shape[1] for poses in self.track) - self.track[0].shape[1] >= life:
            self.track.popleft()
        if rows:
            text = "".join(row.csv() for row in rows).encode()
            with (self.path / METRICS).open("ab") as file:
                file.write(text)
            self.metrics_bytes += len(text)
            self.logger.log(rows)

    def checkpoint(self, run: Run) -> None:
        """Write the checkpoint and the champion of arena 0."""
        track = np.concatenate(list(self.track), 1) if self.track else np.zeros((0, 0, 3))
        state = {
            "run": run.state(),
            "metrics_bytes": self.metrics_bytes,
            "track": track.astype(np.float32),
        }
        schema = run.env.arena.schema.name
        save_checkpoint(self.path / CHECKPOINT, state, observation_schema=schema)
        champion = run.populations[0].champion if run.populations else None
        if champion is not None and run.network is not None:
            save_genome(run.network.genome(champion), self.path / CHAMPION)
