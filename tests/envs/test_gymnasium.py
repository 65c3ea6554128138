"""The tasks as Gymnasium environments: its own checks, and one row against many."""

from __future__ import annotations

import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import neatq_envs
from neatq_envs import register_all
from neatq_envs.row_env import RowVectorEnv

IDS = (
    "neatq/DoublePole-v0",
    "neatq/DoublePoleNoVelocities-v0",
    "neatq/MountainCar-v0",
    "neatq/ServerJobs-v0",
)
SECTIONS = (
    "## Description",
    "## Observation Space",
    "## Action Space",
    "## Rewards",
    "## Starting State",
    "## Episode End",
)
ROWS, SEEDS = 5, [7, 3, 11, 3, 0]


def many(name: str, rows: int = ROWS, **kwargs: Any) -> RowVectorEnv:
    envs = gymnasium.make_vec(name, num_envs=rows, **kwargs)
    assert isinstance(envs, RowVectorEnv)
    return envs


def play_alone(name: str, seed: int, actions: np.ndarray, **kwargs: Any) -> list[tuple[Any, ...]]:
    """Return what one environment says until its episode ends, with a row's actions."""
    env = gymnasium.make(name, **kwargs)
    said: list[tuple[Any, ...]] = [(env.reset(seed=seed)[0].tolist(),)]
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        said.append((observation.tolist(), reward, terminated, truncated))
        if terminated or truncated:
            break
    return said


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_finds_nothing_wrong(name: str) -> None:
    with warnings.catch_warnings():
        # Velocities of poles have no bounds; every other warning is an error.
        if "DoublePole" in name:
            warnings.filterwarnings("ignore", message=".*(minimum|maximum) value is.*infinity")
        check_env(gymnasium.make(name).unwrapped)


@pytest.mark.parametrize("name", IDS)
def test_the_docstring_has_the_sections_of_gymnasium(name: str) -> None:
    text = gymnasium.make(name).unwrapped.__doc__ or ""
    places = [text.find(section) for section in SECTIONS]
    assert min(places) > 0 and places == sorted(places)


@pytest.mark.parametrize("name", IDS)
def test_a_row_is_bit_for_bit_the_single_environment(name: str) -> None:
    envs = many(name, max_episode_steps=150)
    envs.action_space.seed(0)
    actions = np.stack([envs.action_space.sample() for _ in range(150)])
    alone = [
        play_alone(name, seed, actions[:, row], max_episode_steps=150)
        for row, seed in enumerate(SEEDS)
    ]
    observation, _ = envs.reset(seed=SEEDS)
    said: list[list[tuple[Any, ...]]] = [[(seen.tolist(),)] for seen in observation]
    running = np.ones(ROWS, dtype=bool)
    for action in actions:
        observation, reward, terminated, truncated, _ = envs.step(action)
        for row in np.flatnonzero(running):
            values = (reward[row], terminated[row], truncated[row])
            said[row].append((observation[row].tolist(), *(value.item() for value in values)))
        finished = terminated | truncated
        running &= ~finished
        if not running.any():
            break
        if finished.any():
            envs.reset(options={"reset_mask": finished})
    assert said == alone
    assert any(len(row) > 10 for row in said)


@pytest.mark.parametrize("name", IDS)
def test_many_rows_are_those_of_gymnasiums_own_vector_environment(name: str) -> None:
    ours = many(name, max_episode_steps=30)
    theirs = gymnasium.make_vec(
        name,
        num_envs=ROWS,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED},
        max_episode_steps=30,
    )
    assert isinstance(theirs, SyncVectorEnv)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    first, second = ours.reset(seed=4)[0], theirs.reset(seed=4)[0]
    np.testing.assert_array_equal(first, second)
    ours.action_space.seed(0)
    resets = 0
    for number in range(100):
        action = ours.action_space.sample()
        mine, other = ours.step(action)[:4], theirs.step(action)[:4]
        for one, two in zip(mine, other, strict=True):
            np.testing.assert_array_equal(one, two)
            assert one.dtype == two.dtype
        finished = mine[2] | mine[3]
        if finished.any():
            resets += 1
            seeds = [number + row if row % 2 else None for row in range(ROWS)]
            first = ours.reset(seed=seeds, options={"reset_mask": finished})[0]
            second = theirs.reset(seed=seeds, options={"reset_mask": finished})[0]
            np.testing.assert_array_equal(first, second)
    assert resets > 1


