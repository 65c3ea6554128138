"""Questions about the forward links of a genome, as compiled loops over them."""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter

import numpy as np
from numpy.typing import NDArray

from neatq_torch.jit import cached_njit

NodeIndices = NDArray[np.integer]


@cached_njit()
def node_levels(sources: NodeIndices, targets: NodeIndices, nodes: int) -> NDArray[np.int32] | None:
    """Return for each node the length of the longest path of links that ends in it.

    Links [links] lead from and to indices (not ids) of nodes. The levels are int32 [nodes], 0 for
    nodes without incoming links; None if the links form a cycle.
    """
    levels = np.zeros(nodes, dtype=np.int32)
    changed = True
    while changed:
        changed = False
        for link in range(sources.size):
            level = levels[sources[link]] + 1
            if level > levels[targets[link]]:
                levels[targets[link]] = level
                changed = True
                if level >= nodes:
                    return None
    return levels


@cached_njit()
def reaches(
    sources: NodeIndices, targets: NodeIndices, nodes: int, source: int, target: int
) -> bool:
    """Tell whether a path of links leads from node `source` to node `target` (indices).

    A node reaches itself. The links may contain cycles.
    """
    reached = np.zeros(nodes, dtype=np.bool_)
    reached[source] = True
    changed = True
    while changed and not reached[target]:
        changed = False
        for link in range(sources.size):
            if reached[sources[link]] and not reached[targets[link]]:
                reached[targets[link]] = changed = True
    return bool(reached[target])


def find_cycle(sources: NodeIndices, targets: NodeIndices) -> list[int]:
    """Return node indices along one cycle of the links, the first again at the end; or []."""
    sorter: TopologicalSorter[int] = TopologicalSorter()
    for source, target in zip(sources.tolist(), targets.tolist(), strict=True):
        sorter.add(target, source)
    try:
        sorter.prepare()
    except CycleError as error:
        return error.args[1]
    return []
