"""A field of NERO as data: teams, turrets, walls, how one senses, shoots and is rewarded.

A user writes one as a JSON file, for training and for battle; what is left out comes from
"battle", the field of the OpenNERO tournament of 2011:

    {"name": "two walls", "turrets": [[400, 600]], "hit_points": 40, "sensors": "nero-1",
     "walls": [{"x": 300, "y": 400, "width": 200, "height": 4, "angle_rad": 0.3}]}
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from neatq_envs.checks import (
    pair,
    read_object,
    require,
    require_alike,
    require_fields,
    require_known,
    shown,
)
from neatq_envs.scenario import BORDER_INSET, Spawn, file_values, meets_wall, naming_file
from neatq_envs.walls import Wall, box_distance

REWARD_NAMES: tuple[str, ...] = (
    "stand_ground",
    "stick_together",
    "approach_enemy",
    "approach_flag",
    "hit_target",
    "avoid_fire",
)
SENSORS: tuple[str, ...] = ("opennero-2011", "opennero-2014", "nero-1")
FIRING: tuple[str, ...] = ("2011", "2014", "aimed")
OBSERVATIONS = {"opennero-2011": 18, "opennero-2014": 18, "nero-1": 23}
"""How many values each set of sensors has; see `kernels.sense`."""
NERO_ACTIONS: dict[str, tuple[str, ...]] = {
    "opennero-2011": ("speed", "turn"),
    "opennero-2014": ("speed", "turn", "fire", "ignore_friends"),
    "nero-1": ("speed", "turn", "fire"),
}
_RADIUS = 6.53
_ROOM = _RADIUS + BORDER_INSET


@dataclass(frozen=True, kw_only=True)
class NeroScenario:
    """One field of NERO.

    Attributes:
        name: shown in reports.
        width: of the field, in units.
        height: of the field, in units.
        robots: robots in each team.
        walls: obstacles, at any angle; the border of the field is always walled.
        spawns: team i begins at spawn i; more teams than spawns share them.
        turrets: places (x, y) of turrets, enemies of all teams, that stand, turn and shoot.
        flag: (x, y) of a flag, or None.
        sensors: "opennero-2011", "opennero-2014" or "nero-1"; see `neatq_envs.nero.kernels.sense`.
        firing: "2011": at whoever is within 2 degrees, by itself, and better from afar; "2014":
            when asked for, and aiming turns the robot; "aimed": when asked for, at whoever is
            within 2 degrees, the better the nearer (1 - distance / 300). Walls stop shots.
        hit_points: hits that end a life.
        reward_weights: weight of each of `REWARD_NAMES`; those left out are 0.
        lifetime_ticks: of a life in training; in battle lives have no limit.
        max_speed: units per tick, forwards or backwards.
        max_turn_rad: largest turn in one tick.
    """

    name: str
    width: float = 800.0
    height: float = 800.0
    robots: int = 50
    walls: tuple[Wall, ...] = ()
    spawns: tuple[Spawn, ...] = (Spawn(x=400.0, y=266.67), Spawn(x=400.0, y=533.33))
    turrets: tuple[tuple[float, float], ...] = ()
    flag: tuple[float, float] | None = None
    sensors: str = "opennero-2011"
    firing: str = "2011"
    hit_points: int = 20
    reward_weights: Mapping[str, float] = field(default_factory=lambda: {"hit_target": 1.0})
    lifetime_ticks: int = 1000
    max_speed: float = 1.0
    max_turn_rad: float = 0.2

    def __post_init__(self) -> None:
        require_fields(NeroScenario, vars(self))
        object.__setattr__(self, "walls", tuple(self.walls))
        object.__setattr__(self, "spawns", tuple(self.spawns))
        object.__setattr__(self, "reward_weights", dict(self.reward_weights))
        places = [pair(f"turrets[{i}]", at, "positions") for i, at in enumerate(self.turrets)]
        object.__setattr__(self, "turrets", tuple(places))
        if self.flag is not None:
            object.__setattr__(self, "flag", pair("flag", self.flag, "positions"))
        require_known("sensors", self.sensors, SENSORS)
        require_known("firing", self.firing, FIRING)
        self._check_weights()
        self._check_places()
        require(
            self.max_speed <= 4.0,
            f"max_speed: expected at most 4, got {self.max_speed}: a "
            "robot could pass through a wall within one tick",
        )

    def weights(self) -> np.ndarray:
        """Reward weights, float64 [6], in the order of `REWARD_NAMES`."""
        return np.array([self.reward_weights.get(name, 0.0) for name in REWARD_NAMES])

    def replaced(self, **changes: Any) -> NeroScenario:
        """A copy with `changes`, checked again."""
        return replace(self, **changes)

    def refuse_change(self, after: NeroScenario) -> None:
        """Raise a `ScenarioError` if robots that live here could not go on in another scenario."""
        require_alike(self, after, CHANGEABLE_NERO)

    def to_dict(self) -> dict[str, Any]:
        """JSON values that `from_dict` reads back as an equal scenario."""
        return json.loads(json.dumps(asdict(self)))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> NeroScenario:
        """Make a scenario of JSON values; keys left out come from "battle".

        A `ScenarioError` names the key that is unknown, of a wrong type or impossible.
        """
        return NERO_TASKS["battle"].replaced(**_nero_values(values))

    def _check_weights(self) -> None:
        for name in self.reward_weights:
            require_known("reward_weights", name, REWARD_NAMES)
        given = any(self.reward_weights.values())
        require(given, "reward_weights: all are 0; give at least one that is not")

    def _check_places(self) -> None:
        require(bool(self.spawns), "spawns: expected at least one spawn, got none")
        for index, spawn in enumerate(self.spawns):
            self._check_place(f"spawns[{index}]", (spawn.x, spawn.y), _ROOM + spawn.jitter)
            xs, ys = spawn.x + spawn.offsets(), spawn.y + spawn.offsets()
            for number, wall in enumerate(self.walls):
                words = f"spawns[{index}]: jitter {spawn.jitter} reaches walls[{number}]; move one"
                require(not meets_wall(xs, ys, wall, _RADIUS), words)
        for index, place in enumerate(self.turrets):
            self._check_place(f"turrets[{index}]", place, BORDER_INSET)
        if self.flag is not None:
            self._check_place("flag", self.flag, 0.0)

    def _check_place(self, where: str, place: tuple[float, float], margin: float) -> None:
        (x, y), wide, high = place, self.width - margin, self.height - margin
        require(
            margin <= x <= wide and margin <= y <= high,
            f"{where}: ({x:g}, {y:g}) is too near the border; keep x within {margin:g}..{wide:g} "
            f"and y within {margin:g}..{high:g}",
        )
        at = np.array(x), np.array(y)
        for index, wall in enumerate(self.walls):
            inside = box_distance(*at, wall) <= 0
            require(not inside, f"{where}: ({x:g}, {y:g}) is inside walls[{index}]; move one")


CHANGEABLE_NERO = (
    "walls",
    "spawns",
    "turrets",
    "flag",
    "firing",
    "hit_points",
    "reward_weights",
    "lifetime_ticks",
)
"""What may be another while robots live in a scenario."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A part of a curriculum.

    Attributes:
        scenario: the field.
        ticks: how long it lasts; the last stage has no end.
    """

    scenario: NeroScenario
    ticks: int = 10_000

    def __post_init__(self) -> None:
        require(self.ticks >= 1, f"ticks: expected at least 1 of each stage, got {self.ticks}")

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {"scenario": self.scenario.to_dict(), "ticks": self.ticks}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Stage:
        """Read what `to_dict` gave."""
        return cls(scenario=NeroScenario.from_dict(values["scenario"]), ticks=values["ticks"])


NeroSource = NeroScenario | Mapping[str, Any] | Path | str
"""A name of `NERO_TASKS`, the path of a JSON file, the content of one, or a scenario."""


def find_nero(
    source: NeroSource, changes: Mapping[str, Any] = MappingProxyType({})
) -> NeroScenario:
    """The scenario that somebody means, of a curriculum the last one; see `find_stages`."""
    return find_stages(source, changes)[-1].scenario


def find_stages(
    source: NeroSource, changes: Mapping[str, Any] = MappingProxyType({})
) -> tuple[Stage, ...]:
    """The stages that somebody means: one, or those of a curriculum.

    A file of a curriculum has a list `stages` of scenarios, each with its `ticks`; what it says
    besides is the same in all of them, and so are the changes.

    Raises:
        ScenarioError: There is no such scenario or file, or it cannot be.
    """
    wanted = _nero_values(changes)
    if isinstance(source, NeroScenario):
        return (Stage(scenario=source.replaced(**wanted)),)
    if isinstance(source, Mapping):
        return _stages_of(source, wanted)
    if source in NERO_TASKS:
        return (Stage(scenario=NERO_TASKS[str(source)].replaced(**wanted)),)
    if source in CURRICULA:
        return _stages_of(CURRICULA[str(source)], wanted)
    with naming_file(source):
        return _stages_of(file_values(Path(source), [*NERO_TASKS, *CURRICULA]), wanted)


def _stages_of(values: Any, wanted: Mapping[str, Any]) -> tuple[Stage, ...]:
    """Stages of JSON values, each with the wanted values of a scenario."""
    if not (isinstance(values, Mapping) and "stages" in values):
        scenario = NERO_TASKS["battle"].replaced(**{**_nero_values(values), **wanted})
        return (Stage(scenario=scenario),)
    shared = _nero_values({key: one for key, one in values.items() if key != "stages"})
    parts = values["stages"]
    fine = isinstance(parts, list) and parts and all(isinstance(one, Mapping) for one in parts)
    require(bool(fine), f"stages: expected a list of objects {{...}}, got {shown(parts)}")
    stages = []
    for number, part in enumerate(parts):
        with naming_file(f"stages[{number}]"):
            stages.append(_stage_of(part, shared, wanted))
    first = stages[0].scenario
    for number, stage in enumerate(stages):
        for key in ("robots", "sensors", "max_speed", "max_turn_rad"):
            own, wanted_one = getattr(stage.scenario, key), getattr(first, key)
            words = f"stages[{number}]: {key}: expected {wanted_one}, as in stages[0], got {own}"
            require(own == wanted_one, words)
    return tuple(stages)


def _stage_of(
    part: Mapping[str, Any], shared: Mapping[str, Any], wanted: Mapping[str, Any]
) -> Stage:
    own = {key: one for key, one in part.items() if key != "ticks"}
    ticks = part.get("ticks", Stage.ticks)
    whole = isinstance(ticks, int) and not isinstance(ticks, bool)
    require(whole, f"ticks: expected a whole number, got {shown(ticks)}")
    scenario = NERO_TASKS["battle"].replaced(**{**shared, **_nero_values(own), **wanted})
    return Stage(scenario=scenario, ticks=ticks)


def _nero_values(values: Any) -> dict[str, Any]:
    """Values of `NeroScenario` from JSON values; errors name the key."""
    require_fields(NeroScenario, values)
    read = dict(values)
    for key, kind in (("walls", Wall), ("spawns", Spawn)):
        if key in read:
            read[key] = [read_object(kind, one, f"{key}[{i}]") for i, one in enumerate(read[key])]
    return read


_MIDDLE = Wall(x=400.0, y=400.0, width=200.0, height=4.0)
NERO_TASKS: dict[str, NeroScenario] = {
    "battle": NeroScenario(name="battle", walls=(_MIDDLE,)),
    "nero": NeroScenario(
        name="nero",
        sensors="nero-1",
        firing="aimed",
        spawns=(Spawn(x=400.0, y=266.67), Spawn(x=400.0, y=533.33)),
        turrets=((400.0, 450.0),),
        reward_weights={"approach_enemy": 0.5, "hit_target": 1.0, "avoid_fire": 0.3},
    ),
}
"""The field of the tournament of 2011, and one to train on."""

_TRAINED = {"sensors": "nero-1", "firing": "aimed", "walls": [], "turrets": [[400.0, 450.0]]}
_BARRIER = {"x": 400.0, "y": 360.0, "width": 120.0, "height": 4.0}
CURRICULA: dict[str, dict[str, Any]] = {
    "drill": {
        "name": "drill",
        **_TRAINED,
        "stages": [
            {"ticks": 5000, "hit_points": 200, "reward_weights": {"approach_enemy": 1.0}},
            {
                "ticks": 5000,
                "hit_points": 200,
                "reward_weights": {"approach_enemy": 0.5, "hit_target": 1.0},
            },
            {
                "ticks": 5000,
                "hit_points": 100,
                "walls": [_BARRIER],
                "reward_weights": {"approach_enemy": 0.5, "hit_target": 1.0},
            },
            {
                "walls": [_BARRIER],
                "turrets": [[300.0, 450.0], [400.0, 470.0], [500.0, 450.0]],
                "reward_weights": {"approach_enemy": 0.3, "hit_target": 1.0, "avoid_fire": 0.5},
            },
        ],
    },
}
"""Stages by name. "drill" is in the manner of Stanley, Bryant & Miikkulainen (2005): approach an
enemy, hit it, get around a wall to do so, stand against several. Where a team is the enemy there
are no turrets."""
