"""What robots sense and how they act: the one table of observation indices.

The definitions are those of the OpenNERO source code (2014): `RaySensor.cpp`,
`RadarSensor.cpp` and `mods/NERO/environment.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neatq_envs.neighbours import friend_offsets, grid_of
from neatq_envs.rays import barriers, ray_distances
from neatq_envs.scenario import BORDER_INSET, Scenario
from neatq_torch.jit import cached_njit

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

_WALL = ("wall_left_90", "wall_left_45", "wall_ahead", "wall_right_45", "wall_right_90")
_SECTORS = ("left", "ahead_left", "ahead_right", "right", "rear")
_FLAG = tuple(f"flag_{sector}" for sector in _SECTORS)
_ENEMY = tuple(f"enemy_{sector}" for sector in _SECTORS)
_SECOND_FLAG = tuple(f"second_flag_{sector}" for sector in _SECTORS)
_FRIEND = ("friend_proximity", "friend_direction")
_FEEDBACK = "last_reward"
_RAYS = np.array([(math.cos(angle), math.sin(angle)) for angle in RAY_ANGLES_RAD])


@dataclass(frozen=True)
class SensorSchema:
    """Meaning and order of observations, each in [0, 1], and of actions: a name for each index.

    The schema's own name is stored with whatever was trained on it, such as genomes.
    """

    name: str
    observations: tuple[str, ...]
    actions: tuple[str, ...]

    def index(self, observation: str) -> int:
        """The index of an observation."""
        return self.observations.index(observation)

    def action_bounds(self, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
        """The least and the greatest action, float32 [actions], in physical units."""
        high = {"speed": scenario.max_speed, "turn": scenario.max_turn_rad}
        low = {name: -value for name, value in high.items()}
        least = np.array([low.get(name, 0.0) for name in self.actions], dtype=np.float32)
        return least, np.array([high.get(name, 1.0) for name in self.actions], dtype=np.float32)


_MOTION, _NERO = ("speed", "turn"), ("speed", "turn", "fire", "ignore_friends")
# The order in which OpenNERO really filled its inputs, dead ones included: there are no enemies (by
# whose radar a second flag is seen), friend sensors took the place of the target ray, index 17 was
# never written. In the arena a second flag and feedback come last: the first 12 indices stay.
# Feedback is for worlds in which nothing else tells what counts: elsewhere a critic takes the last
# reward for the mark of a good robot, and learns less about what it does.
SCHEMAS: dict[str, SensorSchema] = {
    "arena": SensorSchema("arena-1", (*_WALL, *_FLAG, *_FRIEND), _MOTION),
    "opennero": SensorSchema("opennero-2014", (*_WALL, *_FLAG, *_ENEMY, *_FRIEND, "unused"), _NERO),
    "arena-two-flags": SensorSchema(
        "arena-1-two-flags", (*_WALL, *_FLAG, *_FRIEND, *_SECOND_FLAG), _MOTION
    ),
    "arena-feedback": SensorSchema("arena-1", (*_WALL, *_FLAG, *_FRIEND), _MOTION),
    "arena-feedback-two-flags": SensorSchema(
        "arena-1-feedback-two-flags",
        (*_WALL, *_FLAG, *_FRIEND, *_SECOND_FLAG, _FEEDBACK),
        _MOTION,
    ),
    "opennero-two-flags": SensorSchema(
        "opennero-2014-two-flags", (*_WALL, *_FLAG, *_SECOND_FLAG, *_FRIEND, "unused"), _NERO
    ),
}
IGNORE_ABOVE = 0.5


def schema_of(scenario: Scenario) -> SensorSchema:
    """The schema of a scenario's sensors: of one flag or of two."""
    return SCHEMAS[scenario.sensors + ("-two-flags" if scenario.flag.switch_ticks else "")]


