"""Rows of any Gymnasium environment: each as if it stood alone, and idle when it is done."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.envs.classic_control.cartpole import CartPoleVectorEnv
from gymnasium.vector import AutoresetMode, VectorEnv
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

from neatq_envs.episodes import EpisodeError, episode_seeds
from neatq_envs.gymnasium_rows import SingleRows, VectorRows, make_rows
from neatq_envs.gymnasium_task import GymnasiumTask, Interface, assignments
from neatq_envs.random_play import ObservationScaling
from neatq_envs.torchrl_rows import GymnasiumRows


def rows_of(
    task: str, *env_kwargs: str, shape: tuple[int, int] = (2, 2), episodes: int | None = 1
) -> GymnasiumRows:
    parsed = GymnasiumTask(id=task, kwargs=assignments(env_kwargs))
    rows, interface = make_rows(parsed)
    scaling = as_it_is(interface)
    return GymnasiumRows(rows, interface, scaling, shape=shape, episodes=episodes)


def as_it_is(interface: Interface) -> ObservationScaling:
    return ObservationScaling(np.zeros(interface.inputs), np.ones(interface.inputs))


def act(now: TensorDictBase, action: torch.Tensor) -> TensorDictBase:
    return now.set("action", action)


@pytest.mark.parametrize("task", ["Walk-v0", "Ends-v0"])
def test_the_specs_hold(toy: str, task: str) -> None:
    check_env_specs(rows_of(toy + task))
    check_env_specs(rows_of(toy + task, episodes=None), break_when_any_done="both")


def test_seeds_are_words_of_the_hash_that_is_documented() -> None:
    expected = [np.random.SeedSequence([7, 0, 3, e]).generate_state(1)[0] for e in range(2)]
    assert episode_seeds(7, 3, 2).tolist() == expected
    assert set(episode_seeds(7, 3, 2)) & set(episode_seeds(7, 3, 2, purpose=1)) == set()


def test_every_row_is_a_single_environment_with_the_seeds_of_its_arena(toy: str) -> None:
    """Each row against an environment stepped by hand, through two episodes."""
    rng = np.random.default_rng(0)
    actions = torch.from_numpy(rng.uniform(-1, 1, (60, 2, 2, 1)).astype(np.float32))
    actions[:, 0, 1] = 1.0  # this row leaves early
    env = rows_of(f"{toy}Walk-v0", episodes=2)
    seeds = np.stack([episode_seeds(arena, 4, 2) for arena in (0, 1)])
    env.begin(4)
    alone = [[gymnasium.make(env_id(toy)) for _ in range(2)] for _ in range(2)]
    episode = np.zeros((2, 2), int)
    observation = [[e.reset(seed=int(seeds[a, 0]))[0] for e in alone[a]] for a in range(2)]
    returns = np.zeros((2, 2, 2))
    now = env.reset()
    for action in actions:
        lived, now = env.step_and_maybe_reset(act(now, action))
        for a, r in np.ndindex(2, 2):
            living = episode[a, r] < 2
            assert lived["living"][a, r].item() == living
            if not living:
                assert not lived["next", "done"][a, r].any()
                assert lived["next", "reward"][a, r] == lived["next", "reward_vector"][a, r] == 0
                continue
            assert lived["observation"][a, r].tolist() == seen_as(observation[a][r])
            seen, reward, terminated, truncated, _ = alone[a][r].step(action[a, r].numpy())
            assert lived["next", "reward_vector"][a, r].item() == reward  # in double precision
            assert lived["next", "reward"][a, r].item() == np.float32(reward)
            assert now["reward_vector"][a, r].item() == (0 if terminated or truncated else reward)
            assert lived["next", "terminated"][a, r].item() == terminated
            assert lived["next", "truncated"][a, r].item() == truncated
            returns[a, r, episode[a, r]] += reward
            if terminated or truncated:
                episode[a, r] += 1
                if episode[a, r] < 2:
                    seen, _ = alone[a][r].reset(seed=int(seeds[a, 1]))
            observation[a][r] = seen
    assert (episode == 2).all()
    assert env.episodes.returns.reshape(2, 2, 2).tolist() == returns.tolist()


def seen_as(observation: np.ndarray) -> list[float]:
    return np.clip(observation, -10, 10).astype(np.float32).tolist()


def env_id(toy: str) -> str:
    return f"{toy}Walk-v0"


def test_idle_rows_are_not_stepped_and_do_not_count(toy: str) -> None:
    env = rows_of(f"{toy}Walk-v0", shape=(1, 2))
    walk = sys.modules["toy_tasks"].Walk
    before = walk.steps
    now = env.reset()
    while now["living"].any():
        # The first row walks away to the end of its episode, the other one stands still.
        _, now = env.step_and_maybe_reset(act(now, torch.tensor([[[1.0], [0.0]]])))
    steps = env.episodes.steps
    assert steps[0] < steps[1] == 20
    assert walk.steps - before == steps.sum()
    last = now["observation"].clone()
    _, now = env.step_and_maybe_reset(act(now, torch.ones(1, 2, 1)))
    assert walk.steps - before == steps.sum()
    assert torch.equal(now["observation"], last)
    assert env.episodes.steps.tolist() == steps.tolist()


@pytest.mark.parametrize("by", ["terminated", "truncated"])
def test_an_end_for_good_and_an_end_by_time_are_told_apart(toy: str, by: str) -> None:
    env = rows_of(f"{toy}Ends-v0", "steps=2", f"by={by}", shape=(1, 1))
    now = env.reset()
    ends = []
    for _ in range(2):
        lived, now = env.step_and_maybe_reset(act(now, torch.zeros(1, 1, 1)))
        ends.append([lived["next", name].item() for name in ("done", "terminated", "truncated")])
    assert ends == [[False] * 3, [True, by == "terminated", by == "truncated"]]


def test_quick_steps_are_those_of_torchrl(toy: str) -> None:
    roots = []
    for step in (GymnasiumRows.step_and_maybe_reset, EnvBase.step_and_maybe_reset):
        env = rows_of(f"{toy}Walk-v0", episodes=2)
        now = env.reset()
        for tick in range(45):
            lived, now = step(env, act(now, torch.full((2, 2, 1), (-1.0) ** tick)))
            roots.append((lived, now))
    for quick, plain in zip(roots[:45], roots[45:], strict=True):
        for one, two in zip(quick, plain, strict=True):
            assert {k: v.tolist() for k, v in one.items(True, True)} == {
                k: v.tolist() for k, v in two.items(True, True)
            }


@pytest.mark.parametrize(
    ("how", "pattern"),
    [
        ("raise", r"ZeroDivisionError: the world ended \(toy_tasks.py:\d+\)"),
        ("nan", r"observation\[0\] is nan; expected a finite number within single precision"),
        ("reward", r"reward is inf; expected a finite number of at most 1e12"),
    ],
)
def test_a_failure_names_row_episode_seed_and_step(toy: str, how: str, pattern: str) -> None:
    env = rows_of(f"{toy}Broken-v0", f"how={how}", shape=(2, 1))
    env.begin(starts=[[2, 4], [6, 9]])
    now = env.reset()
    with pytest.raises(EpisodeError) as caught:
        for _ in range(30):
            _, now = env.step_and_maybe_reset(act(now, torch.zeros(2, 1, 1)))
    steps = 2 if how == "raise" else 3
    where = f"slot 0 of arena 1 failed in episode 1 with seed 9, after {steps} steps: "
    assert where in str(caught.value)
    assert caught.match(pattern)


def test_wrong_seeds_are_refused(toy: str) -> None:
    env = rows_of(f"{toy}Walk-v0")
    with pytest.raises(ValueError, match=r"of 4 rows, got the shape \[3, 1\]"):
        env.begin(starts=np.zeros((3, 1)))
    rows, interface = make_rows(GymnasiumTask(id=f"{toy}Walk-v0"))
    with pytest.raises(ValueError, match="one for each of 2 arenas, got 3"):
        GymnasiumRows(rows, interface, as_it_is(interface), shape=(2, 2), seeds=(1, 2, 3))


class WalkRows(VectorEnv[Any, Any, Any]):
    """The walk of toy_tasks, vectorised as this project's own tasks are."""

    def __init__(self, num_envs: int = 1, max_episode_steps: int = 20) -> None:
        self.metadata = {"autoreset_mode": AutoresetMode.DISABLED}
        self.envs = [gymnasium.make("toy/Walk-v0") for _ in range(num_envs)]
        self.num_envs = num_envs
        self.seen: Any = [None] * num_envs

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        mask = np.ones(self.num_envs, bool) if options is None else options["reset_mask"]
        for i in np.flatnonzero(mask):
            self.seen[i] = self.envs[i].reset(seed=seed[i])[0]
        return np.stack(self.seen), {}

    def step(self, actions: np.ndarray) -> Any:
        came = [env.step(action) for env, action in zip(self.envs, actions, strict=True)]
        self.seen = [one[0] for one in came]
        return (*(np.array([one[part] for one in came]) for part in range(4)), {})


