"""Walls: boxes that stop robots and that wall sensors see."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neatq_envs.checks import ScenarioError, require_finite


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A box of `width` x `height` units, centred at (x, y), turned by `angle_rad`."""

    x: float
    y: float
    width: float
    height: float
    angle_rad: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self, "wall")
        if self.width <= 0 or self.height <= 0:
            raise ScenarioError(
                f"wall at ({self.x}, {self.y}): width and height must be greater than 0, "
                f"got {self.width} and {self.height}"
            )

    @staticmethod
    def between(start: tuple[float, float], end: tuple[float, float], *, thickness: float) -> Wall:
        """Return a wall along a line, so much longer that walls with a common end close."""
        (x, y), (to_x, to_y) = start, end
        return Wall(
            x=(x + to_x) / 2,
            y=(y + to_y) / 2,
            width=math.dist(start, end) + thickness,
            height=thickness,
            angle_rad=math.atan2(to_y - y, to_x - x),
        )


def box_distance(x: np.ndarray, y: np.ndarray, wall: Wall) -> np.ndarray:
    """Return the distance in units from points to the surface of a wall; negative inside."""
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    dx, dy = x - wall.x, y - wall.y
    along = np.abs(cosine * dx + sine * dy) - wall.width / 2
    across = np.abs(cosine * dy - sine * dx) - wall.height / 2
    outside = np.hypot(np.maximum(along, 0), np.maximum(across, 0))
    return outside + np.minimum(np.maximum(along, across), 0)
