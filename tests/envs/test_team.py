"""The team as a PettingZoo task: the arena's own world, agent by agent."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neatq_envs.arena import Arena
from neatq_envs.pettingzoo_env import TeamEnv
from neatq_envs.scenario import TASKS

SMALL = TASKS["wall"].replaced(robots=4, lifetime_ticks=6, reward="progress")


def checker(name: str) -> Callable[..., None]:
    """Return one of PettingZoo's tests; their module warns of its own old imports."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
        return getattr(importlib.import_module("pettingzoo.test"), name)


def test_pettingzoo_finds_the_interface_right() -> None:
    checker("parallel_api_test")(TeamEnv(SMALL), num_cycles=20)
    checker("parallel_api_test")(TeamEnv(SMALL.replaced(lifetime_ticks=0)), num_cycles=20)


def test_pettingzoo_finds_that_a_seed_decides_everything() -> None:
    checker("parallel_seed_test")(lambda: TeamEnv(SMALL.replaced(lifetime_ticks=500)))


def test_it_is_the_arena_bit_for_bit() -> None:
    env, arena = TeamEnv(SMALL), Arena(SMALL, [8])
    seen, infos = env.reset(seed=8)
    rng = np.random.default_rng(0)
    assert list(seen) == ["robot_0", "robot_1", "robot_2", "robot_3"]
    for tick in range(1, 7):
        actions = rng.uniform(-1, 1, (4, 2)).astype(np.float32)
        by_agent = {f"robot_{robot}": actions[robot] for robot in reversed(range(4))}
        seen, rewards, terminated, truncated, infos = env.step(by_agent)
        arena.step(actions[None])
        assert np.array_equal([*seen.values()], arena.observation[0])
        assert [*rewards.values()] == arena.reward[0].tolist()
        assert [info["distance"] for info in infos.values()] == arena.distance[0].tolist()
        x, y, heading = np.stack([info["pose"] for info in infos.values()], 1)
        assert np.array_equal(np.stack([x, y], 1), arena.position[0])
        assert np.array_equal(heading, arena.heading_rad[0])
        assert [*terminated.values()] == [False] * 4
        assert [*truncated.values()] == [tick == 6] * 4
    assert env.agents == []


def test_after_the_end_a_reset_makes_another_world() -> None:
    env = TeamEnv(SMALL.replaced(lifetime_ticks=1))
    first = env.reset(seed=2)[1]["robot_3"]["pose"]
    still = dict.fromkeys(env.agents, np.zeros(2))
    env.step(still)
    with pytest.raises(ValueError, match=r"all lives are over; call reset\(\)"):
        env.step(still)
    assert not np.array_equal(env.reset()[1]["robot_3"]["pose"], first)
    assert env.agents == env.possible_agents
    assert np.array_equal(env.reset(seed=2)[1]["robot_3"]["pose"], first)


def test_actions_of_the_wrong_agents_are_refused_by_name() -> None:
    env = TeamEnv(SMALL)
    env.reset(seed=0)
    actions: dict[str, Any] = {agent: np.zeros(2) for agent in env.agents[1:]}
    with pytest.raises(ValueError, match=r"missing: \['robot_0'\], unknown: \['robot_9'\]"):
        env.step({**actions, "robot_9": np.zeros(2)})


def test_a_picture_shows_the_whole_team() -> None:
    env = TeamEnv("flag", render_mode="rgb_array")
    env.reset(seed=0)
    image = env.render()
    assert image is not None and image.shape == (400, 400, 3)
    assert TeamEnv("flag").render() is None


def test_without_pettingzoo_the_error_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "neatq_envs.pettingzoo_env")
    with pytest.raises(ImportError, match=r'pip install "neatq_torch\[pettingzoo\]"'):
        importlib.import_module("neatq_envs.pettingzoo_env")
