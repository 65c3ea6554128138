"""NERO's battle, rule by rule: sensors, targets, shots, damage, turns, movement and the end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import NERO_TASKS, OBSERVATIONS, NeroScenario
from neatq_envs.nero.state import (
    BRAIN,
    GIVEN,
    Field,
    Ground,
    NeroLaw,
    TeamBrains,
    law_of,
    make_field,
    no_brains,
    spawn_robots,
    walls_of,
)
from neatq_envs.scenario import TASKS
from neatq_envs.sensors import Senses
from neatq_envs.walls import Wall, box_distance

Place = tuple[float, float, float]
"""X and y in units, heading in degrees."""
OPEN = NERO_TASKS["battle"].replaced(walls=())
WIDE = OPEN.replaced(width=2000.0)
RADIUS_X, RADIUS_Y = 6.53, 4.09
STAY = (0.0, 0.0, 1.0)
"""Neither go nor turn, but shoot."""


@dataclass
class Stage:
    """A field whose robots are moved by hand."""

    scenario: NeroScenario
    field: Field
    ground: Ground
    law: NeroLaw

    def tick(self, *actions: Sequence[float], seed: int = 0) -> int:
        """Let a tick pass: the first robots act like this, all others stay and shoot."""
        return self.go(np.random.default_rng(seed), *actions)

    def go(self, rng: np.random.Generator, *actions: Sequence[float]) -> int:
        given = np.zeros((len(self.field.team), 4))
        given[:, : len(STAY)] = STAY
        for robot, action in enumerate(actions):
            given[robot, : len(action)] = action
        return kernels.tick(self.field, self.ground, self.law, no_brains(), given, rng)

    def senses(self, robot: int = 0) -> np.ndarray:
        """What a robot senses in its turn, after a tick in which nobody moved or shot."""
        self.tick(*[(0.0, 0.0, 0.0)] * len(self.field.team))
        seen = np.zeros((robot + 1, OBSERVATIONS[self.scenario.sensors]), np.float32)
        kernels.look(self.field, self.ground, self.law, robot + 1, seen)
        return seen[robot]

    def corrected(self) -> np.ndarray:
        """Poses as walls will have pushed them when the next tick begins."""
        field = self.field._replace(pose=self.field.pose.copy())
        kernels.correct(field, self.ground)
        return field.pose


def stage(
    blue: Sequence[Place], red: Sequence[Place] = (), scenario: NeroScenario = OPEN, **changes: Any
) -> Stage:
    scenario = scenario.replaced(**changes)
    field = make_field(scenario, (len(blue), len(red)))
    places = np.array([*blue, *red], float).reshape(-1, 3)
    field.pose[: len(places)] = places
    field.pose[:, 2] = np.radians(field.pose[:, 2])
    field.control[: len(places)], field.begun[:] = GIVEN, True
    return Stage(scenario, field, walls_of(scenario), law_of(scenario))


def ahead(degrees: float, distance: float, start: tuple[float, float] = (400.0, 400.0)) -> Place:
    """A robot in that direction, that looks along x."""
    angle = math.radians(degrees)
    return start[0] + distance * math.cos(angle), start[1] + distance * math.sin(angle), 0.0


# ------------------------------------------------------------------------------------ wall rays

BOTH = "opennero-2011", "opennero-2014"


@pytest.mark.parametrize(
    ("sensors", "straight", "slanted", "none"),
    [
        ("opennero-2011", 25 / 50, 25 * math.sqrt(2) / 50, 1.0),
        ("opennero-2014", 5 / 25, 5 / (25 * math.sqrt(2)), 0.0),
        ("nero-1", 5 / 25, 5 / (25 * math.sqrt(2)), 0.0),
    ],
)
def test_wall_rays_measure_to_the_inner_face_of_the_border(
    sensors: str, straight: float, slanted: float, none: float
) -> None:
    # Border walls are 4 thick and centred on the edges: their faces are at 2 and 798.
    for place in ((27.0, 400.0, 180.0), (773, 400, 0), (400, 27, -90), (400, 773, 90)):
        rays = stage([place], sensors=sensors).senses()[:5]
        assert rays == pytest.approx([none, slanted, straight, slanted, none], abs=1e-6)


def test_the_first_ray_is_to_the_left_and_the_last_to_the_right() -> None:
    assert stage([(400, 748, 0)]).senses()[:5] == pytest.approx([1] * 5)
    left = stage([(400, 768, 0)]).senses()[:5]  # 30 to the left, 42.43 at 45 degrees
    assert left == pytest.approx([0.6, 30 * math.sqrt(2) / 50, 1, 1, 1])
    right = stage([(400, 768, 180)], sensors="opennero-2014").senses()[:5]
    assert right == pytest.approx([0, 0, 0, 5 / (30 * math.sqrt(2)), 5 / 30])


@pytest.mark.parametrize(
    ("distance", "of_2011", "of_2014"),
    [(49.99, 0.9998, 5 / 49.99), (50.01, 1.0, 0.0), (10, 0.2, 0.5), (4.5, 0.09, 1.0)],
)
def test_rays_are_50_long_and_those_of_2014_read_1_up_to_5(
    distance: float, of_2011: float, of_2014: float
) -> None:
    place = (400.0, 2 + distance, -90.0)
    assert stage([place]).senses()[2] == pytest.approx(of_2011, abs=1e-6)
    assert stage([place], sensors="opennero-2014").senses()[2] == pytest.approx(of_2014, abs=1e-6)


def test_rays_meet_walls_in_the_field_at_any_angle() -> None:
    middle = stage([(400, 378, 90)], scenario=NERO_TASKS["battle"])
    assert middle.senses()[:5] == pytest.approx([1, 0.4 * math.sqrt(2), 0.4, 0.4 * math.sqrt(2), 1])
    beside = stage([(520, 400, 180)], scenario=NERO_TASKS["battle"]).senses()
    assert beside[:5] == pytest.approx([1, 1, 0.4, 1, 1])  # the end of the wall is at 500
    turned = Wall(x=400, y=400, width=200, height=4, angle_rad=math.pi / 4)
    away = 22 / math.sqrt(2)  # 20 from its face, 22 from its middle line
    robot = (400 + away, 400 - away, 135.0)
    rays = stage([robot], walls=(turned,)).senses()[:5]
    assert rays == pytest.approx([1, 0.4 * math.sqrt(2), 0.4, 0.4 * math.sqrt(2), 1])


# ---------------------------------------------------------------------------------------- radars

SECTORS = {
    0: (1, 2),
    2.9: (1, 2),
    3.1: (1,),
    11.9: (1,),
    12.1: (0, 1),
    17.9: (0, 1),
    18.1: (0,),
    86.9: (0,),
    87.1: (0, 4),
    89.9: (0, 4),
    90.1: (4,),
    179.9: (4,),
    -2.9: (1, 2),
    -3.1: (2,),
    -11.9: (2,),
    -12.1: (2, 3),
    -17.9: (2, 3),
    -18.1: (3,),
    -86.9: (3,),
    -87.1: (3, 4),
    -89.9: (3, 4),
    -90.1: (4,),
    -179.9: (4,),
}
"""In which sectors something is seen, by its angle in degrees to the left of the heading."""


@pytest.mark.parametrize("degrees", SECTORS)
@pytest.mark.parametrize("heading", [0.0, 100.0, -170.0])
def test_radar_sectors_overlap_at_their_borders(degrees: float, heading: float) -> None:
    seen = [0.3 if sector in SECTORS[degrees] else 0.0 for sector in range(5)]
    other = ahead(degrees + heading, 100)
    robot = (400.0, 400.0, heading)
    enemies = stage([robot], [other], sensors="nero-1").senses()
    assert enemies[5:20] == pytest.approx([0] * 5 + seen + [0] * 5, abs=1e-6)
    friends = stage([robot, other], sensors="nero-1").senses()
    assert friends[5:20] == pytest.approx([0] * 10 + seen, abs=1e-6)
    flag = stage([robot], flag=other[:2], sensors="nero-1").senses()
    assert flag[5:20] == pytest.approx(seen + [0] * 10, abs=1e-6)
    for sensors in BOTH:
        senses = stage([robot], [other], flag=other[:2], sensors=sensors).senses()
        assert senses[5:15] == pytest.approx(seen * 2, abs=1e-6)


@pytest.mark.parametrize(("degrees", "sectors"), [(90, (0, 4)), (-90, (3, 4))])
def test_what_is_exactly_abeam_is_in_the_side_sector_and_in_the_rear(
    degrees: int, sectors: tuple[int, int]
) -> None:
    other = (400.0, 400.0 + math.copysign(100, degrees), 0.0)
    seen = [0.3 if sector in sectors else 0.0 for sector in range(5)]
    assert stage([(400, 400, 0)], [other]).senses()[10:15] == pytest.approx(seen, abs=1e-6)


@pytest.mark.parametrize(
    ("distances", "value"),
    [
        ((100, 150), 30 / 100 + 30 / 150),
        ((50, 60), 1.0),
        ((20,), 1.0),
        ((299.9,), 30 / 299.9),
        ((300.1,), 0.0),
        ((60, 300.1), 0.5),
    ],
)
def test_enemies_within_300_add_30_by_their_distance_up_to_1(
    distances: tuple[float, ...], value: float
) -> None:
    enemies = [ahead(10, distance) for distance in distances]
    senses = stage([(400, 400, 0)], enemies).senses()
    assert senses[10:15] == pytest.approx([0, value, 0, 0, 0], abs=1e-6)


def test_walls_do_not_hide_enemies_from_the_radar() -> None:
    battle = stage([(400, 350, 90)], [(400, 450, 0)], scenario=NERO_TASKS["battle"])
    assert battle.senses()[10:15] == pytest.approx([0, 0.3, 0.3, 0, 0], abs=1e-6)


def test_enemies_off_the_field_are_not_seen_and_turrets_are() -> None:
    fallen = stage([(400, 400, 0)], [ahead(10, 100), ahead(10, 150)])
    fallen.field.alive[1] = False
    assert fallen.senses()[11] == pytest.approx(0.2)
    turrets = stage([(400, 400, 0)], turrets=(ahead(10, 100)[:2],))
    assert turrets.senses()[11] == pytest.approx(0.3)


def test_a_flag_is_seen_within_300_and_where_there_is_none_nothing_is() -> None:
    for distance, value in ((60, 0.5), (15, 1.0), (299.9, 30 / 299.9), (300.1, 0.0)):
        flag = ahead(-10, distance)[:2]
        senses = stage([(400, 400, 0)], flag=flag).senses()
        assert senses[5:10] == pytest.approx([0, 0, value, 0, 0], abs=1e-6)
    assert not stage([(400, 400, 0)]).senses()[5:10].any()


# --------------------------------------------------------------------------------------- friends


def test_in_2011_friends_are_the_mean_place_of_the_living_team_within_15_units() -> None:
    # The mean is at (109, 100): 9 units away, to the right of who looks along y.
    team = [(100.0, 100.0, 90.0), (118.0, 100.0, 0.0)]
    enemy = (700.0, 700.0, 0.0)
    assert stage(team, [enemy]).senses()[15:17] == pytest.approx([9 / 15, 90 / 360])
    other = stage(team, [enemy]).senses(robot=1)  # who looks away from it
    assert other[15] == pytest.approx(9 / 15)
    assert abs(other[16] - 0.5) == pytest.approx(0.5)
    far = [(100.0, 100.0, 90.0), (131.0, 100.0, 0.0)]
    assert stage(far, [enemy]).senses()[15:17] == pytest.approx([0, 0])
    fallen = stage([*team, (600, 600, 0)], [enemy])
    assert fallen.senses()[15:17] == pytest.approx([0, 0])
    fallen.field.alive[2] = False
    assert fallen.senses()[15:17] == pytest.approx([9 / 15, 90 / 360])


def test_alone_in_2011_the_mean_place_is_its_own() -> None:
    assert stage([(100, 100, 30)]).senses()[15:17] == pytest.approx([0, 0.5], abs=1e-6)


def test_in_2014_friends_are_the_mean_place_of_those_within_15_units() -> None:
    team = [(100.0, 100.0, 90.0), (112.0, 100.0, 0.0), (600.0, 600.0, 0.0)]
    near = stage(team, sensors="opennero-2014").senses()  # the mean of two is 6 to the right
    assert near[15:17] == pytest.approx([1 - 6 / 15, 90 / 360], abs=1e-6)
    alone = stage(team, sensors="opennero-2014").senses(robot=2)
    assert alone[15:17] == pytest.approx([1, 0.5], abs=1e-6)


def test_the_sensors_of_2014_are_those_that_the_arena_has_by_the_same_name() -> None:
    rng = np.random.default_rng(3)
    pose = np.column_stack([rng.uniform(388, 412, (8, 2)), rng.uniform(-math.pi, math.pi, 8)])
    scenario = TASKS["flag"].replaced(sensors="opennero", robots=8, walls=())
    looking = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], -1)
    flag = np.array([[430.0, 330.0]])
    expected = Senses(scenario).sense(pose[None, :, :2], looking[None], flag)[0]
    places = [(x, y, math.degrees(heading)) for x, y, heading in pose]
    nero = stage(places, flag=(430.0, 330.0), sensors="opennero-2014")
    sensed = np.stack([nero.senses(robot) for robot in range(8)])
    assert sensed[:, :15] == pytest.approx(expected[:, :15], abs=1e-6)
    assert sensed[:, 15:] == pytest.approx(expected[:, 15:], abs=1e-6)


def test_who_ignored_its_friends_in_2014_reads_nothing_of_them_in_the_next_tick() -> None:
    robots = stage([(100, 100, 0), (100, 100, 0)], sensors="opennero-2014")
    robots.tick((0, 0, 0, 0.6), (0, 0, 0, 0.4))
    seen = np.zeros((2, 18), np.float32)
    kernels.look(robots.field, robots.ground, robots.law, 2, seen)
    assert seen[0, 15:17].tolist() == [0, 0]
    assert seen[1, 15:17] == pytest.approx([1, 0.5])
    robots.tick((0, 0, 0, 0.5))
    kernels.look(robots.field, robots.ground, robots.law, 2, seen)
    assert seen[0, 15:17] == pytest.approx([1, 0.5])


# ----------------------------------------------------------------------------------- own sensors


def test_a_target_is_sensed_in_2011_and_by_the_own_sensors_and_not_in_2014() -> None:
    for degrees, sensed in ((1.9, 1.0), (-1.9, 1.0), (2.1, 0.0), (180.0, 0.0)):
        enemies = [ahead(degrees, 350)]
        assert stage([(400, 400, 0)], enemies).senses()[17] == sensed
        assert stage([(400, 400, 0)], enemies, sensors="nero-1").senses()[20] == sensed
        assert stage([(400, 400, 0)], enemies, sensors="opennero-2014").senses()[17] == 0


def test_the_own_sensors_tell_hit_points_and_fire() -> None:
    robots = stage([(400, 400, 0)], hit_points=8, sensors="nero-1", firing="aimed")
    assert robots.senses()[21:23].tolist() == [1, 0]
    robots.field.pending[0] = 2  # damage that came in since its last turn
    seen = np.zeros((1, 23), np.float32)
    kernels.look(robots.field, robots.ground, robots.law, 1, seen)
    assert seen[0, 21:23].tolist() == [1, 1]
    assert robots.senses()[21:23].tolist() == [0.75, 1]  # taken in this tick
    assert robots.senses()[21:23].tolist() == [0.75, 0]
    robots.field.damage[0] = 11
    assert stage([(400, 400, 0)], sensors="nero-1").senses().size == 23
    kernels.look(robots.field, robots.ground, robots.law, 1, seen)
    assert seen[0, 21] == 0


def test_the_dead_sense_nothing() -> None:
    robots = stage([(400, 400, 0)], [ahead(0, 100)], sensors="nero-1")
    robots.field.alive[0] = False
    assert not robots.senses().any()


# --------------------------------------------------------------------------------------- targets


def shot_at(enemies: list[Place], friends: Sequence[Place] = (), **changes: Any) -> int:
    """At which enemy a robot at (400, 400) shoots that looks along x; -1: at none."""
    robots = stage([(400, 400, 0), *friends], enemies, **changes)
    robots.tick()
    return max(int(robots.field.shot[0]) - 1 - len(friends), -1)


@pytest.mark.parametrize("firing", ["2011", "aimed"])
def test_the_target_is_within_2_degrees_of_the_heading(firing: str) -> None:
    for degrees, hit in ((0, 0), (1.99, 0), (-1.99, 0), (2.01, -1), (-2.01, -1), (180, -1)):
        assert shot_at([ahead(degrees, 200)], firing=firing) == hit, degrees
    assert shot_at([], firing=firing) == -1


@pytest.mark.parametrize("firing", ["2011", "aimed"])
def test_of_several_the_least_distance_by_the_cosine_of_20_times_the_angle(firing: str) -> None:
    # 20 x 1.9 degrees: cos(38 degrees) = 0.788, so 80 counts as 101.5 and 78 as 99.0.
    straight = ahead(0, 100)
    assert shot_at([straight, ahead(1.9, 80)], firing=firing) == 0
    assert shot_at([straight, ahead(1.9, 78)], firing=firing) == 1
    assert shot_at([straight, ahead(-1.9, 78)], firing=firing) == 1
    assert shot_at([ahead(1, 95), straight], firing=firing) == 1  # counts as 101.1
    assert shot_at([ahead(1, 93), straight], firing=firing) == 0  # counts as 99.0


def test_friends_and_the_dead_are_no_targets_and_not_in_the_way() -> None:
    assert shot_at([ahead(0, 200)], friends=[ahead(0, 100)]) == 0
    assert shot_at([], friends=[ahead(0, 100)]) == -1
    robots = stage([(400, 400, 0)], [ahead(0, 100), ahead(0, 200)])
    robots.field.alive[1] = False
    robots.tick()
    assert robots.field.shot.tolist() == [2, -1, -1]


# ----------------------------------------------------------------------------------------- shots


def shots(distance: float, firing: str, wanted: int = 4000, **changes: Any) -> tuple[int, int]:
    """Of how many shots at an enemy so far away how many hit; each of 1000 robots has a few."""
    robots, hits = 1000, 0
    field = stage([(100, 400, 0)] * robots, [(100 + distance, 400, 0)], WIDE, firing=firing)
    rng = np.random.default_rng(5)
    for _ in range(wanted // robots):
        field.go(rng, *[STAY] * robots, (0, 0, 0))
        hits += int(field.field.hits.sum())
        assert field.field.taken[-1] == field.field.hits.sum()
        assert not field.field.pending[:-1].any()
        field.field.damage[-1] = 0
    return hits, wanted


@pytest.mark.parametrize(
    ("firing", "distance", "probability"),
    [
        ("2011", 1, (1 - (599 / 600) / 2) ** 2),  # 0.251
        ("2011", 150, (1 - 0.75 / 2) ** 2),  # 0.391
        ("2011", 300, (1 - 0.5 / 2) ** 2),  # 0.5625
        ("2011", 540, (1 - 0.1 / 2) ** 2),  # 0.9025
        ("2011", 600, 1.0),
        ("2011", 601, 1.0),
        ("2011", 1800, 1.0),
        ("2014", 1, 199 / 400),
        ("2014", 100, 0.25),
        ("2014", 160, 0.1),
        ("2014", 200, 0.0),
        ("2014", 299, 0.0),
        ("aimed", 1, 1 - 1 / 300),
        ("aimed", 75, 0.75),
        ("aimed", 240, 0.2),
        ("aimed", 300, 0.0),
        ("aimed", 500, 0.0),
    ],
)
def test_so_many_shots_hit(firing: str, distance: float, probability: float) -> None:
    hits, number = shots(distance, firing)
    spread = math.sqrt(number * probability * (1 - probability))
    assert abs(hits - number * probability) <= 3.3 * spread


@pytest.mark.parametrize(("firing", "draws"), [("2011", 2), ("2014", 1), ("aimed", 1)])
@pytest.mark.parametrize("distance", [20.0, 120.0, 199.0, 450.0, 700.0])
def test_a_shot_hits_where_its_draws_say_so(firing: str, draws: int, distance: float) -> None:
    robots = stage([(100, 400, 0)], [(100 + distance, 400, 0)], WIDE, firing=firing)
    if firing == "2014" and distance > 300:
        draws = 0
    for seed in range(60):
        rng, twin = np.random.default_rng(seed), np.random.default_rng(seed)
        robots.field.damage[:] = 0
        robots.go(rng, STAY, (0, 0, 0))
        drawn = twin.random(draws)
        if firing == "2011":
            expected = bool((drawn > (600 - distance) / 600 / 2).all())
        elif firing == "2014":
            expected = bool((drawn < (200 - distance) / 400).any())
        else:
            expected = drawn[0] > distance / 300
        assert robots.field.hits.tolist() == [int(expected), 0]
        assert robots.field.taken.tolist() == [0, int(expected)]
        assert rng.random() == twin.random(), "another number of draws"


def test_fire_is_asked_for_except_in_2011() -> None:
    for firing, fires in (("2011", True), ("2014", False), ("aimed", False)):
        for fire, shoots in ((0.49, fires), (0.5, True)):
            robots = stage([(400, 400, 0)], [ahead(0, 100)], firing=firing)
            robots.tick((0, 0, fire))
            assert (robots.field.shot[0] == 1) == shoots, (firing, fire)


@pytest.mark.parametrize("firing", ["2011", "aimed"])
def test_walls_stop_shots(firing: str) -> None:
    def hits(red: Place, blue: Place = (400, 350, 90), **changes: Any) -> int:
        battle = NERO_TASKS["battle"].replaced(firing=firing, **changes)
        field = stage([blue] * 200, [red], battle)
        field.tick()
        assert (field.field.shot[:-1] == 200).all()
        return int(field.field.hits.sum())

    assert hits((400, 450, 0)) == 0
    assert hits((400, 390, 0)) > 0  # before the wall
    assert hits((510, 450, 0), blue=(510, 350, 90)) > 0  # beside it
    turned = Wall(x=400, y=400, width=200, height=4, angle_rad=math.pi / 2)
    assert hits((450, 400, 0), blue=(350, 400, 0), walls=(turned,)) == 0
    assert hits((450, 505, 0), blue=(350, 505, 0), walls=(turned,)) > 0


def test_in_2014_walls_hide_enemies() -> None:
    battle = NERO_TASKS["battle"].replaced(firing="2014")
    hidden = stage([(400, 350, 90)], [(400, 450, 0)], battle)
    hidden.tick()
    assert hidden.field.shot[0] == -1 and hidden.field.pose[0, 2] == pytest.approx(math.pi / 2)
    # The hidden one is nearer than the one in sight, at which it turns.
    choice = stage([(400, 350, 90)], [(400, 420, 0), (500, 350, 0)], battle)
    choice.tick()
    assert choice.field.shot[0] == -1
    assert choice.field.pose[0, 2] == pytest.approx(0, abs=1e-9)


def test_in_2014_it_shoots_at_the_nearest_within_300_or_turns_by_the_full_angle() -> None:
    near, far = ahead(150, 100), ahead(0, 120)
    robots = stage([(400, 400, 0)], [far, near], firing="2014")
    robots.tick((0.5, 0.1, 1.0))  # its own turn is not heard; it goes along the new heading
    assert robots.field.shot[0] == -1
    x, y, _ = ahead(150, 0.5)
    assert robots.field.pose[0] == pytest.approx([x, y, math.radians(150)])
    robots.tick((0.5, 0.1, 1.0))  # within 2 degrees it shoots, and turns as it wants
    assert robots.field.shot[0] == 2
    assert robots.field.pose[0, 2] == pytest.approx(math.radians(150) + 0.1)
    behind = stage([(400, 400, 0)], [near, far], firing="2014")
    behind.tick()  # the nearest, wherever it stands in its team
    assert behind.field.pose[0, 2] == pytest.approx(math.radians(150))
    for degrees, shot, turned in ((1.99, 1, 0.1), (2.01, -1, math.radians(2.01))):
        aimed = stage([(400, 400, 0)], [ahead(degrees, 100)], firing="2014")
        aimed.tick((0.0, 0.1, 1.0))
        assert (aimed.field.shot[0], aimed.field.pose[0, 2]) == (shot, pytest.approx(turned))
    beyond = stage([(400, 400, 0)], [ahead(150, 300.1)], firing="2014")
    beyond.tick((0.0, 0.1, 1.0))
    assert beyond.field.pose[0, 2] == pytest.approx(0.1)
    peaceful = stage([(400, 400, 0)], [near], firing="2014")
    peaceful.tick((0.0, 0.1, 0.4))
    assert peaceful.field.pose[0, 2] == pytest.approx(0.1)


# ----------------------------------------------------------------------------- damage and turns


def duel(hit_points: int = 20) -> Stage:
    """Two that look at each other, 800 apart: each shot hits."""
    return stage([(100, 400, 0)], [(900, 400, 180)], WIDE, hit_points=hit_points)


def test_damage_is_taken_in_the_next_turn_and_blue_comes_first() -> None:
    robots = duel()
    robots.tick()
    assert robots.field.hits.tolist() == [1, 1]
    assert robots.field.damage.tolist() == [0, 1]  # red's turn was still to come
    assert robots.field.pending.tolist() == [1, 0]
    robots.tick()
    assert robots.field.damage.tolist() == [1, 2]
    assert robots.field.taken.tolist() == [1, 1]


def test_who_has_no_hit_points_left_acts_once_more_and_is_hit_until_it_leaves() -> None:
    robots = duel(hit_points=1)
    assert robots.tick() == 2
    assert robots.field.damage.tolist() == [0, 1]
    assert robots.field.alive.all()  # red took its last damage in this turn, after it had shot
    assert robots.field.pending.tolist() == [1, 0]
    assert robots.tick() == 2
    assert robots.field.hits.tolist() == [1, 0]  # red was hit again before it left
    assert robots.field.alive.tolist() == [True, False]
    assert robots.field.damage.tolist() == [1, 1]
    assert robots.tick() == 1
    assert robots.field.alive.tolist() == [False, False]
    assert robots.field.hits.tolist() == [0, 0]
    assert robots.tick() == 0


def test_robots_take_their_turns_one_after_the_other() -> None:
    # Blue's first robot steps to the left before red's turn, into red's line of fire, and its
    # second one out of it.
    def line(*steps: tuple[float, float]) -> list[int]:
        blue = [(300.0, 400.0 - 18, 90.0), (350.0, 400.0 + 12, 90.0)]
        robots = stage(blue, [(800, 400, 180)], WIDE, max_speed=4.0)
        robots.tick(*steps)
        return robots.field.shot.tolist()

    # 2 degrees are 17.46 units at 500, 15.71 at 450.
    assert line((0, 0), (0, 0))[2] == 1
    assert line((0, 0), (4, 0))[2] == -1
    assert line((2, 0), (4, 0))[2] == 0


def test_red_shoots_at_where_blue_has_gone_and_blue_at_where_red_was() -> None:
    # Both step out of the line of the other; blue goes first.
    robots = stage([(100, 400, 90)], [(200, 400, 90)], max_speed=4.0, firing="2011")
    robots.field.pose[0, 2] = 0.0
    robots.tick((0, 0), (4, 0))
    assert robots.field.shot.tolist() == [1, -1]
    robots = stage([(100, 400, 0)], [(200, 400, 180)], max_speed=4.0)
    robots.tick((4, math.pi / 2))  # turns and leaves after it has shot
    assert robots.field.shot.tolist() == [1, -1]


def test_in_their_first_step_robots_draw_a_heading_of_whole_degrees_and_do_nothing_else() -> None:
    robots = stage([(100, 400, 0)], [(900, 400, 180)], WIDE)
    robots.field.begun[0] = False
    rng, twin = np.random.default_rng(4), np.random.default_rng(4)
    robots.go(rng, (1.0, 0.1))
    drawn = math.radians(math.floor(360 * twin.random()))
    turned = (robots.field.pose[0, 2] - drawn) % math.pi  # from which direction is of no matter
    assert min(turned, math.pi - turned) == pytest.approx(0, abs=1e-9)
    assert robots.field.pose[0, :2].tolist() == [100, 400]
    assert robots.field.shot.tolist() == [-1, 0]
    assert robots.field.pending.tolist() == [1, 0]
    assert robots.field.begun.all()


def test_robots_begin_at_a_spawn_give_or_take_20_units_looking_anywhere() -> None:
    scenario = OPEN.replaced(robots=3000)
    field, rng = make_field(scenario, (3000, 3000)), np.random.default_rng(0)
    field.control[:] = GIVEN
    spawn_robots(field, np.arange(6000), scenario, rng)
    for team, y in ((0, 266.67), (1, 533.33)):
        offsets = field.pose[field.team == team, :2] - (400, y)
        assert np.abs(offsets - offsets.round()).max() < 1e-9
        for axis in range(2):
            assert np.unique(offsets[:, axis].round()).tolist() == list(range(-20, 20))
    ground, law, actions = walls_of(scenario), law_of(scenario), np.zeros((6000, 4))
    kernels.tick(field, ground, law, no_brains(), actions, rng)
    degrees = np.degrees(field.pose[:, 2])
    assert np.abs(degrees - degrees.round()).max() < 1e-9
    assert np.unique(degrees.round() % 360).tolist() == list(range(360))


# -------------------------------------------------------------------------------------- movement


def test_it_turns_first_and_goes_along_the_new_heading() -> None:
    robots = stage([(400, 400, 0), (200, 200, 90)])
    robots.tick((1.0, 0.2), (-0.5, -0.1))
    assert robots.field.pose[0] == pytest.approx([400 + math.cos(0.2), 400 + math.sin(0.2), 0.2])
    angle = math.pi / 2 - 0.1
    backwards = [200 - 0.5 * math.cos(angle), 200 - 0.5 * math.sin(angle), angle]
    assert robots.field.pose[1] == pytest.approx(backwards)
    assert robots.field.speed.tolist() == [1.0, -0.5]


def test_robots_pass_through_each_other() -> None:
    robots = stage([(400, 400, 0)], [(410, 400, 180)])
    for _ in range(20):
        robots.tick((1.0, 0.0), (1.0, 0.0))
    assert robots.field.pose[:, 0] == pytest.approx([420, 390])
    assert robots.field.pose[:, 1] == pytest.approx([400, 400])


def driven(place: Place, ticks: int, speed: float = 1.0, **changes: Any) -> np.ndarray:
    """Where a robot is, x and y, that goes straight on for a while."""
    robots = stage([place], **changes)
    for _ in range(ticks):
        robots.tick((speed, 0.0))
    return robots.corrected()[0, :2]


def test_the_middle_wall_stops_a_robot_4_09_units_before_its_face() -> None:
    for y, heading, expected in ((370, 90, 398 - 4.09), (430, -90, 402 + 4.09)):
        place = driven((420, y, heading), 100, scenario=NERO_TASKS["battle"])
        assert place == pytest.approx([420, expected])
    backwards = driven((420, 370, -90), 100, -1.0, scenario=NERO_TASKS["battle"])
    assert backwards == pytest.approx([420, 398 - 4.09])
    end = driven((530, 400, 180), 100, scenario=NERO_TASKS["battle"])
    assert end == pytest.approx([500 + 6.53, 400])  # the ellipse does not turn


def test_borders_stop_a_robot_at_the_half_axes_of_its_ellipse() -> None:
    assert driven((30, 400, 180), 60) == pytest.approx([2 + 6.53, 400])
    assert driven((770, 400, 0), 60) == pytest.approx([798 - 6.53, 400])
    assert driven((400, 30, -90), 60) == pytest.approx([400, 2 + 4.09])
    assert driven((400, 770, 90), 60) == pytest.approx([400, 798 - 4.09])
    assert driven((30, 30, -135), 80) == pytest.approx([2 + 6.53, 2 + 4.09])


def test_it_slides_along_walls_with_what_of_its_way_points_along_them() -> None:
    slid = driven((350, 398 - 4.09, 60), 50, scenario=NERO_TASKS["battle"])
    assert slid == pytest.approx([350 + 50 * math.cos(math.radians(60)), 398 - 4.09])
    border = driven((300, 2 + 4.09, -30), 50)
    assert border == pytest.approx([300 + 50 * math.cos(math.radians(30)), 2 + 4.09])
    # At the end of the wall it is free again.
    assert driven((495, 398 - 4.09, 45), 60, scenario=NERO_TASKS["battle"])[1] > 410


def depth(place: np.ndarray, wall: Wall) -> float:
    """How deep in units a robot's ellipse is in a wall: its border against the box."""
    angle = np.linspace(0, 2 * np.pi, 721)
    x, y = place[0] + RADIUS_X * np.cos(angle), place[1] + RADIUS_Y * np.sin(angle)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (wall.width / 2, wall.height / 2)
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    at = corners @ np.array([(cosine, sine), (-sine, cosine)]) + (wall.x, wall.y)
    within = 1 - np.hypot(*((at - place) / (RADIUS_X, RADIUS_Y)).T).min()
    border = -float(box_distance(x, y, wall).min())
    centre = -float(box_distance(np.array(place[0]), np.array(place[1]), wall))
    return max(border, within * RADIUS_Y, centre)


