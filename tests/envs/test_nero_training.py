"""NERO's training field: lives, deaths, rewards, enemies, exact continuation, and its errors."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import check_env_specs, step_mdp

from neatq_envs.checks import ScenarioError
from neatq_envs.nero.scenario import (
    NERO_TASKS,
    OBSERVATIONS,
    REWARD_NAMES,
    SENSORS,
    NeroScenario,
    Stage,
    find_nero,
    find_stages,
)
from neatq_envs.nero.state import TeamBrains, no_brains
from neatq_envs.nero.torchrl_nero import MEASURE, NeroEnv
from neatq_envs.nero.training import MEASURES, TrainingField
from neatq_envs.scenario import Spawn
from neatq_envs.torchrl_env import (
    ACTION,
    DONE,
    OBSERVATION,
    POSE,
    REWARD,
    REWARD_VECTOR,
    STEP_COUNT,
    TERMINATED,
    TRUNCATED,
)
from neatq_envs.walls import Wall

SMALL = NERO_TASKS["nero"].replaced(
    robots=3, turrets=((400.0, 330.0), (440.0, 270.0)), hit_points=2, lifetime_ticks=25
)
"""Turrets so near the spawn that robots die."""
EMPTY = NERO_TASKS["battle"].replaced(
    walls=(), robots=1, spawns=(Spawn(x=400.0, y=400.0, jitter=0),)
)


def acting(env: NeroEnv) -> Any:
    """A policy that acts by the observation alone, with as many actions as the robots have."""

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        seen: Any = tensordict[OBSERVATION]
        turn = 0.2 * (seen[..., 10] - seen[..., 13] + 0.5 * seen[..., 14] - seen[..., 2])
        parts = [1 - seen[..., 11:13].sum(-1), turn, 2 * seen[..., 11], seen[..., 15]]
        action = torch.stack(parts[: env.action_spec.shape[-1]], -1)
        return tensordict.set(ACTION, action.clamp(*bounds))

    bounds = [torch.from_numpy(bound) for bound in env.arena.bounds]
    return act


def roll(env: NeroEnv, ticks: int) -> Any:
    return env.rollout(ticks, acting(env), break_when_any_done=False, auto_cast_to_device=False)


def equal(one: TensorDictBase, other: TensorDictBase) -> None:
    """Fail unless two tensordicts are the same, bit for bit; NaN is NaN."""
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        a, b = one[key], other[key]
        assert torch.equal(a.nan_to_num(nan=-7.0), b.nan_to_num(nan=-7.0)), key


def training(
    scenario: NeroScenario, seeds: list[int], enemies: tuple[TeamBrains, int] | None = None
) -> TrainingField:
    return TrainingField([Stage(scenario=scenario)], seeds, enemies)


def at(field: TrainingField, *poses: tuple[float, float, float], **changes: Any) -> None:
    """Put everybody of arena 0 somewhere, headings in degrees; change other arrays of the field."""
    state = field.world_state()
    places = np.array(poses, float)
    state["fields"][0]["pose"][:] = np.column_stack([places[:, :2], np.radians(places[:, 2])])
    for name, value in changes.items():
        state["fields"][0][name][:] = value
    field.load_world_state(state)


def step(field: TrainingField, *actions: tuple[float, ...]) -> None:
    field.step(np.array([actions], np.float32))


# ------------------------------------------------------------------------------- the environment


@pytest.mark.parametrize("sensors", SENSORS)
@pytest.mark.parametrize("enemies", [0, 2])
def test_specs_hold(sensors: str, enemies: int) -> None:
    scenario = SMALL.replaced(sensors=sensors, firing="2011")
    against = (fighters(enemies, OBSERVATIONS[sensors]), enemies) if enemies else None
    env = NeroEnv(scenario, arenas=2, enemies=against)
    check_env_specs(env, break_when_any_done="both")
    assert env.batch_size == (2, 3) and env.batch_locked
    space: Any = env.action_spec.space
    low, high = {
        "opennero-2011": ([-1, -0.2], [1, 0.2]),
        "opennero-2014": ([-1, -0.2, 0, 0], [1, 0.2, 1, 1]),
        "nero-1": ([-1, -0.2, 0], [1, 0.2, 1]),
    }[sensors]
    assert space.low[1, 2].tolist() == pytest.approx(low)
    assert space.high[1, 2].tolist() == pytest.approx(high)


def test_shapes_and_types() -> None:
    env = NeroEnv(SMALL, arenas=2)
    next_: Any = env.rand_step(env.reset())["next"]
    expected = {
        OBSERVATION: ([2, 3, 23], torch.float32),
        REWARD: ([2, 3, 1], torch.float32),
        REWARD_VECTOR: ([2, 3, 6], torch.float32),
        MEASURE: ([2, 3, 6], torch.float32),
        POSE: ([2, 3, 3], torch.float32),
        STEP_COUNT: ([2, 3, 1], torch.int64),
        DONE: ([2, 3, 1], torch.bool),
        TERMINATED: ([2, 3, 1], torch.bool),
        TRUNCATED: ([2, 3, 1], torch.bool),
    }
    assert {k: (list(v.shape), v.dtype) for k, v in next_.items()} == expected


def test_arena_e_is_the_environment_of_seed_plus_e() -> None:
    against = fighters(2, 23), 2
    together = roll(NeroEnv(SMALL, arenas=4, seed=10, enemies=against), 60)
    for arena in (0, 2):
        alone = roll(NeroEnv(SMALL, seed=10 + arena, enemies=against), 60)
        equal(alone[0], together[arena])
    assert not torch.equal(together[POSE][0], together[POSE][2])
    env = NeroEnv(SMALL, arenas=4, enemies=against)
    env.set_seed(10)
    equal(roll(env, 60), together)
    assert together["next", TERMINATED].any() and together["next", TRUNCATED].any()


def test_the_same_seed_is_the_same_run_and_reset_begins_it_again() -> None:
    env = NeroEnv(SMALL, arenas=2, seed=5)
    first = roll(env, 40)
    equal(roll(env, 40), first)
    equal(roll(NeroEnv(SMALL, arenas=2, seed=5), 40), first)
    assert not torch.equal(roll(NeroEnv(SMALL, arenas=2, seed=6), 40)[POSE], first[POSE])


def test_what_was_returned_is_not_overwritten_by_later_steps() -> None:
    env = NeroEnv(SMALL, arenas=2)
    act = acting(env)
    stepped = env.step(act(env.reset()))
    kept = stepped.clone()
    data = step_mdp(stepped)
    for _ in range(30):
        _, data = env.step_and_maybe_reset(act(data))
    equal(stepped, kept)


@pytest.mark.parametrize("sensors", ["nero-1", "opennero-2014"])
def test_a_loaded_world_goes_on_bit_for_bit(sensors: str) -> None:
    against = fighters(2, OBSERVATIONS[sensors]), 2
    scenario = SMALL.replaced(sensors=sensors, spawns=(Spawn(x=400.0, y=266.67, jitter=5),))
    env = NeroEnv(scenario, arenas=2, seed=3, enemies=against)
    act = acting(env)
    data = env.reset()
    for _ in range(33):
        _, data = env.step_and_maybe_reset(act(data))
    state = env.world_state()
    other = NeroEnv(scenario, arenas=2, seed=99, enemies=against)
    other.load_world_state(state)
    begun = other.reset()
    for key in (OBSERVATION, POSE, STEP_COUNT, MEASURE, DONE, TERMINATED, TRUNCATED):
        assert torch.equal(begun[key].nan_to_num(), data[key].nan_to_num()), key
    for _ in range(40):
        one, data = env.step_and_maybe_reset(act(data))
        two, begun = other.step_and_maybe_reset(act(begun))
        for key in (OBSERVATION, POSE, STEP_COUNT, MEASURE, REWARD, REWARD_VECTOR, DONE):
            assert torch.equal(one["next", key].nan_to_num(), two["next", key].nan_to_num()), key
    assert env.world_state()["generators"] == other.world_state()["generators"]


def test_a_saved_state_is_a_copy_and_fits_no_other_world() -> None:
    env = NeroEnv(SMALL, arenas=2, enemies=(fighters(1, 23), 1))
    state = env.world_state()
    before = {name: one.copy() for name, one in state["fields"][0].items()}
    network = state["enemies"][0]["value"].copy()
    roll(env, 10)
    for name, one in state["fields"][0].items():
        assert np.array_equal(one, before[name], equal_nan=name == "flag"), name
    assert np.array_equal(state["enemies"][0]["value"], network)
    json.dumps([state["stages"], state["seeds"], state["generators"]])
    with pytest.raises(ScenarioError, match="2 arenas of"):
        NeroEnv(SMALL, arenas=3).load_world_state(state)
    with pytest.raises(ScenarioError, match=r"max_speed: expected 0.5, as it was"):
        NeroEnv(SMALL.replaced(max_speed=0.5), arenas=2).load_world_state(state)


def test_actions_are_clipped_and_must_be_finite() -> None:
    field = training(EMPTY, [0])
    at(field, (400, 400, 0))
    step(field, (5.0, 0.0))
    assert field.pose[0, 0] == pytest.approx([401, 400, 0])
    step(field, (-5.0, 9.0))
    expected = [401 - math.cos(0.2), 400 - math.sin(0.2), 0.2]
    assert field.pose[0, 0] == pytest.approx(expected, abs=1e-6)
    with pytest.raises(ValueError, match="finite"):
        step(field, (math.nan, 0.0))


# -------------------------------------------------------------------------------- lives and deaths


def test_lives_are_truncated_at_their_length() -> None:
    env = NeroEnv(EMPTY.replaced(lifetime_ticks=6, robots=2), arenas=2)
    data = roll(env, 20)
    ages = data["next", STEP_COUNT][1, 0, :, 0].tolist()
    assert ages == [1, 2, 3, 4, 5, 6] * 3 + [1, 2]
    assert torch.equal(data["next", TRUNCATED], data["next", STEP_COUNT] == 6)
    assert torch.equal(data["next", DONE], data["next", TRUNCATED])
    assert not data["next", TERMINATED].any()
    assert data[POSE][..., 0, :2].unique().tolist() == [400]
    assert data[POSE][..., 6, :2].unique().tolist() == [400]  # at the spawn again
    assert data[POSE][..., 5, :2].unique().numel() > 1
    forever = roll(NeroEnv(EMPTY.replaced(lifetime_ticks=0)), 50)
    assert forever["next", STEP_COUNT].max() == 50


SNIPER = EMPTY.replaced(
    width=2000.0, hit_points=2, turrets=((1200.0, 400.0),), lifetime_ticks=100, robots=2
)
"""A turret 800 units from the spawn, in the law of 2011: each of its shots hits."""


def sniped(env: NeroEnv, ticks: int) -> list[Any]:
    """Roots of ticks in which nobody moves and the turret looks at robot 0 each time."""
    data, act, roots = env.reset(), torch.zeros(*env.action_spec.shape), []
    for _ in range(ticks):
        field = env.arena.fields[0]
        field.pose[:2] = [(400, 400, 1.0), (400, 700, 1.0)]
        field.pose[-1, 2] = math.pi
        roots.append(env.step_and_maybe_reset(data.set(ACTION, act)))
        data = roots[-1][1]
    return roots


def test_who_dies_is_terminated_and_begins_anew_with_full_hit_points() -> None:
    env = NeroEnv(SNIPER.replaced(sensors="nero-1", firing="2011"))
    roots = sniped(env, 3)
    # The turret comes last: what it hits in tick k is taken in tick k + 1.
    taken = [one["next", MEASURE][0, 0, MEASURES.index("damage")].item() for one, _ in roots]
    assert taken == [0, 1, 1]
    ends = [one["next", TERMINATED][0, :, 0].tolist() for one, _ in roots]
    assert ends == [[False, False]] * 2 + [[True, False]]
    last, root = roots[-1]
    assert not last["next", TRUNCATED].any()
    assert last["next", STEP_COUNT][0, :, 0].tolist() == [3, 3]
    assert last["next", OBSERVATION][0, 0, 21] == 0
    assert root[STEP_COUNT][0, :, 0].tolist() == [0, 3]
    assert root[POSE][0, :, :2].tolist() == [[400, 400], [400, 700]]
    assert root[OBSERVATION][0, 0, 21:23].tolist() == [1, 0]
    assert not root[TERMINATED].any() and not root[DONE].any()
    field = env.arena.fields[0]
    assert field.damage.tolist() == [0, 0, 0] and field.pending.tolist() == [0, 0, 0]
    assert field.alive.all() and field.begun.all()
    assert root[POSE][0, 0, 2] != 1.0  # it looks somewhere else
    assert torch.isclose(root[POSE][0, 1, 2], torch.tensor(1.0))


def test_who_dies_in_its_last_tick_is_terminated_and_not_truncated() -> None:
    field = training(SNIPER.replaced(lifetime_ticks=1), [0])
    at(field, (400, 400, 90), (400, 700, 90), (1200, 100, 90), damage=(1, 0, 0), pending=(1, 0, 0))
    step(field, (0.0, 0.0), (0.0, 0.0))
    assert field.terminated.tolist() == [[True, False]]
    assert field.truncated.tolist() == [[False, True]]


def test_nothing_of_the_old_life_stands_at_the_beginning_of_a_new_one() -> None:
    last, root = sniped(NeroEnv(SNIPER), 3)[-1]
    assert last["next", REWARD_VECTOR][0, 0, REWARD_NAMES.index("avoid_fire")] == -1
    assert last["next", MEASURE][0, 0, MEASURES.index("damage")] == 1
    assert root[MEASURE][0, 0, MEASURES.index("damage")] == 0
    field = training(LAWN, [0])
    at(field, (100, 400, 0), (100, 500, 90), (100, 100, -90), (900, 400, 90))
    step(field, (0.5, 0.0), (0.0, 0.0), (0.0, 0.0))
    field.respawn(np.array([[True, False, False]]))
    assert field.measures[0, 0, [MEASURES.index("hits"), MEASURES.index("speed")]].tolist() == [
        0,
        0,
    ]
    assert root[REWARD_VECTOR][0, 0].tolist() == [0] * 6


def test_a_masked_reset_begins_these_lives_anew_and_the_world_goes_on() -> None:
    env = NeroEnv(SMALL.replaced(lifetime_ticks=1000, hit_points=1000), arenas=2)
    data, act = env.reset(), acting(env)
    for _ in range(9):
        data = step_mdp(env.step(act(data)))
    before = data.clone()
    mask = torch.tensor([[True, False, False], [False, True, True]])
    after = env.reset(data.set("_reset", mask[..., None]))
    assert env.arena.tick == 9
    assert after[STEP_COUNT][..., 0].tolist() == [[0, 9, 9], [9, 0, 0]]
    assert torch.equal(after[POSE][~mask], before[POSE][~mask])
    spawn = after[POSE][mask][:, :2] - torch.tensor([400, 266.67])
    assert (spawn >= -20.01).all() and (spawn <= 19.01).all()
    env.reset()
    assert env.arena.tick == 0


def test_lives_begin_looking_anywhere_in_whole_degrees() -> None:
    field = training(EMPTY.replaced(robots=3000), [0])
    degrees = np.degrees(field.pose[0, :, 2])
    assert np.abs(degrees - degrees.round()).max() < 1e-9
    assert np.unique(degrees.round() % 360).tolist() == list(range(360))
    field.respawn(np.ones((1, 3000), bool))
    again = np.degrees(field.pose[0, :, 2])
    assert np.unique(again.round() % 360).tolist() == list(range(360))
    assert (again != degrees).mean() > 0.9


def test_who_is_not_begun_anew_after_its_death_leaves_the_field_and_senses_nothing() -> None:
    field = training(SNIPER.replaced(robots=1, hit_points=1), [0])
    at(field, (400, 400, 90), (1200, 400, 180), pending=(1, 0))
    step(field, (0.0, 0.0))
    assert field.terminated.tolist() == [[True]]
    assert field.observation.any()
    step(field, (0.0, 0.0))
    assert not field.fields[0].alive[0] and not field.observation.any()
    assert field.terminated.tolist() == [[True]]
    field.respawn(np.array([[True]]))
    assert field.fields[0].alive[0] and not field.terminated.any()


# ----------------------------------------------------------------------------------------- stages

DRILL = {
    "robots": 2,
    "walls": [],
    "stages": [
        {"ticks": 5, "reward_weights": {"stand_ground": 1.0}},
        {"ticks": 3, "turrets": [[100, 100]], "spawns": [{"x": 200, "y": 200, "jitter": 0}]},
        {"flag": [300, 300], "lifetime_ticks": 4},
    ],
}


def test_a_stage_ends_all_lives_and_the_next_field_begins() -> None:
    env = NeroEnv(find_stages(DRILL), arenas=2)
    data = roll(env, 16)
    ends = (data["next", TRUNCATED].all(1).all(0).squeeze(-1)).nonzero().squeeze(-1).tolist()
    assert ends == [4, 7, 11, 15]  # after 5 and 3 more ticks, then after each life of 4
    assert torch.equal(data["next", TRUNCATED].any(1).any(0), data["next", TRUNCATED][0, 0])
    assert data[STEP_COUNT][1, 1, :, 0].tolist() == [0, 1, 2, 3, 4, 0, 1, 2] + [0, 1, 2, 3] * 2
    assert data[POSE][..., 5, :2].unique().tolist() == [200]
    enemy, flag = MEASURES.index("enemy_distance"), MEASURES.index("flag_distance")
    seen = ~data["next", MEASURE].isnan()
    # What the last tick of a stage came to is told of the old field.
    assert seen[..., enemy][0, 0].tolist() == [False] * 5 + [True] * 3 + [False] * 8
    assert seen[..., flag][0, 0].tolist() == [False] * 8 + [True] * 8
    assert env.arena.scenario.flag == (300.0, 300.0)
    assert env.arena.weights.tolist() == [0, 0, 0, 0, 1, 0]
    env.reset()
    assert env.arena.weights.tolist() == [1, 0, 0, 0, 0, 0]


def test_the_last_pose_of_a_stage_is_where_the_robot_was() -> None:
    env = NeroEnv(find_stages(DRILL))
    data = roll(env, 6)
    assert data["next", POSE][0, :, 4, :2].tolist() != [[200, 200], [200, 200]]
    assert data[POSE][0, :, 5, :2].tolist() == [[200, 200], [200, 200]]


@pytest.mark.parametrize("ticks", [3, 6, 9])
def test_a_loaded_world_is_in_its_stage(ticks: int) -> None:
    env, other = (NeroEnv(find_stages(DRILL), arenas=2, seed=seed) for seed in (0, 7))
    act, data = acting(env), env.reset()
    for _ in range(ticks):
        _, data = env.step_and_maybe_reset(act(data))
    env.arena.weights[5] = 0.25
    other.load_world_state(env.world_state())
    assert other.arena.weights[5] == 0.25
    begun = other.reset()
    for _ in range(8):
        one, data = env.step_and_maybe_reset(act(data))
        two, begun = other.step_and_maybe_reset(act(begun))
        for key in (OBSERVATION, POSE, STEP_COUNT, MEASURE, REWARD, DONE):
            assert torch.equal(one["next", key].nan_to_num(), two["next", key].nan_to_num()), key


def test_all_stages_have_robots_that_move_alike() -> None:
    parts = [{"ticks": 1, "max_speed": 1.0}, {"max_speed": 0.5}]
    with pytest.raises(ScenarioError, match="max_speed"):
        find_stages({"robots": 1, "walls": [], "stages": parts})


# ---------------------------------------------------------------------------------------- rewards

LAWN = EMPTY.replaced(
    width=2000.0, robots=3, flag=(100.0, 200.0), turrets=((900.0, 400.0),), hit_points=20
)


def rewarded(weights: dict[str, float]) -> TrainingField:
    """A tick of robots at (100, 400), 12 units above it and 300 below, the turret 800 away.

    The first goes towards the turret at half speed and hits it (law of 2011, farther than 600).
    It takes the two hits that came in before; the others look away and stay.
    """
    field = training(LAWN.replaced(reward_weights=weights), [0])
    places = (100, 400, 0), (100, 412, 90), (100, 100, -90), (900, 400, 90)
    at(field, *places, pending=(2, 0, 0, 0))
    step(field, (0.5, 0.0), (0.0, 0.0), (-1.0, 0.0))
    return field


def test_rewards_for_evolution_are_those_of_opennero() -> None:
    # Afterwards robot 0 is at (100.5, 400), robot 1 at (100, 412), robot 2 at (100, 101).
    field = rewarded({"hit_target": 1.0})
    vector = dict(zip(REWARD_NAMES, field.reward_vector[0].T, strict=True))
    assert vector["stand_ground"] == pytest.approx([-0.5, 0, -1])
    assert vector["stick_together"] == pytest.approx(
        [-(0.5**2 + 12**2), -(0.5**2 + 12**2), -(0.5**2 + 299**2)]
    )
    assert vector["approach_enemy"] == pytest.approx(
        [-(799.5**2), -(800**2 + 12**2), -(800**2 + 299**2)]
    )
    assert vector["approach_flag"] == pytest.approx([-(0.5**2 + 200**2), -(212**2), -(99**2)])
    assert vector["hit_target"].tolist() == [1, 0, 0]
    assert vector["avoid_fire"].tolist() == [-2, 0, 0]
    measures = dict(zip(MEASURES, field.measures[0].T, strict=True))
    assert measures["hits"].tolist() == [1, 0, 0]
    assert measures["damage"].tolist() == [2, 0, 0]
    assert measures["enemy_distance"][0] == pytest.approx(799.5)
    assert measures["friend_distance"][0] == pytest.approx(math.hypot(0.5, 12))
    assert measures["flag_distance"][2] == pytest.approx(99)
    assert measures["speed"].tolist() == [0.5, 0, 1]


def test_of_what_is_not_there_the_reward_is_0() -> None:
    field = training(EMPTY, [0])
    step(field, (1.0, 0.0))
    assert field.reward_vector[0, 0].tolist() == [-1, 0, 0, 0, 0, 0]
    names = dict(zip(MEASURES, field.measures[0, 0], strict=True))
    for name in ("enemy_distance", "friend_distance", "flag_distance"):
        assert math.isnan(names[name])


PARTS = {
    "stand_ground": [1 - 2 * 0.5, 1.0, -1.0],
    "stick_together": [12 - math.hypot(0.5, 12), 12 - math.hypot(0.5, 12), 300 - 299.00041806],
    "approach_enemy": [0.5, 0.0, math.hypot(800, 300) - math.hypot(800, 299)],
    "approach_flag": [200 - math.hypot(0.5, 200), 0.0, 100 - 99.0],
    "hit_target": [1, 0, 0],
    "avoid_fire": [-1, 0, 0],  # two hits in a tick count as one
}
"""What each robot's reward for learning consists of: the way made towards something in units."""


