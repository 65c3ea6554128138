from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_torch.evolution import (
    NEAT_2002,
    OPENNERO,
    Replacement,
    ReproductionConfig,
    RtNEAT,
    RtNEATConfig,
    SpeciesConfig,
)
from neatq_torch.evolution.trials import BestStretches
from neatq_torch.genome import InnovationLedger, initial_genome


def population(slots: int = 6, seed: int = 0, **config: Any) -> RtNEAT:
    config = {"minimum_life_ticks": 10} | config
    return RtNEAT.start(RtNEATConfig(**config), slots=slots, inputs=2, outputs=1, rng=seed)


def live(evolution: RtNEAT, ticks: int, rewards: list[float]) -> None:
    """Let robot i earn rewards[i] at each tick."""
    column = np.array(rewards)[:, None, None]
    evolution.record(np.broadcast_to(column, (len(rewards), ticks, 1)))


def run(evolution: RtNEAT, batches: int, seed: int) -> list[Replacement]:
    """Collect batches of 3 ticks with random rewards, with replacements and write backs."""
    rng = np.random.default_rng(seed)
    replacements: list[Replacement] = []
    for _ in range(batches):
        evolution.record(rng.normal(size=(len(evolution.genomes), 3, 1)))
        replacements += evolution.advance()
        slot = int(rng.integers(len(evolution.genomes)))
        evolution.write_back(slot, evolution.genomes[slot].link_weight + np.float32(0.01))
    return replacements


def test_50_robots_are_replaced_975_times_in_40000_ticks() -> None:
    config = RtNEATConfig()
    evolution = RtNEAT.start(config, slots=50, inputs=1, outputs=1, rng=0)
    rewards = np.random.default_rng(0).normal(size=(50, 40, 1))
    first = None
    for _ in range(1000):
        evolution.record(rewards)
        if evolution.advance() and first is None:
            first = evolution.tick
    assert evolution.tick == 40_000
    assert first == 1040
    assert evolution.births == 975


