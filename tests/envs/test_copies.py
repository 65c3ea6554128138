"""Copies and pickles of the arena, in all its forms, go on like the original, bit for bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from neatq_envs.arena import Arena
from neatq_envs.pettingzoo_env import TeamEnv
from neatq_envs.scenario import TASKS
from neatq_envs.torchrl_env import ArenaEnv

WAYS: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}
ARENA_IDS = [f"neatq/{name}-v0" for name in ("Flag", "Moving", "Wall", "Trap", "Maze", "Switch")]
OTHER_IDS = ["neatq/DoublePole-v0", "neatq/MountainCar-v0", "neatq/ServerJobs-v0"]


def go(env: Any, steps: int, seed: int) -> list[Any]:
    """What an environment gives for actions that a seed decides; new episodes where they end."""
    actions = copy.deepcopy(env.action_space)
    actions.seed(seed)
    came = []
    for _ in range(steps):
        seen, reward, *ends, info = env.step(actions.sample())
        came.append([seen.tolist(), np.ravel(reward).tolist(), repr(ends), repr(info)])
        if any(end is True for end in ends):
            came.append(env.reset()[0].tolist())
    return came


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("task", ARENA_IDS + OTHER_IDS)
def test_a_copy_of_a_task_goes_on_like_the_original(task: str, way: str) -> None:
    env = gymnasium.make(task)
    env.reset(seed=3)
    go(env, 30, seed=1)
    other = WAYS[way](env)
    assert other is not env
    assert go(other, 60, seed=2) == go(env, 60, seed=2)
    assert other.reset()[0].tolist() == env.reset()[0].tolist()  # chance goes on, too
    WAYS[way](gymnasium.make(task)).reset(seed=1)  # one without a world yet


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_rows_goes_on_like_the_original(way: str) -> None:
    env = gymnasium.make_vec("neatq/Wall-v0", 3, vectorization_mode="vector_entry_point")
    env.reset(seed=3)
    go(env, 10, seed=1)
    other = WAYS[way](env)
    assert go(other, 20, seed=2) == go(env, 20, seed=2)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("collide", [False, True])
def test_a_crowd_against_a_wall_goes_on_exactly_as_a_copy(
    to_flag: Callable[[Arena], np.ndarray], way: str, collide: bool
) -> None:
    """Where bodies touch, physics holds more than places and velocities."""
    arena = Arena(TASKS["wall"].replaced(robots=20, collide=collide), [5, 6])
    for _ in range(150):
        arena.step(to_flag(arena))
    other = WAYS[way](arena)
    for _ in range(60):
        for one in (arena, other):
            one.step(to_flag(one))
        assert np.array_equal(other.position, arena.position)
        assert np.array_equal(other.observation, arena.observation)
    mask = np.ones(arena.shape, bool)
    for one in (arena, other):
        one.respawn(mask)
    assert np.array_equal(other.position, arena.position)
    assert other.tick == arena.tick == 210


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_the_team_goes_on_like_the_original(way: str) -> None:
    env = TeamEnv(TASKS["switch"].replaced(robots=3, lifetime_ticks=40))
    env.reset(seed=8)

    def steps(one: TeamEnv, count: int, seed: int) -> list[Any]:
        rng = np.random.default_rng(seed)
        came = []
        for _ in range(count):
            draw = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
            seen, rewards, *_ = one.step(dict(zip(one.agents, draw, strict=True)))
            came.append(([value.tolist() for value in seen.values()], rewards))
        return came

    steps(env, 10, 1)
    other = WAYS[way](env)
    assert other.agents == env.agents
    assert steps(other, 30, 2) == steps(env, 30, 2)
    assert other.agents == env.agents == []


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_the_torchrl_environment_goes_on_like_the_original(way: str) -> None:
    env = ArenaEnv(TASKS["wall"].replaced(robots=4, lifetime_ticks=15), arenas=2, seed=3)
    now = env.reset()
    torch.manual_seed(0)
    for _ in range(9):
        _, now = env.step_and_maybe_reset(env.rand_action(now))
    other = WAYS[way](env)
    same = now.clone()
    for _ in range(20):
        action = env.rand_action(now.clone())["action"]
        _, now = env.step_and_maybe_reset(now.set("action", action))
        _, same = other.step_and_maybe_reset(same.set("action", action.clone()))
        assert (now == same).all()
