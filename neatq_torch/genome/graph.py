"""Questions about the forward links of a genome, answered without a loop over links."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.integer]


def node_levels(sources: Indices, targets: Indices, nodes: int) -> NDArray[np.int32] | None:
    """Return for each node the length of the longest path of links that ends in it.

    Args:
        sources: [links] index (not id) of the node each link leaves.
        targets: [links] index of the node each link enters.
        nodes: number of nodes.

    Returns:
        int32 [nodes], 0 for nodes without incoming links; None if the links form a cycle.
    """
    levels = np.zeros(nodes, dtype=np.int32)
    left_sources, left_targets = sources, targets
    level = 0
    while left_sources.size:
        level += 1
        levels[left_targets] = level
        entered = np.zeros(nodes, dtype=bool)
        entered[left_targets] = True
        waiting = entered[left_sources]
        if waiting.all():
            return None
        left_sources, left_targets = left_sources[waiting], left_targets[waiting]
    return levels


def reaches(sources: Indices, targets: Indices, nodes: int, source: int, target: int) -> bool:
    """Tell whether a path of links leads from node `source` to node `target` (indices).

    A node reaches itself. The links may contain cycles.
    """
    reached = np.zeros(nodes, dtype=bool)
    reached[source] = True
    count = 1
    while not reached[target]:
        reached[targets[reached[sources]]] = True
        grown = int(np.count_nonzero(reached))
        if grown == count:
            return False
        count = grown
    return True


def find_cycle(sources: Indices, targets: Indices) -> list[int]:
    """Return node indices along one cycle of the links, [] if there is none.

    Meant for error messages: it walks link by link.
    """
    left_sources, left_targets = sources, targets
    while left_sources.size:
        waiting = np.isin(left_sources, left_targets)
        if waiting.all():
            return _walk_back(left_sources, left_targets)
        left_sources, left_targets = left_sources[waiting], left_targets[waiting]
    return []


def _walk_back(sources: Indices, targets: Indices) -> list[int]:
    """Follow links backwards until a node repeats; every source has an incoming link."""
    incoming = dict(zip(targets.tolist(), sources.tolist(), strict=True))
    path = [int(sources[0])]
    while (before := incoming[path[-1]]) not in path:
        path.append(before)
    return path[path.index(before) :][::-1]
