"""A user's own optimiser over a population whose genomes are replaced."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.optim import LBFGS, SGD, Adagrad, Adam, AdamW, Optimizer

from neatq_torch.genome import Genome, InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.network import GenomeNetwork, PopulationNetwork

Make = Callable[[list[torch.nn.Parameter]], Optimizer]

OPTIMIZERS: dict[str, Make] = {
    "adam": lambda parameters: Adam(parameters, lr=0.05),
    "amsgrad": lambda parameters: Adam(parameters, lr=0.05, amsgrad=True, foreach=True),
    "adamw": lambda parameters: AdamW(parameters, lr=0.05, weight_decay=0.1),
    "momentum": lambda parameters: SGD(parameters, lr=0.05, momentum=0.9, nesterov=True),
}


def grown(seed: int, mutations: int) -> Genome:
    rng = np.random.default_rng(seed)
    genome = initial_genome(3, 2, rng=rng, genome_id=seed)
    ledger = InnovationLedger.for_genomes([genome])
    growth = MutationConfig(add_node_prob=0.5, add_link_prob=0.5, recurrent_link_prob=0.0)
    for _ in range(mutations):
        genome = mutate(genome, growth, ledger, rng)
    return genome


def loss_of(output: Tensor, x: Tensor) -> Tensor:
    return (output - x[..., :2]).square().sum()


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_each_network_learns_as_with_an_optimiser_of_its_own(name: str) -> None:
    genomes = [grown(seed, 3) for seed in range(3)]
    network = PopulationNetwork(genomes)
    optimizer = OPTIMIZERS[name](list(network.parameters()))
    network.separate(optimizer)
    columns = network.weight.shape[1]
    alone = [GenomeNetwork(genome) for genome in genomes]
    own = [OPTIMIZERS[name](list(one.parameters())) for one in alone]
    chance = torch.Generator().manual_seed(0)
    newborns = {4: (1, grown(7, 3)), 9: (1, grown(8, 60)), 12: (0, grown(9, 0))}
    for step in range(20):
        if step in newborns:  # the second needs more columns than there are
            slot, genome = newborns[step]
            network.replace(slot, genome)
            alone[slot] = GenomeNetwork(genome)
            own[slot] = OPTIMIZERS[name](list(alone[slot].parameters()))
        x = torch.rand(3, 8, 3, generator=chance)
        optimizer.zero_grad()
        loss_of(network(x), x).backward()
        optimizer.step()
        for one, its, seen in zip(alone, own, x, strict=True):
            its.zero_grad()
            loss_of(one(seen), seen).backward()
            its.step()
    assert network.weight.shape[1] > columns
    for slot, one in enumerate(alone):
        np.testing.assert_allclose(
            network.genome(slot).link_weight, one.genome().link_weight, rtol=1e-4, atol=1e-5
        )


def test_gradients_stay_where_they_were_and_settings_are_those_of_the_group() -> None:
    network = PopulationNetwork([grown(0, 3), grown(1, 3)])
    head = torch.nn.Linear(2, 1)
    optimizer = SGD([{"params": [*network.parameters()], "lr": 0.5}, {"params": head.parameters()}])
    network.separate(optimizer)
    before = network.weight.detach().clone()
    head(network(torch.rand(2, 4, 3))).sum().backward()
    assert network.weight.grad is not None
    gradient = network.weight.grad.clone()
    optimizer.step()
    assert torch.equal(network.weight.grad, gradient)
    torch.testing.assert_close(network.weight.detach(), before - 0.5 * gradient)
    optimizer.zero_grad()
    assert network.weight.grad is None
    after = network.weight.detach().clone()
    optimizer.param_groups[0]["lr"] = 0.0
    network(torch.rand(2, 4, 3)).sum().backward()
    optimizer.step()
    assert torch.equal(network.weight.detach(), after)


def test_a_step_between_forward_and_backward_is_still_refused() -> None:
    network = PopulationNetwork([grown(0, 3), grown(1, 3)])
    optimizer = SGD(network.parameters(), lr=0.1)
    network.separate(optimizer)
    x = torch.rand(2, 4, 3)
    late = network(x).sum()
    network(x).sum().backward()
    optimizer.step()
    with pytest.raises(RuntimeError, match="inplace operation"):
        late.backward()


def test_a_saved_optimiser_goes_on() -> None:
    def made() -> tuple[PopulationNetwork, Optimizer]:
        network = PopulationNetwork([grown(0, 3), grown(1, 3)])
        optimizer = Adam(network.parameters(), lr=0.1)
        network.separate(optimizer)
        return network, optimizer

    def step(network: PopulationNetwork, optimizer: Optimizer) -> None:
        optimizer.zero_grad()
        x = torch.ones(2, 4, 3)
        loss_of(network(x), x).backward()
        optimizer.step()

    first, second = made(), made()
    step(*first)
    for one, other in zip(second, first, strict=True):
        one.load_state_dict(copy.deepcopy(other.state_dict()))
    for one in (first, second):
        step(*one)
        one[0].replace(1, grown(2, 3))
        step(*one)
    assert torch.equal(first[0].weight, second[0].weight)


def test_an_optimiser_that_does_not_fit_is_refused() -> None:
    network = PopulationNetwork([grown(0, 3), grown(1, 3)])
    with pytest.raises(ValueError, match="expected an optimiser over the weight of these networks"):
        network.separate(Adam(torch.nn.Linear(2, 2).parameters()))
    optimizer = Adam(network.parameters())
    network(torch.ones(2, 3)).sum().backward()
    optimizer.step()
    with pytest.raises(ValueError, match="that made no step yet"):
        network.separate(optimizer)


def test_an_optimiser_that_treats_parameters_together_or_has_a_state_at_once_is_refused() -> None:
    network = PopulationNetwork([grown(0, 3), grown(1, 3)])
    with pytest.raises(ValueError, match="LBFGS computes with all parameters as one"):
        network.separate(LBFGS(network.parameters()))
    with pytest.raises(ValueError, match="Adagrad has a state at once"):
        network.separate(Adagrad(network.parameters()))


@pytest.mark.parametrize("named", [False, True])
def test_a_step_with_a_closure_equals_a_step_after_it(named: bool) -> None:
    def trained(step: Callable[[Optimizer, Callable[[], Tensor]], Tensor]) -> Tensor:
        network = PopulationNetwork([grown(0, 3), grown(1, 3)])
        optimizer = Adam(network.parameters(), lr=0.1)
        network.separate(optimizer)
        for count in range(6):
            if count == 3:
                network.replace(1, grown(2, 3))
            x = torch.full((2, 4, 3), 0.1 * count)

            def closure(x: Tensor = x) -> Tensor:
                optimizer.zero_grad()
                loss = loss_of(network(x), x)
                loss.backward()
                return loss

            assert step(optimizer, closure).ndim == 0
            assert network.weight.grad is not None
        return network.weight.detach()

    def at_once(optimizer: Optimizer, closure: Callable[[], Tensor]) -> Tensor:
        return optimizer.step(closure=closure) if named else optimizer.step(closure)  # type: ignore[return-value]

    def after(optimizer: Optimizer, closure: Callable[[], Tensor]) -> Tensor:
        loss = closure()
        optimizer.step()
        return loss

    assert torch.equal(trained(at_once), trained(after))
