"""Genomes to start from."""

from __future__ import annotations

import numpy as np

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.mutation import mutated_weights
from neatq_torch.genome.mutation_config import MutationConfig
from neatq_torch.genome.vocabulary import NodeKind, activation_index

START = MutationConfig(weight_mutation_power=1.0)
"""Start weights are one mutation of zeros by power 1, as in OpenNERO."""


def initial_genome(
    inputs: int,
    outputs: int,
    *,
    rng: np.random.Generator,
    bias: bool = True,
    activation: str = "sigmoid",
    observation_schema: str = "",
    genome_id: int = 0,
) -> Genome:
    """Return a genome with every input and the bias linked to every output.

    Node ids are 1..inputs, then the bias, then the outputs; innovations run from 1 over the
    inputs of the first output, then of the second. Weights are mostly U(-1, 1), some are 0.

    Args:
        inputs: number of inputs, without the bias.
        outputs: number of outputs.
        rng: draws the weights.
        bias: whether there is a bias node.
        activation: activation of the outputs.
        observation_schema: name of the meaning and order of the inputs.
        genome_id: number of the genome in its run.

    Raises:
        ValueError: there is no input or no output.
        GenomeError: the activation is unknown.
    """
    if inputs < 1 or outputs < 1:
        raise ValueError(
            f"a genome needs at least 1 input and 1 output, not {inputs} and {outputs}."
        )
    kinds = [NodeKind.INPUT] * inputs + [NodeKind.BIAS] * bias + [NodeKind.OUTPUT] * outputs
    sensors = inputs + bias
    activations = [0] * sensors + [activation_index(activation)] * outputs
    links = sensors * outputs
    sources = np.arange(1, sensors + 1, dtype=np.int32)
    targets = np.arange(sensors + 1, sensors + outputs + 1, dtype=np.int32)
    return Genome(
        genome_id=genome_id,
        observation_schema=observation_schema,
        node_id=np.arange(1, sensors + outputs + 1, dtype=np.int32),
        node_kind=np.array(kinds, dtype=np.uint8),
        node_activation=np.array(activations, dtype=np.uint8),
        link_innovation=np.arange(1, links + 1),
        link_source=np.tile(sources, outputs),
        link_target=np.repeat(targets, sensors),
        link_weight=mutated_weights(np.zeros(links, dtype=np.float32), START, rng),
        link_enabled=np.ones(links, dtype=bool),
        link_recurrent=np.zeros(links, dtype=bool),
    )
