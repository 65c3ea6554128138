"""The shared critic: targets in closed form, lessons for networks, and exactness."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from neatq_torch.genome import layered_genome
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import (
    CandidateHeads,
    CriticConfig,
    CriticLearner,
    DiscreteHeads,
    Heads,
    RunningNormalization,
    compiled_critic,
)
from neatq_torch.learning.critic import TwinCritic
from neatq_torch.learning.shared_critic import SharedCritic
from neatq_torch.network import PopulationNetwork

BOX, CHOICES = CandidateHeads(1, [-2.0], [2.0]), DiscreteHeads(3)
SMALL = CriticConfig(width=8, size=16, policy_size=8, warmup=10, capacity=100, newborn_updates=5)


def population(heads: Heads, arenas: int = 1, slots: int = 3, seed: int = 0) -> PopulationNetwork:
    """Networks of two inputs."""
    rng = np.random.default_rng(seed)
    activation = "steep_sigmoid" if isinstance(heads, CandidateHeads) else "identity"
    genomes = [
        layered_genome(
            2, heads.outputs, hidden=3, rng=rng, activation=activation, genome_id=number + 1
        )
        for number in range(arenas * slots)
    ]
    return PopulationNetwork(genomes, shape=(arenas, slots))


def batch_of(seed: int, heads: Heads, network: PopulationNetwork, ticks: int = 8) -> TensorDict:
    """What robots of all slots went through: nobody's episode ends."""
    rng, shape = torch.Generator().manual_seed(seed), (*network.shape, ticks)
    action = torch.rand(*shape, 1, generator=rng) * 4 - 2
    if isinstance(heads, DiscreteHeads):
        action = torch.randint(3, (*shape, 1), generator=rng).float()
    never = torch.zeros(*shape, 1, dtype=torch.bool)
    following = {
        "observation": torch.rand(*shape, 2, generator=rng),
        "reward": torch.rand(*shape, 1, generator=rng),
        "done": never,
        "terminated": never.clone(),
    }
    now = {
        "observation": torch.rand(*shape, 2, generator=rng),
        "action": action,
        "genome_id": network.genome_id[..., None, None].expand(*shape, 1).clone(),
    }
    return TensorDict(now | {"next": TensorDict(following, shape)}, shape)


def constant(critic: TwinCritic, worth: Sequence[float]) -> None:
    """Let both perceptrons tell two numbers, whatever they read."""
    with torch.no_grad():
        for one in critic.parameters():
            one.zero_()
        critic.layers()[-1][:, -1] = torch.tensor(worth).view(2, -1)


def rows(heads: Heads, *, reward: float, terminated: bool, steps: int) -> dict[str, Tensor]:
    """One transition."""
    return {
        "observation": torch.zeros(1, 2),
        "action": torch.zeros(1, 1),
        "steps_to_next_obs": torch.tensor([[steps]]),
        "next_observation": torch.zeros(1, 2),
        "next_reward": torch.tensor([[reward]]),
        "next_terminated": torch.tensor([[terminated]]),
    }


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("terminated", [False, True])
def test_the_target_in_a_box_is_that_of_the_lower_of_both(steps: int, terminated: bool) -> None:
    critic = SharedCritic(CriticConfig(discount=0.9), BOX, 2, 3, seed=0)
    constant(critic.critic, [0.0, 1.0])
    constant(critic.target, [7.0, 5.0])
    given = rows(BOX, reward=2.0, terminated=terminated, steps=steps)
    error = critic.learn(given, torch.full((1, 1), 0.5))
    target = 2.0 + (0.0 if terminated else 0.9**steps * 5.0)
    assert error.item() == pytest.approx((target**2 + (target - 1) ** 2) / 2, rel=1e-6)


@pytest.mark.parametrize("terminated", [False, True])
def test_the_target_of_a_few_actions_is_double(terminated: bool) -> None:
    critic = SharedCritic(CriticConfig(discount=0.5), CHOICES, 2, 3, seed=0)
    constant(critic.critic, [0.0, 9.0, 1.0, 0.0, 9.0, 1.0])  # the second action is best by these,
    constant(critic.target, [8.0, 4.0, 8.0, 8.0, 6.0, 8.0])  # and worth the lower of 4 and 6
    given = rows(CHOICES, reward=1.0, terminated=terminated, steps=2)
    error = critic.learn(given, torch.zeros(1, 3))
    target = 1.0 + (0.0 if terminated else 0.25 * 4.0)
    assert error.item() == pytest.approx(target**2, rel=1e-6)


def test_rewards_are_measured_by_how_far_returns_go() -> None:
    network = population(BOX)
    learner = CriticLearner(network, BOX, CriticConfig(discount=0.5), seeds=[0])
    batch = batch_of(0, BOX, network, ticks=4)
    learner.update(batch)
    reward = batch.get(("next", "reward"))[0, ..., 0].double().numpy()
    returns = np.zeros((3, 4))
    for tick in range(4):
        returns[:, tick] = reward[:, tick] + 0.5 * (returns[:, tick - 1] if tick else 0)
    own = learner.critics[0].spread.deviation.item()
    assert own == pytest.approx(returns.std(), rel=1e-6)


