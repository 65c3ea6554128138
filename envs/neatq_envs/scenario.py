"""What a world is made of: field, walls, spawn points, flag and reward.

A user writes a scenario as a JSON file; what is left out comes from the task "flag":

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
(mods/NERO, 2014). Three more tell ways of learning apart:

* "trap": a pocket between spawn and flag, open towards the spawn. Who runs straight to the flag
  ends 139 units from it, and must go back to 266, as far as the spawn, before a way leads around.
* "maze": the hard maze of Lehman & Stanley (2011); see `neatq_envs.walls`. The straight way
  ends in the first room, 138 units from the flag. Its door leads away from the flag, to 189, and
  on into a dead end at 87, from which the way leads back to 127.
* "switch": two flags that are always seen, 200 units apart, as far from the spawn as that of
  "flag". Only one counts, every 610 ticks it is the other one, and nothing but the reward tells
  which. A robot that never changes its mind is 100 units away on average, wherever between the
  two it waits. 610 ticks fit evenly into neither lives of 1000 nor rows of metrics, so that lives
  begin, and rows fall, at all moments between two switches.
* "behind": the flags of "switch" behind a wall. Who runs straight to the one that counts waits
  below it, at 161 over a life; who gets around the wall and never changes its mind has 136.

docs/worlds.md tells what standing still, the straight way and a perfect robot come to on each. The
shortest ways are 141, 288, 413 and 450 units long ("flag", "wall", "trap", "maze").
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neatq_envs.checks import (
    ScenarioError,
    from_json,
    read_object,
    require,
    require_alike,
    require_fields,
    require_known,
    shown,
)
from neatq_envs.flags import FlagSchedule
from neatq_envs.walls import MAZE_GOAL, MAZE_START, Wall, box_distance, hard_maze

REWARD_DIMENSIONS: tuple[str, ...] = ("stand_ground", "stick_together", "approach_flag")
REWARD_LAWS: tuple[str, ...] = ("published", "progress")
SENSOR_SETS: tuple[str, ...] = ("arena", "arena-feedback", "opennero")
_FILE_BYTES = 10_000_000
BORDER_INSET = 2.0
"""Distance in units from the edge of the field to the inner face of its border wall."""


@dataclass(frozen=True, kw_only=True)
class Spawn:
    """Where lives begin: (x, y) plus a whole number from -jitter to jitter - 1 on each axis."""

    x: float
    y: float
    jitter: int = 20

    def __post_init__(self) -> None:
        require_fields(Spawn, vars(self))

    def offsets(self) -> np.ndarray:
        """Every offset of one axis that a robot may get."""
        return np.arange(-self.jitter, max(self.jitter, 1))


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
        sensors: "arena", "arena-feedback" or "opennero"; see `neatq_envs.sensors`.
        reward: "published" or "progress"; see `neatq_envs.rewards`.
        reward_weights: weight of each reward dimension; those left out are 0.
        lifetime_ticks: after so many ticks a life is truncated; 0 = lives have no limit.
        first_lives: "spread": robots are of all ages when a world begins, so that lives end one
            after the other. None: they begin, and where nobody is born end, all together, and so
            together with whatever the world does every few lives.
        max_speed: units per tick, forwards or backwards; at most `robot_radius`.
        max_turn_rad: largest turn in one tick.
        robot_radius: units.
        collide: whether robots collide with each other (walls always stop them). Nobody is pushed
            faster than `max_speed`. Robots that press on each other overlap: 200 in one corner by
            less than one radius at speeds of up to half a radius per tick, but by nearly two at
            higher ones; those that begin on top of each other part within a few hundred ticks.
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
    first_lives: str | None = None
    max_speed: float = 1.0
    max_turn_rad: float = 0.2
    robot_radius: float = 4.09
    collide: bool = False

    def __post_init__(self) -> None:
        require_fields(Scenario, vars(self))
        object.__setattr__(self, "walls", tuple(self.walls))
        object.__setattr__(self, "spawns", tuple(self.spawns))
        object.__setattr__(self, "reward_weights", dict(self.reward_weights))
        require_known("sensors", self.sensors, SENSOR_SETS)
        require_known("reward", self.reward, REWARD_LAWS)
        if self.first_lives is not None:
            require_known("first_lives", self.first_lives, ("spread",))
        self._check_motion()
        self._check_weights()
        self._check_spawns()
        self._check_flag()

    def weights(self) -> np.ndarray:
        """Reward weights, float64 [dimensions], in the order of `REWARD_DIMENSIONS`."""
        return np.array([self.reward_weights.get(name, 0.0) for name in REWARD_DIMENSIONS])

    def replaced(self, **changes: Any) -> Scenario:
        """A copy with `changes`, checked again."""
        return replace(self, **changes)

    def refuse_change(self, after: Scenario) -> None:
        """Raise a `ScenarioError` if robots that live here could not go on in another scenario."""
        require_alike(self, after, CHANGEABLE)
        require(
            bool(self.flag.switch_ticks) == bool(after.flag.switch_ticks),
            "flag.switch_ticks: robots have sensors for one flag or for two, and keep them",
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON values that `from_dict` reads back as an equal scenario."""
        return json.loads(json.dumps(asdict(self)))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Scenario:
        """Make a scenario of JSON values; keys left out come from the task "flag".

        A `ScenarioError` names the key that is unknown, of a wrong type or impossible.
        """
        return TASKS["flag"].replaced(**_read_scenario(values))

    def _check_motion(self) -> None:
        require(
            self.max_speed <= self.robot_radius,
            f"max_speed {self.max_speed} is greater than robot_radius {self.robot_radius}: "
            "a robot could pass through a wall within one tick; lower the speed",
        )

    def _check_weights(self) -> None:
        for name in self.reward_weights:
            require_known("reward_weights", name, REWARD_DIMENSIONS)
        given = [name for name, weight in self.reward_weights.items() if weight]
        require(bool(given), "reward_weights: all are 0; give at least one that is not")
        require(
            self.reward != "progress" or given == ["approach_flag"],
            'reward "progress" measures the way to the flag alone: give "approach_flag" the '
            "only reward weight that is not 0",
        )

    def _check_spawns(self) -> None:
        require(bool(self.spawns), "spawns: expected at least one spawn, got none")
        margin = BORDER_INSET + self.robot_radius
        for number, spawn in enumerate(self.spawns):
            offsets = spawn.offsets()
            xs, ys = spawn.x + offsets, spawn.y + offsets
            where = f"spawns[{number}] at ({spawn.x}, {spawn.y}) with jitter {spawn.jitter}"
            low, right, top = min(xs[0], ys[0]), xs[-1], ys[-1]
            require(
                low >= margin and right <= self.width - margin and top <= self.height - margin,
                f"{where}: a robot of radius {self.robot_radius} would touch the border; keep "
                f"x within {margin:g}..{self.width - margin:g} and y within "
                f"{margin:g}..{self.height - margin:g}, jitter included",
            )
            for index, wall in enumerate(self.walls):
                require(
                    not meets_wall(xs, ys, wall, self.robot_radius),
                    f"{where}: a robot of radius {self.robot_radius} would begin inside "
                    f"walls[{index}]; move the spawn or the wall, or lower the jitter",
                )

    def _check_flag(self) -> None:
        places = np.array(self.flag.positions).reshape(-1, 2)
        walled = np.broadcast_to(self.in_wall(*places.T), len(places)).tolist()
        for number, (x, y) in enumerate(self.flag.positions):
            where = f"flag.positions[{number}] ({x}, {y})"
            inside = 0 <= x <= self.width and 0 <= y <= self.height
            require(inside, f"{where} is outside the field of {self.width} x {self.height}")
            require(not walled[number], f"{where} is inside a wall; move it")
        if self.flag.ring is not None:
            self._check_ring(self.flag.ring)

    def _check_ring(self, ring: tuple[float, float]) -> None:
        spawn, (least, greatest) = self.spawns[0], ring
        room = min(spawn.x, spawn.y, self.width - spawn.x, self.height - spawn.y)
        require(
            greatest <= room,
            f"flag.ring: the greatest radius {greatest} leaves the field; round the first "
            f"spawn there is room for {room:g}",
        )
        # The flag is drawn again where it falls into a wall: a tenth of the ring must be free.
        radius, angle = np.meshgrid(np.linspace(least, greatest, 9), np.linspace(0, 2 * np.pi, 73))
        x, y = spawn.x + radius * np.cos(angle), spawn.y + radius * np.sin(angle)
        words = "flag.ring: nearly all of the ring is inside walls; move them"
        require(self.in_wall(x, y).mean() <= 0.9, words)

    def in_wall(self, x: ArrayLike, y: ArrayLike) -> np.ndarray:
        """Whether points lie in a wall, of the shape of `x` and `y`; just false without walls."""
        x, y = np.asarray(x), np.asarray(y)
        return np.any([box_distance(x, y, wall) <= 0 for wall in self.walls], axis=0)


