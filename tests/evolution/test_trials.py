from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.evolution.trials import Trials, TrialWeight, relative_fitness, z_scores


def trial(amounts: list[float], ticks: int = 10) -> np.ndarray:
    """One robot earning each amount, spread over the ticks of one trial."""
    return np.repeat(np.array(amounts) / ticks, ticks)[None, :, None]


def test_trials_are_averaged_by_hand() -> None:
    trials = Trials(1, 1, 10)
    seen = []
    for amount in (8.0, 4.0, 2.0, 20.0):
        trials.record(trial([amount]))
        seen.append(trials.averages[0, 0])
        assert trials.latest[0, 0] == pytest.approx(amount)
    # s1; s1 + s2/2; then half of the old and half of the new.
    assert seen == pytest.approx([8.0, 8.0 + 2.0, 5.0 + 1.0, 3.0 + 10.0])
    assert trials.closed.tolist() == [4] and trials.total == 4


def test_recent_trials_count_half_from_the_second_on() -> None:
    trials = Trials(1, 1, 10, average="recent")
    seen = []
    for amount in (8.0, 4.0, 2.0, 20.0):
        trials.record(trial([amount]))
        seen.append(trials.averages[0, 0])
    assert seen == pytest.approx([8.0, 6.0, 4.0, 12.0])


def test_growing_weights_by_hand() -> None:
    """Who finds a way late is above who waits, though their lives are worth the same."""
    trials = Trials(2, 1, 4, weight="growing")
    trials.record([[[-9.0], [-9.0], [-1.0], [-1.0]], [[-5.0]] * 4])
    # Weights of 0.4, 0.8, 1.2, 1.6.
    assert trials.latest[:, 0] == pytest.approx([-9 * 1.2 - 2.8, -20.0])
    trials.record([[[1.0], [0.0]], [[0.0], [1.0]]])
    assert trials.sums[:, 0] == pytest.approx([0.4, 0.8])


def test_episodes_know_neither_growing_weights_nor_another_average() -> None:
    plain, other = Trials(1, 1, 4, 1), Trials(1, 1, 4, 1, average=None, weight="growing")
    for trials in (plain, other):
        trials.record([[[1.0], [2.0], [4.0]]], [[False, True, True]])
    assert other.averages[0, 0] == plain.averages[0, 0] == 3.5


def test_trials_of_episodes_are_averaged_by_hand() -> None:
    trials = Trials(2, 2, 1000, trial_episodes=2)
    # Slot 0 ends an episode at ticks 1, 2, 5 and 6; slot 1 at 4 and 5, by when it earned 5 and 50.
    done = np.array([[1, 1, 0, 0, 1, 1], [0, 0, 0, 1, 1, 0]])
    rewards = np.array([[[4, 0], [2, 8], [1, 1], [1, 1], [1, 1], [1, 1]], [[1, 10]] * 6])
    closing = trials.record(rewards, done)
    assert np.argwhere(closing).tolist() == [[0, 1], [0, 5], [1, 4]]
    # Slot 0: (6, 8) / 2 = (3, 4), then (4, 4) / 2 = (2, 2).
    assert trials.latest.tolist() == [[2.0, 2.0], [2.5, 25.0]]
    assert trials.averages.tolist() == [[2.5, 3.0], [2.5, 25.0]]
    assert trials.sums.tolist() == [[0.0, 0.0], [1.0, 10.0]]
    assert trials.closed.tolist() == [2, 1] and trials.total == 3
    trials.record([[[0, 0]], [[3, 0]]], [[0], [1]])
    assert trials.ended.tolist() == [0, 1]
    trials.reset(1)
    assert not trials.ended.any() and (trials.closed > 0).tolist() == [True, False]
    assert trials.total == 3
    # The third and later ones still count half.
    trials.record([[[8, 0], [0, 0]], [[0, 0]] * 2], [[1, 1], [0, 0]])
    assert trials.averages[0].tolist() == [2.5 / 2 + 2.0, 1.5]


def test_trials_of_episodes_need_to_know_where_these_end() -> None:
    trials = Trials(2, 1, 10, trial_episodes=1)
    with pytest.raises(
        ValueError, match=r"done: expected the shape .*slots = 2, ticks = 3\], got nothing"
    ):
        trials.record(np.zeros((2, 3, 1)))
    with pytest.raises(
        ValueError, match=r"done: expected the shape .*slots = 2, ticks = 3\], got \[3, 2\]"
    ):
        trials.record(np.zeros((2, 3, 1)), np.zeros((3, 2)))
    assert not trials.age_ticks.any()


def test_a_trial_closes_in_the_middle_of_a_batch() -> None:
    trials = Trials(1, 1, 10)
    trials.record(np.ones((1, 7, 1)))
    assert trials.averages[0, 0] == 0.0
    trials.record(np.ones((1, 7, 1)))
    assert trials.averages[0, 0] == 10.0
    assert trials.sums[0, 0] == 4.0
    assert trials.age_ticks.tolist() == [14]


