"""Rewards: a vector for evolution, a number in [0, 1] for learning.

Both are computed after the move. OpenNERO computed them before it, from where the robot had
come to rest one tick earlier: the same series, one tick later.

Laws, with d the distance in units and D the diagonal of the field (1131.37 in OpenNERO's):

| dimension | "published" (2014) and "progress" | "bounded" (OpenNERO since 2015) |
| --- | --- | --- |
| stand_ground | -|speed| | 1 - |speed| / max_speed |
| stick_together | -d^2 to the nearest friend | 1 / (d^2 / D + 1) |
| approach_flag | -d^2 to the flag | 1 / (d^2 / D + 1) |

A robot without friends gets 0 for stick_together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from neatq_envs.neighbours import grid_of, nearest_friend_squared
from neatq_envs.scenario import Scenario

STAND_GROUND, STICK_TOGETHER, APPROACH_FLAG = 0, 1, 2  # the order of REWARD_DIMENSIONS
_NOBODY = np.empty((0, 0))


class Law(NamedTuple):
    """The numbers of one scenario's rewards.

    Attributes:
        bounded: whether the law is "bounded".
        progress: whether the law is "progress".
        shares: of each dimension, the weight over the sum of their magnitudes.
        scales: of each dimension, what a published reward is measured in.
        max_speed: units per tick.
        diagonal: of the field, units.
    """

    bounded: bool
    progress: bool
    shares: tuple[float, float, float]
    scales: tuple[float, float, float]
    max_speed: float
    diagonal: float


class Rewards:
    """Rewards all robots of one scenario.

    The learning reward weighs the dimensions with the scenario's weights w:

    * "published": (sum w (R / s + 1) + sum |w|) / (2 sum |w|), with s = D^2 / 2 (640,000 in
      OpenNERO's field) for squared distances; with approach_flag alone 1 - d^2 / 1,280,000.
      OpenNERO used the same s for the speed, which made that part nearly constant; here it has
      the natural scale s = max_speed / 2.
    * "bounded": (sum w R / sum |w| + 1) / 2.
    * "progress": (1 + (d before - d now) / max_speed) / 2, clipped to [0, 1], both distances to
      the flag that stood during the move: shaping by a potential (Ng, Harada & Russell 1999).
      Mirrored if the weight is negative.
    """

    def __init__(self, scenario: Scenario) -> None:
        weights = scenario.weights()
        diagonal = math.hypot(scenario.width, scenario.height)
        half = diagonal**2 / 2
        self._law = Law(
            bounded=scenario.reward == "bounded",
            progress=scenario.reward == "progress",
            shares=tuple((weights / np.abs(weights).sum()).tolist()),
            scales=(scenario.max_speed / 2, half, half),
            max_speed=scenario.max_speed,
            diagonal=diagonal,
        )
        self._grid = grid_of(scenario.width, scenario.height, scenario.robots, least=1.0)
        self._friends = bool(weights[STICK_TOGETHER]) and scenario.robots > 1

    def after_move(
        self, speed: np.ndarray, position: np.ndarray, flag: np.ndarray, before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rewards for evolution, rewards for learning and the distances to the flag.

        stick_together looks for friends; it is left at 0 while its weight is 0.

        Args:
            speed: the speed that was asked for, float64 [arenas, robots], units per tick.
            position: after the move, float64 [arenas, robots, 2], units.
            flag: float64 [arenas, 2], units.
            before: distance to the flag before the move, float64 [arenas, robots], units.

        Returns:
            float64 [arenas, robots, dimensions], [arenas, robots] in [0, 1], and
            [arenas, robots] in units.
        """
        nearest = nearest_friend_squared(position, self._grid) if self._friends else _NOBODY
        return _rewards(speed, position, flag, before, nearest, self._law)


def flag_distance(position: np.ndarray, flag: np.ndarray) -> np.ndarray:
    """Return distances [arenas, robots] of positions [arenas, robots, 2] to flags [arenas, 2]."""
    way = flag[:, None] - position
    return np.sqrt(way[..., 0] * way[..., 0] + way[..., 1] * way[..., 1])


@njit(cache=True)
def _rewards(
    speed: np.ndarray,
    position: np.ndarray,
    flag: np.ndarray,
    before: np.ndarray,
    nearest: np.ndarray,
    law: Law,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Do `Rewards.after_move`.

    `nearest` holds squared distances to the nearest friend, float64 [arenas, robots], or nothing
    if friends do not count.
    """
    arenas, robots = speed.shape
    vector = np.empty((arenas, robots, len(law.shares)))
    learning, distance = np.empty_like(speed), np.empty_like(speed)
    for arena in range(arenas):
        for robot in range(robots):
            dx = flag[arena, 0] - position[arena, robot, 0]
            dy = flag[arena, 1] - position[arena, robot, 1]
            squared = dx * dx + dy * dy
            now = math.sqrt(squared)
            still = _stillness(speed[arena, robot], law)
            together = _nearness(nearest[arena, robot], law) if nearest.size else 0.0
            approach = _nearness(squared, law)
            vector[arena, robot, STAND_GROUND] = still
            vector[arena, robot, STICK_TOGETHER] = together
            vector[arena, robot, APPROACH_FLAG] = approach
            gain = before[arena, robot] - now
            learning[arena, robot] = _learning((still, together, approach), gain, law)
            distance[arena, robot] = now
    return vector, learning, distance


@njit(cache=True)
def _stillness(speed: float, law: Law) -> float:
    return 1.0 - abs(speed) / law.max_speed if law.bounded else -abs(speed)


@njit(cache=True)
def _nearness(squared: float, law: Law) -> float:
    return 1.0 / (squared / law.diagonal + 1.0) if law.bounded else -squared


@njit(cache=True)
def _learning(rewards: tuple[float, float, float], gain: float, law: Law) -> float:
    """Weigh rewards, float64 [dimensions]; `gain` is the way made towards the flag, in units."""
    mean = 0.0
    if law.progress:
        mean = np.sign(law.shares[APPROACH_FLAG]) * gain / law.max_speed
    elif law.bounded:
        for dimension in range(len(rewards)):
            mean += rewards[dimension] * law.shares[dimension]
    else:
        for dimension in range(len(rewards)):
            mean += (rewards[dimension] / law.scales[dimension] + 1.0) * law.shares[dimension]
    return min(max((mean + 1.0) / 2, 0.0), 1.0)
