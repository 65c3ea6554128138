"""Running normalisation: the mean and the deviation of all that came, however it came."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.learning import RunningNormalization


def seen(seed: int, arenas: int = 2, slots: int = 3, ticks: int = 12) -> tuple[torch.Tensor, ...]:
    rng = torch.Generator().manual_seed(seed)
    observation = 5 + 3 * torch.randn(arenas, slots, ticks, 4, generator=rng)
    return observation, torch.rand(arenas, slots, ticks, generator=rng) < 0.7


def test_mean_and_deviation_are_those_of_what_counts() -> None:
    observation, counts = seen(0)
    own = RunningNormalization(2, 4)
    own.add(observation, counts)
    for arena in range(2):
        rows = observation[arena][counts[arena]].double().numpy()
        np.testing.assert_allclose(own.mean[arena], rows.mean(0))
        np.testing.assert_allclose(own.deviation[arena], rows.std(0))


@given(cut=st.integers(0, 12), seed=st.integers(0, 50))
def test_how_it_is_cut_into_batches_is_no_matter(cut: int, seed: int) -> None:
    observation, counts = seen(seed)
    whole, parts = RunningNormalization(2, 4), RunningNormalization(2, 4)
    whole.add(observation, counts)
    for part in (slice(cut), slice(cut, None)):
        parts.add(observation[:, :, part], counts[:, :, part])
    torch.testing.assert_close(parts.mean, whole.mean)
    torch.testing.assert_close(parts.deviation, whole.deviation)


def test_what_comes_out_has_mean_zero_and_deviation_one() -> None:
    observation, counts = seen(0)
    own = RunningNormalization(2, 4)
    own.add(observation, torch.ones_like(counts))
    normal = own(observation)
    assert normal.dtype == observation.dtype
    torch.testing.assert_close(normal.mean((1, 2)), torch.zeros(2, 4), atol=1e-6, rtol=0)
    torch.testing.assert_close(normal.flatten(1, 2).std(1, correction=0), torch.ones(2, 4))
    assert torch.equal(own(observation[1], 1), normal[1])


def test_an_arena_does_not_depend_on_those_beside() -> None:
    observation, counts = seen(0)
    both, alone = RunningNormalization(2, 4), RunningNormalization(1, 4)
    both.add(observation, counts)
    alone.add(observation[1:], counts[1:])
    assert torch.equal(both(observation)[1:], alone(observation[1:]))


def test_before_anything_came_nothing_is_changed() -> None:
    observation, counts = seen(0)
    own = RunningNormalization(2, 4)
    assert torch.equal(own(observation), observation)
    own.add(observation, torch.zeros_like(counts))
    assert torch.equal(own(observation), observation)


@pytest.mark.parametrize(("least", "stretched"), [(0.1, 10.0), (0.01, 100.0)])
def test_what_hardly_ever_changes_is_not_stretched_without_end(
    least: float, stretched: float
) -> None:
    own = RunningNormalization(1, 1, least=least)
    own.add(torch.zeros(1, 1, 10, 1), torch.ones(1, 1, 10, dtype=torch.bool))
    assert own(torch.ones(1, 1, 1)).item() == pytest.approx(stretched)


def test_a_state_goes_on_exactly() -> None:
    observation, counts = seen(0)
    first, second = RunningNormalization(2, 4), RunningNormalization(2, 4)
    first.add(observation, counts)
    second.load_state_dict({name: one.numpy() for name, one in first.state_dict().items()})
    for one in (first, second):
        one.add(*seen(1))
    assert torch.equal(first(observation), second(observation))