angles = st.floats(-math.pi, math.pi)


@given(
    wall=st.builds(
        Wall,
        x=st.just(400.0),
        y=st.just(400.0),
        width=st.floats(4, 120),
        height=st.floats(1, 60),
        angle_rad=angles,
    ),
    start=st.tuples(st.floats(-60, 60), st.floats(-60, 60)),
    heading=angles,
    speed=st.floats(-1, 1),
)
def test_nobody_is_inside_a_wall_at_any_angle(
    wall: Wall, start: tuple[float, float], heading: float, speed: float
) -> None:
    place = (400 + start[0], 400 + start[1], math.degrees(heading))
    robots = stage([place], walls=(wall,))
    for _ in range(15):
        robots.tick((speed, 0.05))
        assert depth(robots.corrected()[0, :2], wall) <= 2e-3


def test_who_is_clear_of_walls_is_left_alone() -> None:
    wall = Wall(x=400, y=400, width=100, height=4, angle_rad=0.6)
    rng = np.random.default_rng(1)
    places = [(x, y, 0.0) for x, y in rng.uniform(340, 460, size=(400, 2))]
    robots = stage(places, walls=(wall,))
    before, after = robots.field.pose, robots.corrected()
    clear = np.array([depth(place, wall) < -0.05 for place in before[:, :2]])
    assert 100 < clear.sum() < 400
    assert before[clear] == pytest.approx(after[clear], rel=1e-12)
    assert (before[~clear] != after[~clear]).any(axis=1).sum() > 10


