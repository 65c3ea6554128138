"""How far along a ray the first wall is met: for wall sensors, and for robots that were pressed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from neatq_envs.walls import Wall
from neatq_torch.jit import cached_njit


class Barriers(NamedTuple):
    """All that stops a ray, in units.

    `boxes`, float64 [walls, 7], hold centre x and y, cosine and sine of the turn, half the width,
    half the height, half the diagonal.
    """

    boxes: np.ndarray
    low: float  # the least x and y inside the border walls
    high_x: float
    high_y: float


def barriers(walls: Iterable[Wall], width: float, height: float, inset: float) -> Barriers:
    """The walls of a field whose border walls begin `inset` units inside its edges."""
    boxes = [
        [
            *(wall.x, wall.y, math.cos(wall.angle_rad), math.sin(wall.angle_rad)),
            *(wall.width / 2, wall.height / 2, math.hypot(wall.width, wall.height) / 2),
        ]
        for wall in walls
    ]
    return Barriers(np.array(boxes).reshape(-1, 7), inset, width - inset, height - inset)


@cached_njit()
def ray_distances(
    position: np.ndarray, ahead: np.ndarray, turns: np.ndarray, reach: float, barriers: Barriers
) -> np.ndarray:
    """How far along each ray the first barrier is met, float64 [arenas, robots, rays].

    Infinite if none is, 0 from inside a box.

    Args:
        position: where the rays start, float64 [arenas, robots, 2], units.
        ahead: float64 [arenas, robots, 2]; the unit of distances is its length.
        turns: cosine and sine of the angle from `ahead` to each ray, float64 [rays, 2].
        reach: barriers further away than that, in the same unit, need not be found.
        barriers: the field and its walls.
    """
    low, high_x, high_y, boxes = barriers.low, barriers.high_x, barriers.high_y, barriers.boxes
    arenas, robots, _ = position.shape
    distances = np.full((arenas, robots, len(turns)), np.inf)
    for arena in range(arenas):
        for robot in range(robots):
            x, y = position[arena, robot, 0], position[arena, robot, 1]
            way_x, way_y = ahead[arena, robot, 0], ahead[arena, robot, 1]
            span = reach * math.sqrt(way_x * way_x + way_y * way_y)
            if min(x - low, high_x - x, y - low, high_y - y) <= span:
                for ray in range(len(turns)):
                    ray_x, ray_y = _turned(way_x, way_y, turns, ray)
                    # From inside, the border is met where the ray leaves the first of its slabs.
                    distance = min(_exit(x, ray_x, low, high_x), _exit(y, ray_y, low, high_y))
                    distances[arena, robot, ray] = distance
            for box in range(len(boxes)):
                dx, dy = x - boxes[box, 0], y - boxes[box, 1]
                if dx * dx + dy * dy > (span + boxes[box, 6]) ** 2:
                    continue
                for ray in range(len(turns)):
                    ray_x, ray_y = _turned(way_x, way_y, turns, ray)
                    distance = _box_distance(dx, dy, ray_x, ray_y, boxes[box])
                    distances[arena, robot, ray] = min(distance, distances[arena, robot, ray])
    return distances


@cached_njit()
def _turned(x: float, y: float, turns: np.ndarray, ray: int) -> tuple[float, float]:
    cosine, sine = turns[ray, 0], turns[ray, 1]
    return x * cosine - y * sine, y * cosine + x * sine


@cached_njit()
def _exit(place: float, ray: float, low: float, high: float) -> float:
    """How far along a ray the slab low..high is left."""
    gap = high - place if ray > 0 else place - low
    return max(gap, 0.0) / max(abs(ray), 1e-12)


@cached_njit()
def _box_distance(dx: float, dy: float, ray_x: float, ray_y: float, box: np.ndarray) -> float:
    """How far along a ray, (dx, dy) from its centre on, a box is met (Kay & Kajiya 1986)."""
    cosine, sine = box[2], box[3]
    enter, leave = _slab(cosine * dx + sine * dy, cosine * ray_x + sine * ray_y, box[4])
    near, far = _slab(cosine * dy - sine * dx, cosine * ray_y - sine * ray_x, box[5])
    enter, leave = max(enter, near), min(leave, far)
    return max(enter, 0.0) if enter <= leave and leave >= 0 else np.inf


@cached_njit()
def _slab(place: float, ray: float, half: float) -> tuple[float, float]:
    """Where a ray enters and leaves the slab -half..half."""
    # A ray along the slab never crosses it: a tiny component puts the crossings far away.
    inverse = 1.0 / (1e-12 if abs(ray) < 1e-12 else ray)
    centre, reach = -place * inverse, half * abs(inverse)
    return centre - reach, centre + reach
