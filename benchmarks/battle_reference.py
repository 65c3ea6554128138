"""The least that a NERO battle can cost: the rules of the tournament of 2011 in one compiled loop.

It can do nothing else: one field with one wall, two teams without a flag or turrets, the sensors,
the firing and the networks of 2011, no film, no training. Written from the rules as OpenNERO's
sources and pages tell them (mods/NERO_Battle of 2011, source/rtneat), not from the library's
kernels, so that it is a second opinion on them, too. Random numbers are drawn in the same order:
with the same generator both engines play the same match.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from neatq_torch.genome import Genome, NodeKind
from neatq_torch.jit import cached_njit

LOW, HIGH = 2.0, 798.0  # the inner faces of the borders
MIDDLE = 400.0
WALL_X, WALL_Y = 100.0, 2.0  # half of the only wall, which lies across the middle
WIDE, TALL = 6.53, 4.09  # half axes of the ellipse that walls stop
SPAWNS_Y = 266.67, 533.33
SENSORS = 18
BIAS = 0.3
RAY = 50.0
HALF = math.sqrt(0.5)
RAYS = (0.0, 1.0), (HALF, HALF), (1.0, 0.0), (HALF, -HALF), (0.0, -1.0)
SIGHT, NEAR = 300.0, 30.0
TAN_2, TAN_3, TAN_12, TAN_18 = (math.tan(math.radians(degrees)) for degrees in (2, 3, 12, 18))
REAR = math.cos(math.radians(87.0))
TOGETHER = 15.0
SHOT = 600.0
FULL_TURN = 2 * math.pi
MOST_TURN = 0.2


class Minds(NamedTuple):
    """Networks of all robots, one behind the other, ready to begin.

    Attributes:
        first: first node of each robot and the end, int64 [robots + 1]: 18 sensors, bias, others.
        output: its two outputs, int64 [robots, 2].
        link: first link into each node and the end, int64 [nodes + 1].
        source: int64 [links].
        weight: float64 [links].
    """

    first: np.ndarray
    output: np.ndarray
    link: np.ndarray
    source: np.ndarray
    weight: np.ndarray


class Robots(NamedTuple):
    """All robots, a row each, blue's first.

    Attributes:
        x: in units, float64 [robots], as the next four are.
        y: in units.
        heading: in rad.
        cosine: of the heading.
        sine: of the heading.
        alive: bool [robots].
        pending: damage since its last turn, int64 [robots].
        damage: taken so far, int64 [robots].
    """

    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    alive: np.ndarray
    pending: np.ndarray
    damage: np.ndarray


def minds_of(teams: Sequence[Sequence[Genome]], robots: int) -> Minds:
    """The networks of two teams of so many robots each; of fewer genomes clones are made."""
    genomes = [team[index % len(team)] for team in teams for index in range(robots)]
    first, output, link, source, weight = [0], [], [], [], []
    for genome in genomes:
        kind = genome.node_kind
        order = np.argsort(np.minimum(kind, NodeKind.OUTPUT), kind="stable")
        place = np.argsort(order)
        used = np.flatnonzero(genome.link_enabled)
        used = used[np.argsort(place[genome.target_index[used]], kind="stable")]
        begins = np.searchsorted(place[genome.target_index[used]], np.arange(len(kind)))
        link.extend(len(source) + begins)
        source.extend(first[-1] + place[genome.source_index[used]])
        weight.extend(genome.link_weight[used])
        output.append(first[-1] + place[kind == NodeKind.OUTPUT])
        first.append(first[-1] + len(kind))
    return Minds(
        first=np.array(first),
        output=np.array(output),
        link=np.array([*link, len(source)]),
        source=np.array(source, np.int64),
        weight=np.array(weight, np.float64),
    )


def fight(
    minds: Minds, rng: np.random.Generator, *, ticks: int = 1000, hit_points: int = 20
) -> tuple[int, int, int]:
    """Let two teams fight: damage of blue, damage of red, and the ticks that it took."""
    count = len(minds.output)
    place = rng.integers(-20, 20, size=(count, 2)).T
    robots = Robots(
        x=MIDDLE + place[0],
        y=np.repeat(SPAWNS_Y, count // 2) + place[1],
        heading=np.zeros(count),
        cosine=np.ones(count),
        sine=np.zeros(count),
        alive=np.ones(count, bool),
        pending=np.zeros(count, np.int64),
        damage=np.zeros(count, np.int64),
    )
    passed = _battle(minds, robots, ticks, hit_points, rng)
    blue, red = np.minimum(robots.damage, hit_points).reshape(2, -1).sum(axis=1).tolist()
    return blue, red, passed


@cached_njit()
def _battle(
    minds: Minds, robots: Robots, ticks: int, hit_points: int, rng: np.random.Generator
) -> int:
    """Let all take their turns until a team is gone; returns how many ticks passed before."""
    count, mates = len(robots.x), len(robots.x) // 2
    value, reached = np.zeros(minds.first[-1]), np.zeros(minds.first[-1], np.bool_)
    fresh = np.zeros(minds.first[-1])
    for robot in range(count):
        bias = minds.first[robot] + SENSORS
        value[bias], reached[minds.first[robot] : bias + 1] = BIAS, True
    for now in range(ticks):
        _push_out(robots)
        blue_x, blue_y, blue = _middle(robots, 0, mates)
        red_x, red_y, red = _middle(robots, mates, count)
        for robot in range(count):
            if robots.alive[robot] and robots.damage[robot] >= hit_points:
                robots.alive[robot] = False
            if not robots.alive[robot]:
                continue
            friends_x, friends_y = (blue_x, blue_y) if robot < mates else (red_x, red_y)
            sensed = value[minds.first[robot] : minds.first[robot] + SENSORS]
            target, distance = _sense(sensed, robots, robot, friends_x, friends_y)
            _propagate(minds, robot, value, fresh, reached)
            if now == 0:
                robots.heading[robot] = math.radians(math.floor(360 * rng.random())) - math.pi
                _face(robots, robot)
                continue
            if target >= 0:
                _shoot(robots, robot, target, distance, rng)
            robots.damage[robot] += robots.pending[robot]
            robots.pending[robot] = 0
            speed = 2 * value[minds.output[robot, 0]] - 1
            turn = (2 * value[minds.output[robot, 1]] - 1) * MOST_TURN
            robots.heading[robot] = (robots.heading[robot] + turn + math.pi) % FULL_TURN - math.pi
            _face(robots, robot)
            robots.x[robot] += speed * robots.cosine[robot]
            robots.y[robot] += speed * robots.sine[robot]
        if blue == 0 or red == 0:  # those who were left had a turn to take what hit them last
            return now
    return ticks


@cached_njit()
def _face(robots: Robots, robot: int) -> None:
    """Keep what the next turn needs of a heading."""
    robots.cosine[robot] = math.cos(robots.heading[robot])
    robots.sine[robot] = math.sin(robots.heading[robot])


@cached_njit()
def _shoot(
    robots: Robots, robot: int, target: int, distance: float, rng: np.random.Generator
) -> None:
    """Shoot, as it was in 2011: best from afar."""
    x, y = robots.x[robot], robots.y[robot]
    miss = (SHOT - distance) / SHOT / 2
    one, other = rng.random(), rng.random()
    if one > miss and other > miss:
        way_x, way_y = robots.x[target] - x, robots.y[target] - y
        if _to_wall(x - MIDDLE, y - MIDDLE, way_x, way_y) > 1.0:
            robots.pending[target] += 1


@cached_njit()
def _push_out(robots: Robots) -> None:
    """Move ellipses out of walls, the nearest way.

    A robot goes one unit a tick at most, so its middle never gets into a wall that is 4 thick, and
    the wall is so far from the borders that nobody touches both.
    """
    x, y = robots.x, robots.y
    for robot in range(len(x)):
        if not robots.alive[robot]:
            continue
        across, up = x[robot] - MIDDLE, y[robot] - MIDDLE
        if abs(across) < WALL_X + WIDE and abs(up) < WALL_Y + TALL:
            away_x = (across - min(max(across, -WALL_X), WALL_X)) / WIDE
            away_y = (up - min(max(up, -WALL_Y), WALL_Y)) / TALL
            deep = math.sqrt(away_x * away_x + away_y * away_y)
            if 0.0 < deep < 1.0:
                x[robot] += away_x * (1.0 / deep - 1.0) * WIDE
                y[robot] += away_y * (1.0 / deep - 1.0) * TALL
        x[robot] = min(max(x[robot], LOW + WIDE), HIGH - WIDE)
        y[robot] = min(max(y[robot], LOW + TALL), HIGH - TALL)


@cached_njit()
def _middle(robots: Robots, first: int, end: int) -> tuple[float, float, int]:
    """The mean place of the living of a team, and how many these are."""
    sum_x, sum_y, count = 0.0, 0.0, 0
    for robot in range(first, end):
        if robots.alive[robot]:
            sum_x, sum_y, count = sum_x + robots.x[robot], sum_y + robots.y[robot], count + 1
    return sum_x / max(count, 1), sum_y / max(count, 1), count


@cached_njit()
def _sense(
    sensed: np.ndarray, robots: Robots, robot: int, friends_x: float, friends_y: float
) -> tuple[int, float]:
    """Write the inputs; returns who is shot at, -1: nobody, and how far that one is."""
    x, y = robots.x[robot], robots.y[robot]
    cosine, sine = robots.cosine[robot], robots.sine[robot]
    sensed[:5] = 1.0
    if _near_wall(x, y):
        _cast_rays(sensed, x, y, cosine, sine)
    target, distance = _look_for_enemies(sensed, robots, robot)
    _look_for_friends(sensed, friends_x - x, friends_y - y, cosine, sine)
    sensed[17] = 1.0 if target >= 0 else 0.0
    return target, distance


@cached_njit()
def _near_wall(x: float, y: float) -> bool:
    """Whether a ray could hit anything."""
    inside = min(x - LOW, HIGH - x, y - LOW, HIGH - y) > RAY
    beside = abs(x - MIDDLE) > WALL_X + RAY or abs(y - MIDDLE) > WALL_Y + RAY
    return not (inside and beside)


@cached_njit()
def _cast_rays(sensed: np.ndarray, x: float, y: float, cosine: float, sine: float) -> None:
    """How far walls are at 90, 45, 0, -45 and -90 degrees: 1 at 50 units and beyond."""
    for ray in range(5):
        along, left = RAYS[ray]
        way_x, way_y = cosine * along - sine * left, sine * along + cosine * left
        gap_x, gap_y = (HIGH - x if way_x > 0 else x - LOW), (HIGH - y if way_y > 0 else y - LOW)
        border = min(gap_x / max(abs(way_x), 1e-12), gap_y / max(abs(way_y), 1e-12))
        distance = min(border, _to_wall(x - MIDDLE, y - MIDDLE, way_x, way_y))
        sensed[ray] = min(distance / RAY, 1.0)


@cached_njit()
def _to_wall(x: float, y: float, way_x: float, way_y: float) -> float:
    """After which share of a way, from a place seen from the wall's middle, the wall is met."""
    step_x = way_x if abs(way_x) > 1e-12 else 1e-12
    step_y = way_y if abs(way_y) > 1e-12 else 1e-12
    one_x, two_x = (-WALL_X - x) / step_x, (WALL_X - x) / step_x
    one_y, two_y = (-WALL_Y - y) / step_y, (WALL_Y - y) / step_y
    enter = max(min(one_x, two_x), min(one_y, two_y), 0.0)
    leave = min(max(one_x, two_x), max(one_y, two_y))
    return enter if enter <= leave else math.inf


