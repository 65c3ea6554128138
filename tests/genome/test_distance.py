from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.genome import (
    DistanceConfig,
    Genome,
    InnovationLedger,
    LinkTable,
    MutationConfig,
    compatibility,
    first_compatible,
    initial_genome,
    mutate,
)
from neatq_torch.genome.distance import KNOWN_GROUPS
from neatq_torch.genome.rules import LINK_FIELDS

PLAIN = DistanceConfig()


def test_distance_is_computed_by_hand(make_genome: Callable[..., Genome]) -> None:
    # Matching 1 and 4: weights 0.5 and 1 apart. Disjoint: 2 and 3. Excess: 6 and 7.
    a = make_genome([(1, 1, 4, 0.5), (2, 2, 4, 1.0), (4, 3, 4, 2.0)])
    b = make_genome(
        [(1, 1, 4, 0.0), (3, 1, 5, 1.0), (4, 3, 4, 1.0), (6, 2, 5, 1.0), (7, 5, 4, 1.0)],
        hidden=(5,),
    )
    assert compatibility(a, b, PLAIN) == pytest.approx(2 + 2 + 0.4 * 0.75)
    other = DistanceConfig(disjoint=10.0, excess=100.0, weight=1.0)
    assert compatibility(a, b, other) == pytest.approx(20 + 200 + 0.75)


def test_counts_are_divided_by_the_larger_genome_only_when_it_is_large() -> None:
    rng = np.random.default_rng(0)
    few, many = initial_genome(1, 3, rng=rng), initial_genome(9, 3, rng=rng)
    few = few.with_weights(many.link_weight[:6])
    normalised = DistanceConfig(weight=0.0, normalised=True)
    assert few.link_innovation.size == 6
    assert many.link_innovation.size == 30
    assert compatibility(few, many, DistanceConfig(weight=0.0)) == 24.0
    assert compatibility(few, many, normalised) == pytest.approx(24.0 / 30.0)
    medium = initial_genome(5, 3, rng=rng)  # 18 links, fewer than 20
    assert compatibility(few, medium, normalised) == 12.0


def test_genomes_without_links_have_a_distance(
    make_genome: Callable[..., Genome], small: Genome
) -> None:
    empty = make_genome([])
    assert compatibility(empty, empty, PLAIN) == 0.0
    assert compatibility(empty, small, PLAIN) == 5.0
    assert compatibility(small, empty, PLAIN) == 5.0


def test_distance_sees_learned_weights(small: Genome) -> None:
    learned = small.with_weights(small.link_weight + np.float32(1.0))
    assert compatibility(small, learned, PLAIN) == pytest.approx(0.4)


@given(st.lists(st.tuples(st.integers(1, 4), st.integers(1, 4)), min_size=1, max_size=5))
def test_distances_are_symmetric(shapes: list[tuple[int, int]]) -> None:
    rng = np.random.default_rng(1)
    genomes = [initial_genome(*shape, rng=rng) for shape in shapes]
    there = [compatibility(genomes[0], one, PLAIN) for one in genomes]
    assert there == [compatibility(one, genomes[0], PLAIN) for one in genomes]
    assert there[0] == 0.0


def table_of(genomes: list[Genome]) -> LinkTable:
    table = LinkTable()
    table.write(range(len(genomes)), genomes)
    return table


def regrouped(
    groups: list[list[int]], order: list[int], place: list[float], threshold: float
) -> list[list[int]]:
    """Regroup points on a line, member by member."""
    groups = [list(members) for members in groups]
    for one in order:
        close = [g for g in groups if g and abs(place[g[0]] - place[one]) < threshold]
        home = close[0] if close else []
        if one in home:
            continue
        next(group for group in groups if one in group).remove(one)
        if not home:
            groups.append(home)
        home.append(one)
    return groups


def test_regrouping_is_that_of_members_who_move_one_by_one() -> None:
    one, rng = initial_genome(1, 1, rng=np.random.default_rng(0)), np.random.default_rng(0)
    for _ in range(300):
        place, group = rng.integers(16, size=12) / 8, rng.integers(4, size=12)
        rows, order = rng.permutation(12), rng.permutation(12)
        groups = [rows[group[rows] == one] for one in np.unique(group)]
        table = table_of([one.with_weights([where, where]) for where in place])
        threshold = float(rng.integers(2, 10) / 8)
        moved = table.regroup(groups, order, threshold, DistanceConfig(weight=1.0))
        before = [members.tolist() for members in groups]
        expected = regrouped(before, order.tolist(), place.tolist(), threshold)
        assert [members.tolist() for members in moved] == expected


