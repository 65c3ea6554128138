"""Rewards: a vector for evolution, a number in [0, 1] for learning.

Both are computed after the move. OpenNERO computed them before it, from where the robot had
come to rest one tick earlier: the same series, one tick later.

With d the distance in units:

| dimension | reward for evolution |
| --- | --- |
| stand_ground | -|speed| |
| stick_together | -d^2 to the nearest friend; 0 without friends |
| approach_flag | -d^2 to the flag |
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neatq_envs.neighbours import grid_of, nearest_friend_squared
from neatq_envs.scenario import Scenario
from neatq_torch.jit import cached_njit

STAND_GROUND, STICK_TOGETHER, APPROACH_FLAG = 0, 1, 2  # the order of REWARD_DIMENSIONS
_NOBODY = np.empty((0, 0))


class Law(NamedTuple):
    """The numbers of one scenario's rewards; tuples are [dimensions]."""

    progress: bool  # whether the law is "progress", and not "published"
    shares: tuple[float, float, float]  # weights over the sum of their magnitudes
    scales: tuple[float, float, float]  # what a published reward is measured in
    max_speed: float  # units per tick


class Rewards:
    """Rewards all robots of one scenario.

    The learning reward weighs the dimensions with the scenario's weights w:

    * "published": (sum w (R / s + 1) + sum |w|) / (2 sum |w|), with s = D^2 / 2 for squared
      distances (D is the diagonal of the field; s is 640,000 in OpenNERO's); with approach_flag
      alone 1 - d^2 / 1,280,000. OpenNERO used the same s for the speed, which made that part
      nearly constant; here it has the natural scale s = max_speed / 2.
    * "progress": (1 + (d before - d now) / max_speed) / 2, clipped to [0, 1], both distances to
      the flag that stood during the move: shaping by a potential (Ng, Harada & Russell 1999).
      Mirrored if the weight is negative.
    """

    def __init__(self, scenario: Scenario) -> None:
        weights = scenario.weights()
        half = math.hypot(scenario.width, scenario.height) ** 2 / 2
        self._law = Law(
            progress=scenario.reward == "progress",
            shares=tuple((weights / np.abs(weights).sum()).tolist()),
            scales=(scenario.max_speed / 2, half, half),
            max_speed=scenario.max_speed,
        )
        self._grid = grid_of(scenario.width, scenario.height, scenario.robots, least=1.0)
        self._friends = bool(weights[STICK_TOGETHER]) and scenario.robots > 1

    def after_move(
        self, speed: np.ndarray, position: np.ndarray, flag: np.ndarray, before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rewards for evolution, rewards for learning and the distances to the flag, in units.

        They are [arenas, robots, dimensions], [arenas, robots] in [0, 1], and [arenas, robots].
        stick_together looks for friends; it is left at 0 while its weight is 0.

        Args:
            speed: the speed that was asked for, float64 [arenas, robots], units per tick.
            position: after the move, float64 [arenas, robots, 2], units.
            flag: float64 [arenas, 2], units.
            before: distance to the flag before the move, float64 [arenas, robots], units.
        """
        nearest = nearest_friend_squared(position, self._grid) if self._friends else _NOBODY
        return _rewards(speed, position, flag, before, nearest, self._law)


def flag_distance(position: np.ndarray, flag: np.ndarray) -> np.ndarray:
    """Distances [arenas, robots] of positions [arenas, robots, 2] to flags [arenas, 2]."""
    way = flag[:, None] - position
    return np.sqrt(way[..., 0] * way[..., 0] + way[..., 1] * way[..., 1])


@cached_njit()
def _rewards(
    speed: np.ndarray,
    position: np.ndarray,
    flag: np.ndarray,
    before: np.ndarray,
    nearest: np.ndarray,
    law: Law,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Do `Rewards.after_move`; `nearest` holds squared distances to friends, or nothing."""
    arenas, robots = speed.shape
    vector = np.empty((arenas, robots, len(law.shares)))
    learning, distance = np.empty_like(speed), np.empty_like(speed)
    for arena in range(arenas):
        for robot in range(robots):
            dx = flag[arena, 0] - position[arena, robot, 0]
            dy = flag[arena, 1] - position[arena, robot, 1]
            squared = dx * dx + dy * dy
            now = math.sqrt(squared)
            together = -nearest[arena, robot] if nearest.size else 0.0
            vector[arena, robot, STAND_GROUND] = -abs(speed[arena, robot])
            vector[arena, robot, STICK_TOGETHER] = together
            vector[arena, robot, APPROACH_FLAG] = -squared
            gain = before[arena, robot] - now
            learning[arena, robot] = _learning(vector[arena, robot], gain, law)
            distance[arena, robot] = now
    return vector, learning, distance


@cached_njit()
def _learning(rewards: np.ndarray, gain: float, law: Law) -> float:
    """Weigh rewards, float64 [dimensions]; `gain` is the way made towards the flag, in units."""
    mean = 0.0
    if law.progress:
        mean = np.sign(law.shares[APPROACH_FLAG]) * gain / law.max_speed
    else:
        for dimension in range(len(rewards)):
            mean += (rewards[dimension] / law.scales[dimension] + 1.0) * law.shares[dimension]
    return min(max((mean + 1.0) / 2, 0.0), 1.0)
