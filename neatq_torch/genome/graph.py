"""Questions about the forward links of a genome, as compiled loops over them."""

from __future__ import annotations

import numpy as np
from numba import njit
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
    levels = _levels(sources, targets, nodes)
    return None if levels.size < nodes else levels


@njit(cache=True)
def _levels(sources: Indices, targets: Indices, nodes: int) -> NDArray[np.int32]:
    """Return the levels [nodes], an empty array if the links form a cycle."""
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
                    return levels[:0]
    return levels


@njit(cache=True)
def reaches(sources: Indices, targets: Indices, nodes: int, source: int, target: int) -> bool:
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