@pytest.mark.parametrize("name", REWARD_NAMES)
@pytest.mark.parametrize("weight", [1.0, 0.3, -2.0])
def test_each_reward_for_learning_alone_is_its_part_scaled_to_0_to_1(
    name: str, weight: float
) -> None:
    field = rewarded({name: weight})
    expected = (np.sign(weight) * np.array(PARTS[name]) + 1) / 2
    assert field.reward[0] == pytest.approx(expected, abs=1e-6)


def test_the_reward_for_learning_is_the_weighted_mean_of_the_parts() -> None:
    field = rewarded({"stand_ground": 1.0, "approach_enemy": 2.0, "avoid_fire": -1.0})
    # Robot 0: (1 x 0 + 2 x 0.5 - 1 x -1) / 4 = 0.5; robot 1: (1 + 0 + 0) / 4 = 0.25.
    assert field.reward[0, :2] == pytest.approx([0.75, 0.625])
    half = LAWN.replaced(max_speed=0.5, reward_weights={"stand_ground": 1, "approach_enemy": 1})
    slower = training(half, [0])
    at(slower, (100, 400, 0), (100, 412, 90), (100, 100, -90), (900, 400, 90))
    step(slower, (0.25, 0.0), (0.0, 0.0), (0.0, 0.0))
    assert slower.reward[0, 0] == pytest.approx(((0 + 0.5) / 2 + 1) / 2)  # shares of the speed