def test_who_stands_exactly_on_the_face_of_a_wall_is_pushed_out() -> None:
    robots = stage([(350, 398, 0)], scenario=NERO_TASKS["battle"])
    assert robots.corrected()[0, :2] == pytest.approx([350, 398 - 4.09])


def wedge(degrees: float) -> Wall:
    """A wall that leaves the lower border at x = 300 at an angle."""
    angle = math.radians(degrees)
    middle = 300 + 100 * math.cos(angle), 2 + 100 * math.sin(angle)
    return Wall(x=middle[0], y=middle[1], width=200, height=4, angle_rad=angle)


@pytest.mark.parametrize(("speed", "degrees"), [(1.0, 5), (2.0, 5), (4.0, 5), (4.0, 15)])
def test_nobody_gets_into_a_wall_in_an_acute_corner(speed: float, degrees: float) -> None:
    wall = wedge(degrees)
    for heading in np.linspace(150, 210, 13):
        robots = stage([(480, 14, heading)], walls=(wall,), max_speed=4.0)
        for _ in range(400):
            robots.tick((speed, 0.0))
            x, y, _ = robots.corrected()[0]
            assert box_distance(x, y, wall) > 0, f"at ({x}, {y}), heading {heading}"


# --------------------------------------------------------------------------------------- the end


