"""Callbacks: what happens around training, built in or a user's own."""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.record.loggers import Logger, get_logger
from tqdm import tqdm

from neatq_trainers.rows import DistanceRow, NeroRow, Row
from neatq_trainers.run import Run

if TYPE_CHECKING:
    from neatq_trainers.changes import AnyChange
    from neatq_trainers.session import Session

LOGS = "logs"
"""The folder of loggers in a run folder."""
BAR_SECONDS = 0.5
"""Least time between two looks of the progress bar."""


class Callback:
    """What is called while a run trains; override what you need.

    `batch` and `advance` are called where an arena is trained: with several processes in each of
    them, on a copy of the callback. All else is called in the process that began the training.

    Example:
        >>> class StopWhenSolved(Callback):
        ...     def rows(self, session, rows):
        ...         session.stop |= any(row.champion_return >= 475 for row in rows)
        >>> train("gym:CartPole-v1", arm="neat", callbacks=[StopWhenSolved()])
    """

    def start(self, session: Session) -> None:
        """Training begins or goes on, as on a cluster after a machine was lost."""

    def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
        """A batch [arenas, slots, ticks] was learnt from, and evolution was told of it."""

    def advance(self, run: Run, newborn: Tensor) -> None:
        """New genomes stand in the slots of a mask [arenas, slots]."""

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        """The run can stop here; `rows` are the new rows of metrics, often none."""

    def idle(self, session: Session) -> None:
        """The run is paused, or has just been: wait a moment, if you like. Called all the time."""

    def changing(self, session: Session, change: AnyChange) -> None:
        """A change is about to be made."""

    def changed(self, session: Session, change: AnyChange) -> None:
        """A change was made, which somebody asked for or which a record repeats."""

    def refused(self, session: Session, change: AnyChange, error: Exception) -> None:
        """A change cannot be made, and everything is as it was; the error says why."""

    def checkpoint(self, session: Session) -> None:
        """A checkpoint was written."""

    def end(self, session: Session) -> None:
        """The run has its whole length, and its folder all files."""


class MetricsFile(Callback):
    """Writes `metrics.csv`."""

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        """Add the rows."""
        session.folder.add_rows(rows)


class TorchRLLogger(Callback):
    """Logs the means over arenas of every metric, under `train/`, by a logger of TorchRL."""

    def start(self, session: Session) -> None:
        """Open the logger that the configuration asks for; it writes to the folder `logs`."""
        kind = session.config.logger or ""
        self._logger = get_logger(kind, str(session.folder.path / LOGS), kind)

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        """Log the rows, by tick or by episodes."""
        if self._logger is None or not rows:
            return
        try:
            _log(self._logger, rows)
            if session.config.logger == "tensorboard":
                self._logger.experiment.flush()  # a checkpoint says how long the files are
        except OSError as error:
            error.filename = str(session.folder.path / LOGS)  # a full disk does not say which file
            raise


def _log(logger: Logger, rows: Sequence[Row]) -> None:
    step = "tick" if isinstance(rows[0], DistanceRow | NeroRow) else "episodes"
    for moment in sorted({getattr(row, step) for row in rows}):
        now = [row for row in rows if getattr(row, step) == moment]
        for name in now[0]._fields:
            known = [value for row in now if (value := getattr(row, name)) is not None]
            if name not in ("arena", step) and known:
                mean = sum(known) / len(known)
                logger.log_scalar(f"train/{name}", mean, step=moment)


class ProgressBar(Callback):
    """A live line on a terminal: what is done, rate, remaining time, a few words.

    Steps are counted within generations, too, where all arenas are trained in this process.
    """

    _bar: tqdm | None = None  # copies in other processes have none

    def start(self, session: Session) -> None:
        """Show where the run stands."""
        unit, total = session.config.length
        self._unit = unit
        self._bar = tqdm(
            total=total,
            initial=session.done,
            unit=f" {unit}",
            mininterval=BAR_SECONDS,
            dynamic_ncols=True,
            disable=not _watched(),
        )

    def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
        """Move on by the steps of a batch."""
        if self._bar is not None and self._unit == "steps":
            self._move(run.metrics.steps(run))

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        """Move on."""
        if self._bar is None:
            return
        if rows:
            self._bar.set_postfix_str(words(rows), refresh=False)
        self._move(session.done)
        if session.over:
            self._bar.close()

    def _move(self, done: int) -> None:
        assert self._bar is not None
        self._bar.total = max(self._bar.total, done)  # a generation is lived to its end
        self._bar.update(done - self._bar.n)


def _watched() -> bool:
    """Whether somebody looks at this process; a daemon has no stderr at all."""
    terminal = sys.stderr is not None and sys.stderr.isatty()
    return terminal and multiprocessing.parent_process() is None


def words(rows: Sequence[Row]) -> str:
    """How the arenas are doing by their last rows: means over them."""
    latest = list({row.arena: row for row in rows}.values())
    if isinstance(latest[0], DistanceRow):
        mean = mean_of(latest, "mean_distance")
        nearest = min(row.min_distance for row in latest if isinstance(row, DistanceRow))
        return f"distance mean {mean:.0f}, least {nearest:.0f}"
    if isinstance(latest[0], NeroRow):
        hits, damage = mean_of(latest, "hits"), mean_of(latest, "damage")
        return f"hits {hits:.2f}, damage {damage:.2f} of a robot in 100 ticks"
    best, champion = (mean_of(latest, name) for name in ("best_fitness", "champion_return"))
    return f"best {best:.1f}, champion {champion:.1f}"


def mean_of(rows: Sequence[Row], name: str) -> float:
    """The mean of a number over rows."""
    return sum(getattr(row, name) for row in rows) / len(rows)


class Checkpoints(Callback):
    """Asks for a checkpoint every `checkpoint_seconds`."""

    def start(self, session: Session) -> None:
        """Wait from now on."""
        self.checkpoint(session)

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        """Ask for a checkpoint when it is time."""
        session.wants_checkpoint |= time.monotonic() >= self._due

    def checkpoint(self, session: Session) -> None:
        """Wait for the next."""
        self._due = time.monotonic() + session.config.checkpoint_seconds


class Report(Callback):
    """Draws the pictures of a run at its end."""

    def end(self, session: Session) -> None:
        """Write the pictures into the folder."""
        from neatq_trainers.report import write_report

        session.folder.notes += write_report(session.folder)
