"""What robots learn from each other's past, and what newborns know before they act."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.genome import InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.learning import (
    Bootstrap,
    CandidateHeads,
    CandidateValue,
    LearnerConfig,
    ReplayConfig,
    ReplayLearner,
    TDLearner,
    WireFittingLoss,
    compiled_wires,
)
from neatq_torch.network import PopulationNetwork

HEADS = CandidateHeads(3, [0.0], [1.0])
STEP = LearnerConfig(learning_rate=0.05, optimizer="adam")


def loss_of(network: PopulationNetwork) -> WireFittingLoss:
    loss = WireFittingLoss(CandidateValue(network, HEADS, propose=True))
    loss.make_value_estimator(gamma=0.0)
    return loss


def learner_of(seeds: range, robots: int, config: ReplayConfig) -> ReplayLearner:
    genomes = [
        initial_genome(1, HEADS.outputs, rng=np.random.default_rng([seed, robot]), genome_id=robot)
        for seed in seeds
        for robot in range(robots)
    ]
    network = PopulationNetwork(genomes, shape=(len(seeds), robots))
    learner = TDLearner(network, loss_of(network), STEP)
    return ReplayLearner(learner, loss_of, config, seeds)


def batch_of(seeds: range, robots: int, ticks: int = 8) -> TensorDict:
    """Random actions a; the reward of the first robot's is 1 - 1.5 (a - 0.8)^2.

    Those of the others are not the robots' own (genome -1).
    """
    shape = (len(seeds), robots, ticks)
    action = torch.stack(
        [torch.rand(*shape[1:], 1, generator=torch.Generator().manual_seed(s)) for s in seeds]
    )
    genome_id = torch.full((*shape, 1), -1)
    genome_id[:, 0] = 0
    never = torch.zeros(*shape, 1, dtype=torch.bool)
    seen = torch.zeros(*shape, 1)
    following = {
        "observation": seen,
        "reward": 1 - 1.5 * (action - 0.8).square(),
        "done": never,
        "terminated": never,
    }
    now = {"observation": seen, "action": action, "genome_id": genome_id, "next": following}
    return TensorDict(now, shape)


def best_actions(network: PopulationNetwork) -> torch.Tensor:
    candidates, values = HEADS(network(torch.zeros(*network.shape, 1)))
    return candidates[..., 0].gather(-1, values.argmax(-1, keepdim=True)).flatten().detach()


def test_everybody_learns_from_what_one_robot_did() -> None:
    learner = learner_of(range(1), 4, ReplayConfig(updates=300, keep_every=1))
    before = best_actions(learner.learner.network)
    assert (before - 0.8).abs().max() > 0.25
    error = learner.update(batch_of(range(1), 4, ticks=400))
    assert len(learner.memories[0]) == 400
    assert best_actions(learner.learner.network).tolist() == pytest.approx([0.8] * 4, abs=0.15)
    assert (error < 0.01).all()


def test_newborns_alone_are_taught_before_they_act() -> None:
    learner = learner_of(range(2), 3, ReplayConfig(updates=1, newborn_updates=300, keep_every=1))
    network = learner.learner.network
    learner.update(batch_of(range(2), 3, ticks=400))
    before = network.weight.detach().clone()
    newborn = torch.tensor([[False, False, False], [True, False, True]])
    learner.reset(newborn)
    changed = (network.weight != before).any(1).view(2, 3)
    assert torch.equal(changed, newborn)
    taught = best_actions(network).view(2, 3)[newborn]
    assert taught.tolist() == pytest.approx([0.8] * 2, abs=0.15)
    assert not learner.learner.steps.view(2, 3)[newborn].any()


def test_newborns_of_the_first_ticks_have_nobody_to_learn_from() -> None:
    learner = learner_of(range(1), 2, ReplayConfig(updates=1, newborn_updates=5))
    before = learner.learner.network.weight.detach().clone()
    learner.reset(torch.tensor([[True, False]]))
    assert torch.equal(learner.learner.network.weight, before)


def test_without_newborns_nobody_is_taught() -> None:
    learner = learner_of(range(1), 2, ReplayConfig(updates=1, newborn_updates=5))
    learner.update(batch_of(range(1), 2))
    before = learner.learner.network.weight.detach().clone()
    learner.reset(torch.zeros(1, 2, dtype=torch.bool))
    assert torch.equal(learner.learner.network.weight, before)


def test_an_arena_learns_as_if_alone() -> None:
    config = ReplayConfig(updates=3, newborn_updates=4, size=8)
    both, alone = learner_of(range(2), 3, config), learner_of(range(1, 2), 3, config)
    for born in (0, 1):  # in the other arena, then here
        newborn = torch.zeros(2, 3, dtype=torch.bool)
        newborn[born, 2] = True
        for learner, seeds, young in ((both, range(2), newborn), (alone, range(1, 2), newborn[1:])):
            learner.update(batch_of(seeds, 3))
            if young.any():
                learner.reset(young)
    columns = alone.learner.network.weight.shape[1]
    assert torch.equal(both.learner.network.weight[3:, :columns], alone.learner.network.weight)


def test_a_restored_learner_goes_on_exactly() -> None:
    config = ReplayConfig(updates=3, size=8, capacity=20)
    one, two = (learner_of(range(1), 3, config) for _ in range(2))
    one.update(batch_of(range(1), 3))
    two.learner.network.load_weights(one.learner.network.weight.detach())
    two.load_state(one.state())
    for learner in (one, two):
        learner.update(batch_of(range(5, 6), 3))
    assert torch.equal(one.learner.network.weight, two.learner.network.weight)


@pytest.mark.parametrize("wrong", [{"updates": -1}, {"size": 0}, {"newborn_updates": 3}])
def test_settings_without_sense_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ReplayConfig(**wrong)


def evolved_learner(
    step: LearnerConfig,
    bootstrap: Bootstrap | None = None,
    separation: float = 0.0,
    discount: torch.Tensor | None = None,
) -> ReplayLearner:
    """Two arenas of networks with hidden nodes and loops; an action that has no room, and two."""
    heads = CandidateHeads(3, [0.0, -2.0, 1.0], [1.0, 2.0, 1.0], value_range=(-1.0, 2.0))
    mutation = MutationConfig(add_node_prob=0.3, add_link_prob=0.4, recurrent_link_prob=0.2)
    rng, genomes = np.random.default_rng(3), []
    for number in range(6):
        one = initial_genome(2, heads.outputs, rng=rng, genome_id=number)
        ledger = InnovationLedger.for_genomes([one])
        for _ in range(2 * number):
            one = mutate(one, mutation, ledger, rng)
        genomes.append(one)
    network = PopulationNetwork(genomes, shape=(2, 3))
    assert network.state_size

    def make_loss(networks: PopulationNetwork) -> WireFittingLoss:
        values = CandidateValue(networks, heads, propose=True)
        targets = step.target_tau is not None
        loss = WireFittingLoss(
            values,
            normalize_return=True,
            delay_value=targets,
            bootstrap=bootstrap,
            epsilon_greedy=0.3,
            separation=separation,
        )
        loss.make_value_estimator(gamma=0.9)
        return loss

    config = ReplayConfig(updates=6, newborn_updates=5, size=150, keep_every=1, horizon=4)
    learner = TDLearner(network, make_loss(network), step)
    learner.loss.discount = discount
    return ReplayLearner(learner, make_loss, config, range(2))


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
    ("optimizer", "tau", "bootstrap", "separation", "own_discount"),
    [
        ("sgd", None, None, 0.0, False),
        ("sgd", 0.3, "double", 0.0, True),
        ("sgd", None, None, 0.05, False),
        ("adam", 0.3, None, 0.0, False),
        ("adam", 0.01, "double", 0.0, False),
        ("adam", None, "expected", 0.01, True),
    ],
)
def test_compiled_code_learns_what_torch_learns(
    optimizer: Literal["sgd", "adam"],
    tau: float | None,
    bootstrap: Bootstrap | None,
    separation: float,
    own_discount: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step = LearnerConfig(learning_rate=0.01, optimizer=optimizer, target_tau=tau)
    own = torch.tensor([[0.0, 0.5, 0.9], [0.99, 0.7, 0.8]]) if own_discount else None
    fast, slow = (evolved_learner(step, bootstrap, separation, own) for _ in range(2))
    newborn = torch.tensor([[False, True, False], [True, False, True]])
    errors = []
    for learner in (fast, slow):
        assert compiled_wires.serves(learner.learner)
        with monkeypatch.context() as patch:
            if learner is slow:
                patch.setattr(compiled_wires, "serves", lambda _: False)
            learner.reset(torch.ones(2, 3, dtype=torch.bool))  # nobody is taught yet
            learner.update(any_batch(0))
            learner.reset(newborn)
            errors.append(learner.update(any_batch(1)))
    before = evolved_learner(step).learner.network.weight
    moved = (slow.learner.network.weight - before).abs()
    assert moved.max() > 0.05
    torch.testing.assert_close(errors[0], errors[1], rtol=2e-4, atol=1e-6)
    for name, value in slow.learner.state().items():
        torch.testing.assert_close(fast.learner.state()[name], value, rtol=2e-3, atol=2e-5)
    torch.testing.assert_close(
        fast.learner.network.weight, slow.learner.network.weight, rtol=2e-3, atol=2e-5
    )


def test_a_network_with_a_discount_of_its_own_learns_as_if_it_were_that_of_all() -> None:
    step = LearnerConfig(learning_rate=0.01, optimizer="adam")
    gammas = torch.tensor([[0.0, 0.5, 0.9], [0.99, 0.7, 0.8]])
    newborn = torch.tensor([[False, True, False], [True, False, True]])

    def learnt(discount: torch.Tensor) -> torch.Tensor:
        learner = evolved_learner(step, discount=discount)
        learner.update(any_batch(0))
        learner.reset(newborn)
        learner.update(any_batch(1))
        return learner.learner.network.weight.detach()

    together = learnt(gammas)
    for place, gamma in enumerate(gammas.flatten().tolist()):
        alone = learnt(torch.full_like(gammas, gamma))
        assert torch.equal(together[place], alone[place])
    summed = evolved_learner(step)  # of all networks, 0.9, from sums that are remembered
    summed.update(any_batch(0))
    by_tick = evolved_learner(step, discount=torch.full_like(gammas, 0.9))
    by_tick.update(any_batch(0))
    torch.testing.assert_close(summed.learner.network.weight, by_tick.learner.network.weight)
