"""The folder of a run in the arena."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from neatq_envs.sensors import schema_of
from neatq_torch.genome import save_genome
from neatq_trainers.build import Run, build
from neatq_trainers.config import ConfigError, RunConfig
from neatq_trainers.loggers import RunLogger
from neatq_trainers.metrics import HEADER, Row
from neatq_trainers.run_files import (
    CHAMPION,
    CHECKPOINT,
    CONFIG,
    CURVES,
    METRICS,
    RunFiles,
    RunFolderError,
    require_run,
    write_config,
)
from neatq_trainers.workers import Snapshot, State

ARENA, ANIMATION = "arena.png", "team.gif"

__all__ = [
    "ANIMATION",
    "ARENA",
    "CHAMPION",
    "CHECKPOINT",
    "CONFIG",
    "CURVES",
    "METRICS",
    "RunFolder",
    "RunFolderError",
    "life_ticks",
]


def life_ticks(config: RunConfig) -> int:
    """How much of a run its pictures show: one life, or 1000 ticks where lives have no end."""
    return config.scenario.lifetime_ticks or 1000


@dataclass(kw_only=True)
class RunFolder(RunFiles):
    """A run in the arena on disk; see `RunFiles`.

    Attributes:
        track: Poses [robots, ticks, 3] of the latest batches of arena 0, one life of them.
    """

    header = HEADER
    track: deque[np.ndarray] = field(default_factory=deque)

    @staticmethod
    def create(path: Path, config: RunConfig) -> RunFolder:
        """Make the folder of a new run.

        Raises:
            RunFolderError: If there is something in it.
            OSError: If it cannot be written.
        """
        RunFolder.claim(path, config.to_dict())
        return RunFolder(path=path, logger=RunLogger(config.logger, path))

    @staticmethod
    def open(path: Path) -> RunFolder:
        """Open the folder of a run that was begun.

        Raises:
            RunFolderError: If there is no checkpoint in it.
        """
        require_run(path)
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
        self.cut_metrics(state["metrics_bytes"], state["metrics_crc"])
        if ticks is not None:
            write_config(self.path, config.to_dict())
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
        values = self.read_config()
        try:
            config = RunConfig.from_dict(values)
        except ValueError as error:
            raise self.damaged_config(error) from error
        state = self.read_checkpoint(schema_of(config.scenario).name)
        try:
            made_with = RunConfig.from_dict(state["config"])
        except (KeyError, TypeError, ConfigError) as error:
            raise self.other_version(error) from error
        self.refuse_other_config(replace(made_with, ticks=config.ticks) == config)
        return config, state

    def record(self, config: RunConfig, poses: np.ndarray, rows: Sequence[Row]) -> None:
        """Add rows to the metrics and poses [robots, ticks, 3] of arena 0 to the track."""
        self.track.append(poses)
        life = life_ticks(config)
        while sum(poses.shape[1] for poses in self.track) - self.track[0].shape[1] >= life:
            self.track.popleft()
        self.add_rows(rows)

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
            "runs": [part.state for part in parts],
            "track": self.latest_track(life_ticks(config)),
        }
        schema = schema_of(config.scenario).name
        self.save(config.to_dict(), state, observation_schema=schema)
        if parts[0].champion is not None:
            save_genome(parts[0].champion, self.path / CHAMPION)