@cached_njit()
def _look_for_enemies(sensed: np.ndarray, robots: Robots, robot: int) -> tuple[int, float]:
    """Write the radar of enemies; returns who is shot at, -1: nobody, and how far that one is."""
    here_x, here_y = robots.x[robot], robots.y[robot]
    cosine, sine, mates = robots.cosine[robot], robots.sine[robot], len(robots.x) // 2
    first = mates if robot < mates else 0
    front_left, mid_left, mid_right, front_right, rear = 0.0, 0.0, 0.0, 0.0, 0.0
    target, least, target_distance = -1, math.inf, 0.0
    for other in range(first, first + mates):
        if not robots.alive[other]:
            continue
        dx, dy = robots.x[other] - here_x, robots.y[other] - here_y
        along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
        squared = along * along + across * across
        if along >= 0.0 and abs(across) <= TAN_2 * along:
            distance = math.sqrt(squared)
            cost = distance / math.cos(20.0 * math.atan2(across, along))
            if cost < least:
                target, least, target_distance = other, cost, distance
        if squared > SIGHT * SIGHT:
            continue
        distance = math.sqrt(squared)
        strength = NEAR / max(distance, NEAR)
        if along >= 0.0:
            if across >= TAN_12 * along:
                front_left += strength
            if -TAN_3 * along <= across <= TAN_18 * along:
                mid_left += strength
            if -TAN_18 * along <= across <= TAN_3 * along:
                mid_right += strength
            if across <= -TAN_12 * along:
                front_right += strength
        if along <= REAR * distance:
            rear += strength
    sensed[10], sensed[11] = min(front_left, 1.0), min(mid_left, 1.0)
    sensed[12], sensed[13] = min(mid_right, 1.0), min(front_right, 1.0)
    sensed[14] = min(rear, 1.0)
    return target, target_distance


