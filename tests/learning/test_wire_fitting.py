"""Wire fitting: what the interpolation promises, its gradients, and what its loss moves."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict

from neatq_torch.genome import Genome, initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    DiscreteHeads,
    TDConfig,
    TDLearner,
    WireFittingLoss,
)
from neatq_torch.learning.wire_fitting import wire_fit
from neatq_torch.network import PopulationNetwork

C, EPSILON = 0.3, 1e-3
SEEDS = st.integers(0, 10**6)


def wires(seed: int, k: int = 4, actions: int = 2) -> tuple[torch.Tensor, ...]:
    """An action, candidates and values in float64."""
    rng = torch.Generator().manual_seed(seed)

    def rand(*size: int) -> torch.Tensor:
        return torch.rand(*size, generator=rng, dtype=torch.float64)

    return rand(actions), rand(k, actions), rand(k)


def test_a_value_between_two_wires_by_hand() -> None:
    action, candidates = torch.tensor([0.5]), torch.tensor([[0.0], [1.0]])
    value = wire_fit(action, candidates, torch.tensor([1.0, 0.5]), 0.5, 0.0)
    # D = 0.25 and 0.25 + 0.5 * 0.5: the weights are 4 and 2.
    assert value.item() == pytest.approx((4 * 1 + 2 * 0.5) / 6)


@given(seed=SEEDS, k=st.integers(1, 6), power=st.integers(-12, -2))
def test_the_best_candidate_is_worth_its_value_as_epsilon_goes_to_zero(
    seed: int, k: int, power: int
) -> None:
    _, candidates, values = wires(seed, k)
    epsilon = 10.0**power
    found = wire_fit(candidates[values.argmax()], candidates, values, C, epsilon).item()
    assert found == pytest.approx(values.max().item(), abs=epsilon * (k - 1) / C + 1e-15)


@given(seed=SEEDS, k=st.integers(1, 6), actions=st.integers(1, 3), single=st.booleans())
def test_no_action_exceeds_the_best_value_or_falls_below_the_worst(
    seed: int, k: int, actions: int, single: bool
) -> None:
    dtype = torch.float32 if single else torch.float64
    action, candidates, values = (each.to(dtype) for each in wires(seed, k, actions))
    for where in (action, *candidates, action * 100):
        found = wire_fit(where, candidates, values, C, EPSILON)
        assert values.min() - 1e-5 <= found <= values.max()


@given(seed=SEEDS)
def test_gradients_are_those_of_finite_differences(seed: int) -> None:
    inputs = [each.requires_grad_() for each in wires(seed)]

    def fit(action: torch.Tensor, u: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
        return wire_fit(action, u, q, C, EPSILON)

    assert torch.autograd.gradcheck(fit, inputs, atol=1e-4)


@given(seed=SEEDS)
def test_gradients_are_those_derived_by_hand(seed: int) -> None:
    action, candidates, values = wires(seed)
    candidates.requires_grad_()
    values.requires_grad_()
    q = wire_fit(action, candidates, values, C, EPSILON)
    found = torch.autograd.grad(q, (candidates, values))
    with torch.no_grad():
        apart = candidates - action
        distance = apart.square().sum(-1) + C * (values.max() - values) + EPSILON
        pull = (values - q) / distance**2 / (1 / distance).sum()  # -dQ/dD
        by_value = 1 / distance / (1 / distance).sum() + C * pull
        by_value[values.argmax()] -= C * pull.sum()  # q_max stands in every distance
    torch.testing.assert_close(found[0], -2 * apart * pull.unsqueeze(-1))
    torch.testing.assert_close(found[1], by_value)
    assert found[1].sum().item() == pytest.approx(1.0)


def test_the_gradient_of_the_best_value_is_not_multiplied() -> None:
    """Ten wires far apart: with q_max held constant the gradient would be about 9."""
    candidates = torch.arange(10.0, dtype=torch.float64).unsqueeze(-1)
    values = torch.zeros(10, dtype=torch.float64)
    values[0] = 1e6
    values.requires_grad_()
    q = wire_fit(candidates[0], candidates, values, C, 1e-6)
    (gradient,) = torch.autograd.grad(q, values)
    assert gradient[0].item() == pytest.approx(1.0, abs=1e-4)
    held = 1.0 + sum(C * 1e6 / (i**2 + C * 1e6) for i in range(1, 10))
    assert held == pytest.approx(10.0, abs=0.01)


INPUTS, K = 3, 3


def population(
    heads: CandidateHeads, robots: int = 1, activation: str = "sigmoid"
) -> PopulationNetwork:
    rng = np.random.default_rng(4)
    genomes = [
        initial_genome(INPUTS, heads.outputs, rng=rng, genome_id=i + 1, activation=activation)
        for i in range(robots)
    ]
    return PopulationNetwork(genomes, shape=(1, robots))


def batch_of(network: PopulationNetwork, ticks: int = 5, actions: int = 1) -> TensorDict:
    rng = torch.Generator().manual_seed(0)
    shape = (*network.shape, ticks)
    never = torch.zeros(*shape, 1, dtype=torch.bool)
    return TensorDict(
        {
            "observation": torch.rand(*shape, INPUTS, generator=rng),
            "action": torch.rand(*shape, actions, generator=rng),
            "genome_id": network.genome_id[..., None, None].expand(*shape, 1).clone(),
            "next": {
                "observation": torch.rand(*shape, INPUTS, generator=rng),
                "reward": torch.rand(*shape, 1, generator=rng),
                "done": never,
                "terminated": never.clone(),
            },
        },
        shape,
    )


def loss_over(
    network: PopulationNetwork, heads: CandidateHeads, gamma: float = 0.9
) -> WireFittingLoss:
    loss = WireFittingLoss(CandidateValue(network, heads, propose=True), reduction="none")
    loss.make_value_estimator(gamma=gamma)
    return loss


def test_the_error_is_that_of_the_fitted_value_against_the_best_next_candidate() -> None:
    heads = CandidateHeads(K, [0.0], [1.0])
    network = population(heads, robots=2)
    batch = batch_of(network)
    found = loss_over(network, heads)(batch)["loss"]
    candidates, values = heads(network(batch["observation"]))
    following = heads.values(network(batch["next", "observation"])).amax(-1)
    value = wire_fit(batch["action"], candidates, values, 0.1, 1e-4)
    error = batch["next", "reward"].squeeze(-1) + 0.9 * following - value
    torch.testing.assert_close(found, 0.5 * error.square())
    torch.testing.assert_close(batch["td_error"].squeeze(-1), error.abs())


def test_smoothing_and_epsilon_are_those_that_were_asked_for() -> None:
    heads = CandidateHeads(K, [0.0], [1.0], value_range=(0.0, 4.0))
    network = population(heads)
    batch = batch_of(network)
    value = CandidateValue(network, heads, propose=True)
    loss = WireFittingLoss(value, smoothing=0.8, epsilon=0.05)
    loss.make_value_estimator(gamma=0.0)
    loss(batch)
    candidates, values = heads(network(batch["observation"]))
    fitted = wire_fit(batch["action"], candidates, values, 0.2, 0.05)
    error = batch["next", "reward"].squeeze(-1) - fitted
    torch.testing.assert_close(batch["td_error"].squeeze(-1), error.abs())


def test_actions_and_values_are_measured_in_spans() -> None:
    near = CandidateHeads(K, [0.0, 0.0], [1.0, 1.0])
    far = CandidateHeads(K, [-5.0, 0.0], [5.0, 100.0], value_range=(-50.0, 150.0))
    network = population(near)
    batch = batch_of(network, actions=2)
    wide = batch.clone()
    wide["action"] = torch.tensor([-5.0, 0.0]) + batch["action"] * torch.tensor([10.0, 100.0])
    wide["next", "reward"] = batch["next", "reward"] * 200 - 50
    found = [loss_over(network, near, 0.0)(batch)["loss"]]
    found.append(loss_over(network, far, 0.0)(wide)["loss"] / 200**2)
    torch.testing.assert_close(found[0], found[1])


def test_an_action_without_a_choice_is_no_distance_away() -> None:
    free, bound = CandidateHeads(K, [0.0], [1.0]), CandidateHeads(K, [0.0, 2.0], [1.0, 2.0])
    genome = population(bound).genome(0)
    network = PopulationNetwork([genome], shape=(1, 1))
    batch = batch_of(network)
    output = network(batch["observation"])
    candidates, values = bound(output)
    batch["action"] = torch.cat([batch["action"], torch.full((1, 1, 5, 1), 2.0)], -1)
    loss_over(network, bound, 0.0)(batch)
    assert free.actions == 1
    value = wire_fit(batch["action"][..., :1], candidates[..., :1], values, 0.1, 1e-4)
    error = batch["next", "reward"].squeeze(-1) - value
    torch.testing.assert_close(batch["td_error"].squeeze(-1), error.abs())


def gradient_by_output(network: PopulationNetwork, heads: CandidateHeads) -> dict[int, float]:
    """Sum of the absolute gradients of the links into each output."""
    loss = loss_over(network, heads)
    network.weight.grad = None
    loss(batch_of(network))["loss"].sum().backward()
    assert network.weight.grad is not None
    copy = PopulationNetwork([network.genome(0)], shape=(1, 1))
    copy.load_weights(network.weight.grad)
    genome: Genome = copy.genome(0)
    return {
        number: float(np.abs(genome.link_weight[genome.link_target == node]).sum())
        for number, node in enumerate(genome.output_ids)
    }


def test_every_candidate_and_every_value_gets_a_gradient() -> None:
    heads = CandidateHeads(K, [-2.0], [2.0])
    found = gradient_by_output(population(heads), heads)
    assert all(found[output] > 1e-6 for output in range(heads.outputs))


def test_candidates_clipped_at_the_bounds_get_none() -> None:
    heads = CandidateHeads(2, [0.0], [1.0])
    network = population(heads, activation="identity")
    genome = network.genome(0)
    weights = np.repeat([9.0, 0.1, 0.2, 0.3], INPUTS + 1)  # links are in the order of the outputs
    network = PopulationNetwork([genome.with_weights(weights)], shape=(1, 1))
    found = gradient_by_output(network, heads)
    assert found[0] == 0.0
    assert found[1] > 0.0


def test_candidates_move_to_the_best_action() -> None:
    """The reward of action a is 1 - 1.5 (a - 0.8)^2; actions are drawn at random, off the wires."""
    heads = CandidateHeads(K, [0.0], [1.0])
    network = population(heads, robots=4)
    loss = WireFittingLoss(CandidateValue(network, heads, propose=True))
    loss.make_value_estimator(gamma=0.0)
    learner = TDLearner(network, loss, TDConfig(learning_rate=0.03, optimizer="adam"))
    before = heads(network(batch_of(network, ticks=50)["observation"]))[0]
    assert (before - 0.8).abs().mean() > 0.2
    rng = torch.Generator().manual_seed(0)
    batch = batch_of(network, ticks=50)
    for _ in range(300):
        batch["action"] = torch.rand(1, 4, 50, 1, generator=rng)
        batch["next", "reward"] = 1 - 1.5 * (batch["action"] - 0.8).square()
        learner.update(batch)
    candidates, values = heads(network(batch["observation"]))
    best = candidates.squeeze(-1).gather(-1, values.argmax(-1, keepdim=True))
    assert (best - 0.8).abs().mean() < 0.1
    assert (values.amax(-1) - 1).abs().mean() < 0.1


def test_at_the_best_candidate_it_is_the_plain_td_step() -> None:
    heads = CandidateHeads(K, [0.0], [1.0])
    network = population(heads)
    batch = batch_of(network)
    candidates, values = heads(network(batch["observation"]))
    batch["candidate_index"] = values.argmax(-1)
    batch["action"] = candidates.squeeze(-1).gather(-1, values.argmax(-1, keepdim=True)).detach()
    gradients = []
    plain = CandidateTDLoss(CandidateValue(network, heads))
    wire = WireFittingLoss(CandidateValue(network, heads, propose=True), epsilon=1e-6)
    for loss in (plain, wire):
        loss.make_value_estimator(gamma=0.9)
        network.weight.grad = None
        loss(batch)["loss"].backward()
        gradients.append(network.weight.grad)
    torch.testing.assert_close(gradients[0], gradients[1], atol=1e-3, rtol=1e-2)


@pytest.mark.parametrize("propose", [True, False])
def test_value_networks_without_candidate_actions_are_refused(propose: bool) -> None:
    heads = CandidateHeads(K, [0.0], [1.0])
    network = population(heads)
    value = CandidateValue(network, heads)
    if propose:
        value = CandidateValue(network, DiscreteHeads(heads.outputs), propose=True)
    with pytest.raises(ValueError, match="proposes candidates"):
        WireFittingLoss(value)