def test_rewards_for_learning_stay_within_0_and_1() -> None:
    weights = dict(zip(REWARD_NAMES, (1.0, -1.0, 0.5, 1.0, -2.0, 1.0), strict=True))
    scenario = SMALL.replaced(reward_weights=weights, flag=(500.0, 300.0))
    env = NeroEnv(scenario, arenas=2, enemies=(fighters(2, 23), 2))
    reward = roll(env, 120)["next", REWARD]
    assert reward.min() >= 0 and reward.max() <= 1
    assert reward.std() > 0.01


def test_an_enemy_that_begins_anew_elsewhere_is_no_way_lost() -> None:
    spawns = Spawn(x=400.0, y=400.0, jitter=0), Spawn(x=1900.0, y=700.0, jitter=0)
    scenario = FAR.replaced(spawns=spawns, reward_weights={"approach_enemy": 1.0})
    field = training(scenario, [0], (fighters(1, 18), 1))
    at(field, (400, 400, 0), (1200, 400, 90), damage=(0, 2))
    step(field, (0.0, 0.0))
    assert field.fields[0].pose[1, :2].tolist() == [1900, 700]
    assert field.reward[0, 0] == pytest.approx(0.5)


def test_without_weights_the_reward_is_in_the_middle() -> None:
    field = training(EMPTY, [0])
    field.weights[:] = 0
    step(field, (0.5, 0.0))
    assert field.reward[0, 0] == 0.5


