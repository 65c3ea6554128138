"""When the robots of a run have found the flag."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CONTACT = 10.0
"""Units. Twice the radius of the tightest circle at full speed (1 unit per tick over 0.2 rad per
tick), so that a robot which circles round the flag has found it."""

STABLE_SHARE = 0.9
LIFE_ROWS = 10
"""Rows of metrics in one life of 1000 ticks."""


def first_contact(tick: NDArray[np.int64], nearest: NDArray[np.float64]) -> int | None:
    """The first tick at which the nearest robot is in contact with the flag; None: never.

    Args:
        tick: Of each row of metrics, every 100 ticks [rows].
        nearest: Distance of the nearest robot to the flag, units [rows].
    """
    found = np.flatnonzero(nearest <= CONTACT)
    return int(tick[found[0]]) if found.size else None


def stable_contact(tick: NDArray[np.int64], nearest: NDArray[np.float64]) -> int | None:
    """The tick from which on a robot is in contact in at least nine of ten rows; None: never.

    It is the first row in contact from which to the end of the run at least nine of ten rows are
    in contact, and at least ten rows are left: one life. The nearest robot counts, not always the
    same one, because every robot is on its way for a part of its life; the tenth that is forgiven
    leaves time to find a flag that has moved.

    Args:
        tick: Of each row of metrics, every 100 ticks [rows].
        nearest: Distance of the nearest robot to the flag, units [rows].
    """
    near = nearest <= CONTACT
    left = np.arange(near.size, 0, -1)
    share = np.cumsum(near[::-1])[::-1] / left
    found = np.flatnonzero(near & (share >= STABLE_SHARE) & (left >= LIFE_ROWS))
    return int(tick[found[0]]) if found.size else None


def champion_reaches(champion: NDArray[np.float64]) -> bool:
    """Whether the champion is in contact in at least a tenth of the last tenth of a run.

    A life has ten rows, so a champion that gets to the flag in each of its lives is there in at
    least one row of ten, however long its way is.

    Args:
        champion: Its distance to the flag, units [rows]; NaN where there is none.
    """
    last = champion[-max(1, champion.size // 10) :]
    return bool((last <= CONTACT).mean() >= 1 / LIFE_ROWS)