def still(robots: int, bare: int = 0) -> TeamBrains:
    """Networks without links: their outputs are 0.5, so that they neither go nor turn."""
    inputs, ends = 18, np.arange(robots + 1)
    nodes = np.append(ends * (inputs + 3), np.full(bare, robots * (inputs + 3)))
    total = int(nodes[-1])
    outputs = (ends[:-1, None] * (inputs + 3) + (inputs + 1, inputs + 2)).ravel()
    return no_brains()._replace(
        node=nodes,
        link=np.zeros(total + 1, np.int64),
        activation=np.ones(total, np.int64),
        bias=np.full(robots + bare, 0.3),
        silent=np.zeros(robots + bare, bool),
        output=np.append(ends * 2, np.full(bare, 2 * robots)),
        outputs=outputs,
        candidates=np.ones(robots + bare, np.int64),
        value=np.zeros(total),
        before=np.zeros(total),
        active=np.zeros(total, bool),
        fired=np.zeros(total, bool),
    )


def battle(robots: Stage, ticks: int, kept: int = 0) -> tuple[int, np.ndarray]:
    """Let them fight with networks that stand still; returns ticks, and hit points and shots."""
    count = len(robots.field.team)
    turrets = len(robots.scenario.turrets)
    robots.field.control[: count - turrets] = BRAIN
    film = np.zeros((kept, count, 3), np.float32), np.zeros((kept, count, 2), np.int16)
    rng, brains = np.random.default_rng(0), still(count - turrets, turrets)
    passed = kernels.play(robots.field, robots.ground, robots.law, brains, ticks, rng, film)
    return passed, film[1]


