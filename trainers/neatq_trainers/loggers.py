"""Metrics for TorchRL's loggers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from neatq_trainers.config import LoggerName
from neatq_trainers.metrics import Row

_NOT_LOGGED = ("arena", "tick")


class RunLogger:
    """Logs the means over arenas of every metric, under `train/`.

    Args:
        name: `csv`, `tensorboard` or None for no logger.
        folder: The run's folder; the logger writes into its sub-folder `logs`.
    """

    def __init__(self, name: LoggerName | None, folder: Path) -> None:
        self._logger = None
        if name == "csv":
            from torchrl.record.loggers.csv import CSVLogger

            self._logger = CSVLogger("csv", log_dir=str(folder / "logs"), video_format="pt")
        elif name == "tensorboard":
            from torchrl.record.loggers.tensorboard import TensorboardLogger

            self._logger = TensorboardLogger("tensorboard", log_dir=str(folder / "logs"))

    def log(self, rows: Sequence[Row]) -> None:
        """Log rows [ticks x arenas]."""
        if self._logger is None:
            return
        for tick in sorted({row.tick for row in rows}):
            for name in Row._fields:
                values = [getattr(row, name) for row in rows if row.tick == tick]
                known = [value for value in values if value is not None]
                if name not in _NOT_LOGGED and known:
                    mean = sum(known) / len(known)
                    self._logger.log_scalar(f"train/{name}", mean, step=tick)