def test_the_slow_copy_follows() -> None:
    critic = SharedCritic(CriticConfig(critic_tau=0.25), CHOICES, 2, 3, seed=0)
    before = critic.target.weight.clone()
    critic.learn(rows(CHOICES, reward=1.0, terminated=False, steps=1), torch.zeros(1, 3))
    followed = 0.75 * before + 0.25 * critic.critic.weight.detach()
    torch.testing.assert_close(critic.target.weight, followed)


def test_a_network_is_told_what_its_action_in_a_box_is_worth() -> None:
    critic = SharedCritic(CriticConfig(width=16), BOX, 2, 3, seed=0)
    seen, outputs = torch.rand(5, 2), torch.rand(3, 5, 1)
    outputs[0, 0], outputs[1, 1] = -0.5, 1.5  # beyond the bounds, where they are cut off
    outputs.requires_grad_()
    action = 2 * outputs.clamp(0, 1) - 1  # from [0, 1] to [-1, 1]
    worth = [critic.critic(torch.cat([seen, one], -1))[0] for one in action]
    expected = torch.autograd.grad(-torch.stack(worth).mean(1).sum(), outputs)[0]
    torch.testing.assert_close(critic.lesson(seen, outputs), expected)


def test_a_network_is_told_which_of_a_few_actions_is_worth_most() -> None:
    critic = SharedCritic(CriticConfig(), CHOICES, 2, 1, seed=0)
    constant(critic.critic, [1.0, 2.0, 6.0, 3.0, 2.0, 0.0])  # on average 2, 2 and 3
    lesson = critic.lesson(torch.zeros(4, 2), torch.zeros(1, 4, 3))
    # d/dz_a of -sum p Q is -p_a (Q_a - mean Q), a quarter for each of four rows.
    expected = -torch.tensor([2 - 7 / 3, 2 - 7 / 3, 3 - 7 / 3]) / 3 / 4
    torch.testing.assert_close(lesson, expected.expand(1, 4, 3))


@pytest.mark.parametrize("heads", [BOX, CHOICES], ids=["box", "choices"])
def test_newborns_learn_what_pays_before_their_first_step(heads: Heads) -> None:
    """Episodes of one step, which pays most for one action: 1 in the box, or the last of three."""
    network = population(heads)
    config = CriticConfig(
        updates_per_step=4.0,
        newborn_updates=300,
        warmup=100,
        learning_rate=0.01,
        every=None,
        width=32,
    )
    learner = CriticLearner(network, heads, config, seeds=[0])
    for seed in range(5):
        batch = batch_of(seed, heads, network, ticks=40)
        action = batch.get("action")
        pays = -(action - 1).square() if isinstance(heads, CandidateHeads) else action
        batch.set(("next", "reward"), pays.float())
        for name in ("done", "terminated"):
            batch.set(("next", name), torch.ones_like(action, dtype=torch.bool))
        learner.update(batch)
    before = network.weight.detach().clone()
    learner.reset(torch.tensor([[True, True, False]]))
    seen = torch.rand(1, 3, 50, 2)
    best = heads.best(network(seen))[0]
    wanted = 1.0 if isinstance(heads, CandidateHeads) else 2.0
    assert (best[:2] - wanted).abs().mean() < 0.4
    assert torch.equal(network.weight[2], before[2])  # who lives on does not learn again


def test_those_alive_learn_where_that_is_wanted() -> None:
    for every, learns in ((2, True), (None, False)):
        network = population(BOX)
        config = CriticConfig(width=8, warmup=10, every=every, updates_per_step=0.5)
        learner = CriticLearner(network, BOX, config, seeds=[0])
        before = network.weight.detach().clone()
        learner.update(batch_of(0, BOX, network))
        assert learner.critics[0].steps == 12  # half a step for each of three times eight ticks
        assert torch.equal(network.weight, before) is not learns


def test_a_network_that_is_alive_follows_the_gradient_by_adam() -> None:
    network = population(BOX)
    config = CriticConfig(
        width=8, warmup=1, every=1, updates_per_step=1 / 24, horizon=1, learning_rate=0.01
    )
    learner = CriticLearner(network, BOX, config, seeds=[0])
    before = network.weight.detach().clone()
    learner.update(batch_of(0, BOX, network))  # one step: Adam's first is by the rate, or none
    moved = (network.weight.detach() - before).abs()
    used = moved > 0
    assert used.any(1).all()
    torch.testing.assert_close(moved[used], torch.full_like(moved[used], 0.01), rtol=2e-2, atol=0)


