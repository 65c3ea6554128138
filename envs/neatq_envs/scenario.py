"""What a world is made of: field, walls, spawn points, flag and reward.

A scenario is frozen data. A user writes one as a JSON file; what is left out comes from the
task "flag":

    {
      "name": "two walls",
      "robots": 30,
      "spawns": [{"x": 400, "y": 150, "jitter": 20}],
      "walls": [{"x": 300, "y": 400, "width": 200, "height": 4},
                {"x": 500, "y": 500, "width": 100, "height": 4, "angle_rad": 0.5}],
      "flag": {"positions": [[400, 650], [200, 600]], "interval_ticks": 5000},
      "reward_weights": {"approach_flag": 1.0}
    }

The geometry of the tasks "flag", "moving" and "wall" is that of the OpenNERO source code
(mods/NERO, 2014). Three more are there to tell ways of learning apart:

* "trap": a pocket between spawn and flag, open towards the spawn. Who runs straight to the flag
  ends 139 units from it, and must go back to 266, as far as the spawn, before a way leads around.
* "maze": the hard maze of Lehman & Stanley (2011); see `neatq_envs.hard_maze`. The straight way
  ends in the first room, 138 units from the flag. Its door leads away from the flag, to 189, and
  on into a dead end at 87, from which the way leads back to 127.
* "switch": two flags that are always seen, 200 units apart, as far from the spawn as that of
  "flag". Only one counts, every 610 ticks it is the other one, and nothing but the reward tells
  which. A robot that never changes its mind is 100 units away on average, wherever between the
  two it waits. 610 ticks fit evenly into neither lives of 1000 nor rows of metrics, so that lives
  begin, and rows fall, at all moments between two switches.

In units, with d the distance from the spawn to the flag, which is what standing still costs, and
means over a life of 1000 ticks: of a robot that runs straight to the flag until a wall holds it,
and of a perfect one, on the shortest way (on "switch", always straight to the flag that counts).

| task | d | straight | perfect | shortest way |
| --- | --- | --- | --- | --- |
| flag | 141 | 10 | 10 | 141 |
| wall | 267 | 147 | 40 | 288 |
| trap | 267 | 147 | 73 | 413 |
| maze | 164 | 139 | 53 | 450 |
| switch | 141 | 102 (to one of the two) | 38 | |
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from neatq_envs.checks import (
    ScenarioError,
    is_number,
    require_choice,
    require_finite,
    require_whole,
)
from neatq_envs.hard_maze import GOAL, START, hard_maze
from neatq_envs.places import FlagSchedule, Spawn
from neatq_envs.walls import Wall, box_distance

REWARD_DIMENSIONS: tuple[str, ...] = ("stand_ground", "stick_together", "approach_flag")
REWARD_LAWS: tuple[str, ...] = ("published", "bounded", "progress")
SENSOR_SETS: tuple[str, ...] = ("arena", "opennero")
BORDER_INSET = 2.0
"""Distance in units from the edge of the field to the inner face of its border wall."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One world: everything that is the same for all arenas of a run.

    Attributes:
        name: shown in reports.
        width: of the field, in units.
        height: of the field, in units.
        robots: robots in each arena.
        walls: obstacles; the border of the field is always walled.
        spawns: robot i begins its lives at spawn i modulo their number.
        flag: where the flag stands and when it moves, or two flags of which one counts.
        sensors: "arena" or "opennero"; see `neatq_envs.sensors`.
        reward: "published", "bounded" or "progress"; see `neatq_envs.rewards`.
        reward_weights: weight of each reward dimension; those left out are 0.
        lifetime_ticks: after so many ticks a life is truncated; 0 = lives have no limit.
        max_speed: units per tick, forwards or backwards; at most `robot_radius`.
        max_turn_rad: largest turn in one tick.
        robot_radius: units.
        collide: whether robots collide with each other (walls always stop them).
    """

    name: str
    width: float = 800.0
    height: float = 800.0
    robots: int = 50
    walls: tuple[Wall, ...] = ()
    spawns: tuple[Spawn, ...] = (Spawn(x=400.0, y=266.67),)
    flag: FlagSchedule = field(default_factory=lambda: FlagSchedule(positions=((300.0, 166.67),)))
    sensors: str = "arena"
    reward: str = "published"
    reward_weights: Mapping[str, float] = field(default_factory=lambda: {"approach_flag": 1.0})
    lifetime_ticks: int = 1000
    max_speed: float = 1.0
    max_turn_rad: float = 0.2
    robot_radius: float = 4.09
    collide: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "walls", tuple(self.walls))
        object.__setattr__(self, "spawns", tuple(self.spawns))
        object.__setattr__(self, "reward_weights", dict(self.reward_weights))
        require_finite(self, "scenario")
        require_whole("scenario", "robots", self.robots, minimum=1)
        require_whole("scenario", "lifetime_ticks", self.lifetime_ticks, minimum=0)
        require_choice("sensors", self.sensors, SENSOR_SETS)
        require_choice("reward", self.reward, REWARD_LAWS)
        self._check_motion()
        self._check_weights()
        self._check_spawns()
        self._check_flag()

    def weights(self) -> np.ndarray:
        """Return reward weights, float64 [dimensions], in the order of `REWARD_DIMENSIONS`."""
        return np.array([self.reward_weights.get(name, 0.0) for name in REWARD_DIMENSIONS])

    def replaced(self, **changes: Any) -> Scenario:
        """Return a copy with `changes`, checked again."""
        return Scenario(
            **({entry.name: getattr(self, entry.name) for entry in fields(self)} | changes)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that `from_dict` reads back as an equal scenario."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        values["walls"] = [asdict(wall) for wall in self.walls]
        values["spawns"] = [asdict(spawn) for spawn in self.spawns]
        values["flag"] = json.loads(json.dumps(asdict(self.flag)))
        values["reward_weights"] = dict(self.reward_weights)
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], defaults: Scenario | None = None) -> Scenario:
        """Make a scenario of JSON values; keys left out come from `defaults` (task "flag").

        Raises:
            ScenarioError: naming the key that is unknown, of a wrong type or impossible.
        """
        from neatq_envs.scenario_file import parse_scenario

        return parse_scenario(values, TASKS["flag"] if defaults is None else defaults)

    def _check_motion(self) -> None:
        for name in ("width", "height", "max_speed", "robot_radius"):
            if getattr(self, name) <= 0:
                raise ScenarioError(f"{name}: must be greater than 0, got {getattr(self, name)}")
        if not 0 <= self.max_turn_rad <= math.pi:
            raise ScenarioError(f"max_turn_rad: must lie in 0..pi, got {self.max_turn_rad}")
        if self.max_speed > self.robot_radius:
            raise ScenarioError(
                f"max_speed {self.max_speed} is greater than robot_radius {self.robot_radius}: "
                "a robot could pass through a wall within one tick; lower the speed"
            )

    def _check_weights(self) -> None:
        for name, weight in self.reward_weights.items():
            require_choice("reward_weights", name, REWARD_DIMENSIONS)
            if not is_number(weight) or not math.isfinite(weight):
                raise ScenarioError(f"reward_weights.{name}: expected a number, got {weight!r}")
        weights = dict(zip(REWARD_DIMENSIONS, self.weights().tolist(), strict=True))
        if not any(weights.values()):
            raise ScenarioError("reward_weights: all are 0; give at least one that is not")
        if self.reward == "progress" and (
            not weights.pop("approach_flag") or any(weights.values())
        ):
            raise ScenarioError(
                'reward "progress" measures the way to the flag alone: give "approach_flag" the '
                "only reward weight that is not 0"
            )

    def _check_spawns(self) -> None:
        if not self.spawns:
            raise ScenarioError("spawns: expected at least one spawn, got none")
        margin = BORDER_INSET + self.robot_radius
        for number, spawn in enumerate(self.spawns):
            xs, ys = spawn.x + spawn.offsets(), spawn.y + spawn.offsets()
            where = f"spawns[{number}] at ({spawn.x}, {spawn.y}) with jitter {spawn.jitter}"
            if not _inside(xs, ys, (self.width, self.height), margin):
                raise ScenarioError(
                    f"{where}: a robot of radius {self.robot_radius} would touch the border; keep "
                    f"x within {margin:g}..{self.width - margin:g} and y within "
                    f"{margin:g}..{self.height - margin:g}, jitter included"
                )
            for index, wall in enumerate(self.walls):
                if (box_distance(xs[:, None], ys[None, :], wall) < self.robot_radius).any():
                    raise ScenarioError(
                        f"{where}: a robot of radius {self.robot_radius} would begin inside "
                        f"walls[{index}]; move the spawn or the wall, or lower the jitter"
                    )

    def _check_flag(self) -> None:
        for number, (x, y) in enumerate(self.flag.positions):
            if not (0 <= x <= self.width and 0 <= y <= self.height):
                raise ScenarioError(
                    f"flag.positions[{number}] ({x}, {y}) is outside the field of "
                    f"{self.width} x {self.height}"
                )
            if self.in_wall(x, y):
                raise ScenarioError(
                    f"flag.positions[{number}] ({x}, {y}) is inside a wall; move it"
                )
        if self.flag.ring is not None:
            self._check_ring(self.flag.ring)

    def _check_ring(self, ring: tuple[float, float]) -> None:
        spawn, (least, greatest) = self.spawns[0], ring
        room = min(spawn.x, spawn.y, self.width - spawn.x, self.height - spawn.y)
        if greatest > room:
            raise ScenarioError(
                f"flag.ring: the greatest radius {greatest} leaves the field; round the first "
                f"spawn there is room for {room:g}"
            )
        # The flag is drawn again where it falls into a wall: a tenth of the ring must be free.
        radius, angle = np.meshgrid(np.linspace(least, greatest, 9), np.linspace(0, 2 * np.pi, 73))
        blocked = np.zeros(radius.shape, dtype=bool)
        for wall in self.walls:
            x, y = spawn.x + radius * np.cos(angle), spawn.y + radius * np.sin(angle)
            blocked |= box_distance(x, y, wall) <= 0
        if blocked.mean() > 0.9:
            raise ScenarioError("flag.ring: nearly all of the ring is inside walls; move them")

    def in_wall(self, x: float, y: float) -> bool:
        """Return whether a point lies in a wall."""
        return any(bool(box_distance(np.array(x), np.array(y), wall) <= 0) for wall in self.walls)


def load_scenario(path: Path | str, defaults: Scenario | None = None) -> Scenario:
    """Read a scenario from a JSON file (see the example at the top of this module).

    Args:
        path: the file.
        defaults: gives the keys that the file leaves out; task "flag" by default.

    Raises:
        ScenarioError: naming the file and what is wrong in it.
    """
    try:
        values = json.loads(Path(path).read_text(encoding="utf-8"))
        return Scenario.from_dict(values, defaults)
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: is not JSON: {error}") from error
    except ScenarioError as error:
        raise ScenarioError(f"{path}: {error}") from error


def _inside(xs: np.ndarray, ys: np.ndarray, size: tuple[float, float], margin: float) -> bool:
    low, high = min(xs.min(), ys.min()), (xs.max(), ys.max())
    return bool(low >= margin and high[0] <= size[0] - margin and high[1] <= size[1] - margin)


# The places of the published moving-flag run, recovered from its figure: they were drawn in a
# ring of 100 to 250 units round the spawn. A fixed list is the same for every algorithm.
MOVING_FLAG: tuple[tuple[float, float], ...] = (
    (251.9, 195.4),
    (253.5, 310.2),
    (537.0, 170.7),
    (414.1, 396.3),
    (324.6, 127.8),
    (299.6, 388.9),
    (458.2, 181.3),
    (611.1, 184.5),
    (392.5, 393.5),
    (344.7, 164.9),
    (235.1, 424.9),
    (432.2, 141.2),
    (353.9, 26.8),
)

_MAZE = (3.0, 2.0)  # the map's origin, for a field that just holds its outer walls

TASKS: dict[str, Scenario] = {
    "flag": Scenario(name="flag", flag=FlagSchedule(positions=((300.0, 166.67),))),
    "moving": Scenario(
        name="moving", flag=FlagSchedule(positions=MOVING_FLAG, interval_ticks=5000)
    ),
    "wall": Scenario(
        name="wall",
        flag=FlagSchedule(positions=((400.0, 533.33),)),
        walls=(Wall(x=400.0, y=400.0, width=100.0, height=4.0),),
    ),
    "trap": Scenario(
        name="trap",
        flag=FlagSchedule(positions=((400.0, 533.33),)),
        walls=(
            Wall(x=400.0, y=400.0, width=240.0, height=4.0),
            Wall(x=282.0, y=349.0, width=4.0, height=98.0),
            Wall(x=518.0, y=349.0, width=4.0, height=98.0),
        ),
    ),
    "maze": Scenario(
        name="maze",
        width=204.0,
        height=210.0,
        spawns=(Spawn(x=_MAZE[0] + START[0], y=_MAZE[1] + START[1], jitter=6),),
        flag=FlagSchedule(positions=((_MAZE[0] + GOAL[0], _MAZE[1] + GOAL[1]),)),
        walls=hard_maze(*_MAZE),
    ),
    "switch": Scenario(
        name="switch",
        flag=FlagSchedule(positions=((300.0, 166.67), (500.0, 166.67)), switch_ticks=610),
    ),
}
