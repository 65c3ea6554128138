"""The TD loss of the chosen candidate: against stock DQN, by hand, and what it must not touch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torchrl.objectives import DQNLoss, SoftUpdate
from torchrl.objectives.utils import ValueEstimators

from neatq_torch.genome import initial_genome
from neatq_torch.learning import CandidateHeads, CandidateTDLoss, CandidateValue
from neatq_torch.network import PopulationNetwork

ROBOTS, TICKS, INPUTS, K, A = 3, 4, 5, 3, 2


def population(robots: int = ROBOTS) -> tuple[PopulationNetwork, CandidateHeads]:
    rng = np.random.default_rng(1)
    heads = CandidateHeads(K, [-1.0] * A, [1.0] * A)
    genomes = [initial_genome(INPUTS, heads.outputs, rng=rng, genome_id=i) for i in range(robots)]
    return PopulationNetwork(genomes, shape=(1, robots)), heads


def transitions(robots: int = ROBOTS, ticks: int = TICKS) -> TensorDict:
    rng = torch.Generator().manual_seed(2)
    shape = (1, robots, ticks)

    def rand(*size: int) -> torch.Tensor:
        return torch.rand(*shape, *size, generator=rng)

    def never() -> torch.Tensor:
        return torch.zeros(*shape, 1, dtype=torch.bool)

    batch = TensorDict(
        {
            "observation": rand(INPUTS),
            "candidate_index": torch.randint(K, shape, generator=rng),
            "next": {
                "observation": rand(INPUTS),
                "reward": rand(1),
                "done": never(),
                "terminated": never(),
                "truncated": never(),
            },
        },
        shape,
    )
    batch["next", "terminated"][0, 0, 1] = batch["next", "done"][0, 0, 1] = True
    batch["next", "truncated"][0, -1, 2] = batch["next", "done"][0, -1, 2] = True
    return batch


@pytest.mark.parametrize("delay_value", [False, True])
def test_it_equals_stock_dqn_over_candidates(delay_value: bool) -> None:
    network, heads = population()
    value = CandidateValue(network, heads)
    ours = CandidateTDLoss(value, delay_value=delay_value, reduction="mean")
    ours.make_value_estimator(gamma=0.9)
    stock = DQNLoss(value, action_space="categorical", delay_value=delay_value, reduction="mean")
    stock.set_keys(action="candidate_index")
    stock.make_value_estimator(gamma=0.9)
    if delay_value:
        for loss in (ours, stock):
            SoftUpdate(loss, tau=0.1)
            with torch.no_grad():
                loss.target_value_network_params["network", "weight"].mul_(0.5)
    losses, gradients = [], []
    for loss in (ours, stock):
        network.weight.grad = None
        losses.append(loss(transitions())["loss"])
        losses[-1].backward()
        gradients.append(network.weight.grad)
    # Stock DQN with its default l2 distance has no factor one half.
    torch.testing.assert_close(2 * losses[0], losses[1])
    torch.testing.assert_close(2 * gradients[0], gradients[1])


def test_only_the_chosen_value_output_gets_a_gradient() -> None:
    network, heads = population(robots=1)
    loss = CandidateTDLoss(CandidateValue(network, heads))
    batch = transitions(robots=1)
    batch["candidate_index"][:] = 1
    loss(batch)["loss"].backward()
    assert network.weight.grad is not None
    network.load_weights(network.weight.grad)  # so that the genome says which link got which
    genome = network.genome(0)
    touched = genome.link_target[genome.link_weight != 0]
    assert set(touched.tolist()) == {genome.output_ids[K * A + 1]}
    assert len(touched) == INPUTS + 1


class FixedValues(TensorDictModuleBase):
    """Two values, the observation and half of it, times one parameter."""

    def __init__(self, keys: tuple[str, str] = ("action_value", "chosen_action_value")) -> None:
        super().__init__()
        self.in_keys = ["observation"]
        self.scale = torch.nn.Parameter(torch.ones(()))
        self.out_keys = list(keys)
        self.keys = keys

    def forward(self, tensordict: TensorDict) -> TensorDict:
        x = tensordict["observation"] * self.scale
        values = torch.cat([x, x / 2], -1)
        tensordict.set(self.keys[0], values)
        return tensordict.set(self.keys[1], values.amax(-1, keepdim=True))


def line(rewards: list[float], values: list[float]) -> TensorDict:
    """One robot's ticks: it always takes candidate 1; states have the values given."""
    ticks = len(rewards)
    states = torch.tensor(values).view(1, 1, ticks + 1, 1)
    never = torch.zeros(1, 1, ticks, 1, dtype=torch.bool)
    following = {
        "observation": states[:, :, 1:],
        "reward": torch.tensor(rewards).view(1, 1, ticks, 1),
        "done": never,
        "terminated": never.clone(),
    }
    index = torch.ones(1, 1, ticks, dtype=torch.long)
    now = {"observation": states[:, :, :-1], "candidate_index": index, "next": following}
    return TensorDict(now, (1, 1, ticks))