@given(st.lists(st.integers(0, 90), min_size=1, max_size=8))
@settings(max_examples=30)
def test_as_many_are_due_whatever_the_batches(batches: list[int]) -> None:
    evolution = population(slots=4, minimum_life_ticks=20, ineligible_fraction=0.5)
    total = 0
    for ticks in batches:
        live(evolution, ticks, [0.0] * 4)
        total += evolution.due()
        evolution.advance()
        assert evolution.due() == 0
    # One at each multiple of 20 / (4 * 0.5) = 10 ticks beyond 20.
    assert total == max(0, sum(batches) // 10 - 2)


def test_several_may_be_due_on_one_tick() -> None:
    evolution = population(slots=40, minimum_life_ticks=10)
    live(evolution, 10, [0.0] * 40)
    assert evolution.due() == 0
    live(evolution, 1, [0.0] * 40)
    assert evolution.due() == 2
    assert len({one.slot for one in evolution.advance()}) == 2


def test_the_worst_eligible_robot_is_removed_whatever_its_species() -> None:
    evolution = population(slots=4, species=SpeciesConfig(threshold=0.3))
    live(evolution, 15, [3.0, 1.0, 2.0, 4.0])
    worst = evolution.genomes[1].genome_id
    assert evolution.fitness[1] == 0.0
    assert (evolution.fitness[[0, 2, 3]] > 0).all()
    (replacement,) = evolution.advance()
    assert (replacement.slot, replacement.removed_genome_id) == (1, worst)
    assert evolution.genomes[1] is replacement.genome
    assert replacement.genome.genome_id == 5
    assert evolution.births == 1


def test_of_equally_bad_robots_the_oldest_goes() -> None:
    evolution = population(slots=3, ineligible_fraction=1.0)
    live(evolution, 14, [0.0, 0.0, 0.0])
    assert [one.slot for one in evolution.advance()] == [0]
    live(evolution, 20, [0.0, 0.0, 0.0])
    assert [one.slot for one in evolution.advance()][:2] == [1, 2]


def test_a_newborn_starts_from_nothing_and_is_never_removed() -> None:
    evolution = population(slots=4)
    live(evolution, 15, [1.0, -9.0, 2.0, 3.0])
    evolution.advance()
    assert evolution.age_ticks.tolist() == [15, 0, 15, 15]
    assert not evolution.trials.sums[1].any()
    assert not evolution.trials.averages[1].any()
    live(evolution, 5, [1.0, -9.0, 2.0, 3.0])
    assert evolution.eligible.tolist() == [True, False, True, True]
    assert evolution.fitness[1] == 0.0
    assert [one.slot for one in evolution.advance()] == [0]


@given(st.integers(0, 1000), st.floats(0.05, 1.0))
@settings(max_examples=20)
def test_nobody_is_removed_or_breeds_before_its_time(seed: int, fraction: float) -> None:
    evolution = population(slots=5, seed=seed, ineligible_fraction=fraction)
    rng = np.random.default_rng(seed)
    for _ in range(30):
        ages = evolution.age_ticks + 4
        evolution.record(rng.normal(size=(5, 4, 1)))
        assert evolution.age_ticks.tolist() == ages.tolist()
        replaced = [one.slot for one in evolution.advance()]
        assert (ages[replaced] >= 10).all()
        assert len(set(replaced)) == len(replaced)
        assert not evolution.age_ticks[replaced].any()
        slots = sorted(slot for one in evolution.species for slot in one.members)
        assert slots == [0, 1, 2, 3, 4]


def test_what_is_due_while_nobody_is_eligible_is_dropped() -> None:
    evolution = population(slots=2, ineligible_fraction=1.0)
    live(evolution, 35, [0.0, 1.0])
    # 5 are due, but two newborns cannot make room again.
    assert evolution.due() == 5
    assert len(evolution.advance()) == 2
    assert evolution.due() == 0
    live(evolution, 5, [0.0, 1.0])
    assert evolution.due() == 1
    assert evolution.advance() == []


def test_nothing_happens_before_the_first_life_is_over() -> None:
    evolution = population()
    live(evolution, 9, [0.0] * 6)
    assert (evolution.due(), evolution.advance(), evolution.champion) == (0, [], None)
    assert not evolution.fitness.any()


def test_the_champion_is_the_fittest_eligible_robot() -> None:
    evolution = population(slots=4)
    live(evolution, 10, [1.0, 2.0, 4.0, 3.0])
    assert evolution.champion == 2
    evolution.trials.reset(2)
    assert evolution.champion == 3


def test_parents_are_named_by_genome_and_were_alive() -> None:
    evolution = population(slots=6)
    alive = {genome.genome_id for genome in evolution.genomes}
    for replacement in run(evolution, 60, seed=1):
        alive.remove(replacement.removed_genome_id)
        assert set(replacement.parents) <= alive
        assert len(replacement.parents) in (1, 2)
        alive.add(replacement.genome.genome_id)
    assert evolution.births > 40
    assert alive == {genome.genome_id for genome in evolution.genomes}


def test_learned_weights_are_written_back_bit_for_bit() -> None:
    evolution = population()
    weights = np.array([0.1, np.pi, -3e-39], dtype=np.float32)
    before = evolution.genomes[2].genome_id
    evolution.write_back(2, weights)
    assert evolution.genomes[2].link_weight.tobytes() == weights.tobytes()
    assert evolution.genomes[2].genome_id == before


def test_a_robot_that_learned_may_leave_its_species() -> None:
    evolution = population(slots=4, species=SpeciesConfig(step=0.0, adjust_every=1))
    live(evolution, 15, [1.0, 0.0, 2.0, 3.0])
    assert evolution.advance()
    evolution.write_back(2, [99.0] * 3)
    live(evolution, 5, [1.0, 9.0, 2.0, 3.0])
    assert evolution.advance()
    assert [2] in [species.members.tolist() for species in evolution.species]


@pytest.mark.parametrize("reproduction", [OPENNERO, NEAT_2002], ids=["opennero", "neat2002"])
def test_the_same_seed_gives_the_same_run(reproduction: ReproductionConfig) -> None:
    first, second, other = (population(seed=seed, reproduction=reproduction) for seed in (3, 3, 4))
    for evolution in (first, second, other):
        run(evolution, 80, seed=1)
    assert as_text(first) == as_text(second)
    assert as_text(first) != as_text(other)


def as_text(evolution: RtNEAT) -> str:
    """Write a whole state as text, arrays as bytes."""
    return json.dumps(evolution.state_dict(), default=lambda array: array.tobytes().hex())


@pytest.mark.parametrize("reproduction", [OPENNERO, NEAT_2002], ids=["opennero", "neat2002"])
@pytest.mark.parametrize("pause", [0, 3, 41])
def test_a_run_continues_from_its_state_bit_for_bit(
    reproduction: ReproductionConfig, pause: int
) -> None:
    evolution = population(seed=5, reproduction=reproduction, ineligible_fraction=0.3)
    run(evolution, pause, seed=1)
    state = json.loads(json.dumps(evolution.state_dict(), default=lambda array: array.tolist()))
    copy = RtNEAT.from_state(evolution.config, state)
    assert as_text(copy) == as_text(evolution)
    rest, copied = run(evolution, 60, seed=2), run(copy, 60, seed=2)
    assert [one.slot for one in rest] == [one.slot for one in copied]
    assert all(a.genome.to_json() == b.genome.to_json() for a, b in zip(rest, copied, strict=True))
    assert as_text(copy) == as_text(evolution)
    assert rest


def test_a_state_is_not_changed_by_what_happens_later() -> None:
    evolution = population()
    run(evolution, 10, seed=1)
    state = evolution.state_dict()
    before = json.dumps(state, default=lambda array: array.tolist())
    run(evolution, 20, seed=2)
    assert json.dumps(state, default=lambda array: array.tolist()) == before


def test_a_state_of_other_dimensions_is_refused() -> None:
    state = population().state_dict()
    config = RtNEATConfig(minimum_life_ticks=10)
    with pytest.raises(ValueError, match=r"state of sums: expected the shape \[6, 2\]"):
        RtNEAT.from_state(config, state, reward_weights=(1.0, 1.0))


def test_founders_are_numbered_from_one_with_weights_of_their_own() -> None:
    evolution = population(slots=3)
    assert [genome.genome_id for genome in evolution.genomes] == [1, 2, 3]
    assert len({genome.link_weight.tobytes() for genome in evolution.genomes}) == 3


def test_a_population_too_small_or_with_a_number_twice_is_refused() -> None:
    genome = initial_genome(1, 1, rng=np.random.default_rng(0), genome_id=7)
    ledger, rng = InnovationLedger.for_genomes([genome]), np.random.default_rng(0)
    with pytest.raises(ValueError, match="at least 2 genomes, got 1"):
        RtNEAT(RtNEATConfig(), [genome], rng, ledger, 8)
    with pytest.raises(ValueError, match="beyond the founders' highest id 7, got 7"):
        RtNEAT(RtNEATConfig(), [genome, genome], rng, ledger, 7)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"minimum_life_ticks": 0}, "minimum_life_ticks: expected at least 1"),
        ({"minimum_life_episodes": 0}, "minimum_life_episodes: expected at least 1"),
        ({"ineligible_fraction": 0.0}, r"ineligible_fraction: expected \(0, 1\], got 0.0"),
        ({"pioneer_share": 0.1}, "pioneer_share: expected None without a survival_share"),
        ({"pioneer_share": 1.1, "survival_share": 0.2}, r"pioneer_share: expected \[0, 1\]"),
    ],
)
def test_a_config_out_of_range_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RtNEATConfig(**change)


