"""Sensors: hand-placed robots, and pymunk's own ray queries as an oracle."""

from __future__ import annotations

import math

import numpy as np
import pymunk
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_envs.arena import Arena, directions
from neatq_envs.physics import border_walls, wall_box
from neatq_envs.rays import barriers, ray_distances
from neatq_envs.scenario import TASKS, Scenario
from neatq_envs.sensors import RAY_ANGLES_RAD, RAY_LENGTH, SCHEMAS, Senses, schema_of
from neatq_envs.walls import Wall


def sense(
    places: list[tuple[float, float, float]],
    flag: tuple[float, float] = (700.0, 700.0),
    task: Scenario = TASKS["flag"],
    ignore: np.ndarray | None = None,
) -> np.ndarray:
    """Return the observations [robots, observations] of robots at (x, y, heading degrees)."""
    poses = np.array([places], dtype=float)
    place, ahead = poses[..., :2].copy(), directions(np.radians(poses[..., 2]))
    return Senses(task).sense(place, ahead, np.array([flag], dtype=float), ignore)[0]


def radar(angle_deg: float, distance: float = 60.0) -> list[float]:
    angle = math.radians(angle_deg)
    flag = (400 + distance * math.cos(angle), 400 + distance * math.sin(angle))
    return sense([(400.0, 400.0, 0.0)], flag)[0, 5:10].tolist()


def test_the_tables_of_indices() -> None:
    arena, nero = SCHEMAS["arena"], SCHEMAS["opennero"]
    assert (arena.name, len(arena.observations), len(arena.actions)) == ("arena-1", 12, 2)
    assert (nero.name, len(nero.observations), len(nero.actions)) == ("opennero-2014", 18, 4)
    assert [nero.index(n) for n in ("wall_left_90", "flag_left", "enemy_left")] == [0, 5, 10]
    assert [nero.index(n) for n in ("friend_proximity", "friend_direction")] == [15, 16]
    assert [arena.index(n) for n in ("friend_proximity", "friend_direction")] == [10, 11]
    low, high = nero.action_bounds(TASKS["flag"])
    assert low.tolist() == pytest.approx([-1, -0.2, 0, 0])
    assert high.tolist() == pytest.approx([1, 0.2, 1, 1])


def test_feedback_is_the_last_reward_where_two_flags_stand() -> None:
    task = TASKS["switch"].replaced(sensors="arena-feedback", reward="progress", robots=2)
    arena, plain = Arena(task, [0]), Arena(task.replaced(sensors="arena"), [0])
    assert arena.schema.observations == (*plain.schema.observations, "last_reward")
    assert arena.observation[..., -1].tolist() == [[0.5, 0.5]]
    for one in (arena, plain):
        one.step(np.array([[[1.0, 0.0], [0.0, 0.0]]]))
    assert arena.observation[..., -1] == pytest.approx(arena.reward)
    assert arena.reward[0, 1] == 0.5 != arena.reward[0, 0]
    assert (arena.observation[..., :-1] == plain.observation).all()
    arena.respawn(np.array([[True, False]]))
    assert arena.observation[0, 0, -1] == 0.5
    one_flag = (TASKS["flag"].replaced(sensors=one) for one in ("arena", "arena-feedback"))
    assert len({schema_of(task) for task in one_flag}) == 1


def test_a_robot_beside_the_right_border() -> None:
    # Facing along x, inner face at 798: 20 units ahead, 20 * sqrt(2) at 45 degrees.
    values = sense([(778.0, 400.0, 0.0)])[0]
    assert values[:5] == pytest.approx([0, 5 / (20 * 2**0.5), 0.25, 5 / (20 * 2**0.5), 0])
    # Turned to the left, the border is on its right.
    values = sense([(778.0, 400.0, 90.0)])[0]
    assert values[:5] == pytest.approx([0, 0, 0, 5 / (20 * 2**0.5), 0.25])


def test_a_wall_reads_one_within_five_units_a_tenth_at_fifty_and_nothing_beyond() -> None:
    ahead = [sense([(798.0 - gap, 400.0, 0.0)])[0, 2] for gap in (3, 5, 10, 49.9999, 50.001)]
    assert ahead == pytest.approx([1, 1, 0.5, 0.1, 0], abs=1e-5)


def test_an_obstacle_is_seen_beside_its_edge_and_missed_past_it() -> None:
    # The wall spans x 350..450 with its lower face at y 398.
    values = sense([(400.0, 378.0, 90.0), (460.0, 400.0, 180.0), (460.0, 410.0, 180.0)], task=WALL)
    assert values[0, 2] == pytest.approx(0.25)
    assert values[1, 2] == pytest.approx(0.5)
    assert values[2, 2] == 0.0


WALL = TASKS["wall"]


@pytest.mark.parametrize(
    ("angle_deg", "sectors"),
    [
        (45, [0]), (15, [0, 1]), (10, [1]), (0, [1, 2]), (-10, [2]), (-15, [2, 3]), (-45, [3]),
        (88, [0, 4]), (120, [4]), (180, [4]), (-120, [4]), (-88, [3, 4]),
    ],
)  # fmt: skip
def test_radar_sectors_overlap_as_in_the_original(angle_deg: float, sectors: list[int]) -> None:
    expected = [0.5 if sector in sectors else 0.0 for sector in range(5)]  # 30 / 60
    assert radar(angle_deg) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("border", "inside", "sector"),
    [
        (90, -1, 0),
        (12, 1, 0),
        (18, -1, 1),
        (-3, 1, 1),
        (3, -1, 2),
        (-18, 1, 2),
        (-12, -1, 3),
        (-90, 1, 3),
        (87, 1, 4),
        (-87, -1, 4),
    ],
)
def test_every_sector_ends_at_its_border(border: float, inside: int, sector: int) -> None:
    assert radar(border + 0.4 * inside)[sector] == 0.5
    assert radar(border - 0.4 * inside)[sector] == 0