def meets_wall(xs: np.ndarray, ys: np.ndarray, wall: Wall, radius: float) -> bool:
    """Whether a robot at one of the places `xs` x `ys` would touch a wall."""
    cosine, sine = abs(math.cos(wall.angle_rad)), abs(math.sin(wall.angle_rad))
    # Only near the wall, one column at a time: there may be millions of places.
    far_x = (cosine * wall.width + sine * wall.height) / 2 + radius
    far_y = (cosine * wall.height + sine * wall.width) / 2 + radius
    near = ys[np.abs(ys - wall.y) <= far_y]
    columns = xs[np.abs(xs - wall.x) <= far_x].tolist()
    return any((box_distance(np.array(x), near, wall) < radius).any() for x in columns)


CHANGEABLE = ("walls", "spawns", "flag", "reward_weights", "lifetime_ticks")
"""What may be another while robots live in a scenario."""
Source = Scenario | Mapping[str, Any] | Path | str
"""A task's name, the path of a JSON file, the content of one, or a scenario."""


def find_scenario(
    source: Source,
    *,
    defaults: Mapping[str, Any] = MappingProxyType({}),
    changes: Mapping[str, Any] = MappingProxyType({}),
) -> Scenario:
    """The scenario that somebody means.

    Args:
        source: see `Source`.
        defaults: JSON values that a file or its content leaves out, and those of a task that are
            others; a scenario keeps its own.
        changes: JSON values that replace those of the source; None leaves the source's own.

    Raises:
        ScenarioError: There is no such task or file, or the scenario cannot be.
    """
    wanted = _read_scenario({key: value for key, value in changes.items() if value is not None})
    if isinstance(source, Scenario):
        return source.replaced(**wanted)
    usual, plain = _read_scenario(defaults), TASKS["flag"]
    if isinstance(source, Mapping):
        return plain.replaced(**(usual | _read_scenario(source) | wanted))
    if source in TASKS:
        return TASKS[str(source)].replaced(**(usual | wanted))
    with naming_file(source):
        values = _read_scenario(file_values(Path(source), TASKS))
        return plain.replaced(**(usual | values | wanted))


