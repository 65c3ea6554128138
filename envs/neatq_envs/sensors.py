"""What robots sense and how they act: the one table of observation indices.

The definitions are those of the OpenNERO source code (2014): `RaySensor.cpp`,
`RadarSensor.cpp` and `mods/NERO/environment.py`. All functions are pure and work on all robots
of all arenas at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from neatq_envs.scenario import BORDER_INSET, Scenario
from neatq_envs.walls import Wall, ray_distance

RAY_LENGTH = 50.0
RAY_NEAR = 5.0  # a wall sensor reads min(1, RAY_NEAR / distance)
RAY_ANGLES_RAD: tuple[float, ...] = tuple(math.radians(d) for d in (90, 45, 0, -45, -90))
RADAR_RANGE = 300.0
RADAR_NEAR = 30.0  # a radar sector reads min(1, RADAR_NEAR / distance)
# (left border, right border) in degrees, left of the heading positive; they overlap on purpose.
# The last sector is the rear: at or beyond its borders.
RADAR_SECTORS_DEG: tuple[tuple[float, float], ...] = ((90, 12), (18, -3), (3, -18), (-12, -90))
RADAR_REAR_DEG = 87.0
FRIEND_RANGE = 15.0
DENSE_ROBOTS = 200  # more robots than this meet in blocks of rows, to bound the memory

_WALL = ("wall_left_90", "wall_left_45", "wall_ahead", "wall_right_45", "wall_right_90")
_SECTORS = ("left", "ahead_left", "ahead_right", "right", "rear")
_FLAG = tuple(f"flag_{sector}" for sector in _SECTORS)
_ENEMY = tuple(f"enemy_{sector}" for sector in _SECTORS)
_FRIEND = ("friend_proximity", "friend_direction")


@dataclass(frozen=True, kw_only=True)
class SensorSchema:
    """Meaning and order of observations and actions.

    Attributes:
        name: to be stored with whatever was trained on it, such as genomes.
        observations: one name for each index; every value lies in [0, 1]. A bias is not part of
            it: networks have their own.
        actions: one name for each index.
    """

    name: str
    observations: tuple[str, ...]
    actions: tuple[str, ...]

    def index(self, observation: str) -> int:
        """Return the index of an observation."""
        return self.observations.index(observation)

    def action_bounds(self, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and the greatest action, float32 [actions], in physical units."""
        high = {"speed": scenario.max_speed, "turn": scenario.max_turn_rad}
        low = {name: -value for name, value in high.items()}
        return (
            np.array([low.get(name, 0.0) for name in self.actions], dtype=np.float32),
            np.array([high.get(name, 1.0) for name in self.actions], dtype=np.float32),
        )


SCHEMAS: dict[str, SensorSchema] = {
    "arena": SensorSchema(
        name="arena-1", observations=(*_WALL, *_FLAG, *_FRIEND), actions=("speed", "turn")
    ),
    # The order in which OpenNERO really filled its inputs, dead ones included: there are no
    # enemies, friend sensors took the place of the target ray, index 17 was never written.
    "opennero": SensorSchema(
        name="opennero-2014",
        observations=(*_WALL, *_FLAG, *_ENEMY, *_FRIEND, "unused"),
        actions=("speed", "turn", "fire", "ignore_friends"),
    ),
}
IGNORE_ABOVE = 0.5


class Senses:
    """Senses all robots of one scenario.

    Args:
        scenario: gives the walls and the schema.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.schema = SCHEMAS[scenario.sensors]
        self._inner = (scenario.width - BORDER_INSET, scenario.height - BORDER_INSET)
        self._walls = scenario.walls

    def sense(
        self,
        position: np.ndarray,
        heading_rad: np.ndarray,
        flag: np.ndarray,
        ignore: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return observations, float32 [arenas, robots, observations], each in [0, 1].

        Args:
            position: float64 [arenas, robots, 2] in units.
            heading_rad: float64 [arenas, robots], counterclockwise from the x axis.
            flag: float64 [arenas, 2] in units.
            ignore: bool [arenas, robots]; where true, friend sensors read 0.
        """
        x, y = position[..., 0], position[..., 1]
        cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
        size = len(self.schema.observations)
        values = np.zeros((*heading_rad.shape, size), dtype=np.float32)
        values[..., :5] = wall_rays(x, y, cosine, sine, self._inner, self._walls)
        values[..., 5:10] = flag_radar(x, y, cosine, sine, flag)
        friends = self.schema.index("friend_proximity")
        values[..., friends], values[..., friends + 1] = friend_senses(x, y, cosine, sine)
        if ignore is not None and ignore.any():
            values[ignore, friends : friends + 2] = 0.0
        return values


