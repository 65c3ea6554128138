"""Fields that become others while robots live on them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from neatq_envs.arena import Arena
from neatq_envs.flags import FlagSchedule
from neatq_envs.nero.scenario import NERO_TASKS, NeroScenario, Stage
from neatq_envs.nero.training import TrainingField
from neatq_envs.scenario import TASKS, Scenario, ScenarioError, Spawn
from neatq_envs.walls import Wall

STILL = Spawn(x=400.0, y=266.0, jitter=0)
OPEN = TASKS["flag"].replaced(robots=3, spawns=(STILL,))
AHEAD = Wall(x=400.0, y=300.0, width=200.0, height=4.0)
FLAGS = TASKS["switch"].replaced(robots=3)
FIELD = NERO_TASKS["battle"].replaced(walls=(), robots=2, spawns=(Spawn(x=400, y=400, jitter=0),))


def north(arena: Arena) -> Arena:
    """Let all robots look along the y axis."""
    state = arena.world_state()
    state["heading_rad"] = np.full(arena.shape, math.pi / 2)
    arena.load_world_state(state)
    return arena


def drive(arena: Arena, ticks: int, speed: float = 1.0) -> None:
    for _ in range(ticks):
        arena.step(np.broadcast_to([speed, 0.0], (*arena.shape, 2)))


def test_a_new_wall_is_sensed_with_the_next_tick_and_stops_robots() -> None:
    arena = north(Arena(OPEN, [0]))
    before = arena.observation
    arena.change(OPEN.replaced(walls=(AHEAD,)))
    assert arena.observation is before
    drive(arena, 1)
    ahead = arena.schema.index("wall_ahead")
    assert arena.observation[0, :, ahead] == pytest.approx(5 / (298 - 267), rel=1e-4)
    drive(arena, 100)
    assert (arena.position[0, :, 1] < 298).all()
    arena.change(OPEN)
    drive(arena, 40)
    assert (arena.position[0, :, 1] > 310).all()


def test_a_robot_that_a_wall_covers_begins_a_new_life() -> None:
    arena = north(Arena(OPEN, [0]))
    drive(arena, 34)
    arena.change(OPEN.replaced(walls=(Wall(x=400.0, y=300.0, width=50.0, height=10.0),)))
    assert arena.age_ticks.tolist() == [[0, 0, 0]]
    assert arena.position[0].tolist() == [[400.0, 266.0]] * 3


def test_lives_that_are_too_long_now_end() -> None:
    arena = Arena(OPEN, [0])
    drive(arena, 50, speed=0.0)
    arena.change(OPEN.replaced(lifetime_ticks=40))
    assert not arena.age_ticks.any()
    assert not arena.truncated.any()


def test_a_flag_that_is_moved_changes_distances_and_no_reward() -> None:
    arena = Arena(OPEN.replaced(reward="progress"), [0])
    arena.change(arena.scenario.replaced(flag=FlagSchedule(positions=((400.0, 366.0),))))
    assert arena.distance.tolist() == [[100.0] * 3]
    drive(arena, 1, speed=0.0)
    assert arena.reward == pytest.approx(0.5)


def test_of_two_flags_the_same_one_goes_on_to_count() -> None:
    arena = Arena(FLAGS, [0, 1, 2, 3])
    first = [FLAGS.flag.positions.index(tuple(place)) for place in arena.flag.tolist()]
    assert len(set(first)) == 2
    moved = FlagSchedule(positions=((200.0, 200.0), (600.0, 200.0)), switch_ticks=610)
    arena.change(FLAGS.replaced(flag=moved))
    assert [moved.positions.index(tuple(place)) for place in arena.flag.tolist()] == first


def test_a_flag_on_a_ring_stays_unless_a_wall_covers_it() -> None:
    ring = OPEN.replaced(flag=FlagSchedule(ring=(100.0, 150.0)))
    arena = Arena(ring, [0])
    place = arena.flag[0].copy()
    arena.change(ring.replaced(lifetime_ticks=500))
    assert arena.flag[0].tolist() == place.tolist()
    arena.change(ring.replaced(walls=(Wall(x=place[0], y=place[1], width=9.0, height=9.0),)))
    assert arena.flag[0].tolist() != place.tolist()


def test_a_changed_world_goes_on_from_its_state_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    one = Arena(OPEN, [0, 1])
    drive(one, 30)
    one.change(OPEN.replaced(walls=(AHEAD,), lifetime_ticks=80))
    one.rebuild()
    other = Arena(OPEN, [7, 8])
    other.load_world_state(one.world_state())
    assert other.scenario == one.scenario
    for _ in range(100):
        actions = rng.uniform(-1, 1, (*one.shape, 2))
        for arena in (one, other):
            arena.step(actions)
            arena.respawn(arena.truncated)
        assert np.array_equal(one.observation, other.observation)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robots": 4}, "robots: expected 3"),
        ({"width": 900.0}, "width: expected 800.0"),
        ({"sensors": "opennero"}, "sensors"),
        ({"flag": FLAGS.flag}, "one flag or for two"),
    ],
)
def test_what_robots_are_made_for_stays(changes: dict[str, Any], words: str) -> None:
    arena = Arena(OPEN, [0])
    with pytest.raises(ScenarioError, match=words):
        arena.change(OPEN.replaced(**changes))
    assert arena.scenario == OPEN
    assert isinstance(arena.scenario, Scenario)


# ------------------------------------------------------------------------------- NERO


def field_of(scenario: NeroScenario) -> TrainingField:
    return TrainingField([Stage(scenario=scenario)], [0, 1])


def let_pass(field: TrainingField, ticks: int) -> None:
    for _ in range(ticks):
        field.step(np.zeros((*field.shape, 2), np.float32))


def test_turrets_come_shoot_and_go() -> None:
    field = field_of(FIELD)
    let_pass(field, 5)
    before = field.pose.copy()
    field.change(FIELD.replaced(turrets=((400.0, 450.0), (400.0, 350.0))))
    assert np.array_equal(field.pose, before)
    let_pass(field, 300)
    assert field.fields[0].damage[:2].sum() > 0
    field.change(FIELD)
    taken = [one.damage.copy() for one in field.fields]
    let_pass(field, 100)
    assert [one.damage.tolist() for one in field.fields] == [one.tolist() for one in taken]


def test_whoever_has_more_hits_than_are_allowed_now_begins_a_new_life() -> None:
    field = field_of(FIELD)
    let_pass(field, 5)
    field.fields[0].damage[0] = 7
    field.change(FIELD.replaced(hit_points=5))
    assert field.age_ticks.tolist() == [[0, 5], [5, 5]]
    assert field.fields[0].damage.tolist() == [0, 0]


def test_weights_follow_the_scenario_unless_it_says_nothing_of_them() -> None:
    field = field_of(FIELD)
    field.weights = np.arange(6.0)
    field.change(FIELD.replaced(lifetime_ticks=500))
    assert field.weights.tolist() == [0, 1, 2, 3, 4, 5]
    field.change(FIELD.replaced(reward_weights={"avoid_fire": 1.0}))
    assert field.weights.tolist() == [0, 0, 0, 0, 0, 1]


def test_a_changed_field_goes_on_from_its_state_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    one, other = field_of(FIELD), field_of(FIELD)
    let_pass(one, 10)
    one.change(FIELD.replaced(turrets=((420.0, 420.0),), walls=(AHEAD,)))
    other.load_world_state(one.world_state())
    assert other.scenario == one.scenario
    for _ in range(200):
        actions = rng.uniform(-1, 1, (*one.shape, 2)).astype(np.float32)
        for field in (one, other):
            field.step(actions)
            field.respawn(field.terminated | field.truncated)
        assert np.array_equal(one.observation, other.observation)
        assert np.array_equal(one.pose, other.pose)


def test_a_field_of_other_sensors_is_refused() -> None:
    field = field_of(FIELD)
    with pytest.raises(ScenarioError, match="sensors: expected 'opennero-2011'"):
        field.change(FIELD.replaced(sensors="nero-1"))
