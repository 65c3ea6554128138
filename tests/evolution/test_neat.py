from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_torch.checkpoint import load_checkpoint, save_checkpoint
from neatq_torch.evolution import NEAT, NEAT_2002, NEATConfig, Species, SpeciesConfig
from neatq_torch.evolution.neat import breeders, offspring_counts, shared_fitness
from neatq_torch.evolution.species import Speciation
from neatq_torch.genome import Genome, InnovationLedger, NodeKind, initial_genome

MUTATION = NEAT_2002.mutation
ONE = initial_genome(2, 1, rng=np.random.default_rng(0))


def start(population: int = 20, seed: int = 0, **config: Any) -> NEAT:
    rng = np.random.default_rng(seed)
    return NEAT.start(NEATConfig(**config), slots=population, inputs=2, outputs=1, rng=rng)


def apart(*positions: float, **config: Any) -> NEAT:
    """A population of genomes whose distance is 0.4 times the difference of their positions."""
    genomes = [ONE.with_weights([at] * 3).replaced(genome_id=i) for i, at in enumerate(positions)]
    ledger = InnovationLedger.for_genomes(genomes)
    rng = np.random.default_rng(0)
    return NEAT(NEATConfig(**config), genomes, rng, ledger, len(genomes))


def live(population: NEAT, generations: int, seed: int = 0) -> list[str]:
    """Advance with fitness by chance; all genomes of all generations."""
    chance = np.random.default_rng((seed, population.generation))
    seen = []
    for _ in range(generations):
        population.tell(chance.normal(size=len(population.genomes)))
        seen += [genome.to_json() for genome in population.genomes]
    return seen


def hidden(genome: Genome) -> int:
    return int((genome.node_kind == NodeKind.HIDDEN).sum())


# ---------------------------------------------------------------------------- shares


def test_offspring_are_shared_out_by_the_mean_fitness_of_species() -> None:
    # Species of 3 and of 1: (1 + 2 + 6) / 3 = 3 and 9 / 1 = 9, so 12 offspring are dealt 3 to 9.
    species = [Species(1, np.array([0, 1, 2])), Species(2, np.array([3]))]
    shares = shared_fitness(np.array([1.0, 2.0, 6.0, 9.0]), species)
    assert shares.tolist() == [3.0, 9.0]
    assert offspring_counts(shares, 12).tolist() == [3, 9]


def test_what_is_left_over_goes_to_the_largest_remainders() -> None:
    # Due are 1.4, 2.8 and 2.8; one is left for each of the latter.
    assert offspring_counts([1.0, 2.0, 2.0], 7).tolist() == [1, 3, 3]
    # Equal remainders: the first of equals first.
    assert offspring_counts([1.0, 1.0, 1.0], 4).tolist() == [2, 1, 1]


def test_negative_fitness_is_lifted_so_that_the_lowest_is_0() -> None:
    species = [Species(1, np.array([0, 1])), Species(2, np.array([2]))]
    assert shared_fitness(np.array([-5.0, -1.0, 3.0]), species).tolist() == [2.0, 8.0]


def test_where_nobody_is_fit_all_species_count_the_same() -> None:
    species = [Species(1, np.array([0, 1])), Species(2, np.array([2]))]
    assert shared_fitness(np.zeros(3), species).tolist() == [1.0, 1.0]
    assert shared_fitness(np.full(3, -7.0), species).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("members", "able"), [(1, 1), (4, 1), (5, 2), (10, 3), (14, 3)])
def test_the_fittest_fifth_and_one_more_may_breed(members: int, able: int) -> None:
    ranked = np.arange(members)[::-1]
    assert breeders(ranked, 0.2).tolist() == ranked[:able].tolist()


@given(st.lists(st.floats(0, 1e9), min_size=1, max_size=20), st.integers(1, 300))
def test_counts_add_up_and_are_within_one_of_what_is_due(shares: list[float], total: int) -> None:
    values = np.array(shares) + 1e-9
    counts = offspring_counts(values, total)
    assert counts.sum() == total
    assert (np.abs(counts - values / values.sum() * total) < 1.0 + 1e-6).all()


# ---------------------------------------------------------------------------- generations


