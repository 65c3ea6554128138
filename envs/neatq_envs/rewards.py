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

import numpy as np

from neatq_envs.scenario import REWARD_DIMENSIONS, Scenario
from neatq_envs.sensors import nearest_friend_squared

STAND_GROUND, STICK_TOGETHER, APPROACH_FLAG = range(len(REWARD_DIMENSIONS))


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
        self._law = scenario.reward
        self._weights = scenario.weights()
        self._max_speed = scenario.max_speed
        self._diagonal = math.hypot(scenario.width, scenario.height)
        half = self._diagonal**2 / 2
        self._scales = np.array([scenario.max_speed / 2, half, half])

    def vector(self, speed: np.ndarray, position: np.ndarray, flag: np.ndarray) -> np.ndarray:
        """Return rewards, float64 [arenas, robots, dimensions].

        stick_together looks at all pairs of robots; it is left at 0 while its weight is 0.

        Args:
            speed: the speed that was asked for, [arenas, robots], units per tick.
            position: after the move, [arenas, robots, 2], units.
            flag: [arenas, 2], units.
        """
        rewards = np.zeros((*speed.shape, len(REWARD_DIMENSIONS)))
        bounded = self._law == "bounded"
        rewards[..., STAND_GROUND] = -np.abs(speed)
        if bounded:
            rewards[..., STAND_GROUND] = 1.0 - np.abs(speed) / self._max_speed
        rewards[..., APPROACH_FLAG] = self._nearness(flag_distance_squared(position, flag))
        if self._weights[STICK_TOGETHER] and position.shape[1] > 1:
            rewards[..., STICK_TOGETHER] = self._nearness(nearest_friend_squared(position))
        return rewards

    def learning(self, vector: np.ndarray, before: np.ndarray, now: np.ndarray) -> np.ndarray:
        """Return the learning reward, float64 [arenas, robots], in [0, 1].

        Args:
            vector: [arenas, robots, dimensions] of `vector`.
            before: distance to the flag before the move, [arenas, robots], units.
            now: distance to the same flag after it.
        """
        if self._law == "progress":
            sign = np.sign(self._weights[APPROACH_FLAG])
            return np.clip((1.0 + sign * (before - now) / self._max_speed) / 2, 0.0, 1.0)
        total = np.abs(self._weights).sum()
        if self._law == "bounded":
            mean = (vector * (self._weights / total)).sum(-1)
        else:
            mean = ((vector / self._scales + 1.0) * (self._weights / total)).sum(-1)
        return np.clip((mean + 1.0) / 2, 0.0, 1.0)

    def _nearness(self, squared: np.ndarray) -> np.ndarray:
        return 1.0 / (squared / self._diagonal + 1.0) if self._law == "bounded" else -squared


def flag_distance_squared(position: np.ndarray, flag: np.ndarray) -> np.ndarray:
    """Return squared distances [arenas, robots] of positions [arenas, robots, 2] to flags."""
    dx, dy = position[..., 0] - flag[:, None, 0], position[..., 1] - flag[:, None, 1]
    return dx * dx + dy * dy