# ---------------------------------------------------------------------------- enemies and turrets


def fighters(count: int, inputs: int) -> TeamBrains:
    """Networks without links that stand still, turn by 0.1 rad a tick and fire."""
    extra = {18: 2, 23: 3}[inputs]
    nodes, ends = inputs + 1 + extra, np.arange(count + 1)
    first = ends[:-1, None] * nodes + inputs + 1
    total = count * nodes
    # A node that nothing reaches is 0.5 by its sigmoid; the turn has a link from the bias.
    link = np.zeros(total + 1, np.int64)
    for robot in range(count):
        link[robot * nodes + inputs + 3 :] += 1
    weight = math.log(0.75 / 0.25)  # 2 x 0.75 - 1 = 0.5 of the largest turn of 0.2 rad
    outputs = (first + np.arange(extra)).ravel()
    return no_brains()._replace(
        node=ends * nodes,
        link=link,
        source=ends[:-1] * nodes + inputs,
        weight=np.full(count, weight),
        late=np.zeros(count, bool),
        activation=np.ones(total, np.int64),
        bias=np.ones(count),
        silent=np.zeros(count, bool),
        output=ends * extra,
        outputs=outputs,
        candidates=np.ones(count, np.int64),
        value=np.zeros(total),
        before=np.zeros(total),
        active=np.zeros(total, bool),
        fired=np.zeros(total, bool),
    )


