from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from neatq_torch.genome import (
    CrossoverConfig,
    Genome,
    GenomeError,
    first_is_fitter,
    initial_genome,
    multipoint,
)

Parents = tuple[Genome, Genome]
ALL, FITTER = CrossoverConfig(), CrossoverConfig(keep_all_genes=False)
multipoint_average = partial(multipoint, average=True)
CROSSOVERS = [multipoint, multipoint_average]


@pytest.fixture
def parents(make_genome: Callable[..., Genome]) -> Parents:
    """Matching 1 and 4; the first has 2 alone, the second 3, 6 and 7 with hidden node 5."""
    first = make_genome([(1, 1, 4, 0.5), (2, 2, 4, 1.0), (4, 3, 4, 2.0)], genome_id=1)
    links = [(1, 1, 4, 0.25), (3, 1, 5, 3.0), (4, 3, 4, 1.0), (6, 2, 5, 4.0), (7, 5, 4, 5.0)]
    return first, make_genome(links, hidden=(5,), genome_id=2)


@pytest.mark.parametrize("cross", CROSSOVERS)
@pytest.mark.parametrize("first_fitter", [True, False])
def test_all_genes_of_both_parents_pass(
    parents: Parents, cross: Callable[..., Genome], first_fitter: bool
) -> None:
    child = cross(*parents, first_fitter, ALL, np.random.default_rng(0))
    assert child.link_innovation.tolist() == [1, 2, 3, 4, 6, 7]
    assert child.link_weight[[1, 2, 4, 5]].tolist() == [1.0, 3.0, 4.0, 5.0]
    assert sorted(child.node_id.tolist()) == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("cross", CROSSOVERS)
def test_only_extra_genes_of_the_fitter_parent_pass(
    parents: Parents, cross: Callable[..., Genome]
) -> None:
    rng = np.random.default_rng(0)
    assert cross(*parents, True, FITTER, rng).link_innovation.tolist() == [1, 2, 4]
    assert cross(*parents, True, FITTER, rng).node_id.tolist() == [1, 2, 3, 4]
    assert cross(*parents, False, FITTER, rng).link_innovation.tolist() == [1, 3, 4, 6, 7]
    assert cross(*parents, False, FITTER, rng).node_id.tolist() == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("first_fitter", [True, False])
def test_each_matching_gene_comes_from_either_parent_half_of_the_time(
    parents: Parents, first_fitter: bool
) -> None:
    rng = np.random.default_rng(0)
    children = [multipoint(*parents, first_fitter, ALL, rng).link_weight for _ in range(1000)]
    from_first = np.array([[child[0] == 0.5, child[3] == 2.0] for child in children])
    from_second = np.array([[child[0] == 0.25, child[3] == 1.0] for child in children])
    assert (from_first ^ from_second).all()
    assert from_first.mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.06)
    both = (from_first[:, 0] & from_first[:, 1]).mean()
    assert both == pytest.approx(0.25, abs=0.06)


def test_averaged_genes_have_the_mean_weight(parents: Parents) -> None:
    child = multipoint_average(*parents, True, ALL, np.random.default_rng(0))
    assert child.link_weight.tolist() == [0.375, 1.0, 3.0, 1.5, 4.0, 5.0]


def test_the_mean_of_huge_weights_is_finite(parents: Parents) -> None:
    huge = np.full(3, 3e38, dtype=np.float32)
    first = parents[0].with_weights(huge)
    child = multipoint_average(first, first, True, ALL, np.random.default_rng(0))
    assert child.link_weight.tolist() == huge.tolist()


@pytest.mark.parametrize("cross", CROSSOVERS)
@pytest.mark.parametrize("disabled_in", [(True, False), (False, True), (True, True)])
def test_a_disabled_gene_is_inherited_disabled_in_75_percent(
    parents: Parents, cross: Callable[..., Genome], disabled_in: tuple[bool, bool]
) -> None:
    first = parents[0].replaced(link_enabled=[not disabled_in[0], True, True])
    second = parents[1].replaced(link_enabled=[not disabled_in[1], True, True, True, True])
    rng = np.random.default_rng(0)
    enabled = np.array([cross(first, second, True, ALL, rng).link_enabled for _ in range(2000)])
    assert 1 - enabled[:, 0].mean() == pytest.approx(0.75, abs=0.04)
    assert enabled[:, 1:].all()


