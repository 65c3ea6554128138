"""Networks, acting and learning on a GPU: the results of the CPU, and no waiting for the host."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from neatq_torch.evolution import RtNEAT, RtNEATConfig
from neatq_torch.genome import Genome, InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    CandidateTDLoss,
    CandidateValue,
    CriticConfig,
    CriticLearner,
    EpsilonGreedy,
    TDConfig,
    TDLearner,
    TraceLearner,
    WireFittingLoss,
    write_back,
)
from neatq_torch.network import PopulationNetwork

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
    pytest.mark.filterwarnings("ignore:Synchronization debug mode"),
]

INPUTS, ROBOTS, TICKS, K = 5, 6, 4, 3
GROWING = MutationConfig(add_node_prob=0.4, add_link_prob=0.5, recurrent_link_prob=0.3)


def some_genomes(outputs: int) -> list[Genome]:
    rng = np.random.default_rng(2)
    genomes = [initial_genome(INPUTS, outputs, rng=rng, genome_id=i + 1) for i in range(ROBOTS)]
    ledger = InnovationLedger.for_genomes(genomes)
    for _ in range(8):
        genomes = [mutate(genome, GROWING, ledger, rng) for genome in genomes]
    return genomes


def heads() -> CandidateHeads:
    return CandidateHeads(K, [-1.0, 0.0], [1.0, 2.0])


def network_on(device: str) -> PopulationNetwork:
    return PopulationNetwork(some_genomes(heads().outputs), shape=(1, ROBOTS)).to(device)


@contextmanager
def no_waiting() -> Iterator[None]:
    torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


@torch.no_grad()
def act(device: str) -> TensorDictBase:
    """A batch [1, robots, ticks] that a policy made, exploring."""
    network = network_on(device)
    exploration = EpsilonGreedy((1, ROBOTS), seeds=[3], epsilon=0.3, max_hold_ticks=3)
    policy = CandidatePolicy(network, heads(), exploration).to(device)
    generator = torch.Generator().manual_seed(1)
    seen = torch.rand(TICKS + 1, 1, ROBOTS, INPUTS, generator=generator).to(device)
    never = torch.zeros(1, ROBOTS, 1, dtype=torch.bool, device=device)
    ticks = []
    for tick in range(TICKS):
        data = TensorDict({"observation": seen[tick]}, (1, ROBOTS), device=device)
        data = policy(data)
        following = {"observation": seen[tick + 1], "reward": seen[tick, ..., :1]}
        data.update({"next": following | {"done": never, "terminated": never}})
        ticks.append(data)
    return TensorDict.stack(ticks, -1)  # pyright: ignore[reportReturnType]


def learner_on(device: str, rule: str) -> TDLearner | TraceLearner:
    network = network_on(device)
    if rule == "traces":
        return TraceLearner(network, heads().to(device))
    wires = rule == "wire fitting"
    value = CandidateValue(network, heads(), propose=wires)
    loss = (WireFittingLoss if wires else CandidateTDLoss)(value, delay_value=True).to(device)
    loss.make_value_estimator(gamma=0.9)
    return TDLearner(network, loss, TDConfig(learning_rate=0.05, target_tau=0.1))


def test_networks_give_the_outputs_and_gradients_of_the_cpu() -> None:
    found = []
    for device in ("cpu", "cuda"):
        network = network_on(device)
        observation = torch.linspace(-1, 1, ROBOTS * 7 * INPUTS).view(1, ROBOTS, 7, INPUTS)
        state = network.step(observation.to(device), network.initial_state((7,)))[1]
        output, state = network.step(observation.to(device), state)
        output.square().sum().backward()
        assert network.state_size and network.weight.grad is not None
        found.append([x.cpu() for x in (output.detach(), state.detach(), network.weight.grad)])
    for cpu, cuda in zip(*found, strict=True):
        torch.testing.assert_close(cuda, cpu, rtol=1e-4, atol=1e-5)


def test_a_newborn_moves_into_a_network_on_the_gpu() -> None:
    network = network_on("cuda")
    genome = some_genomes(heads().outputs)[0]
    newborn = genome.with_weights(genome.link_weight + 1)
    network.replace(4, newborn)
    assert np.array_equal(network.genome(4).link_weight, newborn.link_weight)
    observation = torch.ones(1, ROBOTS, INPUTS, device="cuda")
    alone = PopulationNetwork([newborn])
    expected = alone(torch.ones(1, INPUTS))[0]
    torch.testing.assert_close(network(observation)[0, 4].detach().cpu(), expected.detach())


def test_robots_take_the_candidates_that_they_take_on_the_cpu() -> None:
    cpu, cuda = act("cpu"), act("cuda").cpu()
    assert torch.equal(cpu["candidate_index"], cuda["candidate_index"])
    torch.testing.assert_close(cuda["action"], cpu["action"], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("rule", ["td", "wire fitting", "traces"])
def test_robots_learn_what_they_learn_on_the_cpu(rule: str) -> None:
    weights = []
    for device in ("cpu", "cuda"):
        learner = learner_on(device, rule)
        for _ in range(3):
            learner.update(act("cpu").to(device))
        weights.append(learner.network.weight.detach().cpu())
    torch.testing.assert_close(weights[1], weights[0], rtol=1e-3, atol=1e-4)
    assert not torch.equal(weights[0], network_on("cpu").weight)


def repeated_act() -> Callable[[], object]:
    network = network_on("cuda")
    policy = CandidatePolicy(network, heads(), EpsilonGreedy((1, ROBOTS), seeds=[3])).to("cuda")
    observation = torch.rand(1, ROBOTS, INPUTS, device="cuda")
    return lambda: policy(TensorDict({"observation": observation}, (1, ROBOTS), device="cuda"))


@pytest.mark.parametrize("rule", ["td", "wire fitting", "traces"])
def test_learning_does_not_wait_for_the_host(rule: str) -> None:
    learner, batch = learner_on("cuda", rule), act("cuda")
    learner.update(batch)  # makes what is kept
    with no_waiting():
        learner.update(batch)


def test_acting_does_not_wait_for_the_host() -> None:
    tick = repeated_act()
    tick()
    with no_waiting():
        for _ in range(10):
            tick()


def test_what_was_learnt_is_written_back() -> None:
    learner = learner_on("cuda", "td")
    inputs = learner.network.inputs
    population = RtNEAT.start(
        RtNEATConfig(), slots=len(some_genomes(1)), inputs=inputs, outputs=heads().outputs, rng=0
    )
    population.genomes = some_genomes(heads().outputs)
    learner.update(act("cuda"))
    write_back(learner.network, [population])
    for slot, genome in enumerate(population.genomes):
        assert np.array_equal(genome.link_weight, learner.network.genome(slot).link_weight)


def test_a_shared_critic_on_the_gpu_teaches_networks_that_act_on_the_cpu() -> None:
    heads_of_one = CandidateHeads(1, [-1.0, 0.0], [1.0, 2.0])
    network = PopulationNetwork(some_genomes(2), shape=(1, ROBOTS))
    config = CriticConfig(width=8, warmup=5, every=2, newborn_updates=3, device="cuda")
    learner = CriticLearner(network, heads_of_one, config, seeds=[0])
    batch = act("cpu")
    batch["genome_id"] = network.genome_id[..., None, None].expand(1, ROBOTS, TICKS, 1)
    before = network.weight.detach().clone()
    learner.update(batch)
    learner.reset(torch.ones(1, ROBOTS, dtype=torch.bool))
    assert network.weight.device.type == "cpu"
    assert learner.critics[0].memory.device.type == "cuda"
    assert not torch.equal(network.weight, before)
