"""The plans of all networks side by side, in arrays with room to spare."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from neatq_torch.network.levels import Levels
from neatq_torch.network.plan import GenomePlan, Layout, Program


class Plan:
    """The evaluation order of a population and the room that it has.

    It is deliberately no `nn.Module`: code that swaps a module's parameters and buffers for others
    (functional calls, target networks) must never bring back an old topology.

    Attributes:
        layout: Room of each network.
        program: The evaluation order.
        version: Number of changes so far.
    """

    def __init__(self, plans: Sequence[GenomePlan]) -> None:
        self.layout = Layout.union([plan.need for plan in plans]).with_slack()
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
        for index, plan in enumerate(plans):
            self.write(index, plan)

    def write(self, index: int, plan: GenomePlan) -> None:
        """Put one network's plan in place, after making room for it where it needs more."""
        if not self.layout.holds(plan.need):
            self._make_room(Layout.union([self.layout, plan.need.with_slack()]))
        self.version += 1
        self._levels = None
        program, need = self.program, plan.need
        program.size[index] = need.instructions, need.state, need.hidden
        program.instruction[index, : need.instructions] = plan.instruction
        program.source[index, : need.sparse] = plan.source
        program.kept[index, : need.state] = plan.kept
        program.live[index] = False
        program.live[index, plan.column[plan.column < need.dense]] = True

    def levels(self, device: torch.device) -> Levels:
        """The evaluation order for torch operations; made when first asked for after a change."""
        if self._levels is not None and self._levels.live.device == device:
            return self._levels
        levels = Levels.build(self.program, self.layout, device)
        if type(levels.live) is torch.Tensor:  # not the fake tensor of somebody who traces
            self._levels = levels
        return levels

    def _make_room(self, layout: Layout) -> None:
        """Give every array as many columns as `layout` asks for."""
        program, self.layout = self.program, layout
        self.program = program._replace(
            instruction=_widened(program.instruction, layout.instructions),
            source=_widened(program.source, layout.sparse),
            kept=_widened(program.kept, layout.state),
        )


def _widened(array: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """`array` [networks, old, ...] as [networks, size, ...], with zeros in the new places."""
    wide = np.zeros((len(array), size, *array.shape[2:]), array.dtype)
    wide[:, : array.shape[1]] = array
    return wide