FAR = EMPTY.replaced(width=2000.0, spawns=(Spawn(x=400.0, y=400.0, jitter=0),) * 2, hit_points=3)


def test_enemies_fight_with_their_networks() -> None:
    field = training(FAR, [0], (fighters(2, 18), 2))
    at(field, (400, 400, 90), (1200, 400, 180), (1200, 700, 90))
    step(field, (0.0, 0.0))
    enemies = field.fields[0]
    assert enemies.team.tolist() == [0, 1, 1]
    assert enemies.hits.tolist() == [0, 1, 0]
    assert enemies.pending.tolist() == [1, 0, 0]
    turned = np.degrees(enemies.pose[1:, 2]) % 360
    assert turned == pytest.approx([180 + math.degrees(0.1), 90 + math.degrees(0.1)])
    assert enemies.pose[1:, :2].tolist() == [[1200, 400], [1200, 700]]
    step(field, (0.0, 0.0))
    assert field.measures[0, 0, MEASURES.index("damage")] == 1
    assert field.observation[0, 0, 10:15].tolist() == [0] * 5  # farther away than 300


def test_each_arena_has_networks_of_its_own() -> None:
    field = training(FAR, [0, 0], (fighters(1, 18), 1))
    field.step(np.zeros((2, 1, 2), np.float32))
    values = [state["value"] for state in field.world_state()["enemies"]]
    assert values[0].any() and np.array_equal(*values)
    field.respawn(np.array([[True], [False]]))
    field.step(np.zeros((2, 1, 2), np.float32))
    state = field.world_state()
    state["enemies"][0]["value"][:] = 7
    field.load_world_state(state)
    assert (field.world_state()["enemies"][0]["value"] == 7).all()
    assert not (field.world_state()["enemies"][1]["value"] == 7).any()


