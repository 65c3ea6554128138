"""From genomes to integer tensors: the one place that knows where a link's weight is kept.

A network's values stand in one row of `Layout.rows` places::

    [ inputs | bias | state | hidden | outputs | spare ]

and its weights in one row of `Layout.columns` places::

    [ outputs x (inputs + bias), dense | other links ]

Links from an input to an output, with which every NEAT genome starts, are the dense part: one
batched matrix product for the whole population. All other links are sparse: they are grouped by
the level of their source, and a level adds `value[source] * weight[column]` to its targets. A
place that is not in use reads and writes the network's spare value, which is always zero, so one
genome is replaced by writing its own rows and nobody else's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from neatq_torch.genome.genome import ACTIVATIONS, Genome, NodeKind
from neatq_torch.genome.graph import node_levels

Evaluation = Literal["settle", "synchronous"]
"""`settle`: forward links are evaluated in order within one call; recurrent links read the call
before. `synchronous`: one propagation a call, every link out of a hidden or output node reads the
call before (Stanley's C++ NEAT, OpenNERO)."""

_IDENTITY = ACTIVATIONS.index("identity")
_REGION_BITS = 24
_INPUT, _STATE, _HIDDEN, _OUTPUT = (region << _REGION_BITS for region in range(4))

Indices = NDArray[np.int64]
_NONE = np.empty(0, np.int64)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How many places each network of a population has.

    Attributes:
        inputs: Observations of a network, without the bias.
        outputs: Outputs of a network.
        state: Values that recurrent links read from the call before.
        hidden: Hidden nodes.
        sparse: Links outside the dense part.
        level_links: Sparse links of each level.
        level_nodes: Nodes that pass values on, of each level; level 0 has none.
    """

    inputs: int
    outputs: int
    state: int = 0
    hidden: int = 0
    sparse: int = 0
    level_links: tuple[int, ...] = ()
    level_nodes: tuple[int, ...] = ()

    @property
    def dense(self) -> int:
        """Columns of the dense part."""
        return self.outputs * (self.inputs + 1)

    @property
    def columns(self) -> int:
        """Columns of the weight parameter."""
        return self.dense + self.sparse

    @property
    def first_hidden(self) -> int:
        """Row of the first hidden node."""
        return self.inputs + 1 + self.state

    @property
    def rows(self) -> int:
        """Values of one network, the spare one included."""
        return self.first_hidden + self.hidden + self.outputs + 1

    def row(self, address: Indices) -> Indices:
        """The value rows [n] of addresses [n] (region and index in one number)."""
        first = np.array(
            [0, self.inputs + 1, self.first_hidden, self.first_hidden + self.hidden], np.int64
        )
        return first[address >> _REGION_BITS] + (address & ((1 << _REGION_BITS) - 1))

    def holds(self, other: Layout) -> bool:
        """Whether a network that needs `other` fits."""
        return (
            (self.inputs, self.outputs) == (other.inputs, other.outputs)
            and self.state >= other.state
            and self.hidden >= other.hidden
            and self.sparse >= other.sparse
            and _covers(self.level_links, other.level_links)
            and _covers(self.level_nodes, other.level_nodes)
        )

    @staticmethod
    def union(layouts: Sequence[Layout]) -> Layout:
        """The smallest layout that holds all of `layouts`."""
        depth = max(len(layout.level_links) for layout in layouts)

        def widest(name: str) -> tuple[int, ...]:
            sizes = [getattr(layout, name) for layout in layouts]
            return tuple(max((s[i] for s in sizes if len(s) > i), default=0) for i in range(depth))

        return Layout(
            inputs=layouts[0].inputs,
            outputs=layouts[0].outputs,
            state=max(layout.state for layout in layouts),
            hidden=max(layout.hidden for layout in layouts),
            sparse=max(layout.sparse for layout in layouts),
            level_links=widest("level_links"),
            level_nodes=widest("level_nodes"),
        )

    def with_slack(self) -> Layout:
        """A layout in which the next genomes fit as well: a quarter more, and at least four."""

        def more(size: int) -> int:
            return size + max(4, size // 4)

        links = self.level_links or (0,)
        return Layout(
            inputs=self.inputs,
            outputs=self.outputs,
            state=more(self.state) if self.state else 0,
            hidden=more(self.hidden),
            sparse=more(self.sparse),
            level_links=tuple(map(more, links)),
            level_nodes=(0, *map(more, self.level_nodes[1:])),
        )


def _covers(sizes: tuple[int, ...], needed: tuple[int, ...]) -> bool:
    return len(sizes) >= len(needed) and all(
        size >= need for size, need in zip(sizes, needed, strict=False)
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class GenomePlan:
    """One genome in evaluation order, independent of any population.

    Places are addresses (region and index); `Layout.row` turns them into rows.

    Attributes:
        need: The smallest layout that holds it.
        enabled: Positions of the enabled links in the genome [enabled].
        column: Weight column of each enabled link [enabled].
        state: Addresses whose values the state keeps [state].
        levels: For each level its sparse links (source, target, column) and the nodes to activate
            before them (address, activation).
        hidden_activation: Activation of each hidden node at the end of a call [hidden]; identity
            for those that a level has activated.
        output_activation: The same of each output [outputs].
    """

    need: Layout
    enabled: Indices
    column: Indices
    state: Indices
    levels: tuple[tuple[Indices, Indices, Indices, Indices, Indices], ...]
    hidden_activation: Indices
    output_activation: Indices


def compile_genome(genome: Genome, evaluation: Evaluation) -> GenomePlan:
    """Put a genome's enabled links and nodes in evaluation order.

    Args:
        genome: A valid genome.
        evaluation: `settle` or `synchronous`.

    Returns:
        Its plan. Disabled links take no part.
    """
    address = _addresses(genome)
    inputs, outputs = len(genome.input_ids), len(genome.output_ids)
    enabled = np.flatnonzero(genome.link_enabled)
    source, target = genome.source_index[enabled], genome.target_index[enabled]
    from_input = address[source] < _STATE
    delayed = ~from_input if evaluation == "synchronous" else genome.link_recurrent[enabled]
    dense = from_input & ~delayed & (address[target] >= _OUTPUT)
    levels = _levels(address, source[~delayed], target[~delayed])
    link_level = np.where(delayed | from_input, 0, levels[source])

    state = np.unique(source[delayed])
    source_address = address[source]
    source_address[delayed] = _STATE + np.searchsorted(state, source[delayed])
    column = np.empty(len(enabled), np.int64)
    column[dense] = (address[target[dense]] - _OUTPUT) * (inputs + 1) + address[source[dense]]
    column[~dense] = outputs * (inputs + 1) + np.arange((~dense).sum())

    activation = genome.node_activation.astype(np.int64)
    grouped = []
    for level in range(int(link_level[~dense].max(initial=-1)) + 1):
        links = np.flatnonzero(~dense & (link_level == level))
        nodes = np.unique(source[links]) if level else _NONE
        ends = source_address[links], address[target[links]], column[links]
        grouped.append((*ends, address[nodes], activation[nodes]))
        activation[nodes] = _IDENTITY
    hidden = np.flatnonzero((address >= _HIDDEN) & (address < _OUTPUT))
    output = np.flatnonzero(address >= _OUTPUT)
    return GenomePlan(
        need=Layout(
            inputs=inputs,
            outputs=outputs,
            state=len(state),
            hidden=len(hidden),
            sparse=int((~dense).sum()),
            level_links=tuple(len(level[0]) for level in grouped),
            level_nodes=tuple(len(level[3]) for level in grouped),
        ),
        enabled=enabled,
        column=column,
        state=address[state],
        levels=tuple(grouped),
        hidden_activation=activation[hidden],
        output_activation=activation[output],
    )


def _levels(address: Indices, source: Indices, target: Indices) -> Indices:
    """The level of each node [nodes]: 0 for inputs, at least 1 for all others."""
    others = np.flatnonzero(address >= _HIDDEN)
    ground = np.full(len(others), len(address))
    levels = node_levels(
        np.concatenate([source, ground]), np.concatenate([target, others]), len(address) + 1
    )
    assert levels is not None, "a valid genome has no cycle of forward links"
    return levels[:-1].astype(np.int64)


def _addresses(genome: Genome) -> Indices:
    """The address of each node [nodes]: its region and its index there, in node order."""
    kind = genome.node_kind
    address = np.empty(len(kind), np.int64)
    for node_kind, region in (
        (NodeKind.INPUT, _INPUT),
        (NodeKind.OUTPUT, _OUTPUT),
        (NodeKind.HIDDEN, _HIDDEN),
    ):
        here = np.flatnonzero(kind == node_kind)
        address[here] = region + np.arange(len(here))
    address[kind == NodeKind.BIAS] = _INPUT + (kind == NodeKind.INPUT).sum()
    return address


@dataclass(eq=False, kw_only=True)
class Level:
    """One level of all networks.

    Attributes:
        source, target: Value rows of the links, flat over networks [networks * links].
        column: Weight places of the links, flat over networks [networks * links].
        node: Value rows to activate first, flat over networks [networks * nodes].
        activation: Their activations [networks * nodes, 1].
    """

    source: Tensor
    target: Tensor
    column: Tensor
    node: Tensor
    activation: Tensor

    @staticmethod
    def empty(networks: int, links: int, nodes: int) -> Level:
        """A level with places for that many links and nodes of each network."""
        return Level(
            source=torch.zeros(networks * links, dtype=torch.long),
            target=torch.zeros(networks * links, dtype=torch.long),
            column=torch.zeros(networks * links, dtype=torch.long),
            node=torch.zeros(networks * nodes, dtype=torch.long),
            activation=torch.zeros(networks * nodes, 1, dtype=torch.long),
        )


class Plan:
    """The evaluation order of a whole population.

    It is deliberately no `nn.Module`: code that swaps a module's parameters and buffers for others
    (functional calls, target networks) must never bring back an old topology.

    Attributes:
        layout: Places of each network.
        levels: One `Level` for each level of links.
        state_row: Value rows that the state keeps, flat over networks [networks * state].
        activation: Activation at the end of a call [networks, hidden + outputs, 1].
        live: 1 where a dense weight belongs to a link, else 0 [networks, dense].
        activations: Indices of the activations that occur anywhere.
    """

    def __init__(self, plans: Sequence[GenomePlan], layout: Layout) -> None:
        networks = len(plans)
        self.layout = layout
        self.activations: tuple[int, ...] = ()
        self.levels = [
            Level.empty(networks, links, nodes)
            for links, nodes in zip(layout.level_links, layout.level_nodes, strict=True)
        ]
        self.state_row = torch.zeros(networks * layout.state, dtype=torch.long)
        nodes = layout.hidden + layout.outputs
        self.activation = torch.zeros(networks, nodes, 1, dtype=torch.long)
        self.live = torch.zeros(networks, layout.dense)
        for index, plan in enumerate(plans):
            self.write(index, plan)

    def apply(self, convert: Callable[[Tensor], Tensor]) -> None:
        """Move or cast every tensor, as `nn.Module.to` does with its buffers."""
        for holder in (self, *self.levels):
            for name, value in vars(holder).items():
                if isinstance(value, Tensor):
                    setattr(holder, name, convert(value))

    def write(self, index: int, plan: GenomePlan) -> None:
        """Put one network's plan in place; it must fit (`layout.holds(plan.need)`)."""
        layout = self.layout
        row, column = index * layout.rows, index * layout.columns
        spare = row + layout.rows - 1
        for number, level in enumerate(self.levels):
            used = plan.levels[number] if number < len(plan.levels) else (_NONE,) * 5
            source, target, place, node, activation = used
            _put(level.source, index, layout.level_links[number], row + layout.row(source), spare)
            _put(level.target, index, layout.level_links[number], row + layout.row(target), spare)
            _put(level.column, index, layout.level_links[number], column + place, column)
            _put(level.node, index, layout.level_nodes[number], row + layout.row(node), spare)
            codes = level.activation.view(-1)
            _put(codes, index, layout.level_nodes[number], activation, _IDENTITY)
        _put(self.state_row, index, layout.state, row + layout.row(plan.state), spare)
        hidden = np.full(layout.hidden, _IDENTITY, np.int64)
        hidden[: len(plan.hidden_activation)] = plan.hidden_activation
        final = np.concatenate([hidden, plan.output_activation])
        self.activation[index, :, 0] = torch.from_numpy(final)
        live = np.zeros(layout.dense, np.float32)
        live[plan.column[plan.column < layout.dense]] = 1
        self.live[index] = torch.from_numpy(live)
        early = [code for level in plan.levels for code in level[4].tolist()]
        self.activations = tuple(sorted({*self.activations, *final.tolist(), *early}))


def _put(flat: Tensor, index: int, size: int, values: Indices, fill: int) -> None:
    """Write one network's `size` places of a flat tensor; `fill` stands in those not in use."""
    padded = np.full(size, fill, np.int64)
    padded[: len(values)] = values
    flat[index * size : (index + 1) * size] = torch.from_numpy(padded)