@contextmanager
def naming_file(source: object) -> Iterator[None]:
    """Let whatever is wrong with a scenario file be told with its name.

    Raises:
        ScenarioError: In place of what came.
    """
    try:
        yield
    except OSError as error:
        raise ScenarioError(f"{source}: cannot be read: {error.strerror}") from error
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}") from error
    except ValueError as error:  # no JSON, no UTF-8, or no name of a file
        raise ScenarioError(f"{source}: is not JSON: {error}") from error


def file_values(path: Path, known: Iterable[str]) -> Any:
    """The JSON value in a file; what is none may have been meant for a known name."""
    words = f"expected {', '.join(known)} or the path of a scenario file (.json); got"
    require(bool(path.suffix) or path.exists(), f"task: {words} {shown(str(path))}")
    size = path.stat().st_size
    require(size <= _FILE_BYTES, f"has {size:,} bytes; expected at most {_FILE_BYTES:,}")
    return from_json(path.read_text(encoding="utf-8"))


def _read_scenario(values: Any) -> dict[str, Any]:
    """Values of `Scenario` from JSON values; errors name the key."""
    require_fields(Scenario, values)
    read = dict(values)
    for key, kind in (("walls", Wall), ("spawns", Spawn)):
        if key in read:
            read[key] = [read_object(kind, one, f"{key}[{i}]") for i, one in enumerate(read[key])]
    if "flag" in read:
        read["flag"] = read_object(FlagSchedule, read["flag"], "flag")
    return read


# The places of the published moving-flag run, recovered from its figure: they were drawn in a
# ring of 100 to 250 units round the spawn. A fixed list is the same for every algorithm.
_FLAG_X = 251.9, 253.5, 537.0, 414.1, 324.6, 299.6, 458.2, 611.1, 392.5, 344.7, 235.1, 432.2, 353.9
_FLAG_Y = 195.4, 310.2, 170.7, 396.3, 127.8, 388.9, 181.3, 184.5, 393.5, 164.9, 424.9, 141.2, 26.8
_MOVING = FlagSchedule(positions=tuple(zip(_FLAG_X, _FLAG_Y, strict=True)), interval_ticks=5000)
_MAZE = (3.0, 2.0)  # the map's origin, for a field that just holds its outer walls
TASKS: dict[str, Scenario] = {
    "flag": Scenario(name="flag"),
    "moving": Scenario(name="moving", flag=_MOVING),
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
        spawns=(Spawn(x=_MAZE[0] + MAZE_START[0], y=_MAZE[1] + MAZE_START[1], jitter=6),),
        flag=FlagSchedule(positions=((_MAZE[0] + MAZE_GOAL[0], _MAZE[1] + MAZE_GOAL[1]),)),
        walls=hard_maze(*_MAZE),
    ),
    "switch": Scenario(
        name="switch",
        flag=FlagSchedule(positions=((300.0, 166.67), (500.0, 166.67)), switch_ticks=610),
    ),
    "behind": Scenario(
        name="behind",
        flag=FlagSchedule(positions=((300.0, 533.33), (500.0, 533.33)), switch_ticks=610),
        walls=(Wall(x=400.0, y=400.0, width=300.0, height=4.0),),
    ),
}
