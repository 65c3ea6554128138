"""What robots learn from each other's past, and what newborns know before they act."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.genome import initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidateValue,
    ReplayConfig,
    ReplayLearner,
    TDLearner,
    WireFittingLoss,
)
from neatq_torch.network import PopulationNetwork

HEADS = CandidateHeads(3, [0.0], [1.0])


def config_of(**settings: int) -> ReplayConfig:
    return ReplayConfig(learning_rate=0.05, optimizer="adam", **settings)  # pyright: ignore[reportArgumentType]


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
    learner = TDLearner(network, loss_of(network), config)
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
    learner = learner_of(range(1), 4, config_of(updates=300, keep_every=1))
    before = best_actions(learner.learner.network)
    assert (before - 0.8).abs().max() > 0.25
    error = learner.update(batch_of(range(1), 4, ticks=400))
    assert len(learner.memories[0]) == 400
    assert best_actions(learner.learner.network).tolist() == pytest.approx([0.8] * 4, abs=0.15)
    assert (error < 0.01).all()


def test_newborns_alone_are_taught_before_they_act() -> None:
    learner = learner_of(range(2), 3, config_of(updates=1, newborn_updates=300, keep_every=1))
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
    learner = learner_of(range(1), 2, config_of(updates=1, newborn_updates=5))
    before = learner.learner.network.weight.detach().clone()
    learner.reset(torch.tensor([[True, False]]))
    assert torch.equal(learner.learner.network.weight, before)


def test_without_newborns_nobody_is_taught() -> None:
    learner = learner_of(range(1), 2, config_of(updates=1, newborn_updates=5))
    learner.update(batch_of(range(1), 2))
    before = learner.learner.network.weight.detach().clone()
    learner.reset(torch.zeros(1, 2, dtype=torch.bool))
    assert torch.equal(learner.learner.network.weight, before)


def test_an_arena_learns_as_if_alone() -> None:
    config = config_of(updates=3, newborn_updates=4, size=8)
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


def test_an_arena_in_which_nobody_lives_waits_for_the_others() -> None:
    config = config_of(updates=3, size=8)
    both, alone = learner_of(range(2), 3, config), learner_of(range(1), 3, config)
    for tick, living in enumerate((True, False, True)):
        batch = batch_of(range(10 * tick, 10 * tick + 2), 3)
        if living:
            alone.update(batch[:1].clone())
        else:
            batch["genome_id"][0] = -1
        error = both.update(batch)
        assert error[0].any() == living
    columns = alone.learner.network.weight.shape[1]
    assert torch.equal(both.learner.network.weight[:3, :columns], alone.learner.network.weight)
    assert len(both.memories[0]) == len(alone.memories[0])


def test_a_restored_learner_goes_on_exactly() -> None:
    config = config_of(updates=3, size=8, capacity=20)
    one, two = (learner_of(range(1), 3, config) for _ in range(2))
    one.update(batch_of(range(1), 3))
    two.learner.network.load_weights(one.learner.network.weight.detach())
    two.load_state_dict(one.state_dict())
    for learner in (one, two):
        learner.update(batch_of(range(5, 6), 3))
    assert torch.equal(one.learner.network.weight, two.learner.network.weight)
