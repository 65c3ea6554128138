"""Genomes to start from."""

from __future__ import annotations

from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.mutation import MutationConfig, mutated_weights
from neatq_torch.genome.rules import ACTIVATIONS, NodeKind, index_of

START_WEIGHTS = MutationConfig(weight_mutation_power=1.0)
"""Start weights are one mutation of zeros by power 1, as in OpenNERO."""


class Settings(TypedDict, total=False):
    """What every genome to start from can be given.

    Attributes:
        activation: activation of outputs and hidden nodes; "sigmoid" without it.
        observation_schema: name of the meaning and order of the inputs.
        genome_id: number of the genome in its run.
    """

    activation: str
    observation_schema: str
    genome_id: int


def initial_genome(
    inputs: int,
    outputs: int,
    *,
    rng: np.random.Generator,
    bias: bool = True,
    **settings: Unpack[Settings],
) -> Genome:
    """Return a genome with every input and the bias linked to every output.

    Node ids are 1..inputs, then the bias, then the outputs; innovations run from 1 over the
    inputs of the first output, then of the second. Weights are mostly U(-1, 1), some are 0.

    Args:
        inputs: number of inputs, without the bias.
        outputs: number of outputs.
        rng: draws the weights.
        bias: whether there is a bias node.
        settings: see `Settings`.

    Raises:
        ValueError: there is no input or no output.
        GenomeError: the activation is unknown.
    """
    sources, targets = _forward_pairs(inputs + bias, outputs, 0)
    return _genome((inputs, bias, outputs, 0), sources, targets, rng, **settings)


def layered_genome(
    inputs: int,
    outputs: int,
    *,
    hidden: int,
    rng: np.random.Generator,
    bias: bool = True,
    hidden_activation: str | None = None,
    **settings: Unpack[Settings],
) -> Genome:
    """Return a genome with one hidden layer, as networks of fixed structure have it.

    Every input and the bias are linked to every hidden node, every hidden node and the bias to
    every output; inputs and outputs are not linked. Hidden nodes have the ids behind the outputs;
    their activation is that of the outputs, unless another is given. For all that is not said here
    see `initial_genome`.
    """
    sources, targets = _forward_pairs(inputs + bias, outputs, hidden)
    from_sensor, into_output = sources <= inputs + bias, targets <= inputs + bias + outputs
    is_bias = bias & (sources == inputs + 1)
    kept = (from_sensor & ~into_output) | (into_output & (~from_sensor | is_bias))
    sizes = inputs, bias, outputs, hidden
    genome = _genome(sizes, sources[kept], targets[kept], rng, **settings)
    if hidden_activation is None:
        return genome
    code = index_of(hidden_activation, ACTIVATIONS, "hidden_activation")
    kinds = np.where(genome.node_kind == NodeKind.HIDDEN, code, genome.node_activation)
    return genome.unchecked(node_activation=kinds.astype(np.uint8))


def random_genome(
    inputs: int,
    outputs: int,
    *,
    hidden: int,
    rng: np.random.Generator,
    bias: bool = True,
    link_prob: float = 0.3,
    **settings: Unpack[Settings],
) -> Genome:
    """Return a genome of random topology: 1 to `hidden` hidden nodes, forward links by chance.

    Links may leave sensors and hidden nodes, and enter outputs and hidden nodes of higher number.
    The same link has the same innovation in all genomes made with the same numbers. `link_prob` is
    the probability of each possible link; 0.3 is that of the line which the authors of NEAT left in
    their experiments for this purpose. For all that is not said here see `initial_genome`.
    """
    here = int(rng.integers(1, hidden + 1))
    sources, targets = _forward_pairs(inputs + bias, outputs, hidden)
    last = inputs + bias + outputs + here
    chosen = rng.random(sources.size) < link_prob
    kept = np.flatnonzero(chosen & (sources <= last) & (targets <= last))
    sizes = inputs, bias, outputs, here
    return _genome(sizes, sources[kept], targets[kept], rng, innovations=kept + 1, **settings)


def _forward_pairs(
    sensors: int, outputs: int, hidden: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return (sources, targets) of all links that point forward, as node ids."""
    first = sensors + outputs + 1
    everybody = [*range(1, sensors + 1), *range(first, first + hidden)]
    within = [(source, one) for one in everybody[sensors:] for source in everybody if source < one]
    out = [(source, sensors + 1 + one) for one in range(outputs) for source in everybody]
    sources, targets = np.array(within + out, dtype=np.int32).reshape(-1, 2).T
    return sources, targets


def _genome(
    sizes: tuple[int, bool, int, int],
    sources: NDArray[np.int32],
    targets: NDArray[np.int32],
    rng: np.random.Generator,
    *,
    innovations: NDArray[np.int64] | None = None,
    activation: str = "sigmoid",
    observation_schema: str = "",
    genome_id: int = 0,
) -> Genome:
    """Return a genome of (inputs, bias, outputs, hidden) nodes and links between node ids."""
    inputs, bias, outputs, hidden = sizes
    if inputs < 1 or outputs < 1:
        raise ValueError(
            f"a genome needs at least 1 input and 1 output, not {inputs} and {outputs}."
        )
    nodes, links = inputs + bias + outputs + hidden, sources.size
    code = index_of(activation, ACTIVATIONS, "activation")
    return Genome(
        genome_id=genome_id,
        observation_schema=observation_schema,
        node_id=np.arange(1, nodes + 1, dtype=np.int32),
        # The kinds stand in this order: input, bias, output, hidden.
        node_kind=np.repeat(np.array(list(NodeKind), dtype=np.uint8), sizes),
        node_activation=np.repeat(np.array([0, 0, code, code], dtype=np.uint8), sizes),
        link_innovation=np.arange(1, links + 1) if innovations is None else innovations,
        link_source=sources,
        link_target=targets,
        link_weight=mutated_weights(np.zeros(links, dtype=np.float32), START_WEIGHTS, rng),
        link_enabled=np.ones(links, dtype=bool),
        link_recurrent=np.zeros(links, dtype=bool),
    )
