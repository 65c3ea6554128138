"""Whole ticks of NERO's field against a slow, plain second reading of the rules."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import (
    FIRING,
    NERO_ACTIONS,
    NERO_TASKS,
    OBSERVATIONS,
    SENSORS,
    NeroScenario,
)
from neatq_envs.nero.state import (
    BRAIN,
    GIVEN,
    TURRET,
    Field,
    TeamBrains,
    law_of,
    make_field,
    no_brains,
    walls_of,
)
from neatq_envs.walls import Wall

HALF_AXES = 6.53, 4.09
LOW, HIGH = 2.0, 798.0
RAYS = 90, 45, 0, -45, -90
SECTORS = (12, 90), (-3, 18), (-18, 3), (-90, -12)


# ------------------------------------------------------------------------------------ the oracle


@dataclass
class Robot:
    """One robot; its network has no hidden nodes: weights [outputs, inputs and bias]."""

    at: complex
    heading: float
    team: int
    turret: bool = False
    alive: bool = True
    begun: bool = True
    incoming: int = 0
    damage: int = 0
    taken: int = 0
    hits: int = 0
    shot: int = -1
    ignores: bool = False
    weights: np.ndarray | None = None
    action: tuple[float, ...] = ()


@dataclass
class World:
    """Robots on a field of 800 x 800, blue's first, and what each team's middle was last."""

    scenario: NeroScenario
    robots: list[Robot]
    draws: Iterator[float]
    middle: dict[int, complex] = field(default_factory=dict)

    def piled(self) -> bool:
        """Whether some will be pushed into one corner: no rule says where what is here is seen."""
        walls, living = self.scenario.walls, [one for one in self.robots if one.alive]
        places = [one.at if one.turret else pushed(one.at, walls) for one in living]
        return len(set(places)) < len(places)

    def tick(self) -> None:
        for robot in self.robots:
            robot.hits, robot.shot = 0, -1
            if robot.alive and not robot.turret:
                robot.at = pushed(robot.at, self.scenario.walls)
        self.find_middles()
        for number, robot in enumerate(self.robots):
            if robot.alive:
                self.turn(number, robot)

    def find_middles(self) -> None:
        for team in {robot.team for robot in self.robots}:
            places = [robot.at for robot in self.robots if robot.alive and robot.team == team]
            self.middle[team] = sum(places) / len(places) if places else 0

    def turn(self, number: int, robot: Robot) -> None:
        if robot.turret:
            self.shoot(number, robot, fire=True)
            robot.heading += 0.1
            robot.incoming = 0
            return
        if robot.damage >= self.scenario.hit_points:
            robot.alive = False
            return
        if not robot.begun:
            robot.begun = True
            robot.heading = math.radians(math.floor(360 * next(self.draws))) + math.pi
            return
        speed, turn, fire, ignore = self.decide(number, robot)
        aim = self.shoot(number, robot, fire=fire >= 0.5)
        robot.damage += robot.incoming
        robot.taken, robot.incoming = robot.incoming, 0
        robot.ignores = ignore > 0.5
        robot.heading += turn if aim is None else aim
        robot.at += cmath.rect(speed, robot.heading)

    def decide(self, number: int, robot: Robot) -> tuple[float, float, float, float]:
        if robot.weights is None:
            action = robot.action
        else:
            inputs = np.append(self.sense(number), 0.3)
            unit = 1 / (1 + np.exp(-(robot.weights @ inputs)))
            speed, turn = (2 * unit[:2] - 1) * (
                self.scenario.max_speed,
                self.scenario.max_turn_rad,
            )
            action = (speed, turn, *unit[2:])
        return (*action, *[0.0] * (4 - len(action)))  # type: ignore[return-value]

    def relative(self, robot: Robot, at: complex) -> tuple[float, float]:
        """How far a place is, and at which angle to the left of the heading, in degrees."""
        way = (at - robot.at) * cmath.rect(1, -robot.heading)
        return abs(way), math.degrees(cmath.phase(way))

    def others(self, robot: Robot, *, friends: bool) -> list[int]:
        return [
            number
            for number, other in enumerate(self.robots)
            if other.alive and other is not robot and (other.team == robot.team) == friends
        ]

    # What it senses ------------------------------------------------------------------------

    def sense(self, number: int) -> list[float]:
        robot, sensors = self.robots[number], self.scenario.sensors
        enemies, friends = (self.others(robot, friends=one) for one in (False, True))
        flag = [] if self.scenario.flag is None else [complex(*self.scenario.flag)]
        target = float(self.target(robot) is not None)
        values = [self.ray(robot, degrees) for degrees in RAYS]
        values += self.radar(robot, flag)
        values += self.radar(robot, [self.robots[one].at for one in enemies])
        if sensors == "nero-1":
            values += self.radar(robot, [self.robots[one].at for one in friends])
            left = max(1 - robot.damage / self.scenario.hit_points, 0)
            return [*values, target, left, float(robot.taken + robot.incoming > 0)]
        values += (0.0, 0.0) if robot.ignores else self.friends(robot)
        return [*values, target if sensors == "opennero-2011" else 0.0]

    def ray(self, robot: Robot, degrees: float) -> float:
        way = cmath.rect(1, robot.heading + math.radians(degrees))
        border = [complex(x, y) for x, y in ((LOW, LOW), (HIGH, LOW), (HIGH, HIGH), (LOW, HIGH))]
        outlines = [border, *(corners_of(wall) for wall in self.scenario.walls)]
        met = [crossing(robot.at, way, a, b) for outline in outlines for a, b in sides(outline)]
        distance = min((one for one in met if one is not None), default=math.inf)
        if self.scenario.sensors == "opennero-2011":
            return distance / 50 if distance <= 50 else 1.0
        return min(5 / distance, 1.0) if distance <= 50 else 0.0

    def radar(self, robot: Robot, places: list[complex]) -> list[float]:
        values = [0.0] * 5
        for place in places:
            distance, degrees = self.relative(robot, place)
            if distance <= 300:
                inside = [right <= degrees <= left for right, left in SECTORS]
                for sector, seen in enumerate([*inside, abs(degrees) >= 87]):
                    values[sector] += 30 / distance if seen else 0
        return [min(value, 1.0) for value in values]

    def friends(self, robot: Robot) -> tuple[float, float]:
        """Of 2011; those of 2014 are tested by hand."""
        distance, degrees = self.relative(robot, self.middle[robot.team])
        if distance <= 1e-9:  # a mean of equal places may miss them by a rounding error
            degrees = 0.0
        return (distance / 15, (degrees + 180) / 360) if distance <= 15 else (0.0, 0.0)

    # How it shoots -------------------------------------------------------------------------

    def target(self, robot: Robot) -> int | None:
        costs = {}
        for enemy in self.others(robot, friends=False):
            distance, degrees = self.relative(robot, self.robots[enemy].at)
            if abs(degrees) <= 2:
                costs[enemy] = distance / math.cos(math.radians(20 * degrees))
        return min(costs, key=lambda one: costs[one]) if costs else None

    def sees(self, robot: Robot, other: int) -> bool:
        way = self.robots[other].at - robot.at
        for wall in self.scenario.walls:
            for a, b in sides(corners_of(wall)):
                met = crossing(robot.at, way, a, b)
                if met is not None and met <= 1:
                    return False
        return True

    def shoot(self, number: int, robot: Robot, *, fire: bool) -> float | None:
        """Returns the angle by which aiming turns it, if it does."""
        if self.scenario.firing == "2014":
            return self.shoot_2014(robot, fire=fire)
        target = self.target(robot)
        if target is None or not (fire or self.scenario.firing == "2011"):
            return None
        robot.shot = target
        distance = abs(self.robots[target].at - robot.at)
        if self.scenario.firing == "2011":
            closeness = (600 - distance) / 600
            draws = next(self.draws), next(self.draws)
            hit = min(draws) > closeness / 2
        else:
            hit = next(self.draws) > distance / 300
        if hit and self.sees(robot, target):
            self.hit(robot, target)
        return None

    def shoot_2014(self, robot: Robot, *, fire: bool) -> float | None:
        enemies = self.others(robot, friends=False) if fire else []
        seen = [
            (abs(self.robots[one].at - robot.at), one) for one in enemies if self.sees(robot, one)
        ]
        distance, enemy = min(seen, default=(math.inf, -1))
        if distance >= 300:
            return None
        degrees = self.relative(robot, self.robots[enemy].at)[1]
        if abs(degrees) > 2:
            return math.radians(degrees)
        robot.shot = enemy
        if next(self.draws) < max(0, (200 - distance) / 400):
            self.hit(robot, enemy)
        return None

    def hit(self, robot: Robot, target: int) -> None:
        self.robots[target].incoming += 1
        robot.hits += 1


def corners_of(wall: Wall) -> list[complex]:
    half = complex(wall.width / 2, wall.height / 2)
    signs = (1, 1), (-1, 1), (-1, -1), (1, -1)
    turn = cmath.rect(1, wall.angle_rad)
    return [
        complex(wall.x, wall.y) + turn * complex(a * half.real, b * half.imag) for a, b in signs
    ]


def sides(outline: list[complex]) -> Iterator[tuple[complex, complex]]:
    yield from zip(outline, outline[1:] + outline[:1], strict=True)


def cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


def crossing(start: complex, way: complex, a: complex, b: complex) -> float | None:
    """Which multiple of a way, from a start on, meets the line from a to b; None if none does."""
    side = b - a
    if cross(way, side) == 0:
        return None
    along = cross(a - start, side) / cross(way, side)
    share = cross(a - start, way) / cross(way, side)
    return along if along >= 0 and 0 <= share <= 1 else None


def pushed(at: complex, walls: tuple[Wall, ...]) -> complex:
    """Where an ellipse goes that touches a wall or a border: out of it, the nearest way.

    "Near" is meant in half axes: there the ellipse is a circle, and walls are parallelograms.
    """
    wide, high = HALF_AXES

    def scaled(place: complex) -> complex:
        return complex(place.real / wide, place.imag / high)

    for wall in walls:
        place, outline = scaled(at), [scaled(one) for one in corners_of(wall)]
        nearest = min((foot(place, a, b) for a, b in sides(outline)), key=lambda f: abs(f - place))
        inward = all(cross(b - a, place - a) > 0 for a, b in sides(outline))
        if inward or abs(place - nearest) < 1:
            out = (nearest - place if inward else place - nearest) / abs(place - nearest)
            at = complex((nearest + out).real * wide, (nearest + out).imag * high)
    x = min(max(at.real, LOW + wide), HIGH - wide)
    y = min(max(at.imag, LOW + high), HIGH - high)
    return complex(x, y)


def foot(place: complex, a: complex, b: complex) -> complex:
    """The point from a to b that is nearest to a place."""
    share = ((place - a) * (b - a).conjugate()).real / abs(b - a) ** 2
    return a + min(max(share, 0), 1) * (b - a)


# -------------------------------------------------------------------------------- random fields


class Both(NamedTuple):
    """The same field twice."""

    oracle: World
    field: Field
    brains: TeamBrains
    actions: np.ndarray
    rng: np.random.Generator


def random_scenario(rng: np.random.Generator, sensors: str, firing: str) -> NeroScenario:
    walls = [
        Wall(
            x=middle + rng.uniform(-20, 20),
            y=400 + rng.uniform(-20, 20),
            width=rng.uniform(4, 120),
            height=rng.uniform(1, 40),
            angle_rad=rng.uniform(-3, 3),
        )
        for middle in (250.0, 550.0)  # so far apart that nobody touches both
    ]
    return NERO_TASKS["battle"].replaced(
        walls=walls[: rng.integers(3)],
        sensors=sensors,
        firing=firing,
        flag=rng.uniform((340, 100), (460, 700)).tolist() if rng.random() < 0.7 else None,
        hit_points=int(rng.integers(1, 5)),
        turrets=rng.uniform((350, 350), (450, 450), (rng.integers(3), 2)).tolist(),
        max_speed=rng.uniform(0.5, 4),
        max_turn_rad=rng.uniform(0.1, 1),
    )


def random_robots(
    rng: np.random.Generator, scenario: NeroScenario, sizes: list[int]
) -> list[Robot]:
    """Robots near each other or near walls and borders, which often look at an enemy."""
    whole, actions = OBSERVATIONS[scenario.sensors], len(NERO_ACTIONS[scenario.sensors])
    corner = [complex(*rng.uniform(0, 800, 2)), 400 + 400j, 250 + 400j][rng.integers(3)]
    spread = rng.choice([8, 60, 300])
    low, high = (0, 0, -0.3, -0.3)[:actions], (1, 1, 1.2, 1.2)[:actions]
    robots = []
    for team, size in enumerate(sizes):
        for _ in range(size):
            at = corner + complex(*rng.uniform(-spread, spread, 2))
            at = complex(min(max(at.real, 0.5), 799.5), min(max(at.imag, 0.5), 799.5))
            robot = Robot(at, rng.uniform(-3.1, 3.1), team)
            robot.alive, robot.begun = rng.random() < 0.85, rng.random() < 0.9
            robot.damage = int(rng.integers(scenario.hit_points + 1))
            robot.incoming, robot.taken = rng.integers(3, size=2).tolist()
            robot.ignores = rng.random() < 0.2
            if rng.random() < 0.5:
                robot.weights = rng.normal(0, 2, (actions, whole + 1))
            else:
                most = np.array([scenario.max_speed, scenario.max_turn_rad, 1, 1])[:actions]
                first = np.array([2 * rng.random() - 1 for _ in range(2)])
                rest = rng.uniform(low[2:], high[2:])
                robot.action = tuple((np.append(first, rest) * most).tolist())
            robots.append(robot)
    for x, y in scenario.turrets:
        robots.append(Robot(complex(x, y), rng.uniform(-3, 3), len(sizes), turret=True))
    for robot in robots:
        enemies = [one for one in robots if one.team != robot.team]
        if enemies and rng.random() < 0.6:
            way = enemies[rng.integers(len(enemies))].at - robot.at
            robot.heading = cmath.phase(way) + math.radians(rng.uniform(-3, 3))
    return robots


def twin_of(scenario: NeroScenario, robots: list[Robot], sizes: list[int]) -> Field:
    twin = make_field(scenario, sizes)
    twin.pose[:] = [(robot.at.real, robot.at.imag, robot.heading) for robot in robots]
    for name in ("alive", "begun", "damage", "taken", "ignores"):
        getattr(twin, name)[:] = [getattr(robot, name) for robot in robots]
    twin.pending[:] = [robot.incoming for robot in robots]
    kinds = [TURRET if robot.turret else GIVEN if robot.action else BRAIN for robot in robots]
    twin.control[:] = kinds
    return twin


def brains_of(robots: list[Robot]) -> TeamBrains:
    """The networks of the robots, those of robots without one without nodes."""
    shapes = [(0, 0) if one.weights is None else one.weights.shape for one in robots]
    ends = np.cumsum([0, *(outputs + inputs for outputs, inputs in shapes)])
    links, source, weight, outputs = [np.zeros(1)], [], [], []
    for first, robot, (rows, columns) in zip(ends, robots, shapes, strict=False):
        links.append(np.repeat([0, columns], [columns, rows]))  # into each node
        outputs.append(first + columns + np.arange(rows))
        source.append(np.tile(first + np.arange(columns), rows))
        weight.append(np.zeros(0) if robot.weights is None else robot.weights.ravel())
    total, count = int(ends[-1]), len(robots)
    source_, weight_ = np.concatenate(source).astype(int), np.concatenate(weight)
    return no_brains()._replace(
        node=ends,
        link=np.concatenate(links).cumsum().astype(int),
        source=source_,
        weight=weight_,
        late=np.zeros(len(source_), bool),
        activation=np.ones(total, int),
        bias=np.full(count, 0.3),
        silent=np.zeros(count, bool),
        output=np.cumsum([0, *(rows for rows, _ in shapes)]),
        outputs=np.concatenate(outputs).astype(int),
        candidates=np.ones(count, int),
        value=np.zeros(total),
        before=np.zeros(total),
        active=np.zeros(total, bool),
        fired=np.zeros(total, bool),
    )


def random_field(seed: int, sensors: str, firing: str, sizes: list[int]) -> Both:
    rng = np.random.default_rng(seed)
    scenario = random_scenario(rng, sensors, firing)
    robots = random_robots(rng, scenario, sizes)
    actions = np.zeros((len(robots), 4))
    for row, robot in zip(actions, robots, strict=True):
        row[: len(robot.action)] = robot.action
    draws = iter(np.random.default_rng([seed, 1]).random, None)
    oracle = World(scenario, robots, draws)
    own = twin_of(scenario, robots, sizes), brains_of(robots), actions
    return Both(oracle, *own, np.random.default_rng([seed, 1]))


def assert_same(both: Both) -> None:
    robots, own = both.oracle.robots, both.field
    places = own.pose[:, 0] + 1j * own.pose[:, 1]
    assert places == pytest.approx(np.array([robot.at for robot in robots]), abs=1e-9)
    turned = own.pose[:, 2] - [robot.heading for robot in robots]
    assert np.exp(1j * turned) == pytest.approx(np.ones(len(robots)), abs=1e-9)
    assert (np.abs(own.pose[:, 2]) <= 7).all()
    moves = [not robot.turret for robot in robots]
    for name, other in (
        ("alive", "alive"),
        ("begun", "begun"),
        ("damage", "damage"),
        ("pending", "incoming"),
        ("hits", "hits"),
        ("shot", "shot"),
        ("ignores", "ignores"),
    ):
        expected = [getattr(robot, other) for robot in robots]
        assert getattr(own, name).tolist() == expected, name
    assert own.taken[moves].tolist() == [robot.taken for robot in robots if not robot.turret]


def assert_same_senses(both: Both) -> None:
    """With teams' middles as they are now; the dead sense nothing."""
    oracle, own, scenario = both.oracle, both.field, both.oracle.scenario
    moving = sum(not robot.turret for robot in oracle.robots)
    seen = np.zeros((moving, OBSERVATIONS[scenario.sensors]))
    oracle.find_middles()
    for team in oracle.middle:
        if (mates := own.alive & (own.team == team)).any():
            own.centre[team] = own.pose[mates, :2].mean(axis=0)
    kernels.look(own, walls_of(scenario), law_of(scenario), moving, seen)
    for number, robot in enumerate(oracle.robots[:moving]):
        expected = np.array(oracle.sense(number)) * robot.alive
        if scenario.sensors == "opennero-2014":
            expected[15:17] = seen[number, 15:17]  # see `World.friends`
        assert seen[number] == pytest.approx(expected, abs=1e-9), number


@settings(max_examples=250)
@given(
    seed=st.integers(0, 2**32 - 1),
    sensors=st.sampled_from(SENSORS),
    firing=st.sampled_from(FIRING),
    sizes=st.lists(st.integers(1, 4), min_size=1, max_size=3),
)
def test_ticks_are_those_of_the_oracle(
    seed: int, sensors: str, firing: str, sizes: list[int]
) -> None:
    both = random_field(seed, sensors, firing, sizes)
    scenario = both.oracle.scenario
    if sensors == "opennero-2014":  # see `World.friends`
        for robot in both.oracle.robots:
            if robot.weights is not None:
                robot.weights[:, 15:17] = 0
        both.brains.weight[:] = brains_of(both.oracle.robots).weight
    ground, law = walls_of(scenario), law_of(scenario)
    for _ in range(3):
        assume(not both.oracle.piled())
        living = {robot.team for robot in both.oracle.robots if robot.alive}
        both.oracle.tick()
        args = both.brains, both.actions, both.rng
        teams = kernels.tick(both.field, ground, law, *args)
        assert scenario.turrets or teams == len(living)
        assert_same(both)
        assert_same_senses(both)
    assert next(both.oracle.draws) == both.rng.random(), "another number of draws"
