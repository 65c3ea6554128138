"""A live line on a terminal, and silence elsewhere."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Sequence
from typing import Self

from tqdm import tqdm

from neatq_trainers.metrics import Row


class ProgressBar:
    """What is done, rate, remaining time and a few words.

    Args:
        total: Length of the run.
        done: Done before.
        unit: What is counted.
    """

    def __init__(self, total: int, done: int, unit: str) -> None:
        self._bar = tqdm(
            total=total,
            initial=done,
            unit=f" {unit}",
            mininterval=0.5,
            dynamic_ncols=True,
            disable=not sys.stderr.isatty() or multiprocessing.parent_process() is not None,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def move(self, done: int, text: str | None = None) -> None:
        """Move to `done`; `text` replaces the words."""
        if text is not None:
            self._bar.set_postfix_str(text, refresh=False)
        self._bar.update(done - self._bar.n)


class Progress(ProgressBar):
    """Ticks done, rate, remaining time and the latest distances.

    Args:
        ticks: Length of the run.
        done: Ticks done before.
    """

    def __init__(self, ticks: int, done: int) -> None:
        super().__init__(ticks, done, "ticks")

    def show(self, tick: int, new_rows: Sequence[Row]) -> None:
        """Move to `tick`; the last of `new_rows` tell how far the robots are."""
        text = None
        if new_rows:
            latest = [row for row in new_rows if row.tick == new_rows[-1].tick]
            mean = sum(row.mean_distance for row in latest) / len(latest)
            nearest = min(row.min_distance for row in latest)
            text = f"distance mean {mean:.0f}, least {nearest:.0f}"
        self.move(tick, text)