def test_of_survivors_all_breed_as_often_and_others_never() -> None:
    evolution = population(slots=10, survival_share=0.3)
    live(evolution, 10, [float(one) for one in range(10)])
    judged = evolution.score, evolution.eligible
    fittest = evolution._breeders(*judged)
    drawn = [evolution._parents(*judged, fittest)[0] for _ in range(3000)]
    firsts = np.bincount([one[0] for one in drawn], minlength=10) / len(drawn)
    assert firsts == pytest.approx([0.0] * 7 + [1 / 3] * 3, abs=0.03)
    assert {slot for one in drawn for slot in one} == {7, 8, 9}
    single = np.mean([len(one) == 1 for one in drawn])
    assert single == pytest.approx(OPENNERO.mutate_only_prob, abs=0.03)


def test_a_survivor_alone_in_its_species_breeds_alone_and_one_always_survives() -> None:
    evolution = population(slots=4, survival_share=0.01)
    live(evolution, 10, [1.0, 5.0, 3.0, 2.0])
    judged = evolution.score, evolution.eligible
    fittest = evolution._breeders(*judged)
    drawn = {evolution._parents(*judged, fittest)[0] for _ in range(50)}
    assert drawn == {(1,)}


@pytest.mark.parametrize("rewards", [[0.0] * 6, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
def test_who_makes_room_has_no_more_offspring(rewards: list[float]) -> None:
    evolution = population(slots=6, survival_share=0.2, ineligible_fraction=1.0)
    for _ in range(20):
        live(evolution, 30, rewards)  # so long that more are due than can be judged
        for _, _, removed, parents in evolution.advance():
            assert removed not in parents


PIONEERS: dict[str, Any] = {"minimum_life_ticks": 200, "survival_share": 0.2, "pioneer_share": 0.5}


def with_a_pioneer(**config: Any) -> RtNEAT:
    """Six robots, of which 0 is the worst and has the best hundred ticks; 5 is the fittest."""
    evolution = population(**(PIONEERS | config))
    live(evolution, 100, [-9.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    live(evolution, 100, [7.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    return evolution


def test_best_stretches_are_those_of_the_last_trial_by_hand() -> None:
    own, closing = BestStretches(2), np.zeros((2, 250), dtype=bool)
    closing[1, 149] = True
    rewards = np.zeros((2, 250))
    rewards[0, 100:200], rewards[1, 40:60], rewards[1, 149:] = 3.0, 2.0, 1.0
    own.record(rewards, np.zeros(2, np.int64), closing)
    # In the second trial of slot 1 the hundredth tick is the last one recorded.
    assert own.best.tolist() == [300.0, 100.0]
    assert own.latest.tolist() == [-np.inf, 40.0]
    assert own.earned.tolist() == [0.0, 0.0]
    own.reset(0)
    assert own.best.tolist() == [-np.inf, 100.0]


@given(st.lists(st.integers(1, 130), min_size=1, max_size=5))
@settings(deadline=None, max_examples=30)
def test_stretches_do_not_depend_on_how_batches_are_cut(lengths: list[int]) -> None:
    rewards = np.random.default_rng(1).normal(size=(6, sum(lengths), 1))
    whole, parts = population(**PIONEERS), population(**PIONEERS)
    whole.record(rewards)
    for part in np.split(rewards, np.cumsum(lengths)[:-1], axis=1):
        parts.record(part)
    assert whole.stretches is not None and parts.stretches is not None
    for name in BestStretches.kept:
        np.testing.assert_array_equal(
            getattr(whole.stretches, name), getattr(parts.stretches, name)
        )


def test_a_pioneer_stays_and_breeds_alone_though_it_is_the_worst() -> None:
    evolution = with_a_pioneer()
    assert evolution.pioneer == 0
    pioneer, fittest = evolution.genomes[0].genome_id, evolution.genomes[5].genome_id
    live(evolution, 80, [0.0] * 6)
    born = evolution.advance()
    assert len(born) == 1 and born[0].slot != 0
    of_pioneer = 0
    for _ in range(400):  # each time as if it were the first one
        copy = RtNEAT.from_state(evolution.config, with_a_pioneer().state_dict())
        copy.rng = evolution.rng
        live(copy, 80, [0.0] * 6)
        (one,) = copy.advance()
        assert one.parents in ((pioneer,), (fittest,))
        assert (one.genome.genome_id in copy.pioneering) == (one.parents == (pioneer,))
        of_pioneer += one.parents == (pioneer,)
    assert of_pioneer / 400 == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(("most", "pioneer"), [(5.0, None), (6.9, None), (7.0, 0), (9.0, 0)])
def test_a_pioneer_is_ahead_of_the_fittest_by_more_than_a_standard_deviation(
    most: float, pioneer: int | None
) -> None:
    evolution = population(**PIONEERS)
    live(evolution, 100, [-30.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    live(evolution, 100, [most, 1.0, 2.0, 3.0, 4.0, 5.0])
    # 6.9 and 7.0 are 1.9 and 2 ahead of 5, where deviations are 1.94 and 1.97.
    assert evolution.pioneer == pioneer


def test_who_is_the_fittest_is_no_pioneer() -> None:
    evolution = population(**PIONEERS)
    live(evolution, 280, [1.0, 2.0, 3.0, 4.0, 5.0, 60.0])
    assert evolution.pioneer is None
    assert [one.parents[0] for one in evolution.advance()] == [6]
    assert not evolution.pioneering


def test_there_is_no_pioneer_before_somebody_was_judged_or_where_trials_are_shorter() -> None:
    assert population(**PIONEERS).pioneer is None
    assert with_a_pioneer(minimum_life_ticks=50).pioneer is None
    assert with_a_pioneer(pioneer_share=None).pioneer is None


def test_pioneers_go_on_exactly() -> None:
    one = with_a_pioneer()
    other = RtNEAT.from_state(one.config, one.state_dict())
    born = []
    for evolution in (one, other):
        rng = np.random.default_rng(4)
        for _ in range(60):
            evolution.record(rng.normal(size=(6, 40, 1)))
            evolution.advance()
        born.append([genome.to_dict() for genome in evolution.genomes])
    assert born[0] == born[1]
