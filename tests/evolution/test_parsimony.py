"""Of networks that are about as good, the smallest is the fittest."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.evolution import NEAT, NEAT_2002, OPENNERO, NEATConfig, RtNEAT, RtNEATConfig
from neatq_torch.evolution.parsimony import (
    enabled_links,
    front_ranks,
    good_ranks,
    lowest_good,
    shrinking,
)
from neatq_torch.evolution.reproduction import ReproductionConfig
from neatq_torch.genome import Genome, InnovationLedger, MutationConfig, layered_genome
from neatq_torch.kinds import ConfigError

FULL = layered_genome(2, 1, rng=np.random.default_rng(0), hidden=2)  # 3 * 2 + 2 + 1 links
OBJECTIVES = st.lists(st.tuples(st.integers(-20, 20), st.integers(0, 9)), min_size=1, max_size=30)


def sized(*links: int) -> list[Genome]:
    """Genomes with so many of their nine links enabled."""
    return [
        FULL.replaced(genome_id=number, link_enabled=np.arange(9) < count)
        for number, count in enumerate(links, 1)
    ]


def neat(*links: int, seed: int = 0, **config: Any) -> NEAT:
    genomes = sized(*links)
    ledger = InnovationLedger.for_genomes(genomes)
    changes: dict[str, Any] = {"parsimony": 0.05} | config
    settings = NEATConfig(**changes)
    return NEAT(settings, genomes, np.random.default_rng(seed), ledger, len(genomes) + 1)


def rtneat(*links: int, seed: int = 0, **config: Any) -> RtNEAT:
    genomes = sized(*links)
    ledger = InnovationLedger.for_genomes(genomes)
    changes: dict[str, Any] = {"parsimony": 0.05, "minimum_life_ticks": 10} | config
    settings = RtNEATConfig(**changes)
    return RtNEAT(settings, genomes, np.random.default_rng(seed), ledger, len(genomes) + 1)


def live(population: RtNEAT, ticks: int, rewards: list[float]) -> None:
    column = np.array(rewards)[:, None, None]
    population.record(np.broadcast_to(column, (len(rewards), ticks, 1)))


# ---------------------------------------------------------------------------- ranks


SHARES = [(200, 0.1, 180), (-200, 0.1, -220), (0, 0.5, 0)]


@pytest.mark.parametrize(("best", "share", "least"), SHARES)
def test_the_share_is_one_of_the_size_of_the_best_return(
    best: float, share: float, least: float
) -> None:
    assert lowest_good(best, share) == least


def test_ranks_of_the_good_by_hand() -> None:
    returns = np.array([100.0, 97.0, 95.0, 94.9, 50.0, 50.0, 99.0])
    links = np.array([9, 4, 6, 1, 2, 3, 4])
    # Good enough are returns from 95 on. Of those with 4 links, the one with the better return.
    assert good_ranks(returns, links, 0.05).tolist() == [2, 4, 3, 1, 0, 0, 5]


def test_negative_returns_are_ranked_alike() -> None:
    returns, links = np.array([-100.0, -104.0, -106.0]), np.array([9, 8, 1])
    assert good_ranks(returns, links, 0.05).tolist() == [1, 2, 0]


def test_with_a_share_of_0_size_decides_among_equals_only() -> None:
    returns, links = np.array([7.0, 7.0, 6.999, 7.0]), np.array([5, 3, 1, 5])
    assert good_ranks(returns, links, 0.0).tolist() == [1, 2, 0, 1]


@given(OBJECTIVES, st.sampled_from([0.0, 0.05, 0.5]))
def test_the_smallest_of_the_good_is_first_and_no_other_beats_a_good_one(
    genomes: list[tuple[int, int]], share: float
) -> None:
    returns, links = np.array(genomes, dtype=np.float64).T
    ranks = good_ranks(returns, links.astype(np.int64), share)
    good = returns >= returns.max() - share * abs(returns.max())
    assert ranks.min() == 0
    for one in range(len(genomes)):
        for other in range(len(genomes)):
            if good[one] and good[other] and links[one] != links[other]:
                above = links[one] < links[other]
            elif good[one] != good[other]:
                above = bool(good[one])
            else:
                above = returns[one] > returns[other]
            assert (ranks[one] > ranks[other]) == above


def test_ranks_of_fronts_by_hand() -> None:
    returns = np.array([10.0, 9.8, 9.6, 9.0, 1.0, 2.0, 9.4, 9.7, 0.0])
    links = np.array([9, 5, 7, 2, 9, 1, 4, 8, 0])
    # The median is 9.4. Of the others nobody beats 0, 1 and 6, of which 0 and 6 are the outer ones.
    # The second front are 7 and 2; the others follow by return alone: 3, 5, 4 and 8.
    assert front_ranks(returns, links).tolist() == [6, 5, 4, 3, 1, 2, 6, 4, 0]


def test_within_a_front_those_are_above_that_stand_alone() -> None:
    returns = np.array([9.0, 8.0, 7.0, 5.0, 4.0, 0.0, 0.0, 0.0, 0.0])
    links = np.array([9, 8, 5, 4, 3, 9, 9, 9, 9])
    # Neighbours are apart by 2 / 5 + 4 / 6, 3 / 5 + 4 / 6 and 3 / 5 + 2 / 6.
    assert front_ranks(returns, links).tolist() == [4, 2, 3, 1, 4, 0, 0, 0, 0]


def test_equal_genomes_are_of_one_front_and_of_one_alone_nothing_is_asked() -> None:
    assert front_ranks(np.array([3.0]), np.array([2])).tolist() == [0]
    assert front_ranks(np.full(4, 3.0), np.full(4, 2)).tolist() == [1, 0, 0, 1]


@given(OBJECTIVES)
def test_of_the_better_half_whoever_beats_another_has_a_higher_rank(
    genomes: list[tuple[int, int]],
) -> None:
    returns, links = np.array(genomes, dtype=np.float64).T
    ranks = front_ranks(returns, links.astype(np.int64))
    assert ranks.min() == 0
    for one, (earned, size) in enumerate(genomes):
        for other, (less, more) in enumerate(genomes):
            if less < np.median(returns):
                assert (ranks[one] > ranks[other]) == (earned > less)
            elif earned >= less and size <= more and (earned > less or size < more):
                assert ranks[one] > ranks[other]
    best = returns == returns.max()
    assert ranks[best].max() == ranks.max(), "the best stays"


def test_disabled_links_do_not_count() -> None:
    assert enabled_links(sized(9, 4, 0)).tolist() == [9, 4, 0]


# ---------------------------------------------------------------------------- links are removed


@pytest.mark.parametrize("preset", [OPENNERO, NEAT_2002])
def test_with_parsimony_links_are_removed_unless_somebody_says_how_often(
    preset: ReproductionConfig,
) -> None:
    assert preset.mutation.remove_link_prob is None
    told = ReproductionConfig(mutation=MutationConfig(remove_link_prob=0.0))
    assert shrinking(told) is told
    assert (shrinking(preset).mutation.remove_link_prob or 0) > 0


@pytest.mark.parametrize("config", [RtNEATConfig, NEATConfig])
def test_a_share_that_makes_no_sense_is_refused(config: Any) -> None:
    for share in (-0.1, 1.0):
        with pytest.raises(ConfigError, match=r"parsimony: expected \[0, 1\) or None"):
            config(parsimony=share)


# ---------------------------------------------------------------------------- rtNEAT


def test_the_smallest_robot_of_the_good_is_champion_and_the_worst_is_replaced() -> None:
    population = rtneat(9, 5, 7, 2, 2, 2)
    live(population, 15, [10.0, 9.8, 9.6, 0.0, 0.2, 0.1])
    assert population.merit.tolist() == [3, 5, 4, 0, 2, 1]
    assert population.champion == 1
    # Of the better half the outer ones are first, and 1 beats 2.
    assert population.score.tolist() == [4, 4, 3, 0, 2, 1]
    (replacement,) = population.advance()
    assert replacement.slot == 3


def test_of_equally_good_robots_the_largest_is_replaced_first() -> None:
    population = rtneat(5, 9, 7, 6)
    live(population, 15, [10.0] * 4)
    assert [one.slot for one in population.advance()] == [1]
    live(population, 5, [10.0] * 4)
    assert [one.slot for one in population.advance()] == [2]


def test_robots_that_are_too_young_have_no_merit() -> None:
    population = rtneat(9, 5, 7, 2)
    assert (population.champion, population.merit.tolist()) == (None, [0.0] * 4)
    live(population, 15, [10.0, 9.8, 9.6, 0.0])
    assert [one.slot for one in population.advance()] == [3]
    assert population.merit.tolist() == [0, 2, 1, 0]
    assert population.score.tolist() == [1, 1, 0, 0]


# ---------------------------------------------------------------------------- NEAT


def test_the_smallest_genome_of_the_good_is_champion_and_the_front_breeds() -> None:
    population = neat(9, 5, 7, 2, 9, 9)  # whose better half are the first three
    assert [one.members.size for one in population.species] == [6]
    population.record(np.array([9.6, 9.8, 10.0, 1.0, 2.0, 0.0])[:, None, None], np.ones((6, 1)))
    assert population.champion == 1
    smallest = population.genomes[1]
    replacements = population.advance()
    # Slots 1 and 2 are the outer ones of the front, and a third of six members may breed.
    assert replacements[0].genome is smallest
    assert {one for each in replacements for one in each.parents} <= {2, 3}


def test_a_species_whose_champion_shrinks_does_not_stagnate() -> None:
    population = neat(9, 9)
    founders, shrunk = sized(9, 9), sized(8, 9)
    reached = []
    for genomes, best in ((founders, 1.0), (founders, 1.0), (shrunk, 1.0), (founders, 1.5)):
        population.genomes = genomes
        fitness = np.array([best, 1.0])
        population._note(np.array([population._reached(np.arange(2), fitness)]))
        reached.append([generation for _, _, generation in population.records])
        population.generation += 1
    assert reached == [[0, 0], [0, 0], [2, 2], [3, 3]]


# ---------------------------------------------------------------------------- both


def test_without_parsimony_merit_is_fitness() -> None:
    population = rtneat(9, 5, 7, 2, parsimony=None)
    live(population, 15, [10.0, 9.8, 9.6, 9.0])
    assert population.merit.tolist() == population.fitness.tolist()
    assert population.champion == 0
    other = neat(9, 5, parsimony=None)
    other.record(np.array([[[1.0]], [[0.99]]]), np.ones((2, 1)))
    assert other.merit.tolist() == [1.0, 0.99]
    assert (other.champion, neat(9, 5).champion) == (0, None)


def test_where_all_are_as_good_networks_shrink() -> None:
    generations = neat(*[9] * 30)
    for _ in range(40):
        generations.tell(np.ones(30))
    one_by_one = rtneat(*[9] * 30, ineligible_fraction=0.1)
    for _ in range(300):
        live(one_by_one, 10, [1.0] * 30)
        one_by_one.advance()
    assert np.median(enabled_links(generations.genomes)) <= 3
    assert np.median(enabled_links(one_by_one.genomes)) <= 5


@pytest.mark.parametrize("make", [neat, rtneat])
def test_a_population_with_parsimony_goes_on_bit_for_bit(make: Any) -> None:
    def step(population: Any, chance: np.random.Generator) -> None:
        done = np.broadcast_to(np.arange(10) == 9, (12, 10))
        population.record(chance.normal(size=(12, 10, 1)), done)
        population.advance()

    one, chance = make(*[9] * 12), np.random.default_rng(1)
    for _ in range(10):
        step(one, chance)
    other = type(one).from_state(one.config, one.state_dict())
    again = np.random.default_rng(1)
    again.bit_generator.state = chance.bit_generator.state
    for _ in range(10):
        step(one, chance)
        step(other, again)
    texts = [[genome.to_json() for genome in each.genomes] for each in (one, other)]
    assert texts[0] == texts[1]
    assert json.dumps(one.rng.bit_generator.state) == json.dumps(other.rng.bit_generator.state)
