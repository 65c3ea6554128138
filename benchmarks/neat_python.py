"""neat-python beside us: the same topologies as its networks, and its own breeding."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from neatq_torch.genome import Genome, NodeKind

neat: Any = import_module("neat")  # of the extra `bench`; without types
genes: Any = import_module("neat.genes")

CONFIG = Path(__file__).with_suffix(".cfg")


def configuration() -> Any:
    """The settings in `neat_python.cfg`: 20 inputs, 3 outputs, a population of 1,000."""
    return neat.Config(
        neat.DefaultGenome,
        neat.DefaultReproduction,
        neat.DefaultSpeciesSet,
        neat.DefaultStagnation,
        str(CONFIG),
    )


def population(size: int, seed: int) -> Any:
    """A population of so many fully connected genomes, sorted into species."""
    config = configuration()
    config.pop_size = size
    return neat.Population(config, seed=seed)


def network(genome: Genome, config: Any) -> Any:
    """The same computation: links of the bias become the biases of their targets."""
    other = neat.DefaultGenome(genome.genome_id)
    keys = _keys(genome)
    for key in keys[genome.node_kind > NodeKind.BIAS].tolist():
        other.nodes[key] = _node(key)
    bias = genome.node_kind[genome.source_index] == NodeKind.BIAS
    for link in np.flatnonzero(genome.link_enabled):
        source, target = (int(keys[i[link]]) for i in (genome.source_index, genome.target_index))
        weight = float(genome.link_weight[link])
        if bias[link]:
            other.nodes[target].bias += 0.2 * weight
        else:
            other.connections[source, target] = _link(source, target, weight, int(link))
    return neat.nn.FeedForwardNetwork.create(other, config)


def _keys(genome: Genome) -> np.ndarray:
    """neat-python's names: inputs -1, -2, ..., outputs 0, 1, ..., then hidden nodes."""
    keys = np.zeros(genome.node_id.size, np.int64)
    for kind, first, step in (
        (NodeKind.INPUT, -1, -1),
        (NodeKind.OUTPUT, 0, 1),
        (NodeKind.HIDDEN, len(genome.output_ids), 1),
    ):
        here = np.flatnonzero(genome.node_kind == kind)
        keys[here] = first + step * np.arange(len(here))
    return keys


def _node(key: int) -> Any:
    gene = genes.DefaultNodeGene(key)
    gene.activation, gene.aggregation = "sigmoid", "sum"
    gene.bias, gene.response = 0.0, 0.2  # its sigmoid has slope 5, ours 1
    return gene


def _link(source: int, target: int, weight: float, innovation: int) -> Any:
    gene = genes.DefaultConnectionGene((source, target), innovation=innovation)
    gene.weight, gene.enabled = weight, True
    return gene