@pytest.fixture
def fast_walk(toy: str) -> Iterator[str]:
    rows_of(f"{toy}Walk-v0")  # registers it
    make: Any = WalkRows
    gymnasium.register(
        "toy/FastWalk-v0", "toy_tasks:Walk", vector_entry_point=make, max_episode_steps=20
    )
    yield "toy/FastWalk-v0"
    del gymnasium.registry["toy/FastWalk-v0"]


def test_a_vectorised_environment_gives_what_single_ones_give(toy: str, fast_walk: str) -> None:
    single, interface = make_rows(GymnasiumTask(id=f"{toy}Walk-v0"))
    fast, _ = make_rows(GymnasiumTask(id=fast_walk))
    assert isinstance(single, SingleRows)
    assert isinstance(fast, VectorRows)
    ways: list[list[TensorDict]] = []
    for rows in (single, fast):
        env = GymnasiumRows(rows, interface, as_it_is(interface), shape=(2, 3), episodes=3)
        now, way = env.reset(), []
        rng = torch.Generator().manual_seed(0)
        while now["living"].any():
            action = torch.rand(2, 3, 1, generator=rng) * 2 - 1
            action[:, 0] = 1.0
            lived, now = env.step_and_maybe_reset(act(now, action))
            way.append(lived.clone())
        ways.append(way)
    for one, two in zip(*ways, strict=True):
        assert (one == two).all()
    assert len(ways[0]) == 60


def test_a_vectorised_environment_of_another_kind_is_not_used() -> None:
    rows, _ = make_rows(GymnasiumTask(id="CartPole-v1"))
    assert gymnasium.spec("CartPole-v1").vector_entry_point is not None
    assert isinstance(rows, SingleRows)


def test_a_vectorised_environment_that_was_only_tried_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    closed: list[Any] = []
    monkeypatch.setattr(CartPoleVectorEnv, "close", lambda env: closed.append(env))
    make_rows(GymnasiumTask(id="CartPole-v1"))
    assert len(closed) == 1