def test_a_battle_ends_when_a_team_is_dead_or_time_is_up() -> None:
    # Blue's shot of tick k is taken by red in tick k: red has taken 3 after tick 3 and leaves in
    # tick 4, after which blue is alone.
    robots = stage([(100, 400, 0)], [(900, 400, 0)], WIDE, hit_points=3)
    assert battle(robots, 100)[0] == 4
    assert robots.field.alive.tolist() == [True, False]
    assert robots.field.damage.tolist() == [0, 3]
    assert robots.field.pending.tolist() == [0, 1]  # it was hit until it left
    assert battle(stage([(100, 400, 0)], [(900, 400, 0)], WIDE, hit_points=3), 2)[0] == 2
    assert battle(stage([(100, 400, 90)], [(900, 400, 90)], WIDE), 30)[0] == 30
    two = stage([(100, 400, 0)], [(900, 400, 0), (900, 100, 0)], WIDE, hit_points=3)
    assert battle(two, 30)[0] == 30  # one of two is left
    assert two.field.alive.tolist() == [True, False, True]


def test_turrets_do_not_keep_a_battle_going_that_is_decided() -> None:
    robots = stage([(100, 400, 0)], [(900, 400, 0)], WIDE, hit_points=3, turrets=((1500.0, 700.0),))
    assert battle(robots, 100)[0] == 4


def test_the_film_has_no_hit_points_below_0_of_who_is_on_the_field() -> None:
    robots = stage([(100, 400, 0)] * 3, [(900, 400, 0)], WIDE, hit_points=1)
    ticks, film = battle(robots, 10, kept=10)
    assert ticks == 2
    assert film[:2, 3, 0].tolist() == [0, -1]
    assert film[:2, 0].tolist() == [[1, 3], [1, 3]]


def test_the_network_is_activated_in_the_first_step_as_well() -> None:
    robots = stage([(100, 400, 0)], scenario=WIDE)
    robots.field.control[0], robots.field.begun[0] = BRAIN, False
    brains, rng = still(1), np.random.default_rng(0)
    kernels.tick(robots.field, robots.ground, robots.law, brains, np.empty((0, 4)), rng)
    assert robots.field.begun[0]
    assert brains.value[-2:].tolist() == [0.5, 0.5]