def test_one_batch_may_hold_several_trials() -> None:
    trials = Trials(1, 1, 10)
    trials.record(trial([8.0, 4.0, 2.0]))
    assert trials.averages[0, 0] == pytest.approx(6.0)
    assert trials.closed.tolist() == [3]


def test_robots_of_different_age_close_their_trials_apart() -> None:
    trials = Trials(2, 1, 10)
    trials.record(np.ones((2, 6, 1)))
    trials.reset(1)
    trials.record(np.ones((2, 6, 1)))
    assert trials.age_ticks.tolist() == [12, 6]
    assert trials.averages[:, 0].tolist() == [10.0, 0.0]
    assert trials.sums[:, 0].tolist() == [2.0, 6.0]
    assert (trials.closed > 0).tolist() == [True, False]


@given(
    st.lists(st.integers(0, 40), min_size=1, max_size=6),
    st.integers(0, 100),
    st.sampled_from([4, 1000]),
    st.integers(1, 3),
    st.sampled_from([None, 1, 3]),
    st.sampled_from([None, "growing"]),
)
def test_the_cut_into_batches_does_not_matter_to_the_last_bit(
    batches: list[int],
    seed: int,
    trial_ticks: int,
    dimensions: int,
    episodes: int | None,
    weight: TrialWeight | None,
) -> None:
    rng = np.random.default_rng(seed)
    shape, sizes = (3, sum(batches)), (3, dimensions, trial_ticks, episodes)
    rewards, done = rng.normal(size=(*shape, dimensions)), rng.random(shape) < 0.4
    whole, parts, ticks = (Trials(*sizes, weight=weight) for _ in range(3))
    closed = whole.record(rewards, done)
    for trials, cuts in ((parts, np.cumsum(batches)), (ticks, range(1, shape[1]))):
        pieces = [np.split(one, cuts, axis=1) for one in (rewards, done)]
        closing = [trials.record(*piece) for piece in zip(*pieces, strict=True)]
        assert np.array_equal(np.concatenate(closing, axis=1), closed)
    assert whole.total == parts.total == ticks.total
    for name in Trials.ARRAYS:
        expected = getattr(whole, name).tobytes()
        assert expected == getattr(parts, name).tobytes() == getattr(ticks, name).tobytes()


def test_sums_are_kept_in_double_precision() -> None:
    trials = Trials(1, 1, 3000)
    trials.record(np.full((1, 2000, 1), 0.1, dtype=np.float32))
    exact = 2000 * float(np.float32(0.1))
    assert trials.sums[0, 0] == pytest.approx(exact, rel=1e-12)


def test_rewards_of_the_wrong_shape_or_not_finite_are_refused() -> None:
    trials = Trials(2, 3, 10)
    for shape in ((2, 5, 2), (3, 5, 3), (2, 3)):
        with pytest.raises(ValueError, match=r"\[slots = 2, ticks, dimensions = 3\]"):
            trials.record(np.zeros(shape))
    rewards = np.zeros((2, 5, 3))
    rewards[1, 4, 2] = np.nan
    with pytest.raises(ValueError, match="got nan of slot 1, tick 4, dimension 2"):
        trials.record(rewards)
    assert trials.age_ticks.tolist() == [0, 0]


def test_z_scores_are_computed_by_hand() -> None:
    # Means 3 and 5; population standard deviations 2 and 0.
    samples = np.array([[1.0, 5.0], [5.0, 5.0]])
    assert z_scores(samples).tolist() == [[-1.0, 0.0], [1.0, 0.0]]
    three = z_scores(np.array([[0.0], [0.0], [3.0]]))[:, 0]
    assert three.tolist() == pytest.approx([-(0.5**0.5), -(0.5**0.5), 2**0.5])


def test_equal_samples_have_z_score_zero_whatever_their_mean_rounds_to() -> None:
    assert z_scores(np.full((3, 1), 0.1)).tolist() == [[0.0]] * 3


def test_fitness_is_the_weighted_z_score_above_the_worst() -> None:
    averages = np.array([[1.0, 8.0], [99.0, -99.0], [5.0, 2.0]])
    eligible = np.array([True, False, True])
    # z: first (-1, 1), third (1, -1); weights 1 and 0.25 give -0.75 and 0.75.
    fitness = relative_fitness(averages, eligible, np.array([1.0, 0.25]))
    assert fitness.tolist() == [0.0, 0.0, 1.5]
    reversed_ = relative_fitness(averages, eligible, np.array([-1.0, -0.25]))
    assert reversed_.tolist() == [1.5, 0.0, 0.0]


def test_nobody_eligible_means_fitness_zero_for_all() -> None:
    nobody = np.zeros(2, dtype=bool)
    assert relative_fitness(np.ones((2, 1)), nobody, np.ones(1)).tolist() == [0.0, 0.0]


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_the_worst_has_fitness_zero_and_nobody_less(averages: list[float]) -> None:
    column = np.array(averages)[:, None]
    fitness = relative_fitness(column, np.ones(len(averages), dtype=bool), np.ones(1))
    assert fitness[np.argmin(averages)] == 0.0
    assert (fitness >= 0.0).all()
