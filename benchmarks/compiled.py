"""The limit of the same graphs: a compiled loop over links that lie ready in order.

It can do nothing else: no gradients, no recurrent links, no replacement of a network, one
activation and one observation. What a general module costs beside it is the price of being general.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind, node_levels

try:
    njit: Any = import_module("numba").njit
except ImportError:  # then there is no such line
    njit = None

SIGMOID = ACTIVATIONS.index("sigmoid")
Array = NDArray[np.float32]


def compiled(genomes: list[Genome]) -> Callable[[Array], Array] | None:
    """A function from observations [networks, inputs] to outputs; None without numba.

    Raises:
        ValueError: If a genome has recurrent links or another activation than sigmoid.
    """
    if njit is None:
        return None
    first = genomes[0]
    inputs, outputs = len(first.input_ids), len(first.output_ids)
    node_first, output, link_first, source, weight = _flattened(genomes)
    run = njit(_evaluate)

    def forward(observation: Array) -> Array:
        result = np.empty((len(genomes), outputs), np.float32)
        run(observation, node_first, output, link_first, source, weight, inputs, result)
        return result

    forward(np.zeros((len(genomes), inputs), np.float32))  # compile
    return forward


def evaluation_order(genome: Genome) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Enabled links [links] and hidden and output nodes [nodes], each after what it reads."""
    activations = genome.node_activation[genome.node_kind > NodeKind.BIAS]
    if genome.link_recurrent.any() or (activations != SIGMOID).any():
        raise ValueError(f"genome {genome.genome_id}: expected forward links and sigmoids alone")
    enabled = np.flatnonzero(genome.link_enabled)
    levels = node_levels(
        genome.source_index[enabled], genome.target_index[enabled], genome.node_id.size
    )
    assert levels is not None
    nodes = np.flatnonzero(genome.node_kind > NodeKind.BIAS)
    return enabled, nodes[np.argsort(levels[nodes], kind="stable")]


def _flattened(genomes: list[Genome]) -> list[NDArray]:
    """First node of each network, then of nodes: output or -1, first link; then of links."""
    node_first, output, link_first, source, weight = [0], [], [0], [], []
    for genome in genomes:
        links, nodes = evaluation_order(genome)
        place = np.empty(genome.node_id.size, np.int64)
        fixed = np.flatnonzero(genome.node_kind <= NodeKind.BIAS)
        order = [*fixed[np.argsort(genome.node_kind[fixed], kind="stable")], *nodes]
        place[order] = np.arange(len(order))
        is_output = genome.node_kind == NodeKind.OUTPUT
        number = np.where(is_output, np.cumsum(is_output) - 1, -1)
        for node in nodes:
            incoming = links[genome.target_index[links] == node]
            source.extend(place[genome.source_index[incoming]])
            weight.extend(genome.link_weight[incoming])
            link_first.append(len(source))
            output.append(number[node])
        node_first.append(len(output))
    whole = [np.array(part, np.int32) for part in (node_first, output, link_first, source)]
    return [*whole, np.array(weight, np.float32)]


def _evaluate(
    observation: Array,
    node_first: NDArray[np.int32],
    output: NDArray[np.int32],
    link_first: NDArray[np.int32],
    source: NDArray[np.int32],
    weight: Array,
    inputs: int,
    result: Array,
) -> None:
    most = 0
    for network in range(len(observation)):
        most = max(most, node_first[network + 1] - node_first[network])
    value = np.empty(inputs + 1 + most, np.float32)
    value[inputs] = 1.0
    for network in range(len(observation)):
        value[:inputs] = observation[network]
        place = inputs + 1
        for node in range(node_first[network], node_first[network + 1]):
            total = np.float32(0.0)
            for link in range(link_first[node], link_first[node + 1]):
                total += weight[link] * value[source[link]]
            value[place] = np.float32(1.0) / (np.float32(1.0) + math.exp(-total))
            if output[node] >= 0:
                result[network, output[node]] = value[place]
            place += 1
