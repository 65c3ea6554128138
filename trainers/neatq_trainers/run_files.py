"""Files that every run folder has, written so that nothing is ever half there."""

from __future__ import annotations

import json
import shlex
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from neatq_torch.atomic import write_atomic
from neatq_torch.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from neatq_trainers.config import ConfigError
from neatq_trainers.loggers import RunLogger
from neatq_trainers.metrics import Line, csv_line

CONFIG, METRICS, CHECKPOINT = "config.json", "metrics.csv", "checkpoint.npz"
CHAMPION, CURVES = "champion.json", "curves.png"

State = dict[str, Any]


class RunFolderError(ConfigError):
    """A folder cannot be used for a run."""


@dataclass(kw_only=True)
class RunFiles:
    """A run on disk.

    `metrics.csv` grows by whole lines; the checkpoint says how long it was, so that a run that
    goes on first cuts off what came later. All other files are replaced as a whole.

    Attributes:
        path: The folder.
        logger: TorchRL's logger beside the CSV, or nothing.
        metrics_bytes: Length of `metrics.csv`.
        metrics_crc: CRC-32 of `metrics.csv`.
    """

    header: ClassVar[str]
    """First line of `metrics.csv`."""

    path: Path
    logger: RunLogger
    metrics_bytes: int = field(init=False)
    metrics_crc: int = field(init=False)

    def __post_init__(self) -> None:
        """Count the header."""
        self.metrics_bytes = len(self.header)
        self.metrics_crc = zlib.crc32(self.header.encode())

    @classmethod
    def claim(cls, path: Path, config: Mapping[str, Any]) -> None:
        """Make the folder of a new run, with its configuration and metrics without rows.

        Raises:
            RunFolderError: If there is something in it.
            OSError: If it cannot be written.
        """
        if path.exists() and (not path.is_dir() or any(path.iterdir())) and not cls._unbegun(path):
            instead = "choose another --out"
            if (path / CHECKPOINT).is_file():
                command = f"neatq resume {shlex.quote(str(path))}"
                instead += f", or go on with the run in it: {command}"
            raise RunFolderError(f"{path}: exists and is not empty; {instead}")
        path.mkdir(parents=True, exist_ok=True)
        write_config(path, config)
        write_atomic(path / METRICS, cls.header)

    @classmethod
    def _unbegun(cls, path: Path) -> bool:
        """Whether `path` holds only what `claim` wrote: a run that failed before its first row."""
        if not path.is_dir() or {entry.name for entry in path.iterdir()} - {CONFIG, METRICS}:
            return False
        metrics = path / METRICS
        return not metrics.exists() or metrics.read_bytes() == cls.header.encode()

    def cut_metrics(self, length: int, crc: int) -> None:
        """Cut the metrics back to what they were when the checkpoint was made.

        Raises:
            CheckpointError: If they were altered, or have other columns than those of this version.
        """
        path = self.path / METRICS
        content = path.read_bytes()[:length] if path.is_file() else b""
        if len(content) < length or zlib.crc32(content) != crc:
            raise CheckpointError(
                f"{path}: altered: its first {length} bytes are not those that it had when the "
                "checkpoint was made; restore the file, or begin a new run with another --out"
            )
        if not content.startswith(self.header.encode()):
            raise CheckpointError(
                f"{path}: not of this version of neatq, whose columns are {self.header.strip()}; "
                "go on with the version that made it, or begin a new run with another --out"
            )
        write_atomic(path, content)
        self.metrics_bytes, self.metrics_crc = length, crc

    def add_rows(self, rows: Sequence[Line]) -> None:
        """Add rows to the metrics."""
        if rows:
            self._append("".join(map(csv_line, rows)).encode())
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

    def save(self, config: Mapping[str, Any], state: State, *, observation_schema: str) -> None:
        """Write the checkpoint: the run's state, its configuration, and how long the metrics are.

        Raises:
            OSError: If it cannot be written; the one before is unchanged.
        """
        whole = {
            "config": config,
            **state,
            "metrics_bytes": self.metrics_bytes,
            "metrics_crc": self.metrics_crc,
        }
        save_checkpoint(self.path / CHECKPOINT, whole, observation_schema=observation_schema)

    def read_config(self) -> Any:
        """What `config.json` holds.

        Raises:
            CheckpointError: If it is missing or no JSON.
        """
        path = self.path / CONFIG
        try:
            return json.loads(path.read_bytes())
        except FileNotFoundError as error:
            raise CheckpointError(f"{path}: there is no such file") from error
        except ValueError as error:
            raise self.damaged_config(error) from error

    def damaged_config(self, error: Exception) -> CheckpointError:
        """What to raise where the configuration cannot be used."""
        return CheckpointError(f"{self.path / CONFIG}: altered or damaged: {error}")

    def read_checkpoint(self, observation_schema: str) -> State:
        """What `save` wrote.

        Raises:
            CheckpointError: If it is missing, damaged, or of other observations.
        """
        return load_checkpoint(self.path / CHECKPOINT, observation_schema=observation_schema)

    def refuse_other_config(self, same: bool) -> None:
        """Raise CheckpointError unless the configuration is the one of the checkpoint."""
        if not same:
            raise CheckpointError(
                f"{self.path / CONFIG}: not the configuration that the run was made with; restore "
                "the file, or begin a new run with another --out"
            )

    def other_version(self, error: Exception) -> CheckpointError:
        """What to raise where the checkpoint's configuration cannot be read."""
        return CheckpointError(
            f"{self.path / CHECKPOINT}: not a run of this version of neatq ({error})"
        )


def write_config(path: Path, config: Mapping[str, Any]) -> None:
    """Write the configuration of the run in folder `path`."""
    write_atomic(path / CONFIG, json.dumps(config, indent=2) + "\n")


def require_run(path: Path) -> None:
    """Raise RunFolderError unless a run was begun in folder `path`."""
    if not (path / CHECKPOINT).is_file():
        raise RunFolderError(f"{path}: no run to go on with; there is no {CHECKPOINT} in it")
