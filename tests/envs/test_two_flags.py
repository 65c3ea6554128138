"""Two flags of which one counts: chance, sensors, rewards, pictures and what a robot can reach."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from PIL import ImageColor

from neatq_envs.arena import Arena, directions
from neatq_envs.checks import ScenarioError
from neatq_envs.pettingzoo_env import TeamEnv
from neatq_envs.render import FLAG, draw_paths, frame
from neatq_envs.robot import RobotEnv
from neatq_envs.scenario import TASKS, FlagSchedule, Scenario, Spawn
from neatq_envs.sensors import SCHEMAS, Senses, schema_of

Drive = Callable[[Arena], np.ndarray]
LEFT, RIGHT = (300.0, 166.67), (500.0, 166.67)
SHORT = FlagSchedule(positions=(LEFT, RIGHT), switch_ticks=4)
SMALL = TASKS["switch"].replaced(robots=3, flag=SHORT)


def still(arena: Arena) -> np.ndarray:
    return np.zeros((*arena.shape, len(arena.schema.actions)))


def sides(arena: Arena, ticks: int) -> list[int]:
    """Return which flag counts at first and after each tick."""
    seen = [arena.flag[0].tolist()]
    for _ in range(ticks):
        arena.step(still(arena))
        seen.append(arena.flag[0].tolist())
    return [[list(LEFT), list(RIGHT)].index(place) for place in seen]


# ----------------------------------------------------------------------------- which counts


def test_the_other_flag_counts_after_each_switch() -> None:
    seen = sides(Arena(SMALL, [0]), 13)
    first = seen[0]
    assert seen == [first] * 4 + [1 - first] * 4 + [first] * 4 + [1 - first] * 2


def test_which_flag_counts_first_depends_on_the_seed_alone(to_flag: Drive) -> None:
    firsts = [sides(Arena(SMALL, [seed]), 0)[0] for seed in range(40)]
    assert 10 < sum(firsts) < 30
    for seed in range(6):
        # Neither on how many robots there are, nor on what they sense, do, get or on their lives.
        task = SMALL.replaced(robots=7, sensors="opennero", reward="progress", lifetime_ticks=3)
        arena = Arena(task, range(seed + 1))
        for _ in range(5):
            arena.step(to_flag(arena))
            arena.respawn(arena.truncated)
        arena.reset()
        alone = Arena(SMALL, [seed])
        alone.reset()
        assert arena.flag[seed].tolist() == alone.flag[0].tolist()


def test_a_renewed_arena_switches_by_its_own_clock() -> None:
    arena = Arena(SMALL, [0, 1])
    for _ in range(3):
        arena.step(still(arena))
    arena.renew(np.array([False, True]), [0, 5])
    seen = []
    for _ in range(4):
        seen.append(arena.flag.copy())
        arena.step(still(arena))
    changes = [np.any(a != b, axis=1).tolist() for a, b in pairwise(seen)]
    assert changes == [[True, False], [False, False], [False, False]]
    assert np.any(seen[-1][1] != arena.flag[1])


def test_flags_are_as_far_from_the_spawn_as_that_of_task_flag() -> None:
    task, flag = TASKS["switch"], TASKS["flag"]
    spawn = np.array((task.spawns[0].x, task.spawns[0].y))
    left, right = np.array(task.flag.positions) - spawn
    assert task.spawns == flag.spawns and task.flag.positions[0] == flag.flag.positions[0]
    assert left.tolist() == [-right[0], right[1]]


# --------------------------------------------------------------------------------- sensors


def looking_down(task: Scenario, second: tuple[float, float] | None) -> np.ndarray:
    """Return what a robot at the spawn senses with the first flag to its right at 45 degrees."""
    place, ahead = np.array([[[400.0, 266.67]]]), directions(np.array([[-np.pi / 2]]))
    flags = [None if flag is None else np.array([flag]) for flag in (LEFT, second)]
    assert flags[0] is not None
    return Senses(task).sense(place, ahead, flags[0], None, flags[1])[0, 0]


@pytest.mark.parametrize(("sensors", "radar"), [("arena", 12), ("opennero", 10)])
def test_each_flag_has_a_radar_of_its_own(sensors: str, radar: int) -> None:
    task = TASKS["switch"].replaced(sensors=sensors)
    values = looking_down(task, RIGHT)
    near = 30 / (100 * 2**0.5)
    assert values[5:10] == pytest.approx([0, 0, 0, near, 0])  # left, ahead left and right, right
    assert values[radar : radar + 5] == pytest.approx([near, 0, 0, 0, 0])
    names = schema_of(task).observations
    assert names[radar] == "second_flag_left" and names[radar + 4] == "second_flag_rear"
    one = looking_down(TASKS["flag"].replaced(sensors=sensors), None)
    others = [i for i in range(len(one)) if not radar <= i < radar + 5]
    assert values[others].tolist() == one[others].tolist()


def test_two_flags_have_schemas_of_their_own() -> None:
    for sensors, size in (("arena", 17), ("arena-feedback", 18), ("opennero", 18)):
        one, two = (schema_of(TASKS[name].replaced(sensors=sensors)) for name in ("flag", "switch"))
        assert one == SCHEMAS[sensors] and two == SCHEMAS[f"{sensors}-two-flags"]
        assert len(two.observations) == size and two.actions == one.actions


@pytest.mark.parametrize("sensors", ["arena", "opennero"])
def test_nothing_that_is_sensed_tells_which_flag_counts(sensors: str, to_flag: Drive) -> None:
    task = SMALL.replaced(sensors=sensors, reward="progress")
    one, other = Arena(task, [3]), Arena(task, [3])
    state = one.world_state()
    counts = list(LEFT) if state["flag"].tolist() == [list(RIGHT)] else list(RIGHT)
    other.load_world_state(state | {"flag": np.array([counts])})
    for _ in range(20):
        action = to_flag(one)
        one.step(action)
        other.step(action)
        assert np.array_equal(one.observation, other.observation)
        assert not np.array_equal(one.reward, other.reward)
        assert not np.array_equal(one.flag, other.flag)


# --------------------------------------------------------------------------------- rewards


def test_rewards_are_of_the_flag_that_counted_in_the_tick() -> None:
    arena = Arena(SMALL, [0])
    flags = [np.array(LEFT), np.array(RIGHT)]
    side = sides(arena, 0)[0]
    for tick in range(1, 13):
        counted = flags[(side + (tick - 1) // 4) % 2]
        counts = flags[(side + tick // 4) % 2]
        arena.step(np.tile([1.0, 0.0], (1, 3, 1)))
        squared = ((arena.position - counted) ** 2).sum(-1)
        assert arena.reward_vector[..., 2] == pytest.approx(-squared), tick
        assert arena.distance == pytest.approx(np.hypot(*(arena.position - counts).T).T)


def test_a_switch_is_no_progress(to_flag: Drive) -> None:
    # A robot at full speed straight to the flag that counts gets 1, at the switch as well; the
    # jump of some 200 units would have given 0 or 1, whatever the robot did.
    task = TASKS["switch"].replaced(reward="progress", robots=4, max_turn_rad=3.1)
    task = task.replaced(flag=FlagSchedule(positions=(LEFT, RIGHT), switch_ticks=60))
    arena = Arena(task, [1])
    for _ in range(185):
        arena.step(to_flag(arena))
        assert arena.reward == pytest.approx(np.ones((1, 4)), abs=2e-3)
    rest = Arena(task, [1])
    for _ in range(125):
        rest.step(still(rest))
        assert rest.reward == pytest.approx(np.full((1, 4), 0.5))


# --------------------------------------------------------------------- what can be reached


def walk(goal_of: Callable[..., np.ndarray], phase: int, task: str = "switch") -> float:
    """Return the mean distance to the flag that counts, in a life, of a robot that goes to a goal.

    Args:
        goal_of: where to, given the number of the flag that counts (and where the robot is).
        phase: ticks since the last switch when the life begins.
        task: whose flags they are.
    """
    flags, place, total = np.array(TASKS[task].flag.positions), np.array([400.0, 266.67]), 0.0
    ticks, behind = 1000, task == "behind"
    for tick in range(ticks):
        counts = (phase + tick) // 610 % 2
        way = (goal_of(counts, place) if behind else goal_of(counts)) - place
        place = place + way * min(1.0, 1.0 / max(float(np.hypot(*way)), 1e-9))
        total += float(np.hypot(*(flags[counts] - place)))
    return total / ticks


def test_only_who_follows_the_switches_gets_below_a_hundred() -> None:
    flags = np.array([LEFT, RIGHT])
    phases = range(0, 1220, 61)
    still_mean = np.mean([walk(lambda _: np.array([400.0, 266.67]), phase) for phase in phases])
    first = np.mean([walk(lambda _: flags[0], phase) for phase in phases])
    middle = np.mean([walk(lambda _: flags.mean(0), phase) for phase in phases])
    perfect = np.mean([walk(lambda counts: flags[counts], phase) for phase in phases])
    assert (still_mean, first, middle, perfect) == pytest.approx((141.4, 102, 101.5, 38), abs=0.5)


def test_behind_the_wall_only_who_follows_the_switches_gets_below_136() -> None:
    flags, phases = np.array(TASKS["behind"].flag.positions), range(0, 1220, 61)
    (wall,) = TASKS["behind"].walls
    above, corner = wall.y + 5, wall.width / 2 + 5

    def round_it(counts: int, place: np.ndarray, then: int | None = None) -> np.ndarray:
        aim = flags[counts if then is None else then]
        ends = [np.array([wall.x + side, above]) for side in (-corner, corner)]
        near = min(ends, key=lambda end: np.hypot(*(end - place)) + np.hypot(*(end - aim)))
        return aim if place[1] >= above else near

    below = [walk(lambda one, _: np.array([flags[one][0], 395.0]), p, "behind") for p in phases]
    first = [walk(lambda one, place: round_it(one, place, 0), p, "behind") for p in phases]
    perfect = [walk(round_it, phase, "behind") for phase in phases]
    means = np.mean(below), np.mean(first), np.mean(perfect)
    assert means == pytest.approx((161, 136, 86), abs=0.5)
    start = TASKS["behind"].spawns[0]
    assert np.hypot(*(flags[0] - [start.x, start.y])) == pytest.approx(285, abs=0.5)


def test_lives_and_rows_of_metrics_fall_on_all_moments_between_switches() -> None:
    switch, life = TASKS["switch"].flag.switch_ticks, TASKS["switch"].lifetime_ticks
    assert len({life * number % (2 * switch) for number in range(1000)}) == 61
    assert len({100 * number % switch for number in range(1000)}) == 61


# ------------------------------------------------------------- files, states and other forms


def test_a_file_can_say_it_all() -> None:
    values = {
        "name": "switch",
        "flag": {"positions": [list(LEFT), list(RIGHT)], "switch_ticks": 610},
    }
    assert Scenario.from_dict(values) == TASKS["switch"]
    assert Scenario.from_dict(json.loads(json.dumps(SMALL.to_dict()))) == SMALL


@pytest.mark.parametrize(
    ("flag", "words"),
    [
        ({"positions": [LEFT], "switch_ticks": 5}, ["switch_ticks", "two different places"]),
        ({"positions": [LEFT, RIGHT, (1, 1)], "switch_ticks": 5}, ["two different places"]),
        ({"positions": [LEFT, LEFT], "switch_ticks": 5}, ["two different places", "300.0"]),
        ({"ring": [9, 20], "switch_ticks": 5}, ["two different places", "[]"]),
        ({"positions": [LEFT, RIGHT], "switch_ticks": -5}, ["switch_ticks", "-5"]),
        ({"positions": [LEFT, RIGHT], "switch_ticks": 0.5}, ["switch_ticks", "whole", "0.5"]),
        (
            {"positions": [LEFT, RIGHT], "switch_ticks": 5, "interval_ticks": 7},
            ["switch_ticks", "interval_ticks", "7"],
        ),
    ],
)
def test_what_cannot_switch_is_refused(flag: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ScenarioError) as error:
        Scenario.from_dict({"flag": flag})
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("sensors", ["arena", "opennero"])
def test_a_restored_world_switches_bit_for_bit_on(sensors: str, to_flag: Drive) -> None:
    task = SMALL.replaced(sensors=sensors, spawns=(Spawn(x=400, y=200),))
    live, restored = Arena(task, [1, 2]), Arena(task, [8, 9])
    for _ in range(6):
        live.step(to_flag(live))
    live.rebuild()
    restored.load_world_state(live.world_state())
    for tick in range(30):
        if tick == 17:
            live.reset()
            restored.reset()
        for name in ("flag", "observation", "distance", "reward", "position"):
            assert np.array_equal(getattr(live, name), getattr(restored, name)), (tick, name)
        live.step(to_flag(live))
        restored.step(to_flag(restored))


def test_a_state_from_before_there_were_switches_still_loads() -> None:
    arena, restored = Arena(TASKS["wall"], [1]), Arena(TASKS["wall"], [2])
    state = arena.world_state()
    del state["scenario"]["flag"]["switch_ticks"]
    restored.load_world_state(state)
    assert np.array_equal(arena.observation, restored.observation)


def test_one_robot_and_a_team_are_told_the_distance_that_counts() -> None:
    env, team = RobotEnv("switch"), TeamEnv("switch")
    assert env.observation_space.shape == (17,)
    firsts = set()
    for seed in range(8):
        _, info = env.reset(seed=seed)
        _, infos = team.reset(seed=seed)
        for world, told in ((env.arena, info), (team.arena, infos["robot_0"])):
            way = world.flag[0] - told["pose"][:2]
            assert told["distance"] == pytest.approx(np.hypot(*way))
        assert env.arena.flag.tolist() == team.arena.flag.tolist()
        firsts.add(tuple(env.arena.flag[0]))
    assert firsts == {LEFT, RIGHT}


# -------------------------------------------------------------------------------- pictures


def test_the_flag_that_counts_is_drawn_full_and_the_other_hollow() -> None:
    for counts, other in ((LEFT, RIGHT), (RIGHT, LEFT)):
        image = frame(TASKS["switch"], np.array([[400.0, 600.0]]), np.zeros(1), np.array(counts))
        red = (image == ImageColor.getrgb(FLAG)).all(-1)
        # 18 pixels up the pole, 400 pixels for 800 units.
        full, hollow = (
            red[:, round(x / 2) : round(x / 2) + 20].sum() for x in (counts[0], other[0])
        )
        assert full > 2 * hollow > 20 and red.sum() == full + hollow


def test_paths_show_both_flags() -> None:
    poses = np.zeros((3, 1, 3))
    (axes, *_) = draw_paths(TASKS["switch"], poses, np.array(RIGHT)).axes
    legend = axes.get_legend()
    assert legend is not None
    assert "flag that does not count" in [text.get_text() for text in legend.get_texts()]
    stars = {line.get_xydata()[0].tolist()[0] for line in axes.lines if line.get_marker() == "*"}  # type: ignore[index]
    assert stars == {300.0, 500.0}
