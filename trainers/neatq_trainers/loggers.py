"""Metrics for TorchRL's loggers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neatq_trainers.config import LoggerName


class RunLogger:
    """Logs the means over arenas of every metric, under `train/`.

    Args:
        name: `csv`, `tensorboard` or None for no logger.
        folder: The run's folder; the logger writes into its sub-folder `logs`.
        step: The field of a row that says when.
    """

    def __init__(self, name: LoggerName | None, folder: Path, step: str = "tick") -> None:
        self._logger = None
        self._step = step
        if name == "csv":
            from torchrl.record.loggers.csv import CSVLogger

            self._logger = CSVLogger("csv", log_dir=str(folder / "logs"), video_format="pt")
        elif name == "tensorboard":
            from torchrl.record.loggers.tensorboard import TensorboardLogger

            self._logger = TensorboardLogger("tensorboard", log_dir=str(folder / "logs"))

    def log(self, rows: Sequence[Any]) -> None:
        """Log rows [moments x arenas]."""
        if self._logger is None:
            return
        for moment in sorted({getattr(row, self._step) for row in rows}):
            now = [row for row in rows if getattr(row, self._step) == moment]
            for name in now[0]._fields:
                known = [value for row in now if (value := getattr(row, name)) is not None]
                if name not in ("arena", self._step) and known:
                    mean = sum(known) / len(known)
                    self._logger.log_scalar(f"train/{name}", mean, step=moment)
