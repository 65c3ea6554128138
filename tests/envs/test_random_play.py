"""What random play shows, and what a process of its own says when it ends."""

from __future__ import annotations

import os

import numpy as np
import pytest

from neatq_envs.episodes import RANDOM_PLAY, episode_seeds
from neatq_envs.gymnasium_rows import make_rows
from neatq_envs.gymnasium_task import GymnasiumTask, TaskError, assignments
from neatq_envs.processes import Remote
from neatq_envs.random_play import EnvFacts, Play, look_around, play_at_random, value_range


def task(name: str, *kwargs: str) -> GymnasiumTask:
    return GymnasiumTask(id=name, kwargs=assignments(kwargs))


@pytest.mark.parametrize(
    ("name", "renewed", "repeatable"),
    [("Walk-v0", False, True), ("Carrying-v0", True, True), ("Dicing-v0", True, False)],
)
def test_what_seeds_do_not_settle_is_found(
    toy: str, name: str, renewed: bool, repeatable: bool
) -> None:
    facts = look_around(task(toy + name), 0.9)
    assert (facts.renewed, facts.repeatable) == (renewed, repeatable)
    again = EnvFacts.from_dict(facts.to_dict())
    assert again.to_dict() == facts.to_dict()
    # Bounds of the first entry are -2 and 2; the second is standardised.
    assert facts.scaling.offset[0] == 0 and 0.4 <= facts.scaling.scale[0] <= 2


def test_q_values_of_random_play_have_a_range_by_hand(toy: str) -> None:
    """Reward 1 for three steps, discount 0.5: returns 1.75, 1.5 and 1; the margin is a tenth."""
    found = look_around(task(f"{toy}Ends-v0", "steps=3", "max_episode_steps=3"), 0.5).value_range
    assert found == pytest.approx((1 - 0.075, 1.75 + 0.075))


def test_rewards_that_are_always_the_same_have_a_range() -> None:
    nothing = np.zeros((2, 1))
    seen = Play(nothing[..., None], nothing, np.array([2]), np.array([True]))
    assert value_range(seen, 0.9, 2) == (-1, 1)


def test_the_usual_reward_in_every_step_widens_the_range() -> None:
    # 1 in the first of two steps; if it came in all of four: 1 + 1/2 + 1/4 + 1/8.
    rewards = np.array([[1.0, 1.0], [1.0, 1.0]])
    seen = Play(rewards[..., None], rewards, np.array([2, 1]), np.array([True, True]))
    assert value_range(seen, 0.5, 4) == pytest.approx((1 - 0.0875, 1.875 + 0.0875))


def test_rare_rewards_do_not_widen_the_range() -> None:
    # -10 to 10 once each: the 5th and the 95th percentile are -9 and 9; 1 + 1/2 + 1/4 + 1/8.
    rewards = np.arange(-10.0, 11.0)[None]
    seen = Play(rewards[..., None], rewards, np.ones(21, int), np.ones(21, bool))
    assert value_range(seen, 0.5, 4) == pytest.approx((-1.2 * 9 * 1.875, 1.2 * 9 * 1.875))


def test_random_play_has_seeds_of_its_own_and_ends(toy: str) -> None:
    rows, interface = make_rows(task(f"{toy}Walk-v0"))
    seen = play_at_random(task(f"{toy}Walk-v0"), rows, interface, 5000)
    assert seen.lengths.max() == len(seen.rewards) <= 20
    assert seen.ended.all()
    seeds = episode_seeds(0, 0, 20, purpose=RANDOM_PLAY)
    first = [np.random.default_rng(int(seed)).uniform(-1, 1) for seed in seeds]
    assert seen.observations[0, :, 0].tolist() == first


def test_episodes_without_end_are_refused(toy: str) -> None:
    with pytest.raises(TaskError, match=r"did not end in 5000 steps.*max_episode_steps=1000"):
        look_around(task("toy_tasks:toy/Endless-v0"), 0.9)


def test_a_process_that_ends_says_how() -> None:
    remote = Remote(float, 3)
    remote.ask("is_integer")
    assert remote.answer() is True
    remote.ask("nothing")
    with pytest.raises(AttributeError, match="nothing"):
        remote.answer()
    remote.close()
    gone = Remote(os._exit, 7)
    with pytest.raises(RuntimeError, match="ended with exit code 7"):
        gone.answer()
    gone.close()