def test_a_row_may_hold_a_longer_or_a_shorter_genome_than_before(small: Genome) -> None:
    short = small.replaced(**{name: getattr(small, name)[:3] for name in LINK_FIELDS})
    table, order = table_of([short, short, short]), np.arange(3)
    for row, genome, expected in [
        (0, short, [[0, 1, 2]]),
        (1, small, [[0, 2], [1]]),
        (1, short.with_weights([9.0] * 3), [[0, 2], [1]]),
        (1, short, [[0, 1, 2]]),
    ]:
        table.write([row], [genome])
        groups = table.regroup([np.array([0, 1, 2])], order, 1.0, PLAIN)
        assert [members.tolist() for members in groups] == expected


def test_a_table_that_remembers_distances_regroups_as_a_new_one() -> None:
    rng = np.random.default_rng(0)
    genomes = [initial_genome(2, 2, rng=rng, genome_id=number) for number in range(40)]
    table, groups, config = table_of(genomes), [np.arange(40)], DistanceConfig(weight=1.0)
    most = 0
    for turn in range(200):
        rows = rng.integers(40, size=rng.integers(4)).tolist()
        for row in rows:
            genomes[row] = initial_genome(2, 2, rng=rng, genome_id=row)
        table.write(rows, [genomes[row] for row in rows])
        groups = [rng.permutation(one) for one in groups if one.size]
        order, threshold = rng.permutation(40), float(rng.uniform(0.2, 1.2))
        if turn == 100:
            config = DistanceConfig(weight=2.0)
        expected = table_of(genomes).regroup(groups, order, threshold, config)
        groups = table.regroup(groups, order, threshold, config)
        assert [one.tolist() for one in groups] == [one.tolist() for one in expected]
        most = max(most, len(groups))
    assert most > KNOWN_GROUPS


def test_genomes_without_links_are_regrouped(make_genome: Callable[..., Genome]) -> None:
    table = table_of([make_genome([]), make_genome([])])
    (group,) = table.regroup([np.array([0]), np.array([1])], np.arange(2), 1.0, PLAIN)[:1]
    assert group.tolist() == [0, 1]


@pytest.mark.parametrize(
    "config",
    [
        DistanceConfig(weight=0.0),
        DistanceConfig(disjoint=0.3, excess=0.7),
        DistanceConfig(normalised=True),
    ],
)
def test_regrouping_measures_as_compatibility_does(config: DistanceConfig) -> None:
    rng = np.random.default_rng(0)
    founders = [initial_genome(8, 3, rng=rng, genome_id=number) for number in range(30)]
    ledger, growth = InnovationLedger.for_genomes(founders), MutationConfig(add_link_prob=0.9)
    genomes = [
        reduce(lambda one, _: mutate(one, growth, ledger, rng), range(8), g) for g in founders
    ]
    table, pair = table_of(genomes), [np.array([0]), np.arange(1, 30)]
    apart = np.array([compatibility(genomes[0], one, config) for one in genomes])
    for threshold in [*apart[1:], *np.nextafter(apart[1:], np.inf)]:
        first, *_ = table.regroup(pair, np.arange(30), threshold, config)
        assert sorted(first) == np.flatnonzero(apart < threshold).tolist()


def test_a_negative_coefficient_is_refused() -> None:
    with pytest.raises(ValueError, match=r"excess: expected \[0, inf\), got -1.0"):
        DistanceConfig(excess=-1.0)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.3, 1.0, 3.0]), st.integers(0, 4))
def test_genomes_are_sorted_as_by_comparing_one_after_the_other(
    seed: int, threshold: float, groups: int
) -> None:
    rng = np.random.default_rng(seed)
    config = MutationConfig(add_node_prob=0.3, add_link_prob=0.3)
    genomes = [initial_genome(2, 1, rng=rng)]
    ledger = InnovationLedger.for_genomes(genomes)
    for _ in range(15):
        genomes.append(mutate(genomes[rng.integers(len(genomes))], config, ledger, rng))
    leaders, rest = genomes[:groups], genomes[groups:]
    found = first_compatible(rest, leaders, threshold, PLAIN)
    for one, group in zip(rest, found.tolist(), strict=True):
        close = [compatibility(one, leader, PLAIN) < threshold for leader in leaders]
        assert group == (close.index(True) if any(close) else len(leaders))
        if group == len(leaders):
            leaders.append(one)
