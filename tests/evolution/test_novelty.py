"""Who behaves unlike others, and what that is worth."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.evolution import RtNEAT, RtNEATConfig
from neatq_torch.evolution.novelty import ARCHIVE_EVERY, Novelty, mixed


def population(novelty: float | None, slots: int = 4, seed: int = 0) -> RtNEAT:
    config = RtNEATConfig(minimum_life_ticks=10, novelty=novelty)
    return RtNEAT.start(config, slots=slots, inputs=2, outputs=1, rng=seed)


def constant(values: list[float], ticks: int) -> np.ndarray:
    """One number for each robot at each tick [robots, ticks, 1]."""
    return np.repeat(np.array(values)[:, None, None], ticks, axis=1)


def test_novelty_is_the_mean_distance_to_the_nearest_behaviours() -> None:
    novelty = Novelty(3)
    ends = np.array([[[9.0, 9.0], end] for end in ([0.0, 0.0], [3.0, 4.0], [6.0, 8.0])])
    novelty.record(np.array([[False, True]] * 3), ends)
    # The archive has the first robot's, at distances 0, 5 and 10; the others are 5, 10; 5, 5; ...
    assert novelty.archive.tolist() == [[0.0, 0.0]]
    slots = np.arange(3)
    assert novelty.of(slots).tolist() == pytest.approx([15 / 3, 15 / 3, 25 / 3])
    assert novelty.of(slots[1:]).tolist() == pytest.approx([5.0, (5 + 10) / 2])


def test_no_more_than_fifteen_neighbours_count() -> None:
    novelty = Novelty(31)
    novelty.record(np.ones((31, 1), bool), np.arange(31.0)[:, None, None])
    novelty.archive = novelty.archive[:0]
    assert novelty.of(np.arange(31))[0] == np.arange(1, 16).mean()
    assert novelty.of(np.array([4])).tolist() == [0.0]


def test_what_a_robot_did_before_the_end_of_a_trial_does_not_count() -> None:
    novelty = Novelty(2)
    novelty.record(np.array([[False, True], [False, False]]), np.arange(4.0).reshape(2, 2, 1))
    assert novelty.latest[0].tolist() == [1.0]
    assert np.isnan(novelty.latest[1]).all()


@given(st.lists(st.integers(0, 30), min_size=1, max_size=6), st.integers(0, 100))
def test_the_cut_into_batches_does_not_matter(batches: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    closing, behaviour = rng.random((3, sum(batches))) < 0.3, rng.normal(size=(3, sum(batches), 2))
    whole, parts = Novelty(3), Novelty(3)
    whole.record(closing, behaviour)
    cuts = np.cumsum(batches)[:-1]
    for flags, part in zip(np.split(closing, cuts, 1), np.split(behaviour, cuts, 1), strict=True):
        parts.record(flags, part)
    for name, value in whole.state_dict().items():
        np.testing.assert_array_equal(parts.state_dict()[name], value)
    assert len(whole.archive) == -(-whole.seen // ARCHIVE_EVERY)


def test_fitness_and_novelty_are_mixed_between_the_worst_and_the_best() -> None:
    fitness, eligible = np.array([2.0, 0.0, 6.0, 4.0]), np.array([True, False, True, True])
    score = mixed(fitness, np.array([30.0, 10.0, 20.0]), eligible, 0.25)
    assert score.tolist() == [0.25, 0.0, 0.75, 0.75 * 0.5 + 0.25 * 0.5]
    same = np.array([5.0, 5.0, 5.0])
    assert mixed(fitness, same, eligible, 1.0).tolist() == [0.0] * 4
    assert mixed(fitness, same[:0], np.zeros(4, bool), 0.5).tolist() == [0.0] * 4


def test_by_novelty_alone_the_one_in_the_crowd_goes_though_it_is_the_champion() -> None:
    ends = constant([0.0, 0.1, 0.2, 50.0], 16)
    for novelty, slot in ((None, 3), (1.0, 1)):
        evolution = population(novelty)
        evolution.record(constant([1.0, 9.0, 8.0, 0.0], 16), behaviour=ends)
        assert evolution.champion == 1
        assert evolution.advance()[0].slot == slot


def test_behaviour_that_novelty_needs_is_asked_for() -> None:
    evolution = population(0.5)
    with pytest.raises(ValueError, match=r"behaviour: expected .*, got nothing"):
        evolution.record(np.zeros((4, 5, 1)))
    with pytest.raises(ValueError, match=r"\[slots = 4, ticks, dimensions\], got \[3, 5, 2\]"):
        evolution.record(np.zeros((4, 5, 1)), behaviour=np.zeros((3, 5, 2)))
    with pytest.raises(ValueError, match="expected finite numbers"):
        evolution.record(np.zeros((4, 5, 1)), behaviour=np.full((4, 5, 2), np.nan))
    assert evolution.tick == evolution.age_ticks.sum() == 0


def live(evolution: RtNEAT, batches: int, seed: int) -> str:
    rng = np.random.default_rng(seed)
    for _ in range(batches):
        evolution.record(rng.normal(size=(4, 3, 1)), behaviour=rng.normal(size=(4, 3, 2)))
        evolution.advance()
    return json.dumps(evolution.state_dict(), default=lambda array: array.tobytes().hex())


@pytest.mark.parametrize("pause", [0, 2, 40])
def test_a_population_goes_on_from_its_state_bit_for_bit(pause: int) -> None:
    evolution = population(0.5)
    live(evolution, pause, seed=1)
    state = json.loads(json.dumps(evolution.state_dict(), default=lambda array: array.tolist()))
    copy = RtNEAT.from_state(evolution.config, state)
    assert live(copy, 30, seed=2) == live(evolution, 30, seed=2)


def test_without_novelty_behaviour_makes_no_difference() -> None:
    with_it, without = population(None), population(None)
    rng = np.random.default_rng(0)
    for _ in range(30):
        rewards = rng.normal(size=(4, 3, 1))
        with_it.record(rewards, behaviour=rng.normal(size=(4, 3, 2)))
        without.record(rewards)
        assert [one.slot for one in with_it.advance()] == [one.slot for one in without.advance()]
    assert "novelty" not in without.state_dict()
