"""Actions that several tests share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from neatq_envs.arena import Arena

Drive = Callable[[Arena], np.ndarray]


def towards(place: tuple[float, float] | None, arena: Arena) -> np.ndarray:
    """Return actions that steer all robots to a place (the flag), at full speed."""
    goal = arena.flag[:, None] if place is None else np.array(place)
    way = goal - arena.position
    turn = np.arctan2(way[..., 1], way[..., 0]) - arena.heading_rad
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    actions = np.zeros((*arena.shape, len(arena.schema.actions)))
    actions[..., 0], actions[..., 1] = arena.scenario.max_speed, turn
    return actions


@pytest.fixture(scope="session")
def toy(toy: str) -> str:
    """What Gymnasium's own ids of the toy environments begin with."""
    return toy.removeprefix("gym:")


@pytest.fixture
def to_flag() -> Drive:
    return lambda arena: towards(None, arena)


@pytest.fixture
def to_corner() -> Drive:
    return lambda arena: towards((0.0, 0.0), arena)
