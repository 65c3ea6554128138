"""A genome as a drop-in module for any PyTorch code."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from torch import nn

from neatq_torch.genome import Genome, InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.network import Evaluation, GenomeNetwork, PopulationNetwork

EVALUATIONS: tuple[Evaluation, Evaluation] = ("settle", "synchronous")


@pytest.fixture
def genome() -> Genome:
    rng = np.random.default_rng(4)
    genome = initial_genome(3, 2, rng=rng)
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(20):
        genome = mutate(genome, MutationConfig(add_node_prob=0.5), ledger, rng)
    return genome


def test_it_maps_inputs_to_outputs_over_any_leading_dimensions(genome: Genome) -> None:
    network = GenomeNetwork(genome)
    x = torch.rand(5, 4, 3)
    assert network(x).shape == (5, 4, 2)
    assert network(x[0, 0]).shape == (2,)
    torch.testing.assert_close(network(x)[2, 1], network(x[2, 1]))


def test_a_synchronous_one_keeps_what_hidden_nodes_said_and_one_that_settles_does_not(
    genome: Genome,
) -> None:
    state_sizes = [GenomeNetwork(genome, evaluation=one).state_size for one in EVALUATIONS]
    assert state_sizes[0] == 0 < state_sizes[1]


def test_it_trains_inside_a_sequential_with_any_optimiser(genome: Genome) -> None:
    torch.manual_seed(0)
    model = nn.Sequential(GenomeNetwork(genome), nn.Linear(2, 1))
    optimiser = torch.optim.AdamW(model.parameters(), lr=0.02)
    x = torch.rand(64, 3)
    target = x[:, :1] * x[:, 1:2]
    losses = []
    for _ in range(150):
        loss = (model(x) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.2 * losses[0]
    trained = model[0]
    assert isinstance(trained, GenomeNetwork)
    again = GenomeNetwork(trained.genome())
    torch.testing.assert_close(again(x), trained(x))


def test_its_state_dict_and_its_copy_are_exact(genome: Genome) -> None:
    network, x = GenomeNetwork(genome), torch.rand(7, 3)
    other = GenomeNetwork(genome.with_weights(np.zeros(genome.link_weight.size)))
    assert not torch.equal(other(x), network(x))
    other.load_state_dict(network.state_dict())
    assert torch.equal(other(x), network(x))
    assert torch.equal(copy.deepcopy(network)(x), network(x))
    assert network.genome().to_json() == genome.to_json()


def test_it_follows_to(genome: Genome) -> None:
    double = GenomeNetwork(genome).to(torch.float64)
    assert double(torch.rand(2, 3, dtype=torch.float64)).dtype == torch.float64
    meta = GenomeNetwork(genome).to("meta")
    assert meta(torch.rand(2, 3, device="meta")).device.type == "meta"


@pytest.mark.parametrize("strict", [False, True])
def test_it_exports(genome: Genome, strict: bool) -> None:
    network = GenomeNetwork(genome)
    rows = torch.export.Dim("rows", min=2)
    program = torch.export.export(
        network, (torch.rand(4, 3),), dynamic_shapes=({0: rows},), strict=strict
    )
    x = torch.rand(9, 3)
    torch.testing.assert_close(program.module()(x), network(x))
    assert network.double()(x.double()).dtype == torch.float64


def test_a_population_exports_after_a_replacement(genome: Genome) -> None:
    network = PopulationNetwork([genome, genome])
    network.replace(1, genome.with_weights(np.ones(genome.link_weight.size)))
    x = torch.rand(2, 4, 3)
    program = torch.export.export(network, (x,))
    torch.testing.assert_close(program.module()(x), network(x))
    assert network.double()(x.double()).dtype == torch.float64


def test_it_compiles_as_one_graph(genome: Genome) -> None:
    network, x = GenomeNetwork(genome), torch.rand(4, 3)
    compiled = torch.compile(network, backend="eager", fullgraph=True)
    torch.testing.assert_close(compiled(x), network(x))