def test_friends_are_ignored_above_one_half() -> None:
    arena = Arena(TASKS["flag"].replaced(sensors="opennero", robots=2), [0])
    actions = np.zeros((1, 2, 4))
    actions[0, :, 3] = 0.49, 0.51
    arena.step(actions)
    assert (arena.observation[0, :, 15] > 0).tolist() == [True, False]


def test_radar_range() -> None:
    assert radar(45, 299)[0] == pytest.approx(30 / 299)
    assert radar(45, 301)[0] == 0.0
    assert radar(45, 20)[0] == 1.0
    assert radar(0, 0)[1:3] == [1.0, 1.0]


def test_the_middle_of_friends_includes_the_robot_itself() -> None:
    # Two robots 10 apart: the middle is 5 away, straight ahead for one, to the right for the other.
    values = sense([(400, 400, 0.0), (410, 400, -90.0), (700, 100, 0.0)])
    assert values[0, 10:] == pytest.approx([1 - 5 / 15, 0.5])
    assert values[1, 10:] == pytest.approx([1 - 5 / 15, 0.25])  # at -90 degrees: (-90 + 180) / 360
    assert values[2, 10:] == pytest.approx([1.0, 0.5])  # alone
    close = sense([(400, 400, 0.0), (400, 400.002, 0.0)])
    assert close[0, 10:] == pytest.approx([1 - 0.001 / 15, 0.75])


def test_friends_at_one_place_have_no_direction() -> None:
    values = sense([(400.1, 266.67 + 0.1, 33.0)] * 7)
    assert values[:, 10] == pytest.approx(np.ones(7)) and (values[:, 11] == 0.5).all()


def test_friends_beyond_fifteen_units_do_not_count() -> None:
    near, far = sense([(400, 400, 0.0), (415, 400, 0)]), sense([(400, 400, 0.0), (415.1, 400, 0)])
    assert near[0, 10] == pytest.approx(0.5)
    assert far[0, 10] == 1.0


def test_the_original_order_and_its_dead_inputs() -> None:
    task = TASKS["flag"].replaced(sensors="opennero")
    places = [(778.0, 400.0, 0.0), (778.0, 410.0, 0.0)]
    values = sense(places, flag=(718.0, 400.0), task=task)
    assert values.shape == (2, 18)
    assert values[0, 2] == pytest.approx(0.25)
    assert values[0, 5:10] == pytest.approx([0, 0, 0, 0, 0.5])  # behind, 60 units
    assert (values[:, 10:15] == 0).all() and (values[:, 17] == 0).all()
    assert values[0, 15:17] == pytest.approx([1 - 5 / 15, 0.75])  # middle at +90 degrees
    ignored = sense(places, flag=(718.0, 400.0), task=task, ignore=np.array([[True, False]]))
    assert ignored[0, 15:17].tolist() == [0, 0]
    assert (ignored[0, :15] == values[0, :15]).all() and (ignored[1] == values[1]).all()


@given(
    seed=st.integers(0, 2**32 - 1),
    angle_rad=st.floats(-3.2, 3.2),
    size=st.tuples(st.floats(1, 120), st.floats(1, 120)),
)
@settings(max_examples=30, deadline=None)
def test_rays_equal_the_ray_queries_of_pymunk(
    seed: int, angle_rad: float, size: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    wall = Wall(x=60, y=60, width=size[0], height=size[1], angle_rad=angle_rad)
    space = pymunk.Space()
    space.add(*(wall_box(space.static_body, box) for box in (*border_walls(TASKS["flag"]), wall)))
    place = rng.uniform(10, 140, size=(1, 20, 2))
    heading = rng.uniform(-np.pi, np.pi, size=(1, 20))
    turns = directions(np.array([RAY_ANGLES_RAD]))[0]
    around = barriers([wall], 800.0, 800.0, 2.0)
    distances = ray_distances(place, directions(heading), turns, RAY_LENGTH, around)
    for robot in range(20):
        x, y = place[0, robot]
        nearest = space.point_query_nearest((x, y), 0.01, pymunk.ShapeFilter())
        if nearest is not None:  # ray queries from inside a shape mean something else
            assert nearest.distance >= 0 or (distances[0, robot] == 0).all()
            continue
        for ray, turn in enumerate(RAY_ANGLES_RAD):
            angle = heading[0, robot] + turn
            end = (x + 50 * math.cos(angle), y + 50 * math.sin(angle))
            hit = space.segment_query_first((x, y), end, 0.0, pymunk.ShapeFilter())
            distance = distances[0, robot, ray]
            if hit is None:
                assert distance > 50 - 1e-9
            else:
                assert distance == pytest.approx(50 * hit.alpha, abs=1e-9)


def test_distances_are_measured_in_lengths_of_the_ray() -> None:
    # The face of the wall, at x = 398, is 20 units away: five lengths of a ray of 4 units.
    around = barriers([Wall(x=400, y=400, width=4, height=100)], 800.0, 800.0, 2.0)
    place = np.full((1, 3, 2), (378.0, 400.0))
    ahead = np.array([[(4.0, 0.0), (0.0, -4.0), (0.0, 4.0)]])
    straight_and_left = np.array([(1.0, 0.0), (0.0, 1.0)])
    distances = ray_distances(place, ahead, straight_and_left, 6.0, around)
    assert distances[0].tolist() == [[5, np.inf], [np.inf, 5], [np.inf, np.inf]]
