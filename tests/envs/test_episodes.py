"""Rows without end, and rows that go on where they were saved or elsewhere, bit for bit."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from neatq_envs.episodes import (
    EVALUATION,
    EpisodeError,
    EpisodeRows,
    Starts,
    episode_seed,
    episode_seeds,
    rows_of,
    side_by_side,
)
from neatq_envs.gymnasium_rows import DealtRows, EnvRows, SingleRows, VectorRows, make_rows
from neatq_envs.gymnasium_task import GymnasiumTask, Interface
from neatq_envs.machines import Crew
from neatq_envs.random_play import ObservationScaling
from neatq_envs.torchrl_rows import GymnasiumRows

SHAPE = (2, 3)


def made(rows: EnvRows, interface: Interface, episodes: int | None, **more: Any) -> GymnasiumRows:
    scaling = ObservationScaling(np.zeros(interface.inputs), np.full(interface.inputs, 2.0))
    return GymnasiumRows(rows, interface, scaling, shape=SHAPE, episodes=episodes, **more)


def env_of(task: str, episodes: int | None = None, **more: Any) -> GymnasiumRows:
    return made(*make_rows(GymnasiumTask(id=task)), episodes, **more)


def actions_of(env: GymnasiumRows, step: int) -> torch.Tensor:
    """Actions that depend on the step alone, and let some rows end sooner than others."""
    low, high = (torch.tensor(bound) for bound in env.interface.bounds)
    drawn = torch.rand(*SHAPE, len(low), generator=torch.Generator().manual_seed(step))
    drawn[:, 0] = 0.9
    values = low + (high - low) * drawn
    return values.round() if env.interface.choices else values


def go(
    env: GymnasiumRows, now: TensorDictBase, steps: range, newborn: int = 0
) -> tuple[TensorDictBase, list[dict[str, Any]]]:
    """Step on; in every step that `newborn` divides, robot 1 of each arena makes room for another.

    Returns:
        The root after the last step, and everything that was seen, as lists.
    """
    way = []
    for step in steps:
        lived, now = env.step_and_maybe_reset(now.set("action", actions_of(env, step)))
        if newborn and step % newborn == 0:
            mask = torch.zeros(*SHAPE, 1, dtype=torch.bool)
            mask[:, 1] = True
            now = env.reset(now.set("_reset", mask))
        way += [{k: v.tolist() for k, v in one.items(True, True)} for one in (lived, now)]
    return now, way


def saved(env: GymnasiumRows) -> Any:
    """The state of the world, through a file."""
    file = io.BytesIO()
    torch.save(env.world_state(), file)
    file.seek(0)
    return torch.load(file, weights_only=False)


@pytest.fixture
def walk(toy: str) -> Iterator[Any]:
    make_rows(GymnasiumTask(id=f"{toy}Walk-v0"))
    yield sys.modules["toy_tasks"].Walk


TASKS = {
    "CartPole-v1": SingleRows,
    "neatq/DoublePole-v0": VectorRows,
    "neatq/ServerJobs-v0": VectorRows,
    "neatq/Switch-v0": VectorRows,
    "Pendulum-v1": SingleRows,
}


@pytest.mark.parametrize("episodes", [None, 2])
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("stop", [0, 7, 33, 120])
def test_a_restored_world_goes_on_bit_for_bit(task: str, episodes: int | None, stop: int) -> None:
    newborn = 11 if episodes is None else 0
    env = env_of(task, episodes, seeds=(5, 9))
    assert isinstance(env.episodes._rows, TASKS[task])
    env.begin(3)
    now, _ = go(env, env.reset(), range(stop), newborn)
    state = saved(env)
    _, expected = go(env, now, range(stop, stop + 90), newborn)
    again = env_of(task, episodes)
    again.load_world_state(state)
    again.rebuild()
    root = again.reset()
    assert again.reset()["observation"].tolist() == root["observation"].tolist()
    _, came = go(again, root, range(stop, stop + 90), newborn)
    assert came == expected
    assert again.episodes.returns.tolist() == env.episodes.returns.tolist()
    assert again.episodes.steps.tolist() == env.episodes.steps.tolist()
    if stop == 120 and task == "CartPole-v1":  # idle ones are among them, or many had lives before
        assert (now["episode"] > 2).any() if episodes is None else not now["living"].all()


@pytest.mark.parametrize("renewed", [False, True])
def test_a_restored_world_may_need_new_environments(toy: str, renewed: bool) -> None:
    """What an episode carries over to the next one is not in the state: only renewal goes on."""
    parsed = GymnasiumTask(id=f"{toy}Carrying-v0")
    env = made(*make_rows(parsed, renewed=renewed), None)
    now, _ = go(env, env.reset(), range(50))
    state = saved(env)
    _, expected = go(env, now, range(50, 80))
    again = made(*make_rows(parsed, renewed=renewed), None)
    again.load_world_state(state)
    assert (go(again, again.reset(), range(50, 80))[1] == expected) == renewed


def test_idle_rows_are_idle_again_and_the_next_generation_is_the_same(toy: str) -> None:
    env = env_of(f"{toy}Walk-v0", 1, seeds=(3, 4))
    now, _ = go(env, env.reset(), range(25))
    assert not now["living"].any()
    again = env_of(f"{toy}Walk-v0", 1)
    again.load_world_state(saved(env))
    assert not again.reset()["living"].any()
    ways = []
    for one in (env, again):
        one.begin(7)
        one.load_world_state(saved(one))  # a state of one that has yet to begin
        ways.append(go(one, one.reset(), range(25))[1])
    assert ways[0] == ways[1]
    assert env.episodes.seed.reshape(SHAPE)[:, 0].tolist() == [
        episode_seed(3, 7, 0),
        episode_seed(4, 7, 0),
    ]


def test_an_episode_alone_is_kept_in_the_state(toy: str) -> None:
    env = env_of(f"{toy}Walk-v0")
    for stop in (13, 20, 20 * 7 + 5):
        go(env, env.reset(), range(stop))
        taken = env.world_state()["rows"]["actions"]
        assert taken.dtype == np.float32
        assert len(taken) == env.episodes.step_count.max() < 20


def test_a_state_of_other_rows_is_refused(toy: str) -> None:
    env = env_of(f"{toy}Walk-v0")
    go(env, env.reset(), range(3))
    state = env.world_state()
    with pytest.raises(ValueError, match="one for each of 2 arenas, got 1"):
        env.load_world_state({**state, "seeds": [1]})
    short = {name: values[:4] for name, values in state["rows"].items()}
    with pytest.raises(ValueError, match="the state has 4 rows, this has 6"):
        env.load_world_state({**state, "rows": short})


def test_rows_without_end_have_episodes_of_their_own(toy: str) -> None:
    env = env_of(f"{toy}Walk-v0", seeds=(5, 8))
    now, _ = go(env, env.reset(), range(50), newborn=7)
    episode = now.get("episode")[..., 0].numpy()
    assert now["living"].all()
    assert (episode[:, 1] == 8).all()  # once in 7 steps, from step 0 on
    assert (episode[:, 2] < episode[:, 1]).all()
    for (arena, slot), number in np.ndenumerate(episode):
        expected = episode_seed((5, 8)[arena], slot, int(number))
        assert env.episodes.seed.reshape(SHAPE)[arena, slot] == expected
    assert np.unique(env.episodes.seed).size == env.episodes.seed.size


def test_a_newborn_begins_the_next_episode_before_the_end_of_this_one(toy: str) -> None:
    env = env_of(f"{toy}Walk-v0")
    now, _ = go(env, env.reset(), range(1, 5), newborn=4)
    assert now["episode"][..., 0].tolist() == [[0, 1, 0]] * 2
    assert now["step_count"][..., 0].tolist() == [[4, 0, 4]] * 2
    assert now.get("reward_vector")[:, 1].tolist() == [[0.0]] * 2
    assert env.episodes.returns.reshape(SHAPE)[:, 1].tolist() == [0.0] * 2


@pytest.mark.parametrize("masked", [True, False])
def test_after_begin_the_next_reset_is_of_all_rows(toy: str, masked: bool) -> None:
    env = env_of(f"{toy}Walk-v0", 2)
    now, _ = go(env, env.reset(), range(5))
    env.begin(1)
    with pytest.raises(RuntimeError, match="reset the environment before"):
        env.step(now.set("action", actions_of(env, 0)))
    mask = torch.zeros(*SHAPE, 1, dtype=torch.bool)
    mask[0, 0] = True
    now = env.reset(now.set("_reset", mask) if masked else None)
    assert now["step_count"].sum() == now["episode"].sum() == 0
    assert env.episodes.seed[-1] == episode_seed(1, 1, 0)


def test_purposes_have_seeds_of_their_own(toy: str) -> None:
    env = env_of(f"{toy}Walk-v0", 1, purpose=EVALUATION)
    env.reset()
    assert env.episodes.seed[0] == episode_seeds(0, 0, 1, purpose=EVALUATION)[0]
    assert env.episodes.seed[0] != episode_seed(0, 0, 0)


def test_where_no_row_lives_no_environment_is_called(toy: str) -> None:
    rows, _ = make_rows(GymnasiumTask(id=f"{toy}Walk-v0"))
    episodes = EpisodeRows(rows, "walk")
    episodes.begin(Starts.given([[3], [4]]))
    episodes.step(np.ones((2, 1)))
    episodes.go_on(np.ones(2, bool))
    episodes._rows = None  # type: ignore[assignment]
    seen, steps = episodes.observation, episodes.steps
    episodes.step(np.ones((2, 1)))
    assert episodes.observation is seen and episodes.steps is steps
    assert episodes.reward.tolist() == [0, 0]


@pytest.fixture
def dealt() -> Iterator[list[EnvRows]]:
    made: list[EnvRows] = []
    yield made
    for rows in made:
        rows.close()


def test_workers_change_nothing(toy: str, dealt: list[EnvRows]) -> None:
    ways = []
    for workers in (1, 2, 3):
        rows, interface = make_rows(GymnasiumTask(id=f"{toy}Walk-v0"), crew=Crew(workers))
        dealt.append(rows)
        assert isinstance(rows, SingleRows if workers == 1 else DealtRows)
        env = made(rows, interface, None, seeds=(5, 6))
        _, way = go(env, env.reset(), range(30), newborn=4)
        state = saved(env)
        env.load_world_state(state)
        ways.append((way, go(env, env.reset(), range(30, 50))[1]))
    assert ways[0] == ways[1] == ways[2]
    assert isinstance(
        make_rows(GymnasiumTask(id="neatq/DoublePole-v0"), crew=Crew(2))[0], VectorRows
    )


def test_a_failure_in_a_process_names_the_row(toy: str, dealt: list[EnvRows]) -> None:
    rows, interface = make_rows(GymnasiumTask(id=f"{toy}Broken-v0"), crew=Crew(2))
    dealt.append(rows)
    env = made(rows, interface, 1)
    env.begin(starts=[[2], [2], [2], [2], [9], [7]])
    with pytest.raises(EpisodeError, match=r"slot 1 of arena 1 failed in episode 0 with seed 9"):
        go(env, env.reset(), range(5))


def test_states_of_some_rows_are_that_of_all(toy: str) -> None:
    env = env_of(f"{toy}Walk-v0")
    go(env, env.reset(), range(17), newborn=4)
    whole = env.world_state()["rows"]
    parts = [rows_of(whole, own) for own in (slice(0, 1), slice(1, 2), slice(2, 6))]
    for part in parts:  # as those who have these rows alone keep them
        longest = int(np.where(part["living"], part["step_count"], 0).max())
        part["actions"] = part["actions"][len(part["actions"]) - longest :]
    assert len({len(part["actions"]) for part in parts}) > 1
    joined = side_by_side(parts)
    assert joined.keys() == whole.keys()
    for name, values in whole.items():
        np.testing.assert_array_equal(joined[name], values)
