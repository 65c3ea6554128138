"""How far mutation may move a weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_torch.genome import (
    ACTIVATIONS,
    Genome,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    initial_genome,
    mutate,
    mutate_weights,
)
from neatq_torch.network import (
    Evaluation,
    GenomeNetwork,
    perturbation_scales,
    sensitivity,
)


def linear(weight: float, enabled: Sequence[bool] = (True, True, True, True)) -> Genome:
    """Inputs 0 and 1, identity outputs 2 and 3; links 0-2, 1-2, 0-3 and 1-3."""
    return Genome(
        genome_id=1,
        node_id=np.arange(4, dtype=np.int32),
        node_kind=np.array([NodeKind.INPUT] * 2 + [NodeKind.OUTPUT] * 2, np.uint8),
        node_activation=np.full(4, ACTIVATIONS.index("identity"), np.uint8),
        link_innovation=np.arange(1, 5),
        link_source=np.array([0, 1, 0, 1]),
        link_target=np.array([2, 2, 3, 3]),
        link_weight=np.full(4, weight, np.float32),
        link_enabled=np.array(enabled),
        link_recurrent=np.zeros(4, bool),
    )


def test_a_linear_link_is_as_sensitive_as_its_input_is_large_on_average() -> None:
    seen = torch.tensor([[1.0, 4.0], [3.0, -8.0]])
    assert sensitivity(linear(0.5), seen).tolist() == [2.0, 2.0, 2.0, 2.0]
    assert sensitivity(linear(0.5), seen[:1]).tolist() == [1.0, 4.0, 1.0, 4.0]


def test_scales_are_inverse_to_sensitivity_with_a_mean_of_one() -> None:
    # Sensitivities 1, 4, 1, 4, median 2.5: inverses 2.5, 0.625 with the mean 1.5625.
    scales = perturbation_scales(linear(0.5), torch.tensor([[1.0, 4.0]]))
    assert scales.tolist() == pytest.approx([1.6, 0.4, 1.6, 0.4])


def test_scales_are_clipped_and_what_nothing_is_known_of_keeps_its_own() -> None:
    off = linear(0.5, [True, True, False, True])
    # Sensitivities 1e-6, 1, -, 1: inverses 10 (not 1e6), 1, 1 with the mean 4.
    scales = perturbation_scales(off, torch.tensor([[1e-6, 1.0]]))
    assert scales.tolist() == pytest.approx([2.5, 0.25, 1.0, 0.25])
    assert perturbation_scales(off, torch.zeros(3, 2)).tolist() == [1.0] * 4


@pytest.mark.parametrize("evaluation", ["settle", "synchronous"])
@given(st.integers(0, 1000))
@settings(max_examples=15)
def test_sensitivity_is_what_central_differences_give(evaluation: Evaluation, seed: int) -> None:
    rng, growth = np.random.default_rng(seed), MutationConfig(add_node_prob=0.4, add_link_prob=0.6)
    genome = initial_genome(2, 3, rng=rng)
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(6):
        genome = mutate(genome, growth, ledger, rng)
    seen = torch.rand(5, 2, generator=torch.Generator().manual_seed(seed))

    def outputs(weights: np.ndarray) -> np.ndarray:
        network = GenomeNetwork(genome.with_weights(weights), evaluation=evaluation).double()
        state = network.initial_state((5,))
        output, state = network.step(seen.double(), state)
        for _ in range(3 if network.state_size else 0):
            output, state = network.step(seen.double(), state)
        return output.detach().numpy().mean(0)

    expected, nudge = [], np.float32(2**-7)
    for link in range(genome.link_weight.size):
        step = np.where(np.arange(genome.link_weight.size) == link, nudge, np.float32(0))
        slope = outputs(genome.link_weight + step) - outputs(genome.link_weight - step)
        expected.append(np.linalg.norm(slope / (2 * nudge)))
    found = sensitivity(genome, seen, evaluation=evaluation)
    assert found == pytest.approx(expected, rel=5e-3, abs=1e-4)


@pytest.mark.parametrize(("replaced", "scale"), [(0.0, [2.0, 0.5, 1.0, 0.0]), (1.0, [1.0] * 4)])
def test_perturbed_weights_are_scaled_and_new_ones_are_not(
    replaced: float, scale: list[float]
) -> None:
    config = MutationConfig(weight_scheme="uniform", weight_replace_prob=replaced)
    genome, rng, same = linear(0.0), np.random.default_rng(4), np.random.default_rng(4)
    plain = mutate_weights(genome, config, rng)
    safe = mutate_weights(genome, config, same, lambda _: np.array([2.0, 0.5, 1.0, 0.0]))
    assert rng.bit_generator.state == same.bit_generator.state
    assert safe.link_weight == pytest.approx(plain.link_weight * scale, abs=1e-7)
