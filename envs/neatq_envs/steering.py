"""What actions do to robots: turn first, then wish to move along the new heading."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def steer(
    actions: np.ndarray, heading_rad: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[bool, np.ndarray, np.ndarray]:
    """Return whether all actions are finite, and the headings and speeds they lead to.

    Args:
        actions: float64 [arenas, robots, actions]; those beyond the bounds are clipped.
        heading_rad: float64 [arenas, robots], in (-pi, pi].
        low: least actions, float64 [actions]: speed in units per tick, turn in rad, others.
        high: greatest actions, likewise; a turn is less than one round.

    Returns:
        Finite or not; headings in (-pi, pi] and speeds, both float64 [arenas, robots].
    """
    finite = True
    heading, speed = np.empty_like(heading_rad), np.empty_like(heading_rad)
    for arena in range(len(actions)):
        for robot in range(len(actions[arena])):
            for action in range(len(low)):
                finite &= math.isfinite(actions[arena, robot, action])
            speed[arena, robot] = min(max(actions[arena, robot, 0], low[0]), high[0])
            angle = heading_rad[arena, robot]
            angle += min(max(actions[arena, robot, 1], low[1]), high[1])
            if angle > math.pi:  # less than one turn away: no precision is lost
                angle -= 2 * math.pi
            elif angle <= -math.pi:
                angle += 2 * math.pi
            heading[arena, robot] = angle
    return finite, heading, speed


def directions(heading_rad: np.ndarray) -> np.ndarray:
    """Return cosine and sine of headings [arenas, robots], float64 [arenas, robots, 2]."""
    ahead = np.empty((*heading_rad.shape, 2))
    ahead[..., 0], ahead[..., 1] = np.cos(heading_rad), np.sin(heading_rad)
    return ahead
