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


def box_distance(x: np.ndarray, y: np.ndarray, wall: Wall) -> np.ndarray:
    """Return the distance in units from points to the surface of a wall; negative inside."""
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    dx, dy = x - wall.x, y - wall.y
    along = np.abs(cosine * dx + sine * dy) - wall.width / 2
    across = np.abs(cosine * dy - sine * dx) - wall.height / 2
    outside = np.hypot(np.maximum(along, 0), np.maximum(across, 0))
    return outside + np.minimum(np.maximum(along, across), 0)


def ray_distance(
    x: np.ndarray, y: np.ndarray, ray_x: np.ndarray, ray_y: np.ndarray, wall: Wall
) -> np.ndarray:
    """Return how far along each ray a box is met, infinite if it is missed; 0 from inside.

    By slabs (Kay & Kajiya 1986). The unit is the length of the ray vector (ray_x, ray_y).
    """
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    dx, dy = x - wall.x, y - wall.y
    enter, leave = _slab(cosine * dx + sine * dy, cosine * ray_x + sine * ray_y, wall.width / 2)
    near, far = _slab(cosine * dy - sine * dx, cosine * ray_y - sine * ray_x, wall.height / 2)
    enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    return np.where((enter <= leave) & (leave >= 0), np.maximum(enter, 0.0), np.inf)


def _slab(place: np.ndarray, ray: np.ndarray, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where a ray enters and leaves the slab -half..half."""
    # A ray along the slab never crosses it: a tiny component puts the crossings far away.
    inverse = 1.0 / np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    centre, reach = -place * inverse, half * np.abs(inverse)
    return centre - reach, centre + reach
