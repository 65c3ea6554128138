"""Noise on actions: its distribution, and the same for a robot whoever stands beside it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_torch.learning import ActionNoise, CandidateHeads, DiscreteHeads


def run(noise: ActionNoise, ticks: int) -> torch.Tensor:
    """Noise of so many ticks [ticks, *shape, actions]."""
    return torch.stack([noise() for _ in range(ticks)])


def test_white_noise_is_nearly_normal() -> None:
    drawn = run(ActionNoise((2, 20), 3, seeds=[0, 1], scale=0.5), 1000).flatten().double()
    error = 0.5 / math.sqrt(len(drawn))
    assert abs(drawn.mean()) < 5 * error
    assert drawn.std().item() == pytest.approx(0.5, rel=0.02)
    # Twelve uniform numbers: the kurtosis is 3 - 6 / (5 * 12).
    assert ((drawn / 0.5) ** 4).mean().item() == pytest.approx(2.9, rel=0.03)


@pytest.mark.parametrize("persistence", [0.0, 0.5, 0.9])
def test_noise_lasts_as_long_as_its_persistence_says(persistence: float) -> None:
    noise = ActionNoise((1, 100), 1, seeds=[3], scale=1.0, persistence=persistence)
    run(noise, 100)  # to where it is stationary
    drawn = run(noise, 2000).squeeze(1).squeeze(-1).double().numpy()
    together = np.mean(drawn[1:] * drawn[:-1]) / np.mean(drawn**2)
    assert together == pytest.approx(persistence, abs=0.02)
    assert drawn.std() == pytest.approx(1.0, rel=0.05)


def test_robots_and_numbers_of_an_action_have_chance_of_their_own() -> None:
    drawn = run(ActionNoise((2, 2), 2, seeds=[0, 1], scale=1.0), 2000).flatten(1)
    together = np.corrcoef(drawn.numpy().T) - np.eye(8)
    assert np.abs(together).max() < 0.1


def test_an_arena_has_the_same_noise_whatever_stands_beside_it() -> None:
    both, alone = (ActionNoise((n, 5), 2, seeds=range(4 - n, 4), scale=1.0) for n in (2, 1))
    assert torch.equal(run(both, 100)[:, 1], run(alone, 100)[:, 0])


def test_a_slot_with_a_seed_of_its_own_is_the_first_of_an_arena() -> None:
    own = ActionNoise((1, 2), 1, seeds=[[7, 9]], scale=1.0)
    first = ActionNoise((1, 1), 1, seeds=[9], scale=1.0)
    assert torch.equal(run(own, 70)[:, 0, 1], run(first, 70)[:, 0, 0])


def test_newborns_begin_without_the_noise_of_those_before() -> None:
    noise = ActionNoise((1, 2), 1, seeds=[0], scale=1.0, persistence=0.99)
    run(noise, 200)
    noise.reset(torch.tensor([[True, False]]))
    assert noise.value[0, 0] == 0
    assert noise.value[0, 1] != 0


def test_a_state_goes_on_exactly() -> None:
    first, second = (
        ActionNoise((1, 3), 2, seeds=[5], scale=0.2, persistence=0.8) for _ in range(2)
    )
    run(first, 100)
    second.load_state_dict(first.state_dict())
    assert torch.equal(run(first, 100), run(second, 100))


def test_deterministic_exploration_has_none_and_draws_nothing() -> None:
    noise = ActionNoise((1, 3), 2, seeds=[5], scale=0.2)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert not noise().any()
    assert noise.tick == 0


@pytest.mark.parametrize(("scale", "persistence"), [(-0.1, 0.0), (0.1, 1.0), (0.1, -0.1)])
def test_what_is_no_noise_is_refused(scale: float, persistence: float) -> None:
    with pytest.raises(ValueError, match="expected a scale of at least 0 and a persistence in"):
        ActionNoise((1, 1), 1, seeds=[0], scale=scale, persistence=persistence)


def test_noise_is_in_halves_of_the_span_and_stays_within_the_bounds() -> None:
    heads = CandidateHeads(1, low=[-1.0, 0.0], high=[3.0, 1.0])
    action, noise = torch.tensor([[0.0, 0.5], [2.9, 0.1]]), torch.tensor([[0.5, -0.2], [0.5, -0.4]])
    expected = torch.tensor([[1.0, 0.4], [3.0, 0.0]])
    torch.testing.assert_close(heads.moved(action, noise), expected)


def test_a_few_choices_have_no_noise() -> None:
    action = torch.tensor([[1.0]])
    assert DiscreteHeads(3).moved(action, torch.tensor([[0.7]])) is action