def wall_rays(
    x: np.ndarray,
    y: np.ndarray,
    cosine: np.ndarray,
    sine: np.ndarray,
    inner: tuple[float, float],
    walls: tuple[Wall, ...] = (),
) -> np.ndarray:
    """Return wall sensors [..., 5]: min(1, 5 / distance), 0 if nothing is within 50 units.

    Args:
        x: of the robots [...], in units; likewise `y`.
        y: see `x`.
        cosine: of the headings [...].
        sine: of the headings [...].
        inner: the greatest x and y inside the border walls; the least are `BORDER_INSET`.
        walls: obstacles.
    """
    turn_x, turn_y = np.cos(RAY_ANGLES_RAD), np.sin(RAY_ANGLES_RAD)
    ray_x = cosine[..., None] * turn_x - sine[..., None] * turn_y
    ray_y = sine[..., None] * turn_x + cosine[..., None] * turn_y
    # From inside, the border is met where the ray leaves the first of its two slabs.
    distance = np.minimum(
        _exit_distance(x[..., None], ray_x, inner[0]), _exit_distance(y[..., None], ray_y, inner[1])
    )
    for wall in walls:
        distance = np.minimum(
            distance, ray_distance(x[..., None], y[..., None], ray_x, ray_y, wall)
        )
    near = RAY_NEAR / np.maximum(distance, RAY_NEAR)
    return np.where(distance <= RAY_LENGTH, near, 0.0)


def _exit_distance(place: np.ndarray, ray: np.ndarray, high: float) -> np.ndarray:
    gap = np.where(ray > 0, high - place, place - BORDER_INSET)
    return np.maximum(gap, 0.0) / np.maximum(np.abs(ray), 1e-12)


def flag_radar(
    x: np.ndarray, y: np.ndarray, cosine: np.ndarray, sine: np.ndarray, flag: np.ndarray
) -> np.ndarray:
    """Return the flag radar [arenas, robots, 5]: min(1, 30 / distance) where the flag is.

    The borders of a sector belong to it. Beyond 300 units nothing is seen; walls do not hide.
    """
    dx, dy = flag[:, None, 0] - x, flag[:, None, 1] - y
    distance = np.sqrt(dx * dx + dy * dy)
    angle_deg = np.degrees(np.arctan2(cosine * dy - sine * dx, cosine * dx + sine * dy))
    value = RADAR_NEAR / np.maximum(distance, RADAR_NEAR)
    value = np.where(distance <= RADAR_RANGE, value, 0.0)
    seen = np.empty((*x.shape, 5))
    for sector, (left, right) in enumerate(RADAR_SECTORS_DEG):
        np.multiply(value, (angle_deg <= left) & (angle_deg >= right), out=seen[..., sector])
    np.multiply(value, np.abs(angle_deg) >= RADAR_REAR_DEG, out=seen[..., 4])
    return seen


def friend_senses(
    x: np.ndarray, y: np.ndarray, cosine: np.ndarray, sine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return proximity and direction [arenas, robots] of the middle of the friends nearby.

    The middle is the mean position of all robots within 15 units, the robot itself included.
    Proximity is 1 - d / 15; direction is (angle to the left + 180) / 360 degrees, 0.5 = ahead.
    Alone: 1 and 0.5.
    """
    dx, dy = _friend_offsets(x, y)
    distance = np.sqrt(dx * dx + dy * dy)
    proximity = np.clip(1.0 - distance / FRIEND_RANGE, 0.0, 1.0)
    angle = np.arctan2(cosine * dy - sine * dx, cosine * dx + sine * dy)
    # A mean of equal places may miss them by a rounding error, which has no direction.
    direction = np.where(distance < 1e-9, 0.5, angle / (2 * np.pi) + 0.5)
    return proximity, direction


def _friend_offsets(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the way from each robot to the middle of its friends."""
    places = np.stack([x, y, np.ones_like(x)], axis=-1)
    sums = np.empty_like(places)
    for block, squared in _pair_distances(x, y):
        near = (squared <= FRIEND_RANGE**2).astype(np.float64)
        np.matmul(near, places, out=sums[:, block])
    return sums[..., 0] / sums[..., 2] - x, sums[..., 1] / sums[..., 2] - y


def nearest_friend_squared(position: np.ndarray) -> np.ndarray:
    """Return the squared distance [arenas, robots] to the nearest friend, infinite if alone."""
    nearest = np.empty(position.shape[:2])
    for block, squared in _pair_distances(position[..., 0], position[..., 1]):
        own = np.arange(squared.shape[1])
        squared[:, own, block.start + own] = np.inf
        nearest[:, block] = squared.min(-1)
    return nearest


def _pair_distances(x: np.ndarray, y: np.ndarray) -> Iterator[tuple[slice, np.ndarray]]:
    """Yield squared distances [arenas, rows, robots] of blocks of robots to all robots."""
    x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
    robots = x.shape[-1]
    rows = robots if robots <= DENSE_ROBOTS else max(1, DENSE_ROBOTS**2 // robots)
    for start in range(0, robots, rows):
        block = slice(start, start + rows)
        squared, across = x[:, None, :] - x[:, block, None], y[:, None, :] - y[:, block, None]
        np.multiply(squared, squared, out=squared)
        squared += np.multiply(across, across, out=across)
        yield block, squared