def test_importing_the_package_is_enough() -> None:
    code = "import gymnasium; gymnasium.make('neatq_envs:neatq/ServerJobs-v0')"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_registering_twice_changes_nothing() -> None:
    before = {name: gymnasium.registry[name] for name in IDS}
    register_all()
    assert all(gymnasium.registry[name] is spec for name, spec in before.items())


def test_poles_reward_every_balanced_action() -> None:
    env = gymnasium.make("neatq/DoublePole-v0")
    env.reset(seed=0)
    rewards, terminated = [], False
    while not terminated:
        _, reward, terminated, _, _ = env.step(np.array([1.0], dtype=np.float32))
        rewards.append(reward)
    assert rewards[-1] == 0.0 and set(rewards[:-1]) == {1.0}


def test_an_action_of_one_is_ten_newtons() -> None:
    env = gymnasium.make("neatq/DoublePole-v0", long_pole_rad=0.0)
    env.reset(seed=0)
    observation = env.step(np.array([1.0], dtype=np.float32))[0]
    assert observation[1] * 2 == pytest.approx(10 / 1.0275 * 0.02, rel=1e-2)


def test_velocities_can_be_hidden() -> None:
    seen = gymnasium.make("neatq/DoublePole-v0").reset(seed=0)[0]
    hidden = gymnasium.make("neatq/DoublePoleNoVelocities-v0").reset(seed=0)[0]
    assert seen.tolist() == pytest.approx([0, 0, np.radians(1) / 0.52, 0, 0, 0])
    assert hidden.tolist() == seen[[0, 2, 4]].tolist()


def test_cars_can_start_as_in_gymnasium() -> None:
    seen = many("neatq/MountainCar-v0", rows=50, starts="gym").reset(seed=0)[0]
    assert (seen[:, 1] == 0).all() and (abs(seen[:, 0] + 0.5) <= 0.1).all()
    anywhere = many("neatq/MountainCar-v0", rows=50).reset(seed=0)[0]
    assert (anywhere[:, 1] != 0).all()


def test_a_finished_row_stands_still_until_it_is_reset() -> None:
    envs, alone = many("neatq/MountainCar-v0", max_episode_steps=2), many("neatq/MountainCar-v0")
    right, mask = np.full(ROWS, 2), np.array([True] + [False] * (ROWS - 1))
    for each in (envs, alone):
        each.reset(seed=0)
        each.step(right)
        each.step(right)
    envs.reset(seed=[7] * ROWS, options={"reset_mask": mask})
    observation, reward, terminated, truncated, _ = envs.step(right)
    assert reward.tolist() == [-1] + [0] * (ROWS - 1)
    assert not terminated.any() and truncated.tolist() == [False] + [True] * (ROWS - 1)
    alone.reset(seed=[7] * ROWS, options={"reset_mask": mask})
    assert observation[0].tolist() == alone.step(right)[0][0].tolist()
    assert observation[1:].tolist() != alone.step(right)[0][1:].tolist()


def test_wrong_resets_are_refused() -> None:
    envs = many("neatq/MountainCar-v0")
    mask = np.ones(ROWS, dtype=bool)
    with pytest.raises(ValueError, match="the first reset must be of all rows"):
        envs.reset(options={"reset_mask": mask})
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"expected bool \[5\], got bool \[4\]"):
        envs.reset(options={"reset_mask": mask[1:]})
    with pytest.raises(ValueError, match=r"expected bool \[5\], got int64 \[5\]"):
        envs.reset(options={"reset_mask": mask.astype(int)})
    with pytest.raises(ValueError, match="seed: expected one for each of 5 rows, got 2"):
        envs.reset(seed=[1, 2])


def test_actions_that_are_no_numbers_are_refused() -> None:
    envs = many("neatq/DoublePole-v0")
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"finite numbers \[5, 1\]"):
        envs.step(np.full((ROWS, 1), np.nan, dtype=np.float32))
    with pytest.raises(ValueError, match=r"finite numbers \[5, 1\]"):
        envs.step(np.zeros(ROWS, dtype=np.float32))


def test_the_public_names_are_found_without_torch_until_they_need_it() -> None:
    code = (
        "import sys, neatq_envs; from neatq_envs import TASKS, Scenario, TaskError, EpisodeError\n"
        "assert 'torch' not in sys.modules and 'pettingzoo' not in sys.modules\n"
        "print([getattr(neatq_envs, name).__class__ and name for name in neatq_envs.__all__])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "ArenaEnv" in done.stdout and "TeamEnv" in done.stdout
    with pytest.raises(AttributeError, match="no attribute 'Arenas'"):
        neatq_envs.__getattr__("Arenas")