@settings(max_examples=25, deadline=None)
@given(
    population=st.integers(1, 40),
    seed=st.integers(0, 2**32 - 1),
    threshold=st.sampled_from([0.5, 1.0, 3.0]),
    scale=st.sampled_from([0.0, 1.0, 1e6]),
)
def test_a_population_keeps_its_size(
    population: int, seed: int, threshold: float, scale: float
) -> None:
    config = {"species": SpeciesConfig(threshold=threshold, step=0.0), "stagnation_generations": 2}
    evolved = start(population, seed, **config)
    chance = np.random.default_rng(seed)
    for _ in range(6):
        evolved.tell(chance.normal(size=population) * scale)
        assert len(evolved.genomes) == population
        members = np.concatenate([one.members for one in evolved.species])
        assert sorted(members.tolist()) == list(range(population))


def test_champions_of_large_species_live_on_bit_for_bit_and_others_do_not() -> None:
    # Distances within a species are below 3, between them 0.4 * 10 = 4.
    population = apart(*[0.0] * 6, *[10.0] * 5, *[20.0] * 9)
    assert [one.members.size for one in population.species] == [6, 5, 9]
    fitness = np.ones(20)
    fitness[[2, 7, 12]] = 2.0, 2.0, 3.0
    champions = [population.genomes[slot] for slot in (2, 7, 12)]
    population.tell(fitness)
    kept = [any(one.to_json() == new.to_json() for new in population.genomes) for one in champions]
    assert kept == [True, False, True]
    assert population.births == 18


def test_the_champions_of_small_species_have_only_changed_offspring() -> None:
    still = replace(NEAT_2002, mutation=replace(MUTATION, link_weights_prob=1.0))
    population = apart(*[0.0] * 5, 10.0, reproduction=still)
    population.tell([1.0] * 5 + [2.0])
    # Not even the best of all lives on, as it is alone.
    assert all(one.genome_id >= 6 for one in population.genomes)