def test_copied_genes_may_stay_disabled_as_in_opennero(parents: Parents) -> None:
    # 75 % by the coin; of the rest, half are taken from the parent that has it disabled.
    first = parents[0].replaced(link_enabled=[False, True, True])
    config, rng = CrossoverConfig(copy_disabled=True), np.random.default_rng(0)
    enabled = [multipoint(first, parents[1], True, config, rng).link_enabled for _ in range(2000)]
    assert 1 - np.mean(enabled, axis=0)[0] == pytest.approx(0.875, abs=0.03)
    twins = [multipoint(first, first, True, config, rng).link_enabled[0] for _ in range(50)]
    assert not any(twins)


def test_a_disjoint_gene_keeps_its_switch(parents: Parents) -> None:
    second = parents[1].replaced(link_enabled=[True, False, True, True, True])
    child = multipoint(parents[0], second, True, ALL, np.random.default_rng(0))
    assert child.link_enabled.tolist() == [True, True, False, True, True, True]


def test_a_cycle_leaves_the_child_with_the_genes_of_the_fitter_parent(
    make_genome: Callable[..., Genome],
) -> None:
    common = [(1, 1, 5, 1.0), (2, 2, 6, 1.0), (3, 5, 4, 1.0), (4, 6, 7, 1.0), (5, 7, 4, 1.0)]
    hidden = (5, 6, 7)
    first = make_genome([*common, (6, 7, 5, 1.0)], hidden=hidden)
    second = make_genome([*common, (7, 5, 6, 1.0)], hidden=hidden)
    rng = np.random.default_rng(0)
    child = multipoint(first, second, True, ALL, rng)
    assert child.link_innovation.tolist() == [1, 2, 3, 4, 5, 6]
    child = multipoint(first, second, False, ALL, rng)
    assert child.link_innovation.tolist() == [1, 2, 3, 4, 5, 7]


@pytest.mark.parametrize("first_fitter", [True, False])
def test_of_opposite_forward_links_the_older_stays(
    make_genome: Callable[..., Genome], first_fitter: bool
) -> None:
    common = [(1, 1, 5, 1.0), (2, 2, 6, 1.0), (3, 5, 4, 1.0), (4, 6, 4, 1.0)]
    first = make_genome([*common, (6, 6, 5, 1.0)], hidden=(5, 6))
    second = make_genome([*common, (5, 5, 6, 1.0)], hidden=(5, 6))
    child = multipoint(first, second, first_fitter, ALL, np.random.default_rng(0))
    assert child.link_innovation.tolist() == [1, 2, 3, 4, 5]


def test_one_link_under_two_numbers_passes_once(make_genome: Callable[..., Genome]) -> None:
    first = make_genome([(1, 1, 4, 0.5), (8, 2, 4, 1.0)])
    second = make_genome([(1, 1, 4, 0.5), (9, 2, 4, 2.0)])
    child = multipoint(first, second, False, ALL, np.random.default_rng(0))
    assert child.link_innovation.tolist() == [1, 8]


def test_of_equally_fit_parents_the_smaller_one_counts_as_fitter() -> None:
    rng = np.random.default_rng(0)
    large, small = initial_genome(3, 1, rng=rng), initial_genome(3, 1, rng=rng)
    small = small.replaced(**{name: getattr(small, name)[:2] for name in LINKS})
    assert first_is_fitter(small, large, 1.0, 1.0)
    assert not first_is_fitter(large, small, 1.0, 1.0)
    assert first_is_fitter(large, small, 1.1, 1.0)
    assert not first_is_fitter(small, large, 1.0, 1.1)


LINKS = [
    "link_innovation",
    "link_source",
    "link_target",
    "link_weight",
    "link_enabled",
    "link_recurrent",
]


def test_parents_with_other_inputs_or_meaning_cannot_mate(parents: Parents) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(GenomeError, match="differ in their observation schema"):
        multipoint(parents[0], parents[1].replaced(observation_schema="x"), True, ALL, rng)
    other = initial_genome(3, 1, rng=rng)
    with pytest.raises(GenomeError, match="only genomes with the same ones can mate"):
        multipoint(parents[0], other, True, ALL, rng)


def test_a_probability_beyond_one_is_refused() -> None:
    with pytest.raises(ValueError, match=r"inherit_disabled_prob: expected \[0, 1\], got 1.5"):
        CrossoverConfig(inherit_disabled_prob=1.5)
