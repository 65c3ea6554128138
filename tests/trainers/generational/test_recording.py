"""What a life leaves to the next generation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDict

from neatq_trainers.generational.recording import Recorder, Transitions, merged


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def recorded(lengths: Sequence[int], size: int, seeds: Sequence[int]) -> list[Transitions]:
    """Of lives of so many steps; the step is the reward, a hundred times the life the action."""
    recorder = Recorder(size, [rng(seed) for seed in seeds])
    living = torch.tensor(lengths).view(-1, 1, 1)
    for step in range(max(lengths)):
        rows = torch.arange(len(lengths)).view(-1, 1, 1).float()
        following = {
            "observation": rows.expand(-1, 1, 2) + 0.5,
            "reward": torch.full_like(rows, step),
            "terminated": step == living - 1,
        }
        now = {"observation": rows.expand(-1, 1, 2), "action": 100 * rows, "living": living > step}
        recorder.add(TensorDict(now | {"next": following}, rows.shape[:2]))
    return recorder.transitions()


def rewards(life: Transitions) -> list[float]:
    return life["next_reward"][:, 0].tolist()


def test_a_short_life_leaves_all_its_transitions_in_their_order() -> None:
    one, two = recorded([3, 5], 5, [0, 1])
    assert rewards(one) == [0, 1, 2]
    assert rewards(two) == [0, 1, 2, 3, 4]
    assert two["action"].tolist() == [[100]] * 5
    assert two["observation"].tolist() == [[1, 1]] * 5
    assert two["next_observation"].tolist() == [[1.5, 1.5]] * 5
    assert two["next_terminated"][:, 0].tolist() == [False] * 4 + [True]


def test_a_long_life_leaves_a_fair_sample() -> None:
    """Each of 600 steps is among 60 of a life with the chance 0.1: of 400 lives in 40 +- 6."""
    lives = recorded([600] * 400, 60, range(400))
    assert {len(set(rewards(life))) for life in lives} == {60}
    kept = np.bincount([int(step) for life in lives for step in rewards(life)], minlength=600)
    assert kept.mean() == 40
    assert 4.5 < kept.std() < 7.5
    for part in np.split(kept, 6):
        assert abs(part.mean() - 40) < 2.5


def test_what_a_life_leaves_does_not_depend_on_those_beside_it() -> None:
    beside = recorded([500, 700, 20], 30, [4, 5, 6])
    for life, (length, seed) in enumerate([(500, 4), (700, 5), (20, 6)]):
        assert rewards(recorded([length], 30, [seed])[0]) == rewards(beside[life])


def test_lives_are_put_together_one_after_the_other() -> None:
    both = merged(recorded([2, 3], 5, [0, 1]))
    assert rewards(both) == [0, 1, 0, 1, 2]
    assert both["action"][:, 0].tolist() == [0, 0, 100, 100, 100]
