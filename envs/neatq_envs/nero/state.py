"""What a field of robots is, as plain arrays that compiled functions read and write."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from neatq_envs.nero.scenario import FIRING, SENSORS, NeroScenario
from neatq_envs.rays import barriers
from neatq_envs.scenario import BORDER_INSET
from neatq_envs.walls import Wall

BRAIN, GIVEN, TURRET = 0, 1, 2
"""What a robot is moved by: its network, an action from outside, or nothing but a clock."""
BATTLE_STREAM = 9
"""The random numbers of a battle of seed s are those of [s, BATTLE_STREAM]."""
RADIUS = (6.53, 4.09)
"""Half axes in units of what stops at a wall: OpenNERO's model, which does not turn with it."""


class Field(NamedTuple):
    """All robots of one field, a row each, those of team 0 first.

    Attributes:
        pose: x and y in units and the heading in rad, float64 [robots, 3].
        team: int64 [robots].
        control: what moves it, `BRAIN`, `GIVEN` or `TURRET`, int64 [robots].
        alive: bool [robots].
        begun: whether it has drawn its first heading, bool [robots].
        pending: damage since its last turn, int64 [robots].
        damage: damage taken in this life, int64 [robots].
        taken: damage taken in this tick, int64 [robots].
        hits: hits scored in this tick, int64 [robots].
        shot: at whom it shot in this tick, -1: at nobody, int64 [robots].
        speed: that was asked for in this tick, units per tick, float64 [robots].
        ignores: whether it reads nothing of its friends (2014), bool [robots].
        flag: x and y in units, float64 [2]; NaN: there is none.
        centre: mean place of each team in this tick, float64 [teams, 2].
    """

    pose: np.ndarray
    team: np.ndarray
    control: np.ndarray
    alive: np.ndarray
    begun: np.ndarray
    pending: np.ndarray
    damage: np.ndarray
    taken: np.ndarray
    hits: np.ndarray
    shot: np.ndarray
    speed: np.ndarray
    ignores: np.ndarray
    flag: np.ndarray
    centre: np.ndarray


class Ground(NamedTuple):
    """Field and walls.

    Attributes:
        inner: least and greatest x, least and greatest y between the borders' inner faces.
        radius: half axes of a robot's ellipse, along x and along y (it does not turn).
        boxes: x, y, cosine, sine, half width, half height, half diagonal; float64 [walls, 7].
        corners: float64 [walls, 4, 2], counter-clockwise, in half axes of the ellipse.
    """

    inner: tuple[float, float, float, float]
    radius: tuple[float, float]
    boxes: np.ndarray
    corners: np.ndarray


class NeroLaw(NamedTuple):
    """The numbers of a scenario."""

    sensors: int
    firing: int
    hit_points: int
    max_speed: float
    max_turn_rad: float


class TeamBrains(NamedTuple):
    """Networks of all robots, one behind the other; a robot that has none has no nodes.

    Attributes:
        node: first node of each robot and the end of the last, int64 [robots + 1].
        link: first link of each node that is no sensor, and the end; int64 [nodes + 1].
        source: int64 [links], a node. Sensors come first, the bias after the inputs.
        weight: float64 [links].
        late: whether a link carries what its source was in the tick before, bool [links].
        activation: 0 identity, 1 sigmoid, 2 steep sigmoid, 3 tanh, 4 relu; int64 [nodes].
        bias: of each robot, float64 [robots].
        silent: whether nodes that nothing has reached yet are 0, and a first activation goes on
            until every output has fired, as OpenNERO has it; bool [robots].
        output: first entry in `outputs` of each robot and the end, int64 [robots + 1].
        outputs: nodes, int64.
        candidates: among how many actions the greatest value chooses, int64 [robots].
        value: what nodes are, float64 [nodes].
        before: what they were, float64 [nodes].
        active: whether something has reached them, bool [nodes].
        fired: whether they have ever been activated, bool [nodes].
    """

    node: np.ndarray
    link: np.ndarray
    source: np.ndarray
    weight: np.ndarray
    late: np.ndarray
    activation: np.ndarray
    bias: np.ndarray
    silent: np.ndarray
    output: np.ndarray
    outputs: np.ndarray
    candidates: np.ndarray
    value: np.ndarray
    before: np.ndarray
    active: np.ndarray
    fired: np.ndarray


def walls_of(scenario: NeroScenario) -> Ground:
    """The field and the walls of a scenario."""
    radius, inset = np.array(RADIUS), BORDER_INSET
    inner = inset, scenario.width - inset, inset, scenario.height - inset
    corners = [wall_corners(wall) / radius for wall in scenario.walls]
    boxes = barriers(scenario.walls, scenario.width, scenario.height, inset).boxes
    return Ground(inner, RADIUS, boxes, np.array(corners).reshape(-1, 4, 2))


def wall_corners(wall: Wall) -> np.ndarray:
    """Corners of a wall, counter-clockwise, float64 [4, 2] in units."""
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    at = signs * (wall.width / 2, wall.height / 2)
    return (wall.x, wall.y) + at @ np.array([(cosine, sine), (-sine, cosine)])


def law_of(scenario: NeroScenario) -> NeroLaw:
    """The numbers of a scenario."""
    return NeroLaw(
        SENSORS.index(scenario.sensors),
        FIRING.index(scenario.firing),
        scenario.hit_points,
        scenario.max_speed,
        scenario.max_turn_rad,
    )


def make_field(scenario: NeroScenario, sizes: Sequence[int]) -> Field:
    """A field of teams of so many robots each, and the turrets behind them; nobody has a place."""
    turrets = len(scenario.turrets)
    team = np.repeat(np.arange(len(sizes) + 1), (*sizes, turrets))
    robots = len(team)
    control = np.where(team == len(sizes), TURRET, BRAIN)
    pose = np.zeros((robots, 3))
    if turrets:
        pose[-turrets:, :2] = scenario.turrets
    whole = np.zeros((5, robots), np.int64)
    return Field(
        pose=pose,
        team=team,
        control=control,
        alive=np.ones(robots, bool),
        begun=team == len(sizes),
        pending=whole[0],
        damage=whole[1],
        taken=whole[2],
        hits=whole[3],
        shot=whole[4],
        speed=np.zeros(robots),
        ignores=np.zeros(robots, bool),
        flag=np.full(2, np.nan) if scenario.flag is None else np.array(scenario.flag, float),
        centre=np.zeros((len(sizes) + 1, 2)),
    )


def spawn_robots(
    field: Field, robots: np.ndarray, scenario: NeroScenario, rng: np.random.Generator
) -> None:
    """Put robots, their indices, to the spawns of their teams; each draws a heading there."""
    for robot in robots.tolist():
        spawn = scenario.spawns[field.team[robot] % len(scenario.spawns)]
        offset = rng.integers(-spawn.jitter, max(spawn.jitter, 1), size=2)
        field.pose[robot] = (spawn.x + offset[0], spawn.y + offset[1], 0.0)
        field.alive[robot], field.begun[robot] = True, False
        for column in (field.pending, field.damage, field.taken, field.hits, field.speed):
            column[robot] = 0
        field.ignores[robot] = False


def no_brains() -> TeamBrains:
    """Of nobody."""
    ends, whole, real = np.zeros(1, np.int64), np.empty(0, np.int64), np.empty(0)
    truth = np.empty(0, bool)
    links = ends, whole, real, truth, whole
    return TeamBrains(
        ends, *links, real, truth, ends, whole, whole, real, real.copy(), truth, truth
    )
