"""What all kinds of populations have in common, and lives that are made of episodes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_torch.evolution import (
    NEAT,
    NEAT_2002,
    OPENNERO,
    FixedConfig,
    FixedPopulation,
    NEATConfig,
    Population,
    RtNEAT,
    RtNEATConfig,
    SpeciesConfig,
    population_kinds,
)
from neatq_torch.genome import InnovationLedger, initial_genome, layered_genome
from neatq_torch.kinds import ConfigError, Kinds

STILL = replace(NEAT_2002.mutation, add_node_prob=0.0, add_link_prob=0.0, link_weights_prob=0.0)
KINDS: dict[str, dict[str, Any]] = {
    "rtneat": {"minimum_life_episodes": 2, "ineligible_fraction": 0.5},
    "neat": {"episodes": 2, "species": SpeciesConfig(threshold=1.0, step=0.1)},
    "fixed": {"episodes": 2, "start_hidden": 3},
}


def start(kind: str, slots: int = 6, seed: Any = 0, **given: Any) -> Population:
    config_class = population_kinds.config(kind)
    population_class = population_kinds.maker_of(config_class())
    weights = given.pop("reward_weights", (1.0,))
    config = config_class(**(KINDS[kind] | given))
    return population_class.start(
        config, slots=slots, inputs=2, outputs=1, rng=seed, reward_weights=weights
    )


def as_text(one: Population) -> str:
    """A whole state as text, arrays as bytes."""
    return json.dumps(one.state_dict(), default=lambda array: array.tobytes().hex())


def batches(slots: int, number: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    chance = np.random.default_rng(seed)
    for _ in range(number):
        shape = (slots, int(chance.integers(0, 5)))
        yield chance.normal(size=(*shape, 1)), chance.random(shape) < 0.4


def live(one: Population, number: int, seed: int) -> list[tuple[int, int, tuple[int, ...]]]:
    """Live through batches; what was replaced by what."""
    seen = []
    for rewards, done in batches(len(one.genomes), number, seed):
        one.record(rewards, done)
        seen += [(new.slot, new.genome.genome_id, new.parents) for new in one.advance()]
    return seen


# ---------------------------------------------------------------------------- every kind


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pause", [0, 1, 13])
def test_a_population_goes_on_from_its_state_bit_for_bit(kind: str, pause: int) -> None:
    one = start(kind)
    live(one, pause, seed=1)
    state = json.loads(json.dumps(one.state_dict(), default=lambda array: array.tolist()))
    copy = type(one).from_state(one.config, state)
    assert as_text(copy) == as_text(one)
    rest = live(one, 40, seed=2)
    assert rest and live(copy, 40, seed=2) == rest
    assert as_text(copy) == as_text(one)


@pytest.mark.parametrize("kind", KINDS)
@given(cuts=st.lists(st.integers(0, 24), max_size=6), seed=st.integers(0, 100))
@settings(max_examples=25, deadline=None)
def test_the_cut_into_batches_does_not_matter(kind: str, cuts: list[int], seed: int) -> None:
    chance = np.random.default_rng(seed)
    rewards, done = chance.normal(size=(4, 24, 3)), chance.random((4, 24)) < 0.3
    weights = (1.0, -0.3, 0.1)
    whole, parts = (start(kind, slots=4, reward_weights=weights) for _ in range(2))
    whole.record(rewards, done)
    for some, ends in zip(
        *(np.split(one, sorted(cuts), axis=1) for one in (rewards, done)), strict=True
    ):
        parts.record(some, ends)
    assert as_text(parts) == as_text(whole)
    assert parts.due() == whole.due()


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_stands_for_its_generator(kind: str) -> None:
    assert as_text(start(kind, seed=3)) == as_text(start(kind, seed=np.random.default_rng(3)))
    assert as_text(start(kind, seed=3)) != as_text(start(kind, seed=4))


@pytest.mark.parametrize("kind", KINDS)
def test_founders_are_drawn_one_after_the_other(kind: str) -> None:
    config_class = population_kinds.config(kind)
    population_class = population_kinds.maker_of(config_class())
    rng = np.random.default_rng(7)
    made: dict[str, Any] = {"bias": False, "activation": "tanh", "observation_schema": "what"}
    make, look = initial_genome, {}
    if kind == "fixed":
        make, look = layered_genome, {"hidden": 10}
    expected = [make(3, 2, rng=rng, genome_id=i, **look, **made) for i in (1, 2, 3)]
    one = population_class.start(config_class(), slots=3, inputs=3, outputs=2, rng=7, **made)
    assert all(a.to_json() == b.to_json() for a, b in zip(one.genomes, expected, strict=True))
    assert one.rng.bit_generator.state == rng.bit_generator.state
    assert one.ledger.state_dict() == InnovationLedger.for_genomes(expected).state_dict()


@pytest.mark.parametrize(
    ("kind", "activation"),
    [("rtneat", "sigmoid"), ("neat", "steep_sigmoid"), ("fixed", "steep_sigmoid")],
)
def test_outputs_are_as_hidden_nodes_unless_it_is_said(kind: str, activation: str) -> None:
    expected = initial_genome(2, 1, rng=np.random.default_rng(0), activation=activation)
    for genome in start(kind).genomes:
        assert genome.node_activation[3] == expected.node_activation[3]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ((), r"expected the shape \[dimensions = 1\], got \[0\]"),
        ((1.0, np.nan), "expected finite numbers, got nan of dimension 1"),
        (((1.0,),), r"expected the shape \[dimensions = 1\], got \[1, 1\]"),
    ],
)
def test_reward_weights_out_of_range_are_refused(kind: str, weights: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"reward_weights: {message}"):
        start(kind, reward_weights=weights)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_learned_is_written_back(kind: str) -> None:
    one = start(kind)
    learned = one.genomes[2].link_weight + np.float32(0.5)
    one.write_back(2, learned)
    assert one.genomes[2].link_weight.tobytes() == learned.tobytes()
    assert one.genomes[2].genome_id == 3


def test_a_kind_needs_a_name_and_a_configuration_of_its_own() -> None:
    @dataclass(frozen=True)
    class OwnConfig(NEATConfig):
        pass

    class Own(NEAT):
        pass

    kinds = Kinds("population")
    for name in population_kinds:
        config_class = population_kinds.config(name)
        kinds.register(name, config_class, population_kinds.maker_of(config_class()))
    kinds.register("own", OwnConfig, Own)
    kinds.register("own", OwnConfig, Own)
    assert kinds.config("own") is OwnConfig and kinds.name_of(OwnConfig()) == "own"
    assert kinds.maker_of(OwnConfig()) is Own
    assert list(kinds) == [*population_kinds, "own"]
    assert list(population_kinds)[:3] == ["rtneat", "neat", "fixed"]
    for name, config, taken in (
        ("neat", OwnConfig, "the name 'neat'"),
        ("own", RtNEATConfig, "RtNEATConfig as 'rtneat'"),
        ("other", NEATConfig, "NEATConfig as 'neat'"),
        ("twice", OwnConfig, "OwnConfig as 'own'"),
    ):
        with pytest.raises(ConfigError, match=f"population: {taken} is taken"):
            kinds.register(name, config, Own)


# ---------------------------------------------------------------------------- generations

# Three slots, five ticks, two dimensions weighted by 1 and 0.5; each slot has two episodes.
REWARDS = np.array(
    [
        [[1, 0], [2, 2], [4, 0], [99, 0], [99, 0]],
        [[0, 2], [0, 2], [0, 2], [0, 2], [3, 0]],
        [[5, 0], [0, 0], [0, 0], [1, 2], [50, 0]],
    ],
    dtype=float,
)
DONE = np.array([[0, 1, 1, 1, 1], [0, 0, 1, 0, 1], [1, 0, 0, 1, 0]], dtype=bool)


@pytest.mark.parametrize("kind", ["neat", "fixed"])
def test_fitness_is_the_mean_over_the_episodes_of_a_life(kind: str) -> None:
    one = start(kind, slots=3, reward_weights=(1.0, 0.5))
    assert (one.due(), one.champion, one.generations) == (0, None, 0)
    assert np.isnan(one.returns).all()
    one.record(REWARDS[:, :4], DONE[:, :4])
    # Slot 0: 1 + 3 and 4; slot 2: 5 and 2. What comes later does not count.
    assert one.eligible.tolist() == [True, False, True]
    assert one.returns[[0, 2]].tolist() == [4.0, 3.5] and np.isnan(one.returns[1])
    assert (one.due(), one.champion, one.generations, one.advance()) == (0, 0, 0, [])
    one.record(REWARDS[:, 4:], DONE[:, 4:])
    # Slot 1: 3 and 1 + 3.
    assert one.returns.tolist() == one.fitness.tolist() == [4.0, 3.5, 3.5]
    assert (one.due(), one.champion, one.generations) == (1, 0, 1)
    assert len(one.advance()) == 3
    assert (one.due(), one.champion, one.generations) == (0, None, 1)
    assert not one.eligible.any() and np.isnan(one.returns).all()
    one.record(REWARDS, DONE)
    assert one.returns.tolist() == [4.0, 3.5, 3.5]


@pytest.mark.parametrize("kind", ["neat", "fixed"])
def test_as_many_episodes_as_are_configured_make_a_life(kind: str) -> None:
    for episodes in (1, 3):
        one = start(kind, slots=2, episodes=episodes)
        for lived in range(episodes):
            assert one.due() == 0
            one.record(np.full((2, 1, 1), lived), np.ones((2, 1)))
        assert one.due() == 1
        assert one.fitness.tolist() == [(episodes - 1) / 2] * 2


@pytest.mark.parametrize("kind", ["neat", "fixed"])
def test_the_end_of_episodes_must_be_told(kind: str) -> None:
    with pytest.raises(ValueError, match=r"done: expected the shape .* got nothing"):
        start(kind).record(np.zeros((6, 2, 1)))


def test_advancing_is_telling_the_fitness_that_was_recorded() -> None:
    lived, told = start("neat", slots=12), start("neat", slots=12)
    assert isinstance(told, NEAT)
    for seed in range(4):
        rewards = np.random.default_rng(seed).normal(size=(12, 2, 1))
        lived.record(rewards, np.ones((12, 2)))
        new = [(a.genome.to_json(), *a[2:]) for a in lived.advance()]
        other = told.tell(rewards[..., 0].mean(1))
        assert new == [(b.genome.to_json(), *b[2:]) for b in other]
        assert [one.genome for one in other] == told.genomes
    assert as_text(lived) == as_text(told)


def test_every_slot_of_a_generation_is_told_with_its_parents() -> None:
    one = start("neat", slots=8, speciate=False, elite_members=7)
    assert isinstance(one, NEAT) and one.advance() == []
    best, *rest = one.tell(np.arange(8.0))
    # The champion lives on; of 8 the fittest int(0.2 * 8) + 1 = 2 may breed.
    assert (best.slot, best.genome.genome_id, best.removed_genome_id) == (0, 8, 1)
    assert best.parents == (8,)
    assert [new.slot for new in rest] == list(range(1, 8))
    assert [new.removed_genome_id for new in rest] == list(range(2, 9))
    assert [new.genome.genome_id for new in rest] == list(range(9, 16))
    assert all(set(new.parents) <= {7, 8} for new in rest)
    assert all(list(new.parents) == sorted(new.parents, reverse=True) for new in rest)
    assert {len(new.parents) for new in rest} == {1, 2}
    assert one.births == 7


def test_networks_of_fixed_structure_stay() -> None:
    one = start("fixed")
    assert isinstance(one, FixedPopulation) and one.species == [] and one.births == 0
    before = list(one.genomes)
    one.record(np.zeros((6, 2, 1)), np.ones((6, 2)))
    told = one.advance()
    assert [(new.slot, new.removed_genome_id, new.parents) for new in told] == [
        (slot, slot + 1, (slot + 1,)) for slot in range(6)
    ]
    assert all(new.genome is genome for new, genome in zip(told, before, strict=True))
    assert one.genomes == before and one.generation == 1
    assert {genome.node_id.size for genome in before} == {2 + 1 + 1 + 3}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": 0}, "episodes: expected at least 1, got 0"),
        ({"start": "full"}, "start: expected 'minimal' or 'layered' or 'random', got 'full'"),
        ({"start_hidden": 0}, "start_hidden: expected at least 1, got 0"),
    ],
)
def test_a_config_of_generations_out_of_range_is_refused(change: Any, message: str) -> None:
    for config in (NEATConfig, FixedConfig):
        with pytest.raises(ValueError, match=message):
            config(**change)


# ---------------------------------------------------------------------------- episodes in rtNEAT


def rtneat(slots: int = 4, **config: Any) -> RtNEAT:
    one = start("rtneat", slots, **config)
    assert isinstance(one, RtNEAT)
    return one


def test_one_is_replaced_for_every_so_many_closed_trials() -> None:
    one = rtneat(slots=4, ineligible_fraction=0.5)
    # Slot 0 alone ends an episode at each tick: every second one closes a trial.
    ends = np.zeros((4, 1))
    ends[0] = 1
    due = []
    for _ in range(16):
        one.record(np.zeros((4, 1, 1)), ends)
        due.append(one.due())
    # floor(trials / 2) - 2, from the first 4 trials on.
    assert due == [max(0, (tick // 2) // 2 - 2) for tick in range(1, 17)]
    assert due[-1] == 2 and one.generations == 2
    # Only slot 0 may be judged, so only it makes room, and nothing stays due.
    assert [new.slot for new in one.advance()] == [0]
    assert (one.due(), one.eligible.any()) == (0, False)


def test_a_newborn_has_all_its_episodes_before_it() -> None:
    one = rtneat(slots=2, ineligible_fraction=1.0)
    one.record(np.array([[[1.0]] * 5, [[2.0]] * 5]), np.array([[1, 1, 1, 1, 1]] * 2))
    # Four trials are closed, two beyond the first life of all; both make room.
    assert one.due() == 2
    assert sorted(new.slot for new in one.advance()) == [0, 1]
    assert not one.trials.ended.any() and not one.age_ticks.any()
    assert np.isnan(one.returns).all()
    one.record(np.full((2, 1, 1), 3.0), np.ones((2, 1)))
    assert not one.eligible.any()
    one.record(np.full((2, 1, 1), 5.0), np.ones((2, 1)))
    assert one.returns.tolist() == [4.0, 4.0]
    assert one.generations == 3


def test_returns_are_of_an_episode_or_of_the_whole_trial() -> None:
    rewards = np.array([[[1, 10], [2, 20], [3, 30]]] * 2, dtype=float)
    done = np.array([[1, 1, 0], [0, 0, 0]])
    episodes = rtneat(slots=2, reward_weights=(1.0, -0.1))
    episodes.record(rewards, done)
    # (1 + 2) / 2 - 0.1 * (10 + 20) / 2
    assert episodes.returns[0] == 0.0 and np.isnan(episodes.returns[1])
    config = {"minimum_life_episodes": None, "minimum_life_ticks": 3}
    ticks = rtneat(slots=2, reward_weights=(1.0, 0.5), **config)
    ticks.record(rewards[:, :2])
    assert np.isnan(ticks.returns).all()
    ticks.record(rewards[:, 2:])
    assert ticks.returns.tolist() == [6.0 + 30.0] * 2 and ticks.generations == 1


def test_with_ticks_the_end_of_episodes_makes_no_difference() -> None:
    config = RtNEATConfig(minimum_life_ticks=5)
    with_it, without = (RtNEAT.start(config, slots=6, inputs=2, outputs=1, rng=0) for _ in range(2))
    born = 0
    for rewards, done in batches(6, 40, seed=0):
        with_it.record(rewards, done)
        born += len(with_it.advance())
        without.record(rewards)
        without.advance()
        assert as_text(with_it) == as_text(without)
    assert born > 20


# ---------------------------------------------------------------------------- single settings


def moved(setting: str, value: Any, *, seed: int = 0) -> bool:
    """Whether a run of NEAT with one setting differs from one without."""

    def run(config: NEATConfig) -> str:
        one = NEAT.start(config, slots=24, inputs=2, outputs=1, rng=seed)
        chance = np.random.default_rng(seed)
        for _ in range(12):
            one.tell(chance.normal(size=24))
        return as_text(one)

    usual = NEATConfig(
        species=SpeciesConfig(threshold=1.0, step=0.1, floor=0.95),
        stagnation_generations=3,
        refocus_generations=4,
    )
    return run(usual) != run(with_setting(usual, setting, value))


def with_setting(config: Any, path: str, value: Any) -> Any:
    name, _, rest = path.partition(".")
    inner = with_setting(getattr(config, name), rest, value) if rest else value
    return replace(config, **{name: inner})


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("survival_share", 0.5),
        ("stagnation_generations", 4),
        ("refocus_generations", 5),
        ("elite_members", 4),
        ("representative", "champion"),
        ("innovations", "run"),
        ("species.threshold", 1.1),
        ("species.target", 2),
        ("species.step", 0.2),
        ("species.floor", 0.5),
        ("reproduction.mutate_only_prob", 0.3),
        ("reproduction.mate_only_prob", 0.3),
        ("reproduction.multipoint_prob", 0.5),
        ("reproduction.interspecies_mate_prob", 0.1),
        ("reproduction.mutation.add_node_prob", 0.1),
        ("reproduction.mutation.add_link_prob", 0.1),
        ("reproduction.mutation.link_weights_prob", 0.8),
        ("reproduction.mutation.weight_scheme", "uniform"),
        ("reproduction.mutation.weight_mutation_power", 2.4),
        ("reproduction.mutation.max_link_weight", 4.0),
        ("reproduction.mutation.new_link_weight_power", 2.0),
        ("reproduction.mutation.recurrent_link_prob", 0.5),
        ("reproduction.mutation.split_old_below", 0),
        ("reproduction.mutation.split_weight_scale", 0.5),
        ("reproduction.mutation.hidden_activation", "tanh"),
        ("reproduction.mutation.toggle_enable_prob", 0.1),
        ("reproduction.mutation.reenable_prob", 0.9),
    ],
)
def test_every_setting_of_neat_makes_a_difference(setting: str, value: Any) -> None:
    assert any(moved(setting, value, seed=seed) for seed in range(4))


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("minimum_life_ticks", 11),
        ("ineligible_fraction", 0.55),
        ("species.threshold", 1.1),
        ("species.target", 5),
        ("species.step", 0.2),
        ("species.floor", 0.5),
        ("species.adjust_every", 6),
        ("reproduction.mutate_only_prob", 0.3),
        ("reproduction.interspecies_mate_prob", 0.1),
        ("reproduction.mutation.recurrent_loop_prob", 0.1),
        ("reproduction.mutation.forward_from_outputs", False),
        ("reproduction.mutation.new_link_tries", 1),
        ("reproduction.mutation.split_tries", 1),
    ],
)
def test_every_setting_of_rtneat_makes_a_difference(setting: str, value: Any) -> None:
    mutation = replace(OPENNERO.mutation, add_node_prob=0.2, add_link_prob=0.3)
    usual = RtNEATConfig(
        minimum_life_ticks=10,
        species=SpeciesConfig(threshold=1.0, floor=0.95),
        reproduction=replace(OPENNERO, mutation=mutation),
    )

    def run(config: RtNEATConfig) -> list[Any]:
        one = RtNEAT.start(config, slots=12, inputs=2, outputs=2, rng=0)
        chance, seen = np.random.default_rng(1), []
        for _ in range(60):
            one.record(chance.normal(size=(12, 4, 1)), behaviour=chance.normal(size=(12, 4, 1)))
            seen += [(new.slot, new.parents, new.genome.to_json()) for new in one.advance()]
            seen.append((one.speciation.threshold, len(one.species)))
        return seen

    assert run(usual) != run(with_setting(usual, setting, value))


def test_a_uniform_scheme_renews_as_many_weights_as_is_said() -> None:
    mutation = replace(STILL, link_weights_prob=1.0, weight_scheme="uniform")
    for share, renewed in ((0.0, False), (1.0, True)):
        config = NEATConfig(
            reproduction=replace(
                NEAT_2002,
                mutation=replace(mutation, weight_replace_prob=share, weight_mutation_power=0.5),
            )
        )
        one = NEAT.start(config, slots=4, inputs=2, outputs=1, rng=0)
        for slot in range(4):
            one.write_back(slot, [5.0] * 3)
        one.tell(np.ones(4))
        assert all((abs(new.link_weight) < 1).all() == renewed for new in one.genomes)