def test_an_enemy_that_dies_begins_anew_at_its_spawn_with_full_hit_points() -> None:
    spawns = Spawn(x=400.0, y=400.0, jitter=0), Spawn(x=1500.0, y=200.0, jitter=2)
    field = training(FAR.replaced(spawns=spawns), [0], (fighters(2, 18), 2))
    assert (np.abs(field.fields[0].pose[1:, :2] - (1500, 200)) <= 2).all()
    at(field, (400, 400, 0), (1200, 400, 90), (1200, 700, 90), damage=(0, 2, 1))
    step(field, (0.0, 0.0))
    own = field.fields[0]
    assert own.hits[0] == 1 and own.damage.tolist() == [0, 0, 1]
    assert (np.abs(own.pose[1, :2] - (1500, 200)) <= 2).all()
    assert own.pose[2, :2].tolist() == [1200, 700]
    assert own.alive.all() and not field.terminated.any()
    assert own.pending.tolist() == [0, 0, 0]


def test_turrets_turn_by_a_tenth_shoot_and_never_die() -> None:
    field = training(SNIPER.replaced(robots=1, hit_points=20), [0])
    at(field, (400, 400, 0), (1200, 400, 180))
    own = field.fields[0]
    for tick in range(1, 70):
        step(field, (0.0, 0.0))
        assert own.hits[0] == 1  # it is hit in each tick
        turned = (math.pi + 0.1 * tick - own.pose[1, 2]) % (2 * math.pi)
        assert min(turned, 2 * math.pi - turned) == pytest.approx(0, abs=1e-9)
        # It looks at the robot in the first tick, and within 2 degrees again after 62.83 ticks.
        assert own.hits[1] == (tick in (1, 64)), tick
        assert own.pose[1, :2].tolist() == [1200, 400]
    assert own.alive[1] and own.damage[1] == 0
    assert own.damage[0] == 2
    field.respawn(np.array([[True]]))
    assert own.pose[1, :2].tolist() == [1200, 400]


