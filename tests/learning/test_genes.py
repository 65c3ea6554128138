"""How fast a robot learns, how often it explores and how far it looks ahead, as genes."""

from __future__ import annotations

import numpy as np
import pytest

from neatq_torch.evolution import Replacement, RtNEAT, RtNEATConfig
from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    EpsilonGreedy,
    LearnerConfig,
    LearningGenes,
    TDLearner,
)
from neatq_torch.network import PopulationNetwork

HEADS = CandidateHeads(2, [0.0], [1.0])


def genes_of(
    seeds: range = range(1), power: float = 0.5, robots: int = 4, rate: float = 0.1
) -> tuple[LearningGenes, TDLearner, EpsilonGreedy, list[RtNEAT]]:
    populations = [
        RtNEAT.start(
            RtNEATConfig(minimum_life_ticks=5),
            robots=robots,
            inputs=1,
            outputs=HEADS.outputs,
            seed=seed,
        )
        for seed in seeds
    ]
    genomes = [genome for population in populations for genome in population.genomes]
    network = PopulationNetwork(genomes, shape=(len(seeds), robots))
    loss = CandidateTDLoss(CandidateValue(network, HEADS))
    loss.make_value_estimator(gamma=0.8)
    learner = TDLearner(network, loss, LearnerConfig(learning_rate=rate))
    exploration = EpsilonGreedy((len(seeds), robots), seeds=seeds, epsilon=0.2)
    genes = LearningGenes(power, learner, exploration, populations, list(seeds))
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
    genes.inherit(0, Replacement(1, child, 2, (3, 1)))
    genes.inherit(0, Replacement(3, grandchild, 4, (5,)))
    expected = np.outer([2, 6, 6, 6], [0.01, 0.011, 0.1])
    assert genes.values[0] == pytest.approx(expected, rel=1e-6)
    genes.express()
    assert learner.learning_rate.tolist() == pytest.approx([0.02, 0.06, 0.06, 0.06])
    assert exploration.epsilon[0].tolist() == pytest.approx([0.022, 0.066, 0.066, 0.066])
    assert learner.loss.discount is not None
    assert learner.loss.discount[0].tolist() == pytest.approx([0.8, 0.4, 0.4, 0.4])


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
    both.inherit(0, Replacement(0, child, 1, (2,)))
    both.inherit(1, Replacement(2, child, 3, (4, 1)))
    saved, *_ = genes_of(range(1, 2))
    saved.load_state(alone.state())
    for one in (alone, saved):
        one.inherit(0, Replacement(2, child, 3, (4, 1)))
        assert one.values[0].tobytes() == both.values[1].tobytes()


def test_genes_that_cannot_mutate_are_refused() -> None:
    with pytest.raises(ValueError, match="power: expected a finite number above 0, got 0"):
        genes_of(power=0.0)
    with pytest.raises(ValueError, match=r"for founders to start from, got 0.0, 0.2\d* and 0.8"):
        genes_of(rate=0.0)