def test_one_step_targets_by_hand() -> None:
    loss = CandidateTDLoss(FixedValues(), reduction="none")
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.5)
    batch = line([1.0, 0.0], [0.4, 0.6, 0.2])
    # Candidate 1 is worth half the state: 0.2, 0.3; targets 1 + 0.5 * 0.6 and 0.5 * 0.2.
    errors = torch.tensor([1.3 - 0.2, 0.1 - 0.3])
    torch.testing.assert_close(loss(batch)["loss"].flatten(), 0.5 * errors**2)
    torch.testing.assert_close(batch["td_error"].flatten(), errors.abs())


def test_lambda_targets_by_hand() -> None:
    loss = CandidateTDLoss(FixedValues(), reduction="none")
    loss.make_value_estimator(ValueEstimators.TDLambda, gamma=0.5, lmbda=0.5)
    batch = line([1.0, 0.0], [0.4, 0.6, 0.2])
    last = 0.5 * 0.2
    first = 1 + 0.5 * (0.5 * 0.6 + 0.5 * last)
    loss(batch)
    expected = torch.tensor([first - 0.2, last - 0.3]).abs()
    torch.testing.assert_close(batch["td_error"].flatten(), expected)


def test_whole_batch_targets_by_hand() -> None:
    loss = CandidateTDLoss(FixedValues(), reduction="none")
    loss.make_value_estimator(ValueEstimators.TD1, gamma=0.5)
    batch = line([1.0, 0.0], [0.4, 0.6, 0.2])
    loss(batch)
    expected = torch.tensor([1 + 0.25 * 0.2 - 0.2, 0.5 * 0.2 - 0.3]).abs()
    torch.testing.assert_close(batch["td_error"].flatten(), expected)


def test_the_normalised_target_of_the_greatest_reward_is_within_reach_of_a_sigmoid() -> None:
    loss = CandidateTDLoss(FixedValues(), reduction="none", normalize_return=True)
    loss.make_value_estimator(gamma=0.8)
    batch = line([1.0], [2.0, 1.0])
    loss(batch)
    # Q = 1 for ever is the fixed point: 0.2 * 1 + 0.8 * 1 = 1, the value of candidate 1.
    assert batch["td_error"].item() == pytest.approx(0.0, abs=1e-6)
    assert batch["next", "reward"].item() == 1.0


def test_termination_cuts_the_bootstrap_and_truncation_does_not() -> None:
    loss = CandidateTDLoss(FixedValues(), reduction="none")
    loss.make_value_estimator(gamma=0.5)
    batch = line([0.0, 0.0], [0.0, 1.0, 1.0])
    batch["next", "done"][0, 0, :] = True
    batch["next", "terminated"][0, 0, 1] = True
    loss(batch)
    torch.testing.assert_close(batch["td_error"].flatten(), torch.tensor([0.5, 0.5]))


def test_masked_transitions_do_not_count() -> None:
    network, heads = population()
    loss = CandidateTDLoss(CandidateValue(network, heads))
    batch = transitions()
    mask = torch.ones(1, ROBOTS, TICKS, dtype=torch.bool)
    mask[0, 2] = False
    batch["own"] = mask
    loss.loss_mask_key = "own"
    loss(batch)["loss"].backward()
    assert network.weight.grad is not None
    assert not network.weight.grad[2].any()
    assert network.weight.grad[:2].abs().sum(1).all()


def test_it_reads_entries_under_other_names() -> None:
    loss = CandidateTDLoss(FixedValues(keys=("q", "best")), reduction="none")
    names = {"action": "taken", "action_value": "q", "value": "best", "reward": "gain"}
    loss.set_keys(**names, priority="surprise")
    loss.make_value_estimator(gamma=0.5)
    batch = line([1.0, 0.0], [0.4, 0.6, 0.2])
    batch.rename_key_("candidate_index", "taken")
    batch.rename_key_(("next", "reward"), ("next", "gain"))
    loss(batch)
    torch.testing.assert_close(batch["surprise"].flatten(), torch.tensor([1.1, 0.2]))


def test_target_parameters_follow_slowly() -> None:
    network, heads = population()
    loss = CandidateTDLoss(CandidateValue(network, heads), delay_value=True)
    loss.make_value_estimator(gamma=0.9)
    update = SoftUpdate(loss, tau=0.25)
    before = network.weight.detach().clone()
    with torch.no_grad():
        network.weight.add_(1.0)
    update.step()
    target = loss.target_value_network_params["network", "weight"]
    torch.testing.assert_close(target.detach(), before + 0.25)
