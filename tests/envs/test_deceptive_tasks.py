"""The tasks in which going straight to the flag does not pay: how far each way of acting ends."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable

import numpy as np
import pytest

from neatq_envs.arena import Arena
from neatq_envs.scenario import TASKS, Scenario, Spawn
from neatq_envs.walls import MAZE_GOAL as GOAL
from neatq_envs.walls import MAZE_START as START
from neatq_envs.walls import Wall, box_distance

Place = tuple[float, float]
Drive = Callable[[Arena], np.ndarray]
ARC = np.linspace(0, math.pi / 2, 5)
_SPAWN_IN_POCKET = Spawn(x=400.0, y=392.0, jitter=1)


# ---------------------------------------------------------------------------- distances


def distances(task: Scenario, ticks: int = 1000) -> np.ndarray:
    """Return the distances to the flag, float64 [ticks], on the shortest way."""
    way = positions(shortest_way(task), ticks) - task.flag.positions[0]
    return np.hypot(*way.T)


def test_the_search_finds_the_way_round_one_wall() -> None:
    # A point would go 2 * sqrt(50^2 + 131.33^2) + 4 = 285.1 units, by the wall's end. Its radius
    # keeps a robot 4.09 off: within 2 * sqrt(54.09^2 + 127.24^2) + 12.18 = 288.7, round a square.
    assert 285.1 < length(shortest_way(TASKS["wall"])) < 288.7
    assert length(shortest_way(TASKS["flag"])) == pytest.approx(100 * math.sqrt(2))


@pytest.mark.parametrize(
    ("name", "still", "perfect", "far"),
    [
        ("flag", 141, 10, 141),
        ("wall", 267, 40, 288),
        ("trap", 267, 73, 413),
        ("maze", 164, 53, 450),
    ],
)
def test_what_standing_still_and_a_perfect_way_cost(
    name: str, still: float, perfect: float, far: float
) -> None:
    task = TASKS[name]
    assert math.dist((task.spawns[0].x, task.spawns[0].y), task.flag.positions[0]) == pytest.approx(
        still, abs=0.5
    )
    assert distances(task).mean() == pytest.approx(perfect, abs=0.5)
    assert length(shortest_way(task)) == pytest.approx(far, abs=0.5)


@pytest.mark.parametrize(
    ("name", "mean", "end"), [("wall", 147, 139), ("trap", 147, 139), ("maze", 139, 138)]
)
def test_who_runs_straight_to_the_flag_is_held_by_a_wall(
    name: str, mean: float, end: float, to_flag: Drive
) -> None:
    arena, seen = Arena(TASKS[name], [0]), []
    for _ in range(1000):
        arena.step(to_flag(arena))
        seen.append(arena.distance.mean())
    assert seen[-1] == pytest.approx(end, abs=1) and arena.distance.min() > end - 2
    assert np.mean(seen) == pytest.approx(mean, abs=2)


def test_whoever_is_in_the_pocket_must_go_away_from_the_flag() -> None:
    # Its floor is 139 units from the flag; the way round leaves it at (276, 298) and passes the
    # corner at sqrt(124^2 + 235^2) = 266 units, as far as the spawn.
    way = shortest_way(TASKS["trap"].replaced(spawns=[_SPAWN_IN_POCKET]))
    away = distances(TASKS["trap"].replaced(spawns=[_SPAWN_IN_POCKET]))
    assert away[0] < 160 and away.max() == pytest.approx(266, abs=2)
    assert length(way) > 400


def test_the_perfect_way_beats_waiting_by_what_evolution_sees() -> None:
    # Fitness sums squared distances. Whoever waits where walls hold it has them all its life, and
    # larger ones before. The maze has a second dead end, 87 units from the flag.
    for name, end in (("trap", 139.4), ("maze", 138.3), ("maze", 87.3)):
        assert (distances(TASKS[name]) ** 2).mean() < 0.99 * end**2, name


@pytest.mark.parametrize("name", ["trap", "maze"])
def test_robots_can_go_the_shortest_way(name: str) -> None:
    task = TASKS[name]
    places = np.array(shortest_way(task)[1:])
    arena, aim = Arena(task, [3]), np.zeros((1, task.robots), dtype=int)
    for _ in range(600):
        way = places[aim] - arena.position
        near = np.hypot(way[..., 0], way[..., 1]) < 3.0
        turn = np.arctan2(way[..., 1], way[..., 0]) - arena.heading_rad
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        # Whoever looks another way stops and turns.
        speed = np.where(np.abs(turn) < 0.3, task.max_speed, 0.0)
        arena.step(np.stack([speed, turn], axis=-1))
        aim = np.minimum(aim + near, len(places) - 1)
    assert (arena.distance < 10).all()


@pytest.mark.parametrize("collide", [False, True])
def test_nobody_leaves_the_maze(collide: bool) -> None:
    task = TASKS["maze"].replaced(collide=collide, robots=200)
    arena, rng = Arena(task, [0]), np.random.default_rng(0)
    for _ in range(400):  # in long arcs, so that robots press against walls for long
        turn = rng.uniform(-0.05, 0.05, arena.shape)
        arena.step(np.stack([np.full(arena.shape, 1.0), turn], axis=-1))
        x, y = arena.position[..., 0], arena.position[..., 1]
        for wall in task.walls:
            assert (box_distance(x, y, wall) > 0).all()


def test_the_maze_is_the_published_map() -> None:
    task = TASKS["maze"]
    origin = task.spawns[0].x - START[0], task.spawns[0].y - START[1]
    assert task.flag.positions[0] == (origin[0] + GOAL[0], origin[1] + GOAL[1])
    assert (START, GOAL, len(task.walls)) == ((31, 20), (36, 184), 13)
    # The wall from (56, 54) to (56, 157) is upright, 103 long and 4 more for its ends.
    upright = task.walls[7]
    assert (upright.x, upright.y) == pytest.approx((origin[0] + 56, origin[1] + 105.5))
    assert upright.width == pytest.approx(107) and upright.angle_rad == pytest.approx(math.pi / 2)


def test_a_wall_between_two_points_covers_both_and_half_its_thickness_beyond() -> None:
    wall = Wall.between((1.0, 1.0), (4.0, 5.0), thickness=2.0)  # 5 long, along (0.6, 0.8)
    x, y = np.array([1.0, 4.0, 4.6, 4.6 + 0.6]), np.array([1.0, 5.0, 5.8, 5.8 + 0.8])
    assert box_distance(x, y, wall) == pytest.approx([-1, -1, 0, 1], abs=1e-9)


# --------------------------------------------------------------------- the shortest way


def length(way: list[Place]) -> float:
    """Return how long a way is, in units."""
    return sum(map(math.dist, way, way[1:]))


def shortest_way(task: Scenario) -> list[Place]:
    """Return the places where the shortest way from the spawn to the flag turns, ends included.

    Dijkstra (1959) on points round the corners of the walls, a robot's radius off.
    """
    start = task.spawns[0].x, task.spawns[0].y
    places = [start, task.flag.positions[0], *(p for w in task.walls for p in _round(task, w))]
    length, before, done = {0: 0.0}, dict[int, int](), set[int]()
    waiting = [(0.0, 0)]
    while 1 not in done:
        so_far, here = heapq.heappop(waiting)
        done.add(here)
        for there in {*range(len(places))} - done:
            total = so_far + math.dist(places[here], places[there])
            if total < length.get(there, math.inf) and _free(task, places[here], places[there]):
                length[there], before[there] = total, here
                heapq.heappush(waiting, (total, there))
    way = [1]
    while way[-1]:
        way.append(before[way[-1]])
    return [places[number] for number in reversed(way)]


def positions(way: list[Place], ticks: int) -> np.ndarray:
    """Return where a robot is that goes a way by one unit a tick, float64 [ticks, 2]."""
    turns = np.array(way)
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(turns, axis=0).T))])
    after = np.minimum(np.arange(1, ticks + 1), gone[-1])
    return np.stack([np.interp(after, gone, turns[:, axis]) for axis in (0, 1)], axis=1)


def _round(task: Scenario, wall: Wall) -> list[Place]:
    """Return free places on arcs round the corners of a wall."""
    off = 1.025 * task.robot_radius  # so that the chords of the arcs are free, too
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    places = []
    for right in (-1, 1):
        for up in (-1, 1):
            x = right * (wall.width / 2 + off * np.cos(ARC))
            y = up * (wall.height / 2 + off * np.sin(ARC))
            turned = np.stack([wall.x + cosine * x - sine * y, wall.y + sine * x + cosine * y], 1)
            places += [(x, y) for x, y in turned.tolist() if _free(task, (x, y), (x, y))]
    return places


def _free(task: Scenario, start: Place, end: Place) -> bool:
    """Return whether a robot can go straight from one place to another."""
    steps = 2 + int(2 * math.dist(start, end))
    x, y = (np.linspace(a, b, steps) for a, b in zip(start, end, strict=True))
    radius = task.robot_radius
    return all(bool((box_distance(x, y, wall) >= radius).all()) for wall in task.walls)


def team_after_a_moving_flag(ages: np.ndarray) -> float:
    """Return the mean distance of a perfect team of such ages, in the last tenth of a run."""
    task, begin = TASKS["moving"], 54_000
    flags = np.array(task.flag.positions)
    spawn = np.array([task.spawns[0].x, task.spawns[0].y])
    place, total = np.tile(flags[begin // 5000], (len(ages), 1)), 0.0
    for tick in range(begin - 1000, 60_000):
        place[(ages + tick) % 1000 == 0] = spawn
        way = flags[tick // 5000 % len(flags)] - place
        far = np.hypot(*way.T)
        place = place + way * np.minimum(1, 1 / np.maximum(far, 1e-9))[:, None]
        total += np.maximum(far - 1, 0).mean() if tick >= begin else 0
    return total / 6000


def test_where_all_lives_begin_when_the_flag_moves_a_perfect_team_need_not_turn_round() -> None:
    spread, together = np.arange(50) * 20, np.zeros(50, int)
    assert team_after_a_moving_flag(spread) == pytest.approx(19, abs=0.5)
    assert team_after_a_moving_flag(together) == pytest.approx(11.5, abs=0.5)
