from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from neatq_torch.evolution import SpeciesConfig
from neatq_torch.evolution.species import Speciation
from neatq_torch.genome import DistanceConfig, Genome, initial_genome

ONE = initial_genome(1, 1, rng=np.random.default_rng(0))
DISTANCE = DistanceConfig(weight=1.0)


def at(*positions: float) -> list[Genome]:
    """Genomes on a line: their distance is the difference of their positions."""
    return [ONE.with_weights([position, position]) for position in positions]


def sorted_in(genomes: list[Genome], **config: Any) -> Speciation:
    speciation = Speciation(SpeciesConfig(**config), DISTANCE)
    for slot in range(len(genomes)):
        speciation.add(slot, genomes)
    return speciation


def members(speciation: Speciation) -> list[list[int]]:
    return [species.members.tolist() for species in speciation.species]


def test_a_genome_joins_the_first_compatible_species_or_founds_one() -> None:
    genomes = at(0.0, 3.0, 1.5, 0.5)
    speciation = sorted_in(genomes, threshold=2.0)
    # 1.5 is compatible with both species and joins the first.
    assert members(speciation) == [[0, 2, 3], [1]]
    assert [species.species_id for species in speciation.species] == [1, 2]


def test_a_genome_at_the_threshold_is_not_compatible() -> None:
    assert members(sorted_in(at(0.0, 2.0), threshold=2.0)) == [[0], [1]]


def test_the_first_member_represents_its_species_and_the_next_follows_it() -> None:
    genomes = at(0.0, 1.5, 3.0)
    speciation = sorted_in(genomes, threshold=2.0)
    assert members(speciation) == [[0, 1], [2]]
    assert speciation.species[0].members[0] == 0
    speciation.remove(0)
    assert speciation.species[0].members[0] == 1
    speciation.add(0, genomes)
    assert members(speciation) == [[1, 0], [2]]
    speciation.species[0].rank(np.array([2.0, 1.0, 0.0]))
    assert members(speciation) == [[0, 1], [2]]


def test_a_species_without_members_vanishes() -> None:
    speciation = sorted_in(at(0.0, 9.0, 0.0), threshold=2.0)
    speciation.remove(1)
    assert members(speciation) == [[0, 2]]
    with pytest.raises(KeyError, match="slot 1 belongs to no species"):
        speciation.remove(1)


def test_numbers_of_species_are_never_used_again() -> None:
    genomes = at(0.0, 9.0)
    speciation = sorted_in(genomes, threshold=2.0)
    speciation.remove(1)
    assert speciation.add(1, genomes).species_id == 3


def test_sizes_are_those_of_each_slots_species() -> None:
    assert sorted_in(at(0.0, 9.0, 0.0), threshold=2.0).sizes(3).tolist() == [2, 1, 2]


@pytest.mark.parametrize(("target", "expected"), [(1, 2.1), (2, 2.0), (3, 1.9)])
def test_every_fifth_offspring_moves_the_threshold_towards_the_target(
    target: int, expected: float
) -> None:
    genomes = at(0.0, 9.0)
    speciation = sorted_in(genomes, threshold=2.0, target=target)
    for _ in range(4):
        speciation.count_offspring(genomes, [0, 1])
    assert speciation.threshold == 2.0
    speciation.count_offspring(genomes, [0, 1])
    assert speciation.threshold == pytest.approx(expected)


def test_the_threshold_never_falls_below_its_floor() -> None:
    genomes = at(0.0, 0.0)
    speciation = sorted_in(genomes, threshold=0.45, target=4, adjust_every=1)
    for _ in range(5):
        speciation.count_offspring(genomes, [0, 1])
    assert speciation.threshold == 0.3


def test_all_genomes_are_reassigned_when_the_threshold_moves() -> None:
    genomes = at(0.0, 0.35, 0.8)
    speciation = sorted_in(genomes, threshold=1.0, target=2, step=0.5, adjust_every=1)
    assert members(speciation) == [[0, 1, 2]]
    speciation.count_offspring(genomes, [0, 1, 2])
    assert members(speciation) == [[0, 1], [2]]


def test_reassigning_follows_the_given_order_and_sees_each_move() -> None:
    # Slot 0 leaves first; then 1 represents what is left and 2 stays with it.
    genomes = at(0.0, 1.0, 1.2)
    speciation = sorted_in(genomes, threshold=1.5, target=3, step=0.7, adjust_every=1)
    assert members(speciation) == [[0, 1, 2]]
    speciation.species[0].members = np.array([1, 2, 0])
    speciation.count_offspring(genomes, [0, 1, 2])
    assert members(speciation) == [[1, 2], [0]]


def test_reassigning_sees_a_genome_that_changed() -> None:
    genomes = at(0.0, 0.0, 9.0)
    speciation = sorted_in(genomes, threshold=2.0, step=0.0, adjust_every=1)
    speciation.count_offspring(genomes, [0, 1, 2])
    assert members(speciation) == [[0, 1], [2]]
    genomes[1] = genomes[1].with_weights([9.0, 9.0])
    speciation.count_offspring(genomes, [0, 1, 2])
    assert members(speciation) == [[0], [2, 1]]


def test_a_species_swallowed_by_an_older_one_vanishes() -> None:
    genomes = at(0.0, 1.2)
    speciation = sorted_in(genomes, threshold=1.0, target=1, step=0.5, adjust_every=1)
    assert members(speciation) == [[0], [1]]
    speciation.count_offspring(genomes, [0, 1])
    assert members(speciation) == [[0, 1]]


def test_species_continue_from_their_state() -> None:
    genomes = at(0.0, 9.0, 0.0)
    speciation = sorted_in(genomes, threshold=2.0, target=9)
    speciation.remove(1)
    for _ in range(7):
        speciation.count_offspring(genomes, [0, 2])
    state = speciation.state_dict()
    copy = Speciation(speciation.config, DISTANCE)
    copy.load_state(state)
    assert copy.state_dict() == state
    for one in (speciation, copy):
        for _ in range(3):
            one.count_offspring(genomes, [0, 2])
        one.add(1, genomes)
    assert copy.state_dict() == speciation.state_dict()
    assert copy.threshold == pytest.approx(1.8)


def test_a_config_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="0 < floor <= threshold"):
        SpeciesConfig(threshold=0.2)
    with pytest.raises(ValueError, match="adjust_every: expected at least 1, got 0"):
        SpeciesConfig(adjust_every=0)
    with pytest.raises(ValueError, match="step: expected at least 0"):
        SpeciesConfig(step=-0.1)