def test_turrets_are_enemies_of_both_teams() -> None:
    scenario = FAR.replaced(turrets=((1200.0, 700.0),))
    field = training(scenario, [0], (fighters(1, 18), 1))
    at(field, (400, 400, 90), (1900, 700, 180), (1200, 700, 0))
    step(field, (0.0, 0.0))
    own = field.fields[0]
    assert own.shot.tolist() == [-1, 2, 1]
    assert own.hits.tolist() == [0, 1, 1]


# -------------------------------------------------------------------------- what learners observe


def observed(sensors: str, *poses: tuple[float, float, float], speed: float = 0.0) -> np.ndarray:
    scenario = NERO_TASKS["battle"].replaced(robots=len(poses), sensors=sensors)
    field = training(scenario, [0])
    at(field, *poses)
    actions = (speed, 0.0, 0.0, 0.0)[: len(field.bounds[0])]
    step(field, *[actions] * len(poses))
    return field.observation[0]


def test_friends_are_where_they_are_now() -> None:
    alone = observed("opennero-2011", (100, 100, 30), speed=1.0)[0]
    assert alone[15:17] == pytest.approx([0, 0.5], abs=1e-6)


def test_the_first_observation_of_a_world_has_friends() -> None:
    field = training(EMPTY, [0])
    assert field.observation[0, 0, 15:17] == pytest.approx([0, 0.5], abs=1e-6)