@cached_njit()
def _look_for_friends(sensed: np.ndarray, dx: float, dy: float, cosine: float, sine: float) -> None:
    """Write how far the middle of one's team is and in which direction, if it is near."""
    distance = math.sqrt(dx * dx + dy * dy)
    sensed[15], sensed[16] = 0.0, 0.0
    if distance <= TOGETHER:
        angle = math.atan2(cosine * dy - sine * dx, cosine * dx + sine * dy)
        sensed[15] = distance / TOGETHER
        sensed[16] = (angle + math.pi) / FULL_TURN if distance > 1e-9 else 0.5


@cached_njit()
def _propagate(
    minds: Minds, robot: int, value: np.ndarray, fresh: np.ndarray, reached: np.ndarray
) -> None:
    """Let all values go on by one link, at first until both outputs have got something."""
    begin, end = minds.first[robot] + SENSORS + 1, minds.first[robot + 1]
    for _ in range(20):
        for node in range(begin, end):
            total = 0.0
            for link in range(minds.link[node], minds.link[node + 1]):
                total += minds.weight[link] * value[minds.source[link]]
                if not reached[node]:
                    reached[node] = reached[minds.source[link]]
            fresh[node] = 1.0 / (1.0 + math.exp(-total)) if reached[node] else 0.0
        value[begin:end] = fresh[begin:end]
        if reached[minds.output[robot, 0]] and reached[minds.output[robot, 1]]:
            break