def test_nothing_is_learnt_before_enough_is_remembered_or_where_nobody_lives() -> None:
    network = population(BOX)
    learner = CriticLearner(network, BOX, CriticConfig(warmup=30, width=8), seeds=[0])
    learner.update(batch_of(0, BOX, network))
    assert learner.critics[0].steps == 0
    learner.update(batch_of(1, BOX, network))
    assert learner.critics[0].steps == 12  # half a step for each of the 24 of this batch
    idle = batch_of(2, BOX, network)
    idle["genome_id"] = torch.full_like(idle["genome_id"], -1)
    learner.update(idle)
    assert learner.critics[0].steps == 12


def learners(heads: Heads, **changes: Any) -> CriticLearner:
    network = population(heads, arenas=2)
    config = replace(SMALL, **changes)
    return CriticLearner(network, heads, config, seeds=[1, 2], normalization=normal(network))


def normal(network: PopulationNetwork) -> RunningNormalization:
    own = RunningNormalization(network.shape[0], 2)
    own.add(torch.rand(*network.shape, 9, 2), torch.ones(*network.shape, 9, dtype=torch.bool))
    return own


@pytest.mark.parametrize("heads", [BOX, CHOICES], ids=["box", "choices"])
def test_a_state_goes_on_exactly(heads: Heads) -> None:
    first = learners(heads)
    for seed in range(3):
        first.update(batch_of(seed, heads, first.network))
    second = learners(heads)
    second.network.load_weights(first.network.weight.detach().clone())
    second.normalization = first.normalization
    second.load_state_dict(copy.deepcopy(first.state_dict()))
    newborn = torch.tensor([[True, False, False], [False, True, True]])
    for one in (first, second):
        one.update(batch_of(7, heads, one.network))
        one.reset(newborn)
        one.update(batch_of(8, heads, one.network))
    assert torch.equal(first.network.weight, second.network.weight)
    for one, other in zip(first.critics, second.critics, strict=True):
        assert torch.equal(one.critic.weight, other.critic.weight)


@pytest.mark.parametrize("heads", [BOX, CHOICES], ids=["box", "choices"])
def test_an_arena_learns_the_same_whatever_stands_beside_it(heads: Heads) -> None:
    both = learners(heads)
    genomes = [both.network.genome(slot) for slot in (3, 4, 5)]
    network, shared = PopulationNetwork(genomes, shape=(1, 3)), both.normalization
    assert shared is not None
    own = RunningNormalization(1, 2)
    own.load_state_dict({name: one[1:] for name, one in shared.state_dict().items()})
    alone = CriticLearner(network, heads, both.config, seeds=[2], normalization=own)
    for seed in range(3):
        batch = batch_of(seed, heads, both.network)
        both.update(batch)
        alone.update(batch[1:])
    newborn = torch.tensor([[True, False, True], [False, True, True]])
    both.reset(newborn)
    alone.reset(newborn[1:])
    assert torch.equal(both.network.weight[3:], alone.network.weight)


@pytest.mark.parametrize("every", [None, 1])
@pytest.mark.parametrize("size", [16, 100])
@pytest.mark.parametrize("heads", [BOX, CHOICES], ids=["box", "choices"])
def test_compiled_code_learns_what_torch_learns(
    heads: Heads, size: int, every: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Minibatches of one block and of two, of which the second is not full."""
    fast, slow = (learners(heads, size=size, policy_size=size, every=every) for _ in range(2))
    slow.normalization = fast.normalization
    before = fast.network.weight.detach().clone()
    newborn = torch.tensor([[True, False, True], [False, True, True]])
    errors = []
    for learner in (fast, slow):
        with monkeypatch.context() as patch:
            if learner is slow:
                patch.setattr(compiled_critic, "accepts", lambda *_: False)
            learner.update(batch_of(0, heads, learner.network))
            errors.append(learner.update(batch_of(1, heads, learner.network)))
            learner.reset(newborn)
    torch.testing.assert_close(*errors, rtol=2e-4, atol=1e-6)
    assert (slow.network.weight - before).abs().max() > 0.01
    torch.testing.assert_close(fast.network.weight, slow.network.weight, rtol=2e-3, atol=2e-5)
    for one, other in zip(fast.critics, slow.critics, strict=True):
        assert one.steps == other.steps > 0
        torch.testing.assert_close(one.critic.weight, other.critic.weight, rtol=2e-3, atol=2e-5)
        torch.testing.assert_close(one.target.weight, other.target.weight, rtol=2e-3, atol=2e-5)


def test_a_slope_is_that_of_autograd() -> None:
    critic = TwinCritic(3, 1, 16, torch.Generator().manual_seed(0))
    given = torch.rand(7, 3, requires_grad=True)
    (expected,) = torch.autograd.grad(critic(given)[0].sum(), given)
    torch.testing.assert_close(critic.slope(given.detach()), expected)
    assert critic.layers()[0].abs().max() <= 1 / math.sqrt(3)


def test_several_candidates_are_refused() -> None:
    network = population(CandidateHeads(2, [-1.0], [1.0]))
    with pytest.raises(ConfigError, match=r"network.candidates: expected 1, got 2; where a critic"):
        CriticLearner(network, CandidateHeads(2, [-1.0], [1.0]), SMALL, seeds=[0])