def test_who_runs_against_a_wall_senses_it_where_it_is_pushed_to() -> None:
    place = (400, 398 - 4.09, 90)
    ahead = observed("opennero-2011", place, speed=1.0)[0, 2]
    assert ahead == pytest.approx(4.09 / 50, abs=1e-6)


# -------------------------------------------------------------------------------------- scenarios

TURRET_IN_WALL = {"turrets": [[400, 400]]}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"turets": []}, ['unknown key "turets"', 'did you mean "turrets"']),
        ({"sensors": "opennero-2012"}, ["sensors: ", '"opennero-2012"', "known: opennero-2011"]),
        ({"firing": "never"}, ["firing: ", '"never"', "known: 2011, 2014, aimed"]),
        (TURRET_IN_WALL, ["turrets[0]: (400, 400) is inside walls[0]"]),
        ({"turrets": [[100, 100], [0, 5]]}, ["turrets[1]: (0, 5) is too near the border"]),
        ({"turrets": [[1, 2, 3]]}, ["turrets[0]: expected two numbers"]),
        ({"turrets": 3}, ["turrets: expected a list"]),
        ({"flag": [100]}, ["flag: expected two numbers"]),
        ({"flag": [900, 100]}, ["flag: (900, 100) is too near the border"]),
        ({"flag": [310, 401]}, ["flag: (310, 401) is inside walls[0]"]),
        ({"spawns": [{"x": 10, "y": 400}]}, ["spawns[0]: (10, 400) is too near the border"]),
        ({"spawns": [{"x": 400, "y": 771.5}]}, ["spawns[0]", "too near the border"]),
        ({"spawns": [{"x": 400, "y": 400}]}, ["spawns[0]", "inside walls[0]"]),
        ({"spawns": [{"x": 400}]}, ["spawns[0]: missing keys: y"]),
        ({"spawns": [{"x": 400, "y": 300, "z": 1}]}, ["spawns[0]: unknown key"]),
        ({"spawns": []}, ["spawns: expected at least one"]),
        ({"walls": [{"x": 1, "y": 2, "width": 0, "height": 4}]}, ["walls[0].width: expected"]),
        ({"hit_points": 0}, ["hit_points: expected a whole number from 1"]),
        ({"robots": 2.5}, ["robots: expected a whole number"]),
        ({"max_speed": 5}, ["max_speed: expected at most 4"]),
        ({"reward_weights": {"hit": 1}}, ["reward_weights: unknown", '"hit"', "hit_target"]),
        ({"reward_weights": {"hit_target": 0}}, ["reward_weights: all are 0"]),
        ({"reward_weights": {"hit_target": "x"}}, ["reward_weights: expected a number"]),
        ({"lifetime_ticks": -1}, ["lifetime_ticks: expected"]),
        ([], ["expected an object"]),
    ],
)
def test_an_error_names_the_key(values: Any, words: list[str], tmp_path: Path) -> None:
    path = tmp_path / "field.json"
    path.write_text(json.dumps(values))
    for source in (path, values) if isinstance(values, dict) else (path,):
        with pytest.raises(ScenarioError) as caught:
            find_nero(source)
        assert all(word in str(caught.value) for word in words), caught.value
        assert "\n" not in str(caught.value)
    if isinstance(values, dict):
        with pytest.raises(ScenarioError):
            find_nero("battle", values)


def test_a_spawn_whose_jitter_reaches_into_a_wall_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"spawns\[0\]"):
        find_nero({"spawns": [{"x": 400, "y": 390}]})


def test_a_scenario_is_the_same_after_a_file(tmp_path: Path) -> None:
    wall = Wall(x=300, y=400, width=200, height=4, angle_rad=0.3)
    mine = NERO_TASKS["nero"].replaced(walls=(wall,), flag=(100, 100), hit_points=7)
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(mine.to_dict()))
    assert find_nero(path) == find_nero(str(path)) == NeroScenario.from_dict(mine.to_dict()) == mine
    assert find_nero({"hit_points": 7}) == NERO_TASKS["battle"].replaced(hit_points=7)
    assert find_nero("nero", {"robots": 4}).robots == 4
    assert find_nero(mine, {"flag": [5, 6]}).flag == (5.0, 6.0)
    with pytest.raises(ScenarioError, match=r"battle, nero, .* or the path"):
        find_nero("batle")
    assert mine.weights().tolist() == [0, 0, 0.5, 0, 1, 0.3]
