"""A live line on a terminal, and silence elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Self

from tqdm import tqdm

from neatq_trainers.metrics import Row


class Progress:
    """Ticks done, rate, remaining time and the latest distances.

    Args:
        ticks: Length of the run.
        done: Ticks done before.
    """

    def __init__(self, ticks: int, done: int) -> None:
        self._bar = tqdm(
            total=ticks,
            initial=done,
            unit=" ticks",
            mininterval=0.5,
            dynamic_ncols=True,
            disable=not sys.stderr.isatty(),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def show(self, tick: int, new_rows: Sequence[Row]) -> None:
        """Move to `tick`; the last of `new_rows` tell how far the robots are."""
        if new_rows:
            latest = [row for row in new_rows if row.tick == new_rows[-1].tick]
            mean = sum(row.mean_distance for row in latest) / len(latest)
            nearest = min(row.min_distance for row in latest)
            text = f"distance mean {mean:.0f}, least {nearest:.0f}"
            self._bar.set_postfix_str(text, refresh=False)
        self._bar.update(tick - self._bar.n)