def test_a_species_that_stagnates_has_no_offspring_until_it_improves() -> None:
    population = apart(*[0.0] * 10, *[10.0] * 10, stagnation_generations=3)
    frozen = replace(MUTATION, add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
    population.config = replace(
        population.config, reproduction=replace(NEAT_2002, mutation=frozen, mutate_only_prob=1.0)
    )
    sizes = []
    for generation in range(5):
        far = np.array([one.link_weight[0] > 5 for one in population.genomes])
        sizes.append(int(far.sum()))
        # The far species stays at 1; the near one is fitter and improves.
        population.tell(np.where(far, 1.0, 1.0 + 0.01 * (generation + 1)))
    # Generation 0 was its last improvement: it is judged in 0, 1 and 2, and barred in 3.
    assert sizes[:4] == [10, 10, 10, 10]
    assert sizes[4] == 0


def test_if_all_stagnate_the_two_best_species_share_the_next_generation() -> None:
    population = apart(*[0.0] * 6, *[10.0] * 6, *[20.0] * 6, stagnation_generations=1)
    fitness = np.repeat([1.0, 3.0, 2.0], 6)
    population.tell(fitness)
    for species, value in zip(population.species, (1.0, 3.0, 2.0), strict=True):
        fitness[species.members] = value
    first = population.species[0].members.tolist()
    counts: list[int] = []
    children = population._children

    def spy(some: np.ndarray, *rest: Any) -> Any:
        counts.extend(some.tolist())
        return children(some, *rest)

    population._children = spy  # pyright: ignore[reportAttributeAccessIssue]
    population.tell(fitness)
    assert first and counts == [0, 9, 9]


def test_after_20_generations_without_a_record_only_the_two_best_species_breed() -> None:
    config = {"stagnation_generations": 1000, "refocus_generations": 20}
    population = apart(*[0.0] * 6, *[10.0] * 6, *[20.0] * 6, **config)
    still = replace(MUTATION, add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
    population.config = replace(
        population.config, reproduction=replace(NEAT_2002, mutation=still, mutate_only_prob=1.0)
    )

    def species_of() -> list[int]:
        kinds = [round(float(one.link_weight[0]) / 10) for one in population.genomes]
        return np.bincount(kinds, minlength=3).tolist()

    for _ in range(20):
        assert min(species_of()) > 0
        weights = np.array([one.link_weight[0] for one in population.genomes])
        population.tell(np.where(weights == 10.0, 5.0, np.where(weights == 0.0, 4.0, 3.0)))
    assert species_of()[2] > 0
    weights = np.array([one.link_weight[0] for one in population.genomes])
    population.tell(np.where(weights == 10.0, 5.0, np.where(weights == 0.0, 4.0, 3.0)))
    assert species_of() == [9, 9, 0]


def test_whoever_breeds_again_after_a_standstill_is_given_time_again() -> None:
    still = replace(MUTATION, add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
    alone = replace(NEAT_2002, mutation=still, mutate_only_prob=1.0)
    config: dict[str, Any] = {"stagnation_generations": 1000, "refocus_generations": 2}
    population = apart(*[0.0] * 6, *[10.0] * 6, *[20.0] * 6, reproduction=alone, **config)
    for generation in range(3):
        assert population.records[0][2] == 0, generation
        weights = np.array([one.link_weight[0] for one in population.genomes])
        population.tell(np.where(weights == 10.0, 5.0, np.where(weights == 0.0, 4.0, 3.0)))
    reached = {number: generation for number, _, generation in population.records}
    assert (reached[0], sorted(reached.values())) == (2, [0, 2, 2, 2])


def test_all_breeders_have_the_same_chance_and_nobody_else_breeds() -> None:
    still = replace(MUTATION, add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
    alone = replace(NEAT_2002, mutation=still, mutate_only_prob=1.0)
    # Positions tell who the parent was. Of 10 the fittest 3 may breed.
    population = apart(*(i / 10 for i in range(10)), reproduction=alone, elite_members=1000)
    totals = np.zeros(10)
    for _ in range(300):
        again = apart(*(i / 10 for i in range(10)), reproduction=alone, elite_members=1000)
        again.rng = population.rng
        again.tell(np.arange(10.0))
        totals += np.bincount([round(10 * one.link_weight[0]) for one in again.genomes], None, 10)
    # 3000 offspring come from three parents alike.
    assert totals[:7].sum() == 0
    assert np.abs(totals[7:] - 1000).max() < 100


def test_a_new_species_is_numbered_on_and_empty_ones_vanish() -> None:
    population = apart(0.0, 0.0, 10.0)
    assert [one.species_id for one in population.species] == [1, 2]
    far = [ONE.with_weights([at] * 3) for at in (30.0, 10.0, 10.0)]
    population.speciation.renew(far, [population.genomes[0], population.genomes[2]])
    assert [one.species_id for one in population.species] == [2, 3]
    assert [one.members.tolist() for one in population.species] == [[1, 2], [0]]


@pytest.mark.parametrize(("representative", "drawn"), [("champion", {2}), ("random", {0, 1, 2})])
def test_the_champion_or_a_random_member_represents_a_species(
    representative: Any, drawn: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: set[int] = set()

    def spy(self: Speciation, genomes: list[Genome], representatives: list[Genome]) -> None:
        seen.update(one.genome_id for one in representatives)

    population = apart(0.0, 0.1, 0.2, representative=representative)
    monkeypatch.setattr(Speciation, "renew", spy)
    for _ in range(50):
        again = apart(0.0, 0.1, 0.2, representative=representative)
        again.speciation.species = [Species(1, np.array([0, 1, 2]))]
        again.rng = population.rng
        again.tell([1.0, 2.0, 3.0])
    assert seen == drawn


def test_a_threshold_with_a_step_moves_once_a_generation() -> None:
    species = SpeciesConfig(threshold=3.0, target=5, step=0.5, floor=0.3)
    population = start(10, species=species)
    population.tell(np.ones(10))
    assert population.speciation.threshold == 2.5
    fixed = start(10)
    fixed.tell(np.ones(10))
    assert fixed.speciation.threshold == 3.0


def test_the_same_seed_gives_the_same_run_and_another_seed_another() -> None:
    assert live(start(seed=3), 8) == live(start(seed=3), 8)
    assert live(start(seed=3), 3) != live(start(seed=4), 3)


# ---------------------------------------------------------------------------- state


def test_a_saved_population_continues_bit_for_bit(tmp_path: Any) -> None:
    population = start(30, species=SpeciesConfig(threshold=1.0, step=0.1))
    live(population, 12)
    save_checkpoint(
        tmp_path / "run.npz", {"population": population.state_dict()}, observation_schema=""
    )
    state = load_checkpoint(tmp_path / "run.npz")["population"]
    copy = NEAT.from_state(population.config, state)
    assert live(copy, 25) == live(population, 25)
    assert copy.generation == population.generation == 37
    assert copy.births == population.births
    ledgers = (one.ledger.state_dict() for one in (copy, population))
    assert len({json.dumps(one) for one in ledgers}) == 1


def test_learned_weights_are_inherited() -> None:
    still = replace(MUTATION, add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
    population = start(4, reproduction=replace(NEAT_2002, mutation=still, mutate_only_prob=1.0))
    learned = np.array([1.5, -2.5, 0.125], np.float32)
    population.write_back(2, learned)
    population.tell([0.0, 0.0, 1.0, 0.0])
    assert all(np.array_equal(one.link_weight, learned) for one in population.genomes)


@pytest.mark.parametrize(("innovations", "known"), [("generation", 0), ("run", 3)])
def test_mutations_are_known_for_a_generation_or_for_the_run(innovations: Any, known: int) -> None:
    population = start(innovations=innovations)
    next_innovation = population.ledger.next_innovation
    live(population, 1)
    assert len(population.ledger.state_dict()["links"]) >= known
    assert known or not population.ledger.state_dict()["links"]
    # Numbers are never given twice.
    assert population.ledger.next_innovation >= next_innovation == 4


# ---------------------------------------------------------------------------- ablations


def test_without_growth_no_genome_changes_its_structure() -> None:
    mutation = replace(MUTATION, add_node_prob=0.0, add_link_prob=0.0)
    population = start(
        reproduction=replace(NEAT_2002, mutation=mutation), start="layered", start_hidden=4
    )
    founder = population.genomes[0]
    live(population, 10)
    # Two inputs and the bias into 4 hidden nodes, these and the bias into the output.
    assert founder.link_weight.size == 3 * 4 + 4 + 1
    own = {"genome_id": 0, "link_weight": founder.link_weight}
    structures = {one.replaced(**own).to_json() for one in population.genomes}
    assert structures == {founder.replaced(genome_id=0).to_json()}


def test_without_speciation_there_is_one_species() -> None:
    population = start(speciate=False, start="random")
    assert len(start(start="random").species) > 1
    for _ in range(10):
        assert len(population.species) == 1
        live(population, 1)


def test_a_population_without_species_does_not_get_any_by_being_saved() -> None:
    population = start(speciate=False, start="random")
    copy = NEAT.from_state(population.config, population.state_dict())
    live(copy, 3)
    assert len(copy.species) == 1


def test_without_mating_every_child_has_one_parent() -> None:
    def parents(**reproduction: float) -> set[int]:
        population = start(reproduction=replace(NEAT_2002, **reproduction))
        rng = np.random.default_rng(0)
        told = [population.tell(rng.random(len(population.genomes))) for _ in range(6)]
        return {len(one.parents) for generation in told for one in generation}

    assert parents(mutate_only_prob=1.0) == {1}
    assert parents() == {1, 2}


def test_random_founders_have_1_to_10_hidden_nodes() -> None:
    counts = {hidden(one) for one in start(200, start="random").genomes}
    assert counts == set(range(1, 11))


# ---------------------------------------------------------------------------- errors


def test_a_fitness_that_is_not_finite_is_named() -> None:
    with pytest.raises(ValueError, match="fitness: expected finite numbers, got nan of slot 2"):
        start(4).tell([1.0, 2.0, np.nan, np.inf])


def test_fitness_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"fitness: expected the shape \[slots = 4\], got \[3\]"):
        start(4).tell([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("survival_share", 1.5),
        ("stagnation_generations", 0),
        ("refocus_generations", 0),
        ("start_hidden", 0),
        ("elite_members", -1),
        ("start", "full"),
        ("innovations", "for ever"),
        ("representative", "first"),
    ],
)
def test_a_bad_setting_is_named(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=field):
        NEATConfig(**{field: value})


def test_a_population_needs_a_founder_and_a_free_number() -> None:
    ledger, rng = InnovationLedger(), np.random.default_rng(0)
    with pytest.raises(ValueError, match="at least 1 genomes, got 0"):
        NEAT(NEATConfig(), [], rng, ledger, 1)
    with pytest.raises(ValueError, match="highest id 0"):
        NEAT(NEATConfig(), [ONE], rng, ledger, 0)
