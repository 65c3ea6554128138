"""Actions of an environment as points in a box, among which networks choose, and back."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from neatq_envs.observations import parts_of

MOST_WHOLE_NUMBERS = 2**24
"""Single precision, in which networks compute, cannot tell more of them apart."""


@dataclass(frozen=True)
class ActionPart:
    """Numbers of an action that belong to one space that is no Dict and no Tuple.

    Attributes:
        low: Smallest, float64 [numbers].
        high: Largest, float64 [numbers].
        whole: Whether they are whole numbers.
        shape: Of the environment's own.
        dtype: Of the environment's own.
    """

    low: np.ndarray
    high: np.ndarray
    whole: bool
    shape: tuple[int, ...]
    dtype: Any

    @property
    def end(self) -> np.ndarray:
        """Where the box of points ends: each whole number k has the points from k to k + 1."""
        return self.high + 1 if self.whole else self.high

    def own(self, points: np.ndarray) -> np.ndarray:
        """The environment's own [rows, *shape] of points [rows, numbers], clipped to the bounds."""
        points = np.floor(points) if self.whole else points
        values = np.clip(points, self.low, self.high)
        return values.reshape(len(points), *self.shape).astype(self.dtype)


def action_parts(space: Any) -> list[ActionPart] | None:
    """The parts of an action space, in Gymnasium's order; None if points cannot stand for them."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        parts = [action_parts(one) for _, one in parts_of(space)]
        return None if None in parts else [one for own in parts if own is not None for one in own]
    limits = _limits(space)
    if limits is None:
        return None
    low, high = (np.asarray(limit, np.float64).ravel() for limit in limits)
    whole = not np.issubdtype(space.dtype, np.floating)
    return [ActionPart(low, high, whole, tuple(space.shape or ()), space.dtype)]


def own_actions(space: Any, parts: list[ActionPart], points: np.ndarray) -> list[Any]:
    """The environment's own actions, one for each row, of the types that `space.sample()` gives.

    Args:
        space: Of the actions.
        parts: Its `action_parts`.
        points: [rows, numbers], between `low` and `end` of the parts.
    """
    columns, first = [], 0
    for part in parts:
        columns.append(part.own(points[:, first : first + part.low.size]))
        first += part.low.size
    return [_assembled(space, iter(columns), row) for row in range(len(points))]


def _limits(space: Any) -> tuple[Any, Any] | None:
    if isinstance(space, spaces.Box):
        return space.low, space.high
    if isinstance(space, spaces.Discrete):
        return space.start, space.start + space.n - 1
    if isinstance(space, spaces.MultiDiscrete):
        return space.start, space.start + space.nvec - 1
    if isinstance(space, spaces.MultiBinary):
        return np.zeros(math.prod(space.shape)), np.ones(math.prod(space.shape))
    return None


def _assembled(space: Any, columns: Iterator[np.ndarray], row: int) -> Any:
    if isinstance(space, spaces.Dict):
        return {key: _assembled(part, columns, row) for key, part in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(_assembled(part, columns, row) for part in space.spaces)
    column = next(columns)
    return column[row] if isinstance(space, spaces.Discrete) else column[row, ...]
