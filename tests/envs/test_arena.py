"""Ticks, lives, flags, seeds and exact continuation."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neatq_envs.arena import Arena
from neatq_envs.checks import ScenarioError
from neatq_envs.scenario import TASKS, FlagSchedule, Scenario, Spawn, Wall

Drive = Callable[[Arena], np.ndarray]
SMALL = TASKS["flag"].replaced(robots=5)


def still(arena: Arena) -> np.ndarray:
    return np.zeros((*arena.shape, len(arena.schema.actions)))


def test_a_robot_turns_first_and_moves_along_its_new_heading() -> None:
    arena = Arena(SMALL, [0])
    place, heading = arena.position[0, 2], arena.heading_rad[0, 2]
    actions = still(arena)
    actions[0, 2] = (0.5, 0.125)
    arena.step(actions)
    assert arena.heading_rad[0, 2] == pytest.approx(heading + 0.125)
    way = np.array([np.cos(heading + 0.125), np.sin(heading + 0.125)])
    assert arena.position[0, 2] == pytest.approx(place + 0.5 * way)
    assert arena.position[0, 1] == pytest.approx(Arena(SMALL, [0]).position[0, 1])


def test_actions_are_clipped_to_physical_bounds() -> None:
    arena = Arena(SMALL, [0])
    place, heading = arena.position, arena.heading_rad
    arena.step(np.tile([-9.0, 9.0], (1, 5, 1)))
    assert np.hypot(*(arena.position - place)[0].T) == pytest.approx(np.ones(5))
    turned = (arena.heading_rad - heading) % (2 * np.pi)
    assert turned == pytest.approx(np.full((1, 5), 0.2))


def test_headings_wrap() -> None:
    arena = Arena(SMALL.replaced(max_turn_rad=np.pi), [0])
    for turn in (3.0, 3.0, -3.0, -2.0, -2.5):
        expected = arena.heading_rad + turn
        arena.step(np.tile([0.0, turn], (1, 5, 1)))
        assert np.cos(arena.heading_rad - expected) == pytest.approx(np.ones((1, 5)))
        assert (arena.heading_rad > -np.pi).all() and (arena.heading_rad <= np.pi).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused_by_name(value: float) -> None:
    arena = Arena(SMALL, [0, 1])
    actions = still(arena)
    actions[1, 3, 1] = value
    heading = arena.heading_rad
    with pytest.raises(ValueError, match="action turn of robot 3 in arena 1"):
        arena.step(actions)
    assert arena.tick == 0 and (arena.heading_rad == heading).all()


def test_wrong_shapes_are_refused() -> None:
    arena = Arena(SMALL, [0])
    with pytest.raises(ValueError, match=r"\[1, 5, 2\], got \[1, 5, 3\]"):
        arena.step(np.zeros((1, 5, 3)))
    with pytest.raises(ValueError, match=r"mask: expected bool"):
        arena.respawn(np.zeros((1, 4), dtype=bool))


def test_lives_begin_at_the_spawns_with_whole_offsets_and_whole_degrees() -> None:
    spawns = (Spawn(x=100.5, y=200.0, jitter=3), Spawn(x=600.0, y=650.25, jitter=0))
    arena = Arena(Scenario(name="two", robots=200, spawns=spawns), [0])
    first = arena.position[0, ::2] - (100.5, 200.0)
    assert set(first.ravel().tolist()) == {-3, -2, -1, 0, 1, 2}
    assert (arena.position[0, 1::2] == (600.0, 650.25)).all()
    degrees = np.degrees(arena.heading_rad)
    assert degrees == pytest.approx(degrees.round(), abs=1e-9)
    assert degrees.min() < -150 and degrees.max() > 150


def test_a_life_is_truncated_exactly_at_its_lifetime() -> None:
    arena = Arena(SMALL.replaced(lifetime_ticks=3), [0])
    ends = []
    for _ in range(4):
        arena.step(still(arena))
        ends.append(bool(arena.truncated.any()))
    assert ends == [False, False, True, True]
    mask = np.array([[False, True, False, False, False]])
    arena.respawn(mask)
    assert arena.age_ticks.tolist() == [[4, 0, 4, 4, 4]]
    assert (arena.truncated == ~mask).all()


def test_lifetime_zero_never_ends() -> None:
    arena = Arena(SMALL.replaced(lifetime_ticks=0), [0])
    arena.step(still(arena))
    assert not arena.truncated.any()


def test_spread_lives_end_one_after_the_other_in_new_worlds_too() -> None:
    arena = Arena(SMALL.replaced(lifetime_ticks=10, first_lives="spread"), [0, 1])
    for _ in range(2):
        ends = []
        for tick in range(1, 21):
            arena.step(still(arena))
            ends += [(tick, robot) for robot in np.flatnonzero(arena.truncated[1]).tolist()]
            arena.respawn(arena.truncated)
        assert ends == [(begin + 2 * i, 4 - i) for begin in (2, 12) for i in range(5)]
        arena.reset()
    assert Arena(
        SMALL.replaced(lifetime_ticks=0, first_lives="spread"), [0]
    ).age_ticks.tolist() == [[0] * 5]


def test_a_respawn_touches_the_masked_robots_only(to_flag: Drive) -> None:
    arena = Arena(TASKS["flag"].replaced(robots=8), [0, 1])
    for _ in range(30):
        arena.step(to_flag(arena))
    mask = np.zeros((2, 8), dtype=bool)
    mask[0, 2] = mask[1, 7] = True
    names = ("position", "heading_rad", "observation", "reward_vector", "reward", "distance")
    before = {name: getattr(arena, name) for name in names}
    arena.respawn(mask)
    for name in names:
        now = getattr(arena, name)
        assert (now[~mask] == before[name][~mask]).all(), name
        assert not np.array_equal(now[mask], before[name][mask]), name
    assert (np.abs(arena.position[mask] - (400, 266.67)) <= 20).all()
    assert (arena.reward_vector[mask] == 0).all() and arena.tick == 30


def test_arrays_handed_out_are_never_written_again(to_flag: Drive) -> None:
    arena = Arena(SMALL.replaced(sensors="opennero"), [0])
    names = ("position", "heading_rad", "age_ticks", "observation", "reward", "reward_vector")
    kept = {name: (getattr(arena, name), getattr(arena, name).copy()) for name in names}
    for _ in range(5):
        arena.step(to_flag(arena))
        arena.respawn(np.array([[True, False, False, False, True]]))
    for name, (array, copy) in kept.items():
        assert np.array_equal(array, copy), name


def test_rewards_are_given_after_the_move_with_the_flag_that_stood() -> None:
    flag = FlagSchedule(positions=((300, 300), (500, 500)), interval_ticks=2)
    arena = Arena(SMALL.replaced(flag=flag), [0])
    for tick, (stood, stands) in enumerate([(300, 300), (300, 500), (500, 500), (500, 300)]):
        arena.step(np.tile([1.0, 0.0], (1, 5, 1)))
        squared = ((arena.position - stood) ** 2).sum(-1)
        assert arena.reward_vector[..., 2] == pytest.approx(-squared), tick
        assert arena.reward == pytest.approx(1 - squared / 1_280_000)
        assert arena.distance == pytest.approx(np.hypot(*(arena.position - stands).T).T)
        assert arena.flag.tolist() == [[stands, stands]]


def test_progress_uses_one_flag_at_both_ends_also_when_it_moves(to_flag: Drive) -> None:
    flag = FlagSchedule(positions=((300, 300), (500, 500)), interval_ticks=40)
    arena = Arena(SMALL.replaced(flag=flag, reward="progress"), [0])
    for tick in range(80):
        arena.step(to_flag(arena))
        if tick % 40 > 30:
            assert arena.reward == pytest.approx(np.ones((1, 5)), abs=1e-3)


def test_the_list_of_flags_wraps() -> None:
    task = TASKS["moving"].replaced(robots=1)
    task = task.replaced(flag=FlagSchedule(positions=task.flag.positions, interval_ticks=1))
    arena = Arena(task, [0])
    seen = [arena.flag[0].tolist()]
    for _ in range(27):
        arena.step(still(arena))
        seen.append(arena.flag[0].tolist())
    assert seen == [list(task.flag.positions[tick % 13]) for tick in range(28)]


def test_a_flag_drawn_in_a_ring_does_not_depend_on_respawns() -> None:
    wall = Wall(x=400, y=420, width=300, height=40)
    flag = FlagSchedule(ring=(100, 250), interval_ticks=2)
    task = SMALL.replaced(flag=flag, walls=(wall,))
    places: list[list[Any]] = [[], []]
    for number, seen in enumerate(places):
        arena = Arena(task, [7])
        for _ in range(120):
            arena.step(still(arena))
            if number:
                arena.respawn(np.ones((1, 5), dtype=bool))
            seen.append(arena.flag[0].tolist())
    assert places[0] == places[1]
    far = np.hypot(*(np.array(places[0]) - (400, 266.67)).T)
    assert far.min() >= 100 and far.max() <= 250 and len(np.unique(far)) == 61
    assert not any(task.in_wall(x, y) for x, y in places[0])


def test_ignoring_friends_blinds_the_next_observation_only() -> None:
    arena = Arena(SMALL.replaced(sensors="opennero"), [0])
    actions = still(arena)
    actions[0, 1, 3], actions[0, 2, 3] = 0.51, 0.5
    arena.step(actions)
    assert arena.observation[0, 1, 15:17].tolist() == [0, 0]
    assert (arena.observation[0, [0, 2, 3, 4], 15] > 0).all()
    arena.step(still(arena))
    assert (arena.observation[0, :, 15] > 0).all()


def run(arena: Arena, drive: Drive, ticks: int, respawns: bool = True) -> list[Any]:
    """Drive on; every 7th tick a few robots begin new lives. Return all that can be seen."""
    seen = []
    for _ in range(ticks):
        arena.step(drive(arena))
        if respawns and arena.tick % 7 == 0:
            mask = np.zeros(arena.shape, dtype=bool)
            mask[:, [arena.tick % arena.shape[1], 3]] = True
            arena.respawn(mask)
        seen.append(
            [arena.position, arena.heading_rad, arena.observation, arena.reward, arena.flag]
        )
    return seen


def equal(one: list[Any], other: list[Any]) -> bool:
    return all(
        np.array_equal(a, b)
        for row, twin in zip(one, other, strict=True)
        for a, b in zip(row, twin, strict=True)
    )


CROWD = TASKS["wall"].replaced(flag=FlagSchedule(ring=(90, 250), interval_ticks=50), robots=30)


@pytest.mark.parametrize("collide", [False, True])
def test_two_runs_of_one_seed_are_equal_and_seeds_differ(collide: bool, to_flag: Drive) -> None:
    task = CROWD.replaced(collide=collide)
    runs = [run(Arena(task, [seed]), to_flag, 120) for seed in (4, 4, 5)]
    assert equal(runs[0], runs[1]) and not equal(runs[0], runs[2])


@pytest.mark.parametrize("sensors", ["arena", "opennero"])
def test_each_of_many_arenas_is_the_arena_of_its_seed_alone(sensors: str, to_flag: Drive) -> None:
    task = CROWD.replaced(sensors=sensors, reward_weights={"stick_together": 1, "approach_flag": 1})
    together = run(Arena(task, range(20)), to_flag, 100)
    for seed in (0, 1, 7, 13, 19):
        alone = run(Arena(task, [seed]), to_flag, 100)
        assert equal(alone, [[a[seed : seed + 1] for a in row] for row in together])


@pytest.mark.parametrize("collide", [False, True])
def test_a_restored_world_continues_bit_for_bit(collide: bool, to_flag: Drive) -> None:
    task = CROWD.replaced(collide=collide, sensors="opennero")
    live = Arena(task, [1, 2])
    run(live, to_flag, 150)  # by now a crowd presses against the wall
    live.rebuild()
    state = live.world_state()
    restored = Arena(task, [8, 9])
    restored.load_world_state(state)
    for name in ("observation", "reward", "reward_vector", "distance", "age_ticks", "tick"):
        assert np.array_equal(getattr(live, name), getattr(restored, name)), name
    expected = run(live, to_flag, 150)
    assert equal(expected, run(restored, to_flag, 150))
    again = Arena(task, [8, 9])  # the state was not changed by those who ran on from it
    again.load_world_state(state)
    assert equal(expected, run(again, to_flag, 150))


def test_a_world_state_is_arrays_and_json_values() -> None:
    state = Arena(CROWD, [1]).world_state()
    plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in state.items()}
    restored = Arena(CROWD, [2])
    restored.load_world_state(json.loads(json.dumps(plain)))
    assert np.array_equal(restored.observation, state["observation"])
    assert restored.seeds == (1,)


def test_a_state_of_another_world_is_refused() -> None:
    state = Arena(SMALL, [0]).world_state()
    with pytest.raises(ScenarioError, match="robots: expected 6, as it was, got 5"):
        Arena(SMALL.replaced(robots=6), [0]).load_world_state(state)
    with pytest.raises(ScenarioError, match="1 arenas, this has 2"):
        Arena(SMALL, [0, 1]).load_world_state(state)


def test_new_worlds_differ_and_start_at_tick_zero() -> None:
    arena = Arena(SMALL, [0])
    first = arena.position
    arena.step(still(arena))
    arena.reset()
    assert arena.tick == 0 and (arena.age_ticks == 0).all()
    assert not np.array_equal(arena.position, first)


def same(one: Arena, other: Arena, arena: int) -> bool:
    """Return whether an arena of one world is the only arena of another, bit for bit."""
    names = ("position", "heading_rad", "age_ticks", "observation", "reward", "distance", "flag")
    return all(np.array_equal(getattr(one, n)[arena], getattr(other, n)[0]) for n in names)


def test_a_renewed_arena_is_that_of_a_new_seed_and_leaves_the_others_alone(
    to_corner: Drive,
) -> None:
    crowd = TASKS["wall"].replaced(
        robots=30,
        collide=True,
        lifetime_ticks=0,
        spawns=(Spawn(x=60.0, y=60.0),),
        flag=FlagSchedule(ring=(20.0, 40.0), interval_ticks=7),
    )
    both, left = Arena(crowd, [1, 2]), Arena(crowd, [1])
    for _ in range(100):  # into a heap in the corner, whose contacts must not be inherited
        both.step(to_corner(both))
        left.step(to_corner(left))
    both.renew(np.array([False, True]), [0, 9])
    assert both.seeds == (1, 9)
    right = Arena(crowd, [9])
    for _ in range(100):
        assert same(both, left, 0) and same(both, right, 1)
        both.step(to_corner(both))
        left.step(to_corner(left))
        right.step(to_corner(right))
    both.renew(np.array([False, True]))
    right.reset()
    assert same(both, left, 0) and same(both, right, 1)


def test_a_restored_world_knows_when_it_was_renewed(to_flag: Drive) -> None:
    scenario = SMALL.replaced(flag=FlagSchedule(ring=(100.0, 200.0), interval_ticks=5))
    arena, restored = Arena(scenario, [1]), Arena(scenario, [2])
    for _ in range(3):
        arena.step(to_flag(arena))
    arena.renew(np.array([True]))
    arena.rebuild()
    restored.load_world_state(arena.world_state())
    for _ in range(6):
        arena.step(to_flag(arena))
        restored.step(to_flag(restored))
        assert same(arena, restored, 0)
