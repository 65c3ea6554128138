"""The plans of all networks side by side, and their evaluation by torch operations.

Those serve every device and every transform. The networks are one graph, evaluated level by level:
a level adds all links into its nodes, then activates them. No step waits for the device, and none
is a loop over networks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from neatq_torch.genome.rules import ACTIVATIONS
from neatq_torch.network.plan import IDENTITY, GenomePlan, Indices, Layout, Program


def _sigmoid(x: Tensor) -> Tensor:
    """The logistic function, with the same bits wherever a value stands in the tensor.

    `torch.sigmoid` computes whole vectors in one way and the rest of a tensor in another, which
    can differ in the last bit: a network's outputs would depend on what stands beside it.
    """
    return torch.tanh(0.5 * x) * 0.5 + 0.5


_FUNCTIONS = {
    "identity": lambda x: x,
    "sigmoid": _sigmoid,
    "steep_sigmoid": lambda x: _sigmoid(4.9 * x),
    "tanh": torch.tanh,
    "relu": torch.relu,
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Level:
    """One level of all networks; rows and columns count through all networks.

    Attributes:
        source, target: Value rows of its links [links].
        column: Weights of its links, counted through all networks [links].
        node: Value rows that it activates [nodes].
        activation: Their activations [nodes, 1].
        activations: Those that occur; none where it has no nodes.
        links: How many there are. Counted here: while somebody traces, `len` of a tensor warns.
    """

    source: Tensor
    target: Tensor
    column: Tensor
    node: Tensor
    activation: Tensor
    activations: tuple[int, ...]
    links: int

    def activate(self, sums: Tensor) -> Tensor:
        """Apply to each row of `sums` [nodes, batch] its own activation."""
        first, *others = self.activations
        result = _FUNCTIONS[ACTIVATIONS[first]](sums)
        for code in others:
            other = _FUNCTIONS[ACTIVATIONS[code]](sums)
            result = torch.where(self.activation == code, other, result)
        return result


@dataclass(frozen=True, eq=False, kw_only=True)
class Levels:
    """The evaluation order of a population as torch tensors on one device.

    All networks have as many rows here: ``[ inputs | bias | outputs | state | hidden ]``, with the
    largest state and the most hidden nodes of the population.

    Attributes:
        layout: Room of each network.
        networks: How many there are.
        levels: In evaluation order.
        live: Whether a link belongs to a dense column [networks, dense].
        kept: Value rows that the states keep [values].
        kept_at: Where in the states they are kept [values].
        spread: Which of the packed weights each column is [columns], their number for none; see
            `Plan.packed`.
    """

    layout: Layout
    networks: int
    levels: tuple[Level, ...]
    live: Tensor
    kept: Tensor
    kept_at: Tensor
    spread: Tensor | None

    @staticmethod
    def build(
        program: Program, layout: Layout, device: torch.device, packed: Indices | None = None
    ) -> Levels:
        """Sort a program's links and nodes into levels, for all networks at once."""

        def tensor(values: np.ndarray) -> Tensor:
            # While torch.export traces, `to` would make a fake tensor even of one that is there.
            made = torch.from_numpy(values)
            return made if device.type == "cpu" else made.to(device)

        network, number = _used(program.size[:, 0], layout.instructions)
        first, rows, links, code, level = program.instruction[network, number].astype(np.int64).T
        total = np.bincount(network, links, len(program.size)).astype(np.int64)
        link_network, link = _used(total, layout.sparse)
        source = _row(program, layout, link_network, program.source[link_network, link])
        target = np.repeat(_row(program, layout, network, first), links)
        column = link_network * layout.columns + layout.dense + link
        link_level = np.repeat(level, links)

        active = np.flatnonzero(code != IDENTITY)
        node = np.repeat(active, rows[active])
        within = np.arange(len(node)) - np.repeat(np.cumsum(rows[active]), rows[active])
        row = first[node] + rows[node] + within
        row = _row(program, layout, network[node], row)
        levels = []
        for number in np.union1d(link_level, level[active]):
            here, nodes = np.flatnonzero(link_level == number), level[node] == number
            levels.append(
                Level(
                    source=tensor(source[here]),
                    target=tensor(target[here]),
                    column=tensor(column[here]),
                    node=tensor(row[nodes]),
                    activation=tensor(code[node][nodes][:, None]),
                    activations=tuple(np.unique(code[node][nodes]).tolist()),
                    links=len(here),
                )
            )
        network, number = _used(program.size[:, 1], layout.state)
        return Levels(
            layout=layout,
            networks=len(program.size),
            levels=tuple(levels),
            live=tensor(program.live.copy()),
            kept=tensor(_row(program, layout, network, program.kept[network, number])),
            kept_at=tensor(network * layout.state + number),
            spread=None if packed is None else tensor(_places(packed, layout.columns)),
        )

    def evaluate(self, weight: Tensor, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate every network on its observations.

        Args:
            weight: [networks, columns], or packed.
            observation: [..., inputs]; the leading dimensions are networks and batch, flat or not.
            state: [..., state], from the call before.

        Returns:
            Outputs [..., outputs] and the state for the next call: `state` itself if it is empty.
        """
        layout, networks, lead = self.layout, self.networks, observation.shape[:-1]
        batch = math.prod(lead) // networks
        if self.spread is not None:
            weight = nn.functional.pad(weight, (0, 1)).index_select(1, self.spread)
        observation = observation.reshape(networks, batch, layout.inputs)
        sensors = torch.cat([observation, observation.new_ones(networks, batch, 1)], 2)
        dense = torch.where(self.live, weight[:, : layout.dense], 0)
        sums = _product(sensors, dense.view(networks, layout.inputs + 1, layout.outputs))
        rows = [sensors, sums]
        if layout.state:
            rows.append(state.reshape(networks, batch, layout.state))
        if layout.hidden:
            rows.append(observation.new_zeros(networks, batch, layout.hidden))
        values = torch.cat(rows, 2).transpose(1, 2)
        flat = values.reshape(networks * layout.rows, batch)
        columns = weight.reshape(-1)
        for level in self.levels:
            if level.links:
                passed = flat.index_select(0, level.source)
                passed = passed * columns.index_select(0, level.column).unsqueeze(1)
                if torch.onnx.is_in_onnx_export() and torch._C._get_tracing_state() is not None:
                    flat = flat + _sums(level.target, networks * layout.rows, passed)
                else:
                    flat.index_add_(0, level.target, passed)
            if level.activations:
                active = level.activate(flat.index_select(0, level.node))
                flat.index_put_((level.node,), active)
        values = flat.view(networks, layout.rows, batch).transpose(1, 2)
        output = values[..., layout.inputs + 1 : layout.first_state].reshape(*lead, layout.outputs)
        if not layout.state:
            return output, state
        kept = flat.new_zeros(networks * layout.state, batch)
        kept = kept.index_put((self.kept_at,), flat.index_select(0, self.kept))
        kept = kept.view(networks, layout.state, batch).transpose(1, 2)
        return output, kept.reshape(*lead, layout.state)


def _sums(target: Tensor, rows: int, passed: Tensor) -> Tensor:
    """What `passed` [links, batch] adds to each row [rows, batch], by a matrix product.

    The ONNX exporter of before (dynamo=False) keeps one of several links into a row only.
    """
    return nn.functional.one_hot(target, rows).T.to(passed.dtype) @ passed


def _used(sizes: Indices, width: int) -> tuple[Indices, Indices]:
    """Network and number of each entry, where network n uses its first `sizes[n]`."""
    network, number = np.nonzero(np.arange(width) < sizes[:, None])
    return network, number


def _places(packed: Indices, columns: int) -> NDArray[np.int64]:
    """Where in the packed weights each column stands [columns]; behind them, if nowhere."""
    places = np.full(columns, len(packed), np.int64)
    places[packed] = np.arange(len(packed))
    return places


def _row(program: Program, layout: Layout, network: Indices, row: Indices) -> Indices:
    """Rows that count through all networks [n], from each network's own rows [n]."""
    states = program.size[network, 1]
    hidden = row >= layout.first_state + states
    return network * layout.rows + row + np.where(hidden, layout.state - states, 0)


def _product(inputs: Tensor, weight: Tensor) -> Tensor:
    """[networks, batch, outputs] from [networks, batch, inputs] and [networks, inputs, outputs].

    Every network's matrices are padded to begin on a 64-byte border. Matrix products of the CPU
    round differently with the alignment of their operands, so a network's outputs would depend on
    its slot.
    """
    outputs, inner, outer = weight.shape[2], -weight.shape[1] % 16, -weight.shape[2] % 16
    weight = nn.functional.pad(weight, (0, outer, 0, inner))
    return torch.bmm(nn.functional.pad(inputs, (0, inner)), weight)[..., :outputs]


class Plan:
    """The evaluation order of a population and the room that it has.

    It is deliberately no `nn.Module`: code that swaps a module's parameters and buffers for others
    (functional calls, target networks) must never bring back an old topology.

    Attributes:
        layout: Room of each network.
        program: The evaluation order.
        version: Number of changes so far.
        packed: The columns that belong to a link, where the parameter has these alone [links];
            None if it has all columns.
    """

    def __init__(self, plans: Sequence[GenomePlan], *, exact: bool = False) -> None:
        """Plan several genomes with room to grow, or a single one without (`exact`)."""
        need = Layout.union([plan.need for plan in plans])
        self.layout = need if exact else need.with_slack()
        self.packed: Indices | None = None
        if exact and len(plans[0].column) < need.columns:
            self.packed = np.sort(plans[0].column)
        layout, networks = self.layout, len(plans)
        self.program = Program(
            size=np.zeros((networks, 3), np.int32),
            instruction=np.zeros((networks, layout.instructions, 5), np.int32),
            source=np.zeros((networks, layout.sparse), np.int32),
            kept=np.zeros((networks, layout.state), np.int32),
            live=np.zeros((networks, layout.dense), np.bool_),
        )
        self.version = 0
        self._levels: Levels | None = None
        for slot, plan in enumerate(plans):
            self.write(slot, plan)

    @property
    def columns(self) -> int:
        """Columns of the weight parameter."""
        return self.layout.columns if self.packed is None else len(self.packed)

    def place(self, column: Indices) -> Indices:
        """Where the parameter has the weights of columns [n] of the layout."""
        return column if self.packed is None else np.searchsorted(self.packed, column)

    def widened(self, weight: NDArray[np.float32]) -> NDArray[np.float32]:
        """The weights in all columns of the layout [networks, columns]."""
        if self.packed is None:
            return weight
        wide = np.zeros((1, self.layout.columns), np.float32)
        wide.put(self.packed, weight)
        return wide

    def narrowed(self, wide: NDArray[np.float32]) -> NDArray[np.float32]:
        """What the parameter has of all columns [networks, columns]; undoes `widened`."""
        return wide if self.packed is None else wide.take(self.packed, 1)

    def write(self, slot: int, plan: GenomePlan) -> None:
        """Put a genome's plan in a slot, after making room for it where it needs more."""
        if Layout.union([self.layout, plan.need]) != self.layout:
            self._make_room(Layout.union([self.layout, plan.need.with_slack()]))
        self.version += 1
        self._levels = None
        program, need = self.program, plan.need
        program.size[slot] = need.instructions, need.state, need.hidden
        program.instruction[slot, : need.instructions] = plan.instruction
        program.source[slot, : need.sparse] = plan.source
        program.kept[slot, : need.state] = plan.kept
        program.live[slot] = False
        program.live[slot, plan.column[plan.column < need.dense]] = True

    def levels(self, device: torch.device) -> Levels:
        """The evaluation order for torch operations; made when first asked for after a change."""
        if self._levels is not None and self._levels.live.device == device:
            return self._levels
        tracing = torch._C._get_tracing_state()
        go_on: Callable[[object], None] = torch._C._set_tracing_state  # pyright: ignore
        go_on(None)  # for torch.jit.trace, what is made here is a constant
        try:
            levels = Levels.build(self.program, self.layout, device, self.packed)
        finally:
            go_on(tracing)
        if type(levels.live) is torch.Tensor:  # not the fake tensor of somebody who traces
            self._levels = levels
        return levels

    def _make_room(self, layout: Layout) -> None:
        """Give every array as many columns as `layout` asks for, with zeros behind."""

        def wide(array: NDArray[np.int32], columns: int) -> NDArray[np.int32]:
            new = [(0, 0), (0, columns - array.shape[1]), *[(0, 0)] * (array.ndim - 2)]
            return np.pad(array, new)

        program, self.layout = self.program, layout
        self.program = program._replace(
            instruction=wide(program.instruction, layout.instructions),
            source=wide(program.source, layout.sparse),
            kept=wide(program.kept, layout.state),
        )
