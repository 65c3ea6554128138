from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from neatq_torch.evolution import NEAT_2002, OPENNERO, ReproductionConfig
from neatq_torch.evolution.reproduction import Parent, choose_parents, offspring, roulette
from neatq_torch.evolution.species import Species
from neatq_torch.genome import (
    CrossoverConfig,
    Genome,
    InnovationLedger,
    MutationConfig,
    initial_genome,
)

STILL = MutationConfig(add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
MOVING = replace(STILL, link_weights_prob=1.0)


def genome(number: int, weight: float) -> Genome:
    start = initial_genome(2, 1, rng=np.random.default_rng(0), genome_id=number)
    return start.with_weights([weight] * 3)


FIRST, SECOND = Parent(genome(1, 0.25), 1.0), Parent(genome(2, 0.75), 2.0)


def breed(config: ReproductionConfig, *parents: Parent, times: int = 1) -> list[Genome]:
    ledger = InnovationLedger.for_genomes([parent.genome for parent in parents])
    rng = np.random.default_rng(0)
    return [offspring(parents, config, ledger, rng, genome_id=9) for _ in range(times)]


def test_openneros_preset_has_the_values_of_its_parameter_file() -> None:
    mutation = OPENNERO.mutation
    assert (mutation.add_node_prob, mutation.add_link_prob) == (0.03, 0.05)
    assert (mutation.link_weights_prob, mutation.weight_mutation_power) == (0.9, 0.5)
    assert (mutation.recurrent_link_prob, mutation.new_link_tries) == (0.15, 20)
    assert (mutation.max_link_weight, mutation.split_weight_scale) == (3.0, 0.3)
    assert (mutation.toggle_enable_prob, mutation.reenable_prob) == (0.0, 0.0)
    assert (OPENNERO.mutate_only_prob, OPENNERO.mate_only_prob) == (0.25, 0.2)
    assert (OPENNERO.multipoint_prob, OPENNERO.interspecies_mate_prob) == (0.6, 0.001)
    distance = OPENNERO.distance
    assert (distance.disjoint, distance.excess, distance.weight) == (1.0, 1.0, 0.4)
    assert OPENNERO.crossover.keep_all_genes


def test_the_preset_of_2002_has_the_values_of_the_paper() -> None:
    mutation = NEAT_2002.mutation
    assert (mutation.add_node_prob, mutation.add_link_prob) == (0.03, 0.05)
    assert mutation.split_weight_scale == 1.0
    assert mutation.hidden_activation == "steep_sigmoid"
    assert (NEAT_2002.mutate_only_prob, NEAT_2002.interspecies_mate_prob) == (0.25, 0.001)
    assert NEAT_2002.crossover == CrossoverConfig(keep_all_genes=False, copy_disabled=True)


def test_a_single_parent_has_a_mutated_copy() -> None:
    (child,) = breed(ReproductionConfig(mutation=MOVING), FIRST)
    assert child.genome_id == 9
    unmoved = child.replaced(genome_id=FIRST.genome.genome_id, link_weight=FIRST.genome.link_weight)
    assert unmoved.to_json() == FIRST.genome.to_json()
    assert not np.array_equal(child.link_weight, FIRST.genome.link_weight)


def test_60_percent_of_crossovers_choose_genes_and_the_others_average() -> None:
    config = ReproductionConfig(mutation=STILL)
    children = breed(config, FIRST, SECOND, times=1500)
    averaged = np.mean([bool((child.link_weight == 0.5).all()) for child in children])
    chosen = np.mean([set(child.link_weight.tolist()) <= {0.25, 0.75} for child in children])
    assert averaged == pytest.approx(0.4, abs=0.04)
    assert chosen == pytest.approx(0.6, abs=0.04)


def test_20_percent_of_crossed_children_are_not_mutated() -> None:
    config = ReproductionConfig(mutation=MOVING, multipoint_prob=0.0)
    children = breed(config, FIRST, SECOND, times=1500)
    unchanged = np.mean([bool((child.link_weight == 0.5).all()) for child in children])
    assert unchanged == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("twin", [FIRST, Parent(genome(2, 0.25), 2.0)])
def test_children_of_twins_are_always_mutated(twin: Parent) -> None:
    config = ReproductionConfig(mutation=MOVING, mate_only_prob=1.0)
    for child in breed(config, FIRST, twin, times=20):
        assert not (child.link_weight == 0.25).all()


def test_one_number_makes_twins_even_if_weights_differ() -> None:
    config = ReproductionConfig(mutation=MOVING, mate_only_prob=1.0, multipoint_prob=0.0)
    other = Parent(genome(1, 0.75), 2.0)
    assert all(not (child.link_weight == 0.5).all() for child in breed(config, FIRST, other))


def test_extra_genes_come_from_the_fitter_parent_except_between_species() -> None:
    names = ("innovation", "source", "target", "weight", "enabled", "recurrent")
    short = FIRST.genome.replaced(
        **{f"link_{name}": getattr(FIRST.genome, f"link_{name}")[:2] for name in names}
    )
    config = replace(NEAT_2002, mutation=STILL)
    ledger, rng = InnovationLedger.for_genomes([SECOND.genome]), np.random.default_rng(0)

    def links(short_fitness: float, **interspecies: bool) -> int:
        parents = (Parent(short, short_fitness), SECOND)
        child = offspring(parents, config, ledger, rng, genome_id=9, **interspecies)
        return child.link_innovation.size

    assert links(3.0, interspecies=False) == links(3.0) == 2
    assert links(1.0, interspecies=False) == 3
    assert links(3.0, interspecies=True) == 3


def test_roulette_is_proportional_to_the_shares() -> None:
    rng = np.random.default_rng(0)
    draws = np.bincount([roulette([1.0, 0.0, 3.0, 0.0], rng) for _ in range(4000)], minlength=4)
    assert (draws / 4000).tolist() == pytest.approx([0.25, 0.0, 0.75, 0.0], abs=0.03)


def test_roulette_is_uniform_where_all_shares_are_zero() -> None:
    rng = np.random.default_rng(0)
    draws = np.bincount([roulette([0.0] * 4, rng) for _ in range(4000)], minlength=4)
    assert (draws / 4000).tolist() == pytest.approx([0.25] * 4, abs=0.03)


class Chooser:
    """Draws parents many times and counts what comes."""

    def __init__(self, species: list[list[int]], fitness: list[float], eligible: list[int]) -> None:
        self.species = species
        self.fitness = np.array(fitness)
        self.eligible = np.isin(np.arange(self.fitness.size), eligible)

    def draw(self, times: int = 2000, **config: Any) -> list[tuple[tuple[int, ...], bool]]:
        rng = np.random.default_rng(0)
        settings = ReproductionConfig(**config)
        drawn = []
        for _ in range(times):
            species = [Species(i, np.array(slots)) for i, slots in enumerate(self.species)]
            drawn.append(choose_parents(species, self.fitness, self.eligible, settings, rng))
        return drawn

    def firsts(self, **config: Any) -> list[float]:
        slots = [parents[0] for parents, _ in self.draw(**config)]
        return (np.bincount(slots, minlength=self.fitness.size) / len(slots)).tolist()


def test_species_are_drawn_by_the_mean_fitness_of_their_eligible_members() -> None:
    # Means 2 and 6; the young slot 2 counts for nothing. Within species by fitness.
    chooser = Chooser([[0, 1], [2, 3]], [1.0, 3.0, 0.0, 6.0], [0, 1, 3])
    expected = [0.25 * 0.25, 0.25 * 0.75, 0.0, 0.75]
    assert chooser.firsts() == pytest.approx(expected, abs=0.03)


def test_parents_are_drawn_uniformly_where_nobody_is_eligible() -> None:
    chooser = Chooser([[0, 1], [2, 3]], [0.0] * 4, [])
    assert chooser.firsts() == pytest.approx([0.25] * 4, abs=0.03)


def test_a_quarter_of_offspring_has_one_parent() -> None:
    drawn = Chooser([[0, 1]], [1.0, 1.0], [0, 1]).draw()
    single = np.mean([len(parents) == 1 for parents, _ in drawn])
    assert single == pytest.approx(0.25, abs=0.03)


def test_the_only_candidate_breeds_alone() -> None:
    drawn = Chooser([[0, 1]], [1.0, 0.0], [0]).draw(times=100)
    assert {parents for parents, _ in drawn} == {(0,)}


def test_a_mate_from_outside_is_the_fittest_of_another_species() -> None:
    chooser = Chooser([[0, 1], [2, 3]], [1.0, 1.0, 0.5, 0.7], [0, 1, 2, 3])
    drawn = chooser.draw(interspecies_mate_prob=1.0, mutate_only_prob=0.0)
    assert all(between for _, between in drawn)
    assert {parents[1] for parents, _ in drawn if parents[0] < 2} == {3}
    alone = Chooser([[0, 1]], [1.0, 1.0], [0, 1])
    assert not any(between for _, between in alone.draw(interspecies_mate_prob=1.0))


def test_breeding_ranks_the_species() -> None:
    species = [Species(1, np.array([0, 1, 2]))]
    fitness = np.array([1.0, 0.5, 2.0])
    rng = np.random.default_rng(0)
    choose_parents(species, fitness, np.ones(3, dtype=bool), OPENNERO, rng)
    assert species[0].members.tolist() == [2, 0, 1]


def test_a_probability_beyond_one_is_refused() -> None:
    with pytest.raises(ValueError, match=r"multipoint_prob: expected \[0, 1\], got 1.1"):
        ReproductionConfig(multipoint_prob=1.1)
