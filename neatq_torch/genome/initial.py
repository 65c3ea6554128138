"""Genomes to start from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    sensors = inputs + bias
    return _genome(
        (inputs, bias, outputs, 0),
        sources=np.tile(np.arange(1, sensors + 1), outputs),
        targets=np.repeat(np.arange(sensors + 1, sensors + outputs + 1), sensors),
        rng=rng,
        activation=activation,
        observation_schema=observation_schema,
        genome_id=genome_id,
    )


def layered_genome(
    inputs: int,
    outputs: int,
    *,
    hidden: int,
    rng: np.random.Generator,
    bias: bool = True,
    activation: str = "sigmoid",
    observation_schema: str = "",
    genome_id: int = 0,
) -> Genome:
    """Return a genome with one hidden layer, as networks of fixed structure have it.

    Every input and the bias are linked to every hidden node, every hidden node and the bias to
    every output; inputs and outputs are not linked. Hidden nodes have the ids behind the outputs.

    Args:
        inputs: number of inputs, without the bias.
        outputs: number of outputs.
        hidden: number of hidden nodes.
        rng: draws the weights.
        bias: whether there is a bias node.
        activation: activation of hidden nodes and outputs.
        observation_schema: name of the meaning and order of the inputs.
        genome_id: number of the genome in its run.
    """
    sources, targets = _forward_pairs(inputs + bias, outputs, hidden)
    from_sensor, into_output = sources <= inputs + bias, targets <= inputs + bias + outputs
    is_bias = bias & (sources == inputs + 1)
    kept = np.flatnonzero((from_sensor & ~into_output) | (into_output & (~from_sensor | is_bias)))
    return _genome(
        (inputs, bias, outputs, hidden),
        sources=sources[kept],
        targets=targets[kept],
        rng=rng,
        activation=activation,
        observation_schema=observation_schema,
        genome_id=genome_id,
    )


def random_genome(
    inputs: int,
    outputs: int,
    *,
    hidden: int,
    rng: np.random.Generator,
    bias: bool = True,
    activation: str = "sigmoid",
    observation_schema: str = "",
    genome_id: int = 0,
    link_prob: float = 0.3,
) -> Genome:
    """Return a genome of random topology: 1 to `hidden` hidden nodes, forward links by chance.

    Links may leave sensors and hidden nodes, and enter outputs and hidden nodes of higher number.
    The same link has the same innovation in all genomes made with the same numbers.

    Args:
        inputs: number of inputs, without the bias.
        outputs: number of outputs.
        hidden: largest number of hidden nodes, at least 1.
        rng: draws topology and weights.
        bias: whether there is a bias node.
        activation: activation of hidden nodes and outputs.
        observation_schema: name of the meaning and order of the inputs.
        genome_id: number of the genome in its run.
        link_prob: probability of each possible link; 0.3 is that of the line which the authors of
            NEAT left in their experiments for this purpose.
    """
    here = int(rng.integers(1, hidden + 1))
    sources, targets = _forward_pairs(inputs + bias, outputs, hidden)
    last = inputs + bias + outputs + here
    chosen = rng.random(sources.size) < link_prob
    kept = np.flatnonzero(chosen & (sources <= last) & (targets <= last))
    return _genome(
        (inputs, bias, outputs, here),
        sources=sources[kept],
        targets=targets[kept],
        innovations=kept + 1,
        rng=rng,
        activation=activation,
        observation_schema=observation_schema,
        genome_id=genome_id,
    )


def _forward_pairs(
    sensors: int, outputs: int, hidden: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (sources, targets) of all links that point forward, as node ids."""
    first = sensors + outputs + 1
    everybody = [*range(1, sensors + 1), *range(first, first + hidden)]
    within = [(source, one) for one in everybody[sensors:] for source in everybody if source < one]
    out = [(source, sensors + 1 + one) for one in range(outputs) for source in everybody]
    sources, targets = np.array(within + out, dtype=np.int64).T
    return sources, targets


def _genome(
    sizes: tuple[int, bool, int, int],
    *,
    sources: NDArray[np.int64],
    targets: NDArray[np.int64],
    rng: np.random.Generator,
    activation: str,
    observation_schema: str,
    genome_id: int,
    innovations: NDArray[np.int64] | None = None,
) -> Genome:
    """Return a genome of (inputs, bias, outputs, hidden) nodes and links between node ids."""
    inputs, bias, outputs, hidden = sizes
    if inputs < 1 or outputs < 1:
        raise ValueError(
            f"a genome needs at least 1 input and 1 output, not {inputs} and {outputs}."
        )
    kinds = [NodeKind.INPUT] * inputs + [NodeKind.BIAS] * bias + [NodeKind.OUTPUT] * outputs
    kinds += [NodeKind.HIDDEN] * hidden
    activations = [0] * (inputs + bias) + [activation_index(activation)] * (outputs + hidden)
    links = sources.size
    return Genome(
        genome_id=genome_id,
        observation_schema=observation_schema,
        node_id=np.arange(1, len(kinds) + 1, dtype=np.int32),
        node_kind=np.array(kinds, dtype=np.uint8),
        node_activation=np.array(activations, dtype=np.uint8),
        link_innovation=np.arange(1, links + 1) if innovations is None else innovations,
        link_source=sources.astype(np.int32),
        link_target=targets.astype(np.int32),
        link_weight=mutated_weights(np.zeros(links, dtype=np.float32), START, rng),
        link_enabled=np.ones(links, dtype=bool),
        link_recurrent=np.zeros(links, dtype=bool),
    )
