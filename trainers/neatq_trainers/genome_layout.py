"""Where the nodes of a genome stand in a drawing, and what they are called."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from neatq_envs.sensors import SCHEMAS, SensorSchema
from neatq_torch.genome import Genome, NodeKind, node_levels

GAP_ROWS = 0.7
"""Extra room between groups of inputs or outputs, such as wall and flag sensors."""
HIDDEN_ROWS = 1.3
"""Least room between two hidden nodes of a column."""


def candidate_names(candidates: int, actions: Sequence[str]) -> tuple[str, ...]:
    """Names of the outputs that `CandidateHeads` reads, in their order.

    Args:
        candidates: K. A single candidate has no Q-value.
        actions: One name for each number of an action, such as "speed" and "turn".
    """
    if candidates == 1:
        return tuple(actions)
    parts = [f"candidate {c} {action}" for c in range(candidates) for action in actions]
    return (*parts, *(f"Q {c}" for c in range(candidates)))


def node_names(
    genome: Genome, input_names: Sequence[str] | None, output_names: Sequence[str] | None
) -> list[str]:
    """One name for each node, in the order of the genome's arrays; that of a hidden node is its id.

    Args:
        genome: Its observation schema gives the names that are left out.
        input_names: One for each input, or None.
        output_names: One for each output, or None.

    Raises:
        ValueError: If there are more or fewer names than nodes.
    """
    schemas = {schema.name: schema for schema in SCHEMAS.values()}
    schema = schemas.get(genome.observation_schema)
    inputs, outputs = genome.input_ids.size, genome.output_ids.size
    if input_names is None:
        input_names = schema.observations if schema else [f"input {i}" for i in range(inputs)]
    if output_names is None:
        output_names = _output_names(outputs, schema)
    for kind, names, count in (("input", input_names, inputs), ("output", output_names, outputs)):
        if len(names) != count:
            raise ValueError(
                f"{kind}_names: expected one name for each of the genome's {count} {kind}s, got "
                f"{len(names)}"
            )
    waiting = {NodeKind.INPUT: iter(input_names), NodeKind.OUTPUT: iter(output_names)}
    waiting[NodeKind.BIAS] = iter(["bias"])
    return [
        str(node) if kind == NodeKind.HIDDEN else next(waiting[NodeKind(kind)]).replace("_", " ")
        for node, kind in zip(genome.node_id.tolist(), genome.node_kind.tolist(), strict=True)
    ]


def _output_names(outputs: int, schema: SensorSchema | None) -> Sequence[str]:
    actions = schema.actions if schema else ()
    for candidates in range(1, outputs + 1) if schema else ():
        names = candidate_names(candidates, actions)
        if len(names) == outputs:
            return names
    return [f"output {i}" for i in range(outputs)]


def node_places(genome: Genome, names: list[str]) -> np.ndarray:
    """Where nodes stand, float64 [nodes, 2]: column (0 = inputs) and row (downwards).

    Args:
        genome: Its hidden nodes stand in columns by level, between inputs and outputs.
        names: One for each node; where the first word of an input's name changes, or what an
            output's name says before its last word, there is a gap between the rows.
    """
    kind = genome.node_kind
    places = np.zeros((kind.size, 2))
    places[:, 0] = _columns(genome)
    sensors = np.flatnonzero(kind <= NodeKind.BIAS)
    sensors = sensors[np.argsort(kind[sensors], kind="stable")]  # the bias below the inputs
    outputs = np.flatnonzero(kind == NodeKind.OUTPUT)
    left = _rows([names[int(node)] for node in sensors], lambda name: name.split(" ")[0])
    right = _rows([names[int(node)] for node in outputs], lambda name: name.rpartition(" ")[0])
    middle = max(left[-1], right[-1]) / 2
    places[sensors, 1] = left + middle - left[-1] / 2
    places[outputs, 1] = right + middle - right[-1] / 2
    places[kind == NodeKind.HIDDEN, 1] = middle
    for _ in range(4):  # hidden nodes move to the middle of their neighbours
        _pull_hidden(genome, places)
    return places


def _columns(genome: Genome) -> np.ndarray:
    """Column of each node: hidden nodes by level, at least 1; outputs behind all of them."""
    kind = genome.node_kind
    hidden = np.flatnonzero(kind == NodeKind.HIDDEN)
    forward = ~genome.link_recurrent
    # One more link from the first input to each hidden node keeps those without any at level 1.
    first = np.full(hidden.size, np.flatnonzero(kind == NodeKind.INPUT)[0])
    sources = np.concatenate([genome.source_index[forward], first])
    targets = np.concatenate([genome.target_index[forward], hidden])
    levels = node_levels(sources, targets, kind.size)
    assert levels is not None  # a genome's forward links form no cycle
    columns = np.zeros(kind.size)
    order, place = np.unique(levels[hidden], return_inverse=True)
    columns[hidden] = place + 1
    columns[kind == NodeKind.OUTPUT] = order.size + 1 if order.size else 2
    return columns


def _rows(names: Sequence[str], group: Callable[[str], str]) -> np.ndarray:
    """One row for each name, with a gap where the next group begins."""
    groups = [group(name) for name in names]
    changes = [a != b for a, b in pairwise(groups)]
    return np.concatenate([[0.0], np.cumsum(1 + GAP_ROWS * np.array(changes, dtype=float))])


def _pull_hidden(genome: Genome, places: np.ndarray) -> None:
    """Move each hidden node to the mean row of its neighbours, one row from the next at least."""
    rows, source, target = places[:, 1], genome.source_index, genome.target_index
    other = source != target
    total, count = np.zeros(rows.size), np.zeros(rows.size)
    for near, far in ((source[other], target[other]), (target[other], source[other])):
        np.add.at(total, near, rows[far])
        np.add.at(count, near, 1)
    wanted = np.where(count > 0, total / np.maximum(count, 1), rows)
    hidden = genome.node_kind == NodeKind.HIDDEN
    for column in np.unique(places[hidden, 0]):
        nodes = np.flatnonzero(hidden & (places[:, 0] == column))
        nodes = nodes[np.argsort(wanted[nodes], kind="stable")]
        room = HIDDEN_ROWS * np.arange(nodes.size)
        free = wanted[nodes] - room
        pushed = np.maximum.accumulate(free) + np.minimum.accumulate(free[::-1])[::-1]
        places[nodes, 1] = pushed / 2 + room
