"""How fast a robot learns, how often it explores and how far it looks ahead, as genes."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import ArrayLike

from neatq_torch.evolution import Replacement
from neatq_torch.genome import Genome, initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    EpsilonGreedy,
    LearningGenes,
    TDConfig,
    TDLearner,
)
from neatq_torch.network import PopulationNetwork

HEADS = CandidateHeads(2, [0.0], [1.0])


class Population:
    def __init__(self, seed: int, robots: int) -> None:
        rng = np.random.default_rng(seed)
        self.genomes: list[Genome] = [
            initial_genome(1, HEADS.outputs, rng=rng, genome_id=i + 1) for i in range(robots)
        ]

    def write_back(self, slot: int, weights: ArrayLike) -> None:
        self.genomes[slot] = self.genomes[slot].with_weights(weights)


def genes_of(
    seeds: range = range(1),
    power: float = 0.5,
    robots: int = 4,
    rate: float = 0.1,
    heads: CandidateHeads = HEADS,
) -> tuple[LearningGenes, TDLearner, EpsilonGreedy, list[Population]]:
    populations = [Population(seed, robots) for seed in seeds]
    genomes = [genome for population in populations for genome in population.genomes]
    network = PopulationNetwork(genomes, shape=(len(seeds), robots))
    loss = CandidateTDLoss(CandidateValue(network, heads))
    loss.make_value_estimator(gamma=0.8)
    learner = TDLearner(network, loss, TDConfig(learning_rate=rate))
    exploration = EpsilonGreedy((len(seeds), robots), seeds=seeds, epsilon=0.2)
    genes = LearningGenes(power, learner, exploration, cast(Any, populations), list(seeds))
    return genes, learner, exploration, populations


def test_founders_are_mutated_from_what_is_configured_and_robots_do_as_their_genes_say() -> None:
    genes, learner, exploration, _ = genes_of(range(3, 5))
    moved = np.exp(0.5 * np.random.default_rng(4).standard_normal((4, 3)))
    expected = (np.array([0.1, 0.2, 0.2]) * moved).clip([0.01, 0.02, 0.02], [1.0, 1.0, 1.0])
    assert genes.values[1] == pytest.approx(expected)
    assert learner.learning_rate.tolist() == pytest.approx(genes.values[..., 0].flatten().tolist())
    assert exploration.epsilon.tolist() == [
        pytest.approx(row) for row in genes.values[..., 1].tolist()
    ]
    assert learner.loss.discount is not None
    assert learner.loss.discount.tolist() == [
        pytest.approx(row) for row in (1 - genes.values[..., 2]).tolist()
    ]


def test_a_newborn_inherits_from_its_first_parent_even_if_that_was_born_with_it() -> None:
    genes, learner, exploration, (population,) = genes_of(power=1e-9)
    genes.values[0] = np.outer([2, 4, 6, 8], [0.01, 0.011, 0.1])
    child, grandchild = (population.genomes[0].unchecked(genome_id=one) for one in (5, 6))
    genes.inherit(0, [Replacement(1, child, 2, (3, 1))])
    genes.inherit(0, [Replacement(3, grandchild, 4, (5,))])
    expected = np.outer([2, 6, 6, 6], [0.01, 0.011, 0.1])
    assert genes.values[0] == pytest.approx(expected, rel=1e-6)
    genes.express()
    assert learner.learning_rate.tolist() == pytest.approx([0.02, 0.06, 0.06, 0.06])
    assert exploration.epsilon[0].tolist() == pytest.approx([0.022, 0.066, 0.066, 0.066])
    assert learner.loss.discount is not None
    assert learner.loss.discount[0].tolist() == pytest.approx([0.8, 0.4, 0.4, 0.4])


def test_a_whole_generation_inherits_from_the_one_before_and_its_elite_keeps_its_genes() -> None:
    genes, *_, (population,) = genes_of()
    before = genes.values[0].copy()
    rng = np.random.default_rng()
    rng.bit_generator.state = genes.generators[0].bit_generator.state
    made = [population.genomes[0].unchecked(genome_id=one) for one in (2, 5, 6, 7)]
    parents = [(2,), (1, 4), (2, 1), (5,)]
    removed = range(1, 5)
    genes.inherit(
        0, [Replacement(*one) for one in zip(range(4), made, removed, parents, strict=True)]
    )
    moved = np.exp(0.5 * rng.standard_normal((3, 3)))
    least, most = [0.01, 0.02, 0.02], [1.0, 1.0, 1.0]
    expected = [before[1], (before[0] * moved[0]).clip(least, most)]
    expected.append((before[1] * moved[1]).clip(least, most))
    expected.append((expected[1] * moved[2]).clip(least, most))
    assert genes.values[0] == pytest.approx(np.array(expected))


def test_learning_rates_are_in_units_of_the_outputs_as_those_of_the_learner() -> None:
    heads = CandidateHeads(2, [0.0], [1.0], value_range=(-1.0, 3.0))
    genes, learner, *_ = genes_of(heads=heads)
    expected = (genes.values[0, :, 0] / 16).tolist()
    assert learner.learning_rate.tolist() == pytest.approx(expected)


def test_the_logarithm_of_a_gene_moves_by_the_power_and_stays_within_its_range() -> None:
    genes, *_ = genes_of(power=0.1, robots=2000)
    logs = np.log(genes.values[0] / [0.1, 0.2, 0.2])
    assert logs.mean(0).tolist() == pytest.approx([0.0] * 3, abs=0.01)
    assert logs.std(0).tolist() == pytest.approx([0.1] * 3, rel=0.06)
    wild, *_ = genes_of(power=50.0, robots=200)
    assert wild.values[0].min(0).tolist() == pytest.approx([0.01, 0.02, 0.02])
    assert wild.values[0].max(0).tolist() == pytest.approx([1.0] * 3)


def test_an_arena_has_the_genes_that_it_has_alone_and_goes_on_exactly() -> None:
    both, *_, populations = genes_of(range(2))
    alone, *_ = genes_of(range(1, 2))
    child = populations[1].genomes[0].unchecked(genome_id=5)
    both.inherit(0, [Replacement(0, child, 1, (2,))])
    both.inherit(1, [Replacement(2, child, 3, (4, 1))])
    saved, *_ = genes_of(range(1, 2))
    saved.load_state_dict(alone.state_dict())
    for one in (alone, saved):
        one.inherit(0, [Replacement(2, child, 3, (4, 1))])
        assert one.values[0].tobytes() == both.values[1].tobytes()


def test_genes_that_cannot_mutate_are_refused() -> None:
    with pytest.raises(ValueError, match="power: expected a finite number above 0, got 0"):
        genes_of(power=0.0)
    with pytest.raises(ValueError, match=r"for founders to start from, got 0.0, 0.2\d* and 0.8"):
        genes_of(rate=0.0)
