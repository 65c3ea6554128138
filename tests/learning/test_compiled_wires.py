"""The compiled form of wire fitting against the torch operations that say what it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, cast

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from neatq_torch.genome import InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.learning import (
    CandidateHeads,
    CandidateValue,
    LearnerParts,
    ReplayConfig,
    ReplayLearner,
    TDConfig,
    TDLearner,
    WireFittingLoss,
    compiled_wires,
    learner_kinds,
)
from neatq_torch.network import PopulationNetwork

REPLAY = ReplayConfig(
    learning_rate=0.01,
    discount=0.9,
    updates=6,
    newborn_updates=5,
    size=150,
    keep_every=1,
    horizon=4,
)
NEWBORN = torch.tensor([[False, True, False], [True, False, True]])


def evolved_network(heads: CandidateHeads, seed: int = 3) -> PopulationNetwork:
    """Two arenas of networks with hidden nodes and loops."""
    mutation = MutationConfig(add_node_prob=0.3, add_link_prob=0.4, recurrent_link_prob=0.2)
    rng, genomes = np.random.default_rng(seed), []
    for number in range(6):
        one = initial_genome(2, heads.outputs, rng=rng, genome_id=number)
        ledger = InnovationLedger.for_genomes([one])
        for _ in range(2 * number):
            one = mutate(one, mutation, ledger, rng)
        genomes.append(one)
    return PopulationNetwork(genomes, shape=(2, 3))


def evolved_learner(config: ReplayConfig) -> ReplayLearner:
    """An action that has no room, and two that have."""
    heads = CandidateHeads(3, [0.0, -2.0, 1.0], [1.0, 2.0, 1.0], value_range=(-1.0, 2.0))
    network = evolved_network(heads)
    assert network.state_size
    learner = learner_kinds.maker_of(config)(config, LearnerParts(network, heads, (2, 3), range(2)))
    assert isinstance(learner, ReplayLearner)
    return learner


def any_batch(seed: int) -> TensorDict:
    draw, shape = torch.Generator().manual_seed(seed), (2, 3, 40)
    following = {
        "observation": torch.rand(*shape, 2, generator=draw),
        "reward": torch.rand(*shape, 1, generator=draw),
        "done": torch.zeros(*shape, 1, dtype=torch.bool),
        "terminated": torch.rand(*shape, 1, generator=draw) < 0.2,
    }
    low, span = torch.tensor([0.0, -2.0, 1.0]), torch.tensor([1.0, 4.0, 0.0])
    now = {
        "observation": torch.rand(*shape, 2, generator=draw),
        "action": low + span * torch.rand(*shape, 3, generator=draw),
        "genome_id": torch.ones(*shape, 1, dtype=torch.long),
        "next": following,
    }
    return TensorDict(now, shape)


@pytest.mark.parametrize(
    ("optimizer", "tau", "normalize"),
    [
        ("sgd", None, True),
        ("sgd", 0.3, True),
        ("sgd", None, False),
        ("adam", 0.3, True),
        ("adam", 0.01, False),
        ("adam", None, True),
    ],
)
def test_compiled_code_learns_what_torch_learns(
    optimizer: Literal["sgd", "adam"],
    tau: float | None,
    normalize: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rate = 0.01 if optimizer == "adam" else 0.09
    config = replace(
        REPLAY,
        learning_rate=rate,
        optimizer=optimizer,
        target_tau=tau,
        normalize_return=normalize,
    )
    fast, slow = (evolved_learner(config) for _ in range(2))
    errors = []
    for learner in (fast, slow):
        assert compiled_wires.can_teach(learner.learner)
        with monkeypatch.context() as patch:
            if learner is slow:
                patch.setattr(compiled_wires, "can_teach", lambda _: False)
            learner.reset(torch.ones(2, 3, dtype=torch.bool))  # nobody is taught yet
            learner.update(any_batch(0))
            learner.reset(NEWBORN)
            errors.append(learner.update(any_batch(1)))
    before = evolved_learner(config).learner.network.weight
    moved = (slow.learner.network.weight - before).abs()
    assert moved.max() > 0.05
    torch.testing.assert_close(errors[0], errors[1], rtol=2e-4, atol=1e-6)
    for name, value in slow.learner.state_dict().items():
        torch.testing.assert_close(fast.learner.state_dict()[name], value, rtol=2e-3, atol=2e-5)
    torch.testing.assert_close(
        fast.learner.network.weight, slow.learner.network.weight, rtol=2e-3, atol=2e-5
    )


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    k=st.integers(2, 5),
    actions=st.integers(1, 3),
    smoothing=st.sampled_from([0.0, 0.1, 1.0]),
    epsilon=st.sampled_from([1e-4, 1e-2]),
    normalize=st.booleans(),
)
def test_one_gradient_and_its_errors_are_those_of_the_loss(
    seed: int, k: int, actions: int, smoothing: float, epsilon: float, normalize: bool
) -> None:
    """With plain steps the change of the weights is the gradient of `WireFittingLoss`."""
    rng = torch.Generator().manual_seed(seed)
    low = torch.rand(actions, generator=rng) - 1
    heads = CandidateHeads(k, low.tolist(), (low + 0.5).tolist(), value_range=(-1.0, 2.0))
    network = evolved_network(heads, seed)
    value = CandidateValue(network, heads, propose=True)
    loss = WireFittingLoss(value, smoothing=smoothing, epsilon=epsilon, normalize_return=normalize)
    loss.make_value_estimator(gamma=0.9)
    learner = TDLearner(network, loss, TDConfig(learning_rate=9.0))  # 1 in units of Q
    rows = cast(TensorDict, TensorDict.stack([random_transitions(rng, low) for _ in range(2)]))
    every = rows.unsqueeze(1).expand(2, 3, 20).clone()
    if network.state_size:
        none = network.initial_state((20,))
        every["network_state"] = every["next", "network_state"] = none
    loss(every)["loss"].backward()
    assert network.weight.grad is not None
    before = network.weight.detach().clone()
    error = compiled_wires.learn(compiled_wires.pupils_of(learner), learner, rows, 1)
    found, wanted = before - network.weight.detach(), network.weight.grad
    torch.testing.assert_close(found, wanted, rtol=5e-3, atol=1e-3 * float(wanted.abs().max()))
    squares = every["td_error"].squeeze(-1).square().mean(-1).flatten().detach()
    torch.testing.assert_close(torch.from_numpy(error), squares, rtol=2e-3, atol=1e-5)


def random_transitions(rng: torch.Generator, low: torch.Tensor) -> TensorDict:
    following = {
        "observation": torch.rand(20, 2, generator=rng),
        "reward": torch.rand(20, 1, generator=rng),
        "terminated": torch.rand(20, 1, generator=rng) < 0.2,
        "done": torch.ones(20, 1, dtype=torch.bool),
    }
    now = {
        "observation": torch.rand(20, 2, generator=rng),
        "action": low + 0.5 * torch.rand(20, len(low), generator=rng),
        "steps_to_next_obs": torch.ones(20, 1, dtype=torch.long),
        "next": following,
    }
    return TensorDict(now, [20])
