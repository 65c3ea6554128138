from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.genome.heredity import node_levels, reaches
from neatq_torch.genome.rules import find_cycle

PAIRS = st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=20)


def split(pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return ends[:, 0], ends[:, 1]


def closure(pairs: list[tuple[int, int]]) -> np.ndarray:
    """Which node reaches which in at least one step, by Warshall's algorithm."""
    reach = np.zeros((8, 8), dtype=bool)
    for source, target in pairs:
        reach[source, target] = True
    for via in range(8):
        reach |= np.outer(reach[:, via], reach[via])
    return reach


def test_the_level_of_a_node_is_its_longest_path() -> None:
    sources, targets = split([(0, 3), (0, 1), (1, 2), (2, 3)])
    levels = node_levels(sources, targets, 5)
    assert levels is not None
    assert levels.tolist() == [0, 1, 2, 3, 0]


def test_a_graph_without_links_is_all_level_zero() -> None:
    levels = node_levels(*split([]), 2)
    assert levels is not None
    assert levels.tolist() == [0, 0]


@given(PAIRS)
def test_levels_exist_exactly_where_there_is_no_cycle(pairs: list[tuple[int, int]]) -> None:
    sources, targets = split(pairs)
    levels = node_levels(sources, targets, 8)
    assert (levels is None) == bool(closure(pairs).diagonal().any())
    if levels is not None:
        assert (levels[sources] < levels[targets]).all()


@given(PAIRS, st.integers(0, 7), st.integers(0, 7))
def test_reaches_agrees_with_the_transitive_closure(
    pairs: list[tuple[int, int]], source: int, target: int
) -> None:
    expected = source == target or bool(closure(pairs)[source, target])
    assert reaches(*split(pairs), 8, source, target) == expected


@given(PAIRS)
def test_a_cycle_that_is_found_consists_of_links(pairs: list[tuple[int, int]]) -> None:
    cycle = find_cycle(*split(pairs))
    assert bool(cycle) == bool(closure(pairs).diagonal().any())
    assert set(itertools.pairwise(cycle)) <= set(pairs)
    assert cycle[:1] == cycle[-1:]
