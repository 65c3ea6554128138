"""Networks that balance two poles, each until it fails: all of it compiled.

Networks propagate once an action, in double precision, as the authors' program does: a node adds
up what its sources had after the action before, inputs what they have now. That is what
`PopulationNetwork(genomes, evaluation="synchronous")` computes with a bias of 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_envs.double_pole import PLACES, SCALES, step_row
from neatq_experiments.double_pole_rules import WOBBLE_STEPS
from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind

BIAS = 0.5
"""What the bias node has, as in the authors' program."""

STEEP_SIGMOID = ACTIVATIONS.index("steep_sigmoid")


class Networks(NamedTuple):
    """Networks one after the other. Nodes of each: inputs, bias, the output, hidden nodes.

    Attributes:
        nodes: of each network, int64 [networks].
        first: its first link, and the end, int64 [networks + 1].
        source: node that a link comes from, int64 [links].
        target: node that it leads to, int64 [links].
        weight: float64 [links].
    """

    nodes: NDArray[np.int64]
    first: NDArray[np.int64]
    source: NDArray[np.int64]
    target: NDArray[np.int64]
    weight: NDArray[np.float64]


def networks_of(genomes: Sequence[Genome]) -> Networks:
    """Lay out genomes with a bias, one output and nodes with steep sigmoids."""
    nodes, links, ends = [], [], [0]
    for genome in genomes:
        order = np.argsort(genome.node_kind, kind="stable")
        if (genome.node_activation[genome.node_kind >= NodeKind.OUTPUT] != STEEP_SIGMOID).any():
            raise ValueError(f"genome {genome.genome_id}: expected steep sigmoids only")
        number = {node: index for index, node in enumerate(genome.node_id[order].tolist())}
        on = genome.link_enabled
        ends_of = zip(genome.link_source[on].tolist(), genome.link_target[on].tolist(), strict=True)
        links += [(number[source], number[target]) for source, target in ends_of]
        nodes.append(len(number))
        ends.append(len(links))
    source, target = np.array(links, np.int64).reshape(-1, 2).T.copy()
    weight = np.concatenate([one.link_weight[one.link_enabled] for one in genomes])
    return Networks(np.array(nodes), np.array(ends), source, target, weight.astype(np.float64))


def balance(
    genomes: Sequence[Genome],
    state: NDArray[np.float64],
    limit: int,
    *,
    velocities: bool = True,
    wobble: NDArray[np.float64] | None = None,
    bias: float = BIAS,
) -> NDArray[np.int64]:
    """Let networks balance, each from its own start, until all have failed.

    Args:
        genomes: [rows] whose networks act.
        state: float64 [rows, 6], where they start; written.
        limit: most actions.
        velocities: whether networks see them.
        wobble: float64 [rows, 100] zeros, to be filled with a row's |x| + |x'| + |angle| + |angle'|
            (of the long pole) after each of its last 100 actions.
        bias: what the bias node has.

    Returns:
        How many actions each survived, int64 [rows].
    """
    survived = np.zeros(len(state), np.int64)
    if not survived.size:
        return survived
    seen = np.arange(6) if velocities else PLACES
    keep = np.zeros((len(state), WOBBLE_STEPS)) if wobble is None else wobble
    _balance(networks_of(genomes), state, limit, bias, seen, SCALES[seen], keep, survived)
    return survived


# Not kept on disk: numba does not notice when `step_row`, in another file, has changed.
@njit(error_model="numpy")
def _balance(
    networks: Networks,
    state: NDArray[np.float64],
    limit: int,
    bias: float,
    seen: NDArray[np.int64],
    scale: NDArray[np.float64],
    wobble: NDArray[np.float64],
    survived: NDArray[np.int64],
) -> None:
    output = len(seen) + 1
    for row in range(len(state)):
        now, nodes = state[row], networks.nodes[row]
        value, total = np.zeros(nodes), np.zeros(nodes)
        value[output - 1] = bias
        for action in range(limit):
            for i in range(len(seen)):
                value[i] = now[seen[i]] / scale[i]
            total[output:] = 0.0
            for link in range(networks.first[row], networks.first[row + 1]):
                source, target = networks.source[link], networks.target[link]
                total[target] += networks.weight[link] * value[source]
            for node in range(output, nodes):
                value[node] = 1.0 / (1.0 + np.exp(-4.9 * total[node]))
            if not step_row(now, value[output]):
                break
            survived[row] += 1
            wobble[row, action % WOBBLE_STEPS] = (
                abs(now[0]) + abs(now[1]) + abs(now[2]) + abs(now[3])
            )
