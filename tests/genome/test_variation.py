"""Whatever sequence of mutations and crossovers happens, genomes stay sound."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_torch.genome import (
    CrossoverConfig,
    DistanceConfig,
    Genome,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    compatibility,
    initial_genome,
    multipoint,
    mutate,
)
from neatq_torch.genome.genome import COLUMNS

WILD = MutationConfig(
    add_node_prob=0.3,
    add_link_prob=0.6,
    recurrent_link_prob=0.3,
    toggle_enable_prob=0.3,
    reenable_prob=0.2,
)


SHRINKING = replace(WILD, remove_link_prob=0.8, add_node_prob=0.1, add_link_prob=0.2)


def is_sound(genome: Genome) -> bool:
    """Check a genome link by link, without any code of the library."""
    kinds = dict(zip(genome.node_id.tolist(), genome.node_kind.tolist(), strict=True))
    columns = (genome.link_source, genome.link_target, genome.link_recurrent)
    links = list(zip(*(column.tolist() for column in columns), strict=True))
    ends_known = all(source in kinds and target in kinds for source, target, _ in links)
    targets_fit = all(kinds[target] in (NodeKind.OUTPUT, NodeKind.HIDDEN) for _, target, _ in links)
    rising = all(np.diff(genome.link_innovation) > 0) and len(set(links)) == len(links)
    left = [(source, target) for source, target, recurrent in links if not recurrent]
    while left and (free := {s for s, _ in left} - {t for _, t in left}):
        left = [(source, target) for source, target in left if source not in free]
    return ends_known and targets_fit and rising and not left


def evolve(
    seed: int, steps: int, keep_all_genes: bool, mutation: MutationConfig = WILD
) -> list[Genome]:
    rng = np.random.default_rng(seed)
    genomes = [initial_genome(2, 2, rng=rng, genome_id=number) for number in range(4)]
    ledger = InnovationLedger.for_genomes(genomes)
    config = CrossoverConfig(keep_all_genes=keep_all_genes)
    for step in range(steps):
        first, second = (genomes[int(index)] for index in rng.integers(4, size=2))
        average = rng.random() >= 0.5
        child = multipoint(first, second, rng.random() < 0.5, config, rng, average=average)
        child = mutate(child, mutation, ledger, rng)
        genomes[step % 4] = child.replaced(genome_id=4 + step)
    return genomes


@settings(max_examples=40)
@given(
    st.integers(0, 10_000), st.integers(1, 60), st.booleans(), st.sampled_from([WILD, SHRINKING])
)
def test_variation_keeps_every_genome_sound(
    seed: int, steps: int, keep_all: bool, mutation: MutationConfig
) -> None:
    for genome in evolve(seed, steps, keep_all, mutation):
        assert is_sound(genome)
        checked = Genome.from_json(genome.to_json())
        assert checked.to_json() == genome.to_json()
        for name in ("source_index", "target_index", "node_order"):
            assert getattr(genome, name).tolist() == getattr(checked, name).tolist()
        assert not any(getattr(genome, name).flags.writeable for name in COLUMNS)
        assert genome.input_ids.tolist() == [1, 2]
        assert genome.output_ids.tolist() == [4, 5]
        assert np.abs(genome.link_weight).max(initial=0.0) <= 3.0
        assert math.isfinite(compatibility(genome, genome, DistanceConfig()))


def test_wild_variation_grows_structure_of_every_kind() -> None:
    genomes = evolve(seed=0, steps=100, keep_all_genes=True)
    assert min(genome.node_id.size for genome in genomes) > 15
    assert all(genome.link_recurrent.any() for genome in genomes)
    assert all((~genome.link_enabled).any() for genome in genomes)


def test_where_most_mutations_remove_links_genomes_shrink_to_few_and_may_have_none() -> None:
    sizes = [g.link_weight.size for seed in range(9) for g in evolve(seed, 60, False, SHRINKING)]
    assert 0 in sizes
    assert max(sizes) < 15


def test_equal_innovations_are_equal_links_in_the_whole_run() -> None:
    known: dict[int, tuple[int, int, bool]] = {}
    for genome in evolve(seed=1, steps=100, keep_all_genes=True):
        columns = (genome.link_source, genome.link_target, genome.link_recurrent)
        links = zip(*(column.tolist() for column in columns), strict=True)
        for innovation, link in zip(genome.link_innovation.tolist(), links, strict=True):
            assert known.setdefault(innovation, link) == link
    assert len(set(known.values())) == len(known)


def test_the_same_seed_gives_the_same_genomes() -> None:
    pairs = zip(evolve(3, 40, True), evolve(3, 40, True), strict=True)
    assert all(first.to_json() == second.to_json() for first, second in pairs)
