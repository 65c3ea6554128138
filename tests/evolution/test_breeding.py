"""Compiled breeding gives the very genomes that a plain one, written down here, gives.

The plain one goes genome by genome, with numpy's own generator and a list of links.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_torch.evolution import NEAT_2002, OPENNERO, ReproductionConfig
from neatq_torch.evolution.reproduction import Parent, litters, offspring
from neatq_torch.genome import (
    ACTIVATIONS,
    DistanceConfig,
    Genome,
    GenomeError,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    compatibility,
    initial_genome,
    node_levels,
)
from neatq_torch.genome.genome import COLUMNS, STRUCTURE
from neatq_torch.genome.rules import LINK_FIELDS, NODE_FIELDS
from neatq_torch.jit import cached_njit

Columns = dict[str, Any]

WILD = MutationConfig(
    add_node_prob=0.2,
    add_link_prob=0.4,
    recurrent_link_prob=0.3,
    toggle_enable_prob=0.4,
    reenable_prob=0.3,
    remove_link_prob=0.3,
)
UNIFORM = replace(WILD, weight_scheme="uniform", max_link_weight=None, forward_from_outputs=False)
OLD_FIRST = replace(WILD, add_node_prob=0.5, split_old_below=1000, new_link_tries=1)
MATING = replace(OPENNERO, mutation=WILD, interspecies_mate_prob=0.2)
CONFIGS = [
    NEAT_2002,
    OPENNERO,
    MATING,
    replace(NEAT_2002, mutation=UNIFORM, mate_only_prob=0.6, interspecies_mate_prob=0.3),
    replace(MATING, mutation=OLD_FIRST, multipoint_prob=0.3),
    replace(MATING, mate_only_prob=0.8, distance=DistanceConfig(disjoint=0.0, weight=0.0)),
    replace(MATING, mate_only_prob=0.8, distance=DistanceConfig(excess=0.0, weight=0.0)),
    replace(MATING, crossover=replace(MATING.crossover, copy_disabled=False), mutate_only_prob=0.0),
]

# ---------------------------------------------------------------------------- the plain one


def plain_offspring(
    parents: tuple[Parent, ...],
    config: ReproductionConfig,
    ledger: InnovationLedger,
    rng: np.random.Generator,
    genome_id: int,
    interspecies: bool,
) -> Genome:
    if len(parents) == 1:
        return plain_mutant(parents[0].genome, genome_id, config.mutation, ledger, rng)
    first, second = (one.genome for one in parents)
    average = rng.random() >= config.multipoint_prob
    fitter = parents[0].fitness > parents[1].fitness
    if parents[0].fitness == parents[1].fitness:
        fitter = first.link_weight.size < second.link_weight.size
    keep_all = config.crossover.keep_all_genes or interspecies
    child = plain_child(first, second, fitter, average, keep_all, config, rng)
    mated_only = rng.random() < config.mate_only_prob
    same = first.genome_id == second.genome_id
    if mated_only and not same and compatibility(first, second, config.distance) != 0.0:
        return child.replaced(genome_id=genome_id)
    return plain_mutant(child, genome_id, config.mutation, ledger, rng)


def plain_child(
    first: Genome,
    second: Genome,
    first_fitter: bool,
    average: bool,
    keep_all: bool,
    config: ReproductionConfig,
    rng: np.random.Generator,
) -> Genome:
    markings = first.link_innovation, second.link_innovation
    _, a, b = np.intersect1d(*markings, return_indices=True)
    from_second = np.zeros(a.size, bool) if average else rng.random(a.size) < 0.5
    spared = rng.random(a.size) >= config.crossover.inherit_disabled_prob
    on = (first.link_enabled[a] & second.link_enabled[b]) | spared
    weights, switches = (
        (first.link_weight[a], second.link_weight[b]),
        (first.link_enabled[a], second.link_enabled[b]),
    )
    mixed = weights[0] / 2 + weights[1] / 2 if average else np.where(from_second, *weights[::-1])
    if config.crossover.copy_disabled and not average:
        on &= np.where(from_second, *switches[::-1])
    own, other, matched = (first, second, a) if first_fitter else (second, first, b)
    weight, enabled = own.link_weight.copy(), own.link_enabled.copy()
    weight[matched], enabled[matched] = mixed, on
    child = own.replaced(link_weight=weight, link_enabled=enabled)
    return plain_union(child, other) if keep_all else child


def plain_union(child: Genome, other: Genome) -> Genome:
    """The child with the extra genes of another; as it is if they make a cycle, or are none."""
    rows = {name: [getattr(one, name).tolist() for one in (child, other)] for name in LINK_FIELDS}
    own = list(zip(*(column[0] for column in rows.values()), strict=True))
    extra = list(zip(*(column[1] for column in rows.values()), strict=True))
    known = {link[0] for link in own}
    extra = [link for link in extra if link[0] not in known]
    gone: set[int] = set()
    for new in extra:
        for old in own:
            same, opposite = new[1:3] == old[1:3], new[1:3] == old[2:0:-1]
            if new[5] == old[5] and (same or (opposite and not new[5])):
                gone.add(max(new[0], old[0]))
    links = sorted(link for link in own + extra if link[0] not in gone)
    columns = dict(zip(rows, zip(*links, strict=True), strict=True)) if links else {}
    ends = {*columns.get("link_source", ()), *columns.get("link_target", ())}
    nodes = np.isin(other.node_id, list(ends)) & ~np.isin(other.node_id, child.node_id)
    joined = {
        name: np.concatenate((getattr(child, name), getattr(other, name)[nodes]))
        for name in NODE_FIELDS
    }
    try:
        return child.replaced(**joined, **columns) if extra else child
    except GenomeError as error:
        assert "cycle" in str(error)
        return child


def plain_mutant(
    genome: Genome,
    genome_id: int,
    config: MutationConfig,
    ledger: InnovationLedger,
    rng: np.random.Generator,
) -> Genome:
    genome = genome.replaced(genome_id=genome_id)
    if rng.random() < config.add_node_prob:
        return plain_split(genome, config, ledger, rng)
    if rng.random() < config.add_link_prob:
        return plain_link(genome, config, ledger, rng)
    on = np.flatnonzero(genome.link_enabled)
    if config.remove_link_prob and rng.random() < config.remove_link_prob:
        return plain_removal(genome, int(on[rng.integers(on.size)])) if on.size else genome
    weight, enabled = genome.link_weight, genome.link_enabled.copy()
    if rng.random() < config.link_weights_prob:
        weight = plain_weights(weight, config, rng)
    if rng.random() < config.toggle_enable_prob and enabled.size:
        chosen = int(rng.integers(enabled.size))
        enabled[chosen] = not enabled[chosen]
        if not enabled[genome.link_source == genome.link_source[chosen]].any():
            enabled[chosen] = True
    if rng.random() < config.reenable_prob and not enabled.all():
        enabled[enabled.argmin()] = True
    return genome.replaced(link_weight=weight, link_enabled=enabled)


def plain_weights(
    weight: np.ndarray, config: MutationConfig, rng: np.random.Generator
) -> np.ndarray:
    power, cap = config.weight_mutation_power, config.max_link_weight or np.inf
    shift = rng.uniform(-power, power, weight.size)
    choice = rng.random(weight.size)
    kept, replaced = np.zeros((2, weight.size))
    young = np.arange(weight.size) > 0.8 * weight.size
    if config.weight_scheme == "uniform":
        replaced[:] = config.weight_replace_prob
    elif rng.random() < 0.5:
        kept[:], replaced[:] = 0.1, 0.2
    elif weight.size >= 10:
        kept[young], replaced[young] = 0.3, 0.2
    moved = np.where(choice < kept + replaced, shift, weight + shift)
    return np.clip(np.where(choice < kept, weight, moved), -cap, cap).astype(np.float32)


def plain_split(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    links = genome.link_innovation.size
    may = genome.node_kind[genome.source_index] != NodeKind.BIAS
    if not links:
        return genome
    if links >= config.split_old_below:
        tries = rng.integers(links, size=config.split_tries)
    else:
        old = np.flatnonzero(may)
        on = genome.link_enabled[old]
        first = on.argmax() + rng.geometric(0.7) - 1 if on.any() else old.size
        tries = old[first : first + 1]
    found = tries[(genome.link_enabled & may)[tries]]
    if not found.size:
        return genome
    at = int(found[0])
    split = ledger.split(int(genome.link_innovation[at]), genome.node_id.tolist())
    enabled = genome.link_enabled.copy()
    enabled[at] = False
    scale, ends = config.split_weight_scale, (genome.link_source[at], genome.link_target[at])
    weight, recurrent = np.float32(genome.link_weight[at] * scale), genome.link_recurrent[at]
    grown = plain_joined(
        genome.replaced(link_enabled=enabled),
        (split.in_innovation, ends[0], split.node_id, 1.0, True, recurrent),
        (split.out_innovation, split.node_id, ends[1], weight, True, False),
    )
    activation = ACTIVATIONS.index(config.hidden_activation)
    for name, value in zip(NODE_FIELDS, (split.node_id, 3, activation), strict=True):
        grown[name] = np.append(getattr(genome, name), value).astype(NODE_FIELDS[name])
    return genome.replaced(**grown)


def plain_link(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    recurrent = bool(rng.random() < config.recurrent_link_prob)
    tries, power = config.new_link_tries, config.new_link_weight_power
    enterable = np.flatnonzero(genome.node_kind > NodeKind.BIAS)
    sources = rng.integers(genome.node_id.size, size=tries)
    targets = enterable[rng.integers(enterable.size, size=tries)]
    if recurrent:
        sources = np.where(rng.random(tries) < config.recurrent_loop_prob, targets, sources)
    weight = np.float32(rng.uniform(-power, power)).item()
    ends = genome.link_source, genome.link_target, genome.link_recurrent
    known = set(zip(*(column.tolist() for column in ends), strict=True))
    for pair in zip(
        genome.node_id[sources].tolist(), genome.node_id[targets].tolist(), strict=True
    ):
        if (*pair, recurrent) not in known and plain_recurs(genome, config, *pair) == recurrent:
            found = ledger.link(*pair, recurrent, weight)
            new = found.innovation, *pair, found.weight, True, recurrent
            return genome.replaced(**plain_joined(genome, new))
    return genome


def plain_recurs(genome: Genome, config: MutationConfig, source: int, target: int) -> bool:
    kind = dict(zip(genome.node_id.tolist(), genome.node_kind.tolist(), strict=True))[source]
    if kind <= NodeKind.BIAS or source == target:
        return source == target
    forward = ~genome.link_recurrent
    index = {number: at for at, number in enumerate(genome.node_id.tolist())}
    ends = np.append(genome.source_index[forward], index[source])
    into = np.append(genome.target_index[forward], index[target])
    barred = kind == NodeKind.OUTPUT and not config.forward_from_outputs
    return barred or node_levels(ends, into, len(index)) is None


def plain_removal(genome: Genome, chosen: int) -> Genome:
    kept = np.arange(genome.link_weight.size) != chosen
    while True:
        useful = genome.link_source[kept & (genome.link_source != genome.link_target)]
        nodes = (genome.node_kind != NodeKind.HIDDEN) | np.isin(genome.node_id, useful)
        alive = genome.node_id[nodes]
        left = kept & np.isin(genome.link_source, alive) & np.isin(genome.link_target, alive)
        if left.sum() == kept.sum():
            break
        kept = left
    masks = {name: kept if name in LINK_FIELDS else nodes for name in COLUMNS}
    return genome.replaced(**{name: getattr(genome, name)[mask] for name, mask in masks.items()})


def plain_joined(genome: Genome, *new: tuple[Any, ...]) -> Columns:
    columns = [getattr(genome, name).tolist() for name in LINK_FIELDS]
    links = sorted([*zip(*columns, strict=True), *new])
    return dict(zip(LINK_FIELDS, zip(*links, strict=True), strict=True))


def plain_litters(
    pools: list[list[Genome]], fitness: np.ndarray, home: list[int], *means: Any
) -> list[tuple[Genome, tuple[int, ...]]]:
    config, ledger, rng, number = means
    values = iter(fitness.tolist())
    parents = [[Parent(one, value) for one, value in zip(pool, values)] for pool in pools]  # noqa: B905
    born = []
    for genome_id, own in enumerate(home, number):
        pool, outside = parents[own], False
        couple = [pool[rng.integers(len(pool))]]
        if len(pool) > 1 and rng.random() >= config.mutate_only_prob:
            others = [one[0] for one in parents if one is not pool]
            outside = bool(others) and rng.random() < config.interspecies_mate_prob
            mates = others if outside else pool
            couple.append(mates[rng.integers(len(mates))])
        child = plain_offspring(tuple(couple), config, ledger, rng, genome_id, outside)
        ranked = sorted(couple, key=lambda one: -one.fitness)
        born.append((child, tuple(one.genome.genome_id for one in ranked)))
    return born


# ---------------------------------------------------------------------------- both


def related(seed: int, count: int, founders: int = 2) -> tuple[list[Genome], InnovationLedger]:
    """Genomes of different sizes that share genes."""
    rng = np.random.default_rng(seed)
    genomes = [initial_genome(2, 2, rng=rng, genome_id=one) for one in range(1, founders + 1)]
    ledger = InnovationLedger.for_genomes(genomes)
    for number in range(founders + 1, count + 1):
        mutant = genomes[rng.integers(len(genomes))]
        for _ in range(rng.integers(4)):
            mutant = plain_mutant(mutant, number, WILD, ledger, rng)
        genomes.append(mutant.replaced(genome_id=number))
    return genomes, ledger


def twice(ledger: InnovationLedger, seed: int) -> list[tuple[InnovationLedger, Any]]:
    return [
        (InnovationLedger.from_state(ledger.state_dict()), np.random.default_rng(seed))
        for _ in range(2)
    ]


def assert_same(one: Genome, other: Genome) -> None:
    """Each column bit for bit, and what is derived from them."""
    for name in (*COLUMNS, "genome_id", "source_index", "target_index", "node_order"):
        mine, yours = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        assert mine.dtype == yours.dtype and mine.tobytes() == yours.tobytes(), name
    assert one.interface == other.interface
    assert not any(getattr(one, name).flags.writeable for name in COLUMNS)


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.sampled_from(CONFIGS), st.booleans(), st.integers(1, 2))
def test_a_child_is_that_of_the_plain_way(
    seed: int, config: ReproductionConfig, interspecies: bool, number: int
) -> None:
    genomes, ledger = related(seed, 8)
    (mine, rng), (yours, other) = twice(ledger, seed)
    for turn in range(12):
        draw = np.random.default_rng((seed, turn))
        some = draw.integers(len(genomes), size=number)
        parents = tuple(Parent(genomes[one], float(draw.integers(3))) for one in some)
        child = offspring(parents, config, mine, rng, genome_id=9 + turn, interspecies=interspecies)
        assert_same(child, plain_offspring(parents, config, yours, other, 9 + turn, interspecies))
        genomes[draw.integers(len(genomes))] = child
        assert rng.bit_generator.state == other.bit_generator.state
    assert mine.state_dict() == yours.state_dict()


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.sampled_from(CONFIGS), st.lists(st.integers(1, 5), min_size=1))
def test_the_litters_of_a_generation_are_those_of_the_plain_way(
    seed: int, config: ReproductionConfig, sizes: list[int]
) -> None:
    genomes, ledger = related(seed, sum(sizes))
    rest = iter(genomes)
    pools = [list(islice(rest, size)) for size in sizes]
    draw = np.random.default_rng(seed)
    fitness = draw.integers(-2, 3, sum(sizes)).astype(float)
    home = np.sort(draw.integers(len(pools), size=draw.integers(150)))
    (mine, rng), (yours, other) = twice(ledger, seed)
    born = list(litters(pools, fitness, home, config, mine, rng, 500))
    told = plain_litters(pools, fitness, home.tolist(), config, yours, other, 500)
    for (child, parents), (plain, of) in zip(born, told, strict=True):
        assert_same(child, plain)
        assert parents == of
    assert mine.state_dict() == yours.state_dict()
    assert rng.bit_generator.state == other.bit_generator.state


def test_a_generation_has_children_that_share_the_arrays_of_their_structure() -> None:
    genomes, ledger = related(0, 4)
    quiet = replace(NEAT_2002, mutation=MutationConfig(add_node_prob=0.0, add_link_prob=0.0))
    home, rng = np.zeros(70, np.int64), np.random.default_rng(0)
    for child, parents in litters([genomes], np.arange(4.0), home, quiet, ledger, rng, 9):
        parent = next(one for one in genomes if one.genome_id == parents[0])
        assert all(getattr(child, name) is getattr(parent, name) for name in STRUCTURE)
        assert child.link_weight.base is None


def test_genomes_of_different_worlds_do_not_breed_in_a_generation() -> None:
    genomes, ledger = related(0, 2)
    pools = [[genomes[0], genomes[1].replaced(observation_schema="x")]]
    rng, home = np.random.default_rng(0), np.zeros(2, np.int64)
    with pytest.raises(GenomeError, match="genomes 1 and 2 differ"):
        next(litters(pools, np.zeros(2), home, NEAT_2002, ledger, rng, 9))


def test_a_weight_that_is_not_finite_is_found_in_a_generation() -> None:
    (genome, *_), ledger = related(0, 2)
    huge = genome.with_weights(np.full(genome.link_weight.size, 3e38, np.float32))
    config = MutationConfig(max_link_weight=None, weight_mutation_power=1e38)
    config = replace(config, add_node_prob=0.0, add_link_prob=0.0)
    rng, home = np.random.default_rng(0), np.zeros(50, np.int64)
    means = replace(NEAT_2002, mutation=config), ledger, rng, 9
    with pytest.raises(GenomeError, match="is not a finite float32 number"):
        list(litters([[huge]], np.zeros(1), home, *means))


@cached_njit()
def draws(rng: np.random.Generator, most: int, size: int, power: float) -> tuple[Any, ...]:
    some = rng.integers(0, most), rng.integers(0, most, size=size), rng.random()
    return *some, rng.random(size), rng.uniform(-power, power, size), rng.geometric(0.7)


@settings(max_examples=60)
@given(
    st.sampled_from(["PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64"]),
    st.integers(0, 10_000),
    st.one_of(st.integers(1, 70), st.sampled_from([2**31, 2**32 - 1, 2**32, 2**32 + 1, 2**62])),
    st.integers(0, 9),
)
def test_compiled_code_draws_what_numpy_draws(name: str, seed: int, most: int, size: int) -> None:
    mine, yours = (np.random.Generator(getattr(np.random, name)(seed)) for _ in range(2))
    for power in (0.5, 2.5, 0.3):
        got = draws(mine, most, size, power)
        some = yours.integers(most), yours.integers(most, size=size), yours.random()
        more = yours.random(size), yours.uniform(-power, power, size), yours.geometric(0.7)
        for one, other in zip(got, (*some, *more), strict=True):
            assert np.array_equal(one, other)
        assert str(mine.bit_generator.state) == str(yours.bit_generator.state)
