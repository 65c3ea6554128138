"""MultiNEAT beside us: the same topologies, node by node and link by link."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.compiled import evaluation_order
from neatq_torch.genome import Genome, NodeKind, node_levels

multineat: Any = import_module("multineat")  # of the extra `bench`; compiled, without stubs

_KINDS = {
    NodeKind.INPUT: multineat.NeuronType.INPUT,
    NodeKind.BIAS: multineat.NeuronType.BIAS,
    NodeKind.OUTPUT: multineat.NeuronType.OUTPUT,
    NodeKind.HIDDEN: multineat.NeuronType.HIDDEN,
}


class Network:
    """One network, propagated as often as it is deep: then its outputs have settled."""

    def __init__(self, genome: Genome) -> None:
        links, _ = evaluation_order(genome)
        source, target = genome.source_index[links], genome.target_index[links]
        levels = node_levels(source, target, genome.node_id.size)
        assert levels is not None
        self.depth = max(1, int(levels[genome.node_kind == NodeKind.OUTPUT].max()))
        # MultiNEAT takes the first neurons for inputs and the next for outputs.
        order = np.argsort(genome.node_kind, kind="stable")
        place = np.argsort(order)
        self.network = multineat.NeuralNetwork()
        for node in order:
            self.network.AddNeuron(_neuron(_KINDS[NodeKind(genome.node_kind[node])]))
        weights = genome.link_weight[links]
        for one, other, weight in zip(place[source], place[target], weights, strict=True):
            self.network.AddConnection(_connection(int(one), int(other), float(weight)))
        sensors = int((genome.node_kind <= NodeKind.BIAS).sum())
        self.network.SetInputOutputDimentions(sensors, len(genome.output_ids))

    def activate(self, inputs: list[float]) -> Sequence[float]:
        """Outputs for inputs and bias (1), in one list."""
        network = self.network
        network.Input(inputs)
        for _ in range(self.depth):
            network.ActivateFast()
        return network.Output()


def _neuron(kind: Any) -> Any:
    neuron = multineat.Neuron()
    neuron.type = kind
    neuron.activation_function_type = multineat.ActivationFunction.UNSIGNED_SIGMOID
    neuron.a, neuron.b = 1.0, 0.0  # slope and shift
    return neuron


def _connection(source: int, target: int, weight: float) -> Any:
    link = multineat.Connection()
    link.source_neuron_idx, link.target_neuron_idx, link.weight = source, target, weight
    link.recur_flag = False
    return link