class Senses:
    """Senses all robots of one scenario, which gives the walls and the schema."""

    def __init__(self, scenario: Scenario) -> None:
        self.schema = schema_of(scenario)
        has = _FEEDBACK in self.schema.observations
        self._feedback = self.schema.index(_FEEDBACK) if has else None
        size = scenario.width, scenario.height
        self._barriers = barriers(scenario.walls, *size, BORDER_INSET)
        self._grid = grid_of(*size, scenario.robots, FRIEND_RANGE)

    def sense(
        self,
        position: np.ndarray,
        ahead: np.ndarray,
        flag: np.ndarray,
        ignore: np.ndarray | None = None,
        second: np.ndarray | None = None,
        reward: np.ndarray | None = None,
    ) -> np.ndarray:
        """Observations, float32 [arenas, robots, observations], each in [0, 1].

        What they read is in the table of `neatq_envs.torchrl_env.ArenaEnv`. The borders of a radar
        sector belong to it, and walls do not hide flags. Alone, a robot reads 1 and 0.5 of friends.

        Args:
            position: float64 [arenas, robots, 2] in units.
            ahead: cosine and sine of the headings, float64 [arenas, robots, 2].
            flag: float64 [arenas, 2] in units.
            ignore: bool [arenas, robots]; where true, friend sensors read 0.
            second: place of the second flag, likewise; needed if the schema has sensors for it.
            reward: of the last tick, float64 [arenas, robots], read where the schema has it; None
                at the beginning of a life, where it reads 0.5.
        """
        values = np.zeros((*position.shape[:2], len(self.schema.observations)), dtype=np.float32)
        walls = ray_distances(position, ahead, _RAYS, RAY_LENGTH, self._barriers)
        friends = friend_offsets(position, self._grid, FRIEND_RANGE)
        friend = self.schema.index("friend_proximity")
        _write_values(values, friend, walls, friends, position, ahead, flag)
        if second is not None:
            index = self.schema.index(_SECOND_FLAG[0])
            _write_flag(values[..., index:], position, ahead, second)
        if self._feedback is not None:
            values[..., self._feedback] = 0.5 if reward is None else reward
        if ignore is not None and ignore.any():
            values[ignore, friend : friend + 2] = 0.0
        return values


@cached_njit()
def _write_values(
    values: np.ndarray,
    friend: int,
    walls: np.ndarray,
    friends: np.ndarray,
    position: np.ndarray,
    ahead: np.ndarray,
    flag: np.ndarray,
) -> None:
    """Write `Senses.sense` into zeros; `friend` is the index of the first friend sensor.

    `walls` are distances [arenas, robots, rays], `friends` ways [arenas, robots, 2], in units.
    """
    _write_flag(values[..., len(RAY_ANGLES_RAD) :], position, ahead, flag)
    arenas, robots, rays = walls.shape
    for arena in range(arenas):
        for robot in range(robots):
            value = values[arena, robot]
            for ray in range(rays):
                distance = walls[arena, robot, ray]
                if distance <= RAY_LENGTH:
                    value[ray] = RAY_NEAR / max(distance, RAY_NEAR)
            x, y = friends[arena, robot, 0], friends[arena, robot, 1]
            distance = math.sqrt(x * x + y * y)
            value[friend] = max(1.0 - distance / FRIEND_RANGE, 0.0)
            value[friend + 1] = 0.5
            if distance > 1e-9:  # a mean of equal places may miss them by a rounding error
                value[friend + 1] += _angle_rad(x, y, ahead[arena, robot]) / (2 * math.pi)


@cached_njit()
def _write_flag(
    values: np.ndarray, position: np.ndarray, ahead: np.ndarray, flag: np.ndarray
) -> None:
    """Write the radar of a flag into values that begin with its sensors."""
    arenas, robots, _ = position.shape
    for arena in range(arenas):
        for robot in range(robots):
            x = flag[arena, 0] - position[arena, robot, 0]
            y = flag[arena, 1] - position[arena, robot, 1]
            distance = math.sqrt(x * x + y * y)
            if distance <= RADAR_RANGE:
                near = RADAR_NEAR / max(distance, RADAR_NEAR)
                angle_deg = math.degrees(_angle_rad(x, y, ahead[arena, robot]))
                for sector, (left, right) in enumerate(RADAR_SECTORS_DEG):
                    if right <= angle_deg <= left:
                        values[arena, robot, sector] = near
                if abs(angle_deg) >= RADAR_REAR_DEG:
                    values[arena, robot, len(RADAR_SECTORS_DEG)] = near


@cached_njit()
def _angle_rad(x: float, y: float, ahead: np.ndarray) -> float:
    """The angle from the heading to the left to a way (x, y), in (-pi, pi]."""
    along, across = ahead[0] * x + ahead[1] * y, ahead[0] * y - ahead[1] * x
    return math.atan2(across, along)
