from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neatq_torch.evolution import Trials, relative_fitness, z_scores
from neatq_torch.evolution.trials import TrialAverage


def trial(amounts: list[float], ticks: int = 10) -> np.ndarray:
    """One robot earning each amount, spread over the ticks of one trial."""
    return np.repeat(np.array(amounts) / ticks, ticks)[None, :, None]


@pytest.mark.parametrize(
    ("average", "expected"),
    [
        # s1; s1 + s2/2; then half of the old and half of the new.
        ("opennero", [8.0, 8.0 + 2.0, 5.0 + 1.0, 3.0 + 10.0]),
        ("exponential", [8.0, 6.0, 4.0, 12.0]),
    ],
)
def test_trials_are_averaged_by_hand(average: TrialAverage, expected: list[float]) -> None:
    trials = Trials(1, 1, 10, average)
    seen = []
    for amount in (8.0, 4.0, 2.0, 20.0):
        trials.record(trial([amount]))
        seen.append(trials.averages[0, 0])
    assert seen == pytest.approx(expected)
    assert trials.closed.tolist() == [4]


def test_a_trial_closes_in_the_middle_of_a_batch() -> None:
    trials = Trials(1, 1, 10, "opennero")
    trials.record(np.ones((1, 7, 1)))
    assert trials.averages[0, 0] == 0.0
    trials.record(np.ones((1, 7, 1)))
    assert trials.averages[0, 0] == 10.0
    assert trials.sums[0, 0] == 4.0
    assert trials.age_ticks.tolist() == [14]


def test_one_batch_may_hold_several_trials() -> None:
    trials = Trials(1, 1, 10, "exponential")
    trials.record(trial([8.0, 4.0, 2.0]))
    assert trials.averages[0, 0] == pytest.approx(4.0)
    assert trials.closed.tolist() == [3]


def test_robots_of_different_age_close_their_trials_apart() -> None:
    trials = Trials(2, 1, 10, "opennero")
    trials.record(np.ones((2, 6, 1)))
    trials.reset(1)
    trials.record(np.ones((2, 6, 1)))
    assert trials.age_ticks.tolist() == [12, 6]
    assert trials.averages[:, 0].tolist() == [10.0, 0.0]
    assert trials.sums[:, 0].tolist() == [2.0, 6.0]
    assert trials.eligible.tolist() == [True, False]


@given(
    st.lists(st.integers(0, 40), min_size=1, max_size=6),
    st.integers(0, 100),
    st.sampled_from([4, 1000]),
    st.integers(1, 3),
    st.sampled_from(["opennero", "exponential"]),
)
def test_the_cut_into_batches_does_not_matter_to_the_last_bit(
    batches: list[int], seed: int, trial_ticks: int, dimensions: int, average: TrialAverage
) -> None:
    rng = np.random.default_rng(seed)
    rewards = rng.normal(size=(3, sum(batches), dimensions))
    whole, parts, ticks = (Trials(3, dimensions, trial_ticks, average) for _ in range(3))
    whole.record(rewards)
    for batch in np.split(rewards, np.cumsum(batches), axis=1):
        parts.record(batch)
    for tick in range(rewards.shape[1]):
        ticks.record(rewards[:, tick : tick + 1])
    for name, array in whole.state_dict().items():
        assert array.tobytes() == getattr(parts, name).tobytes()
        assert array.tobytes() == getattr(ticks, name).tobytes()


def test_ticks_that_do_not_count_are_taken_to_be_like_the_others() -> None:
    trials = Trials(2, 1, 4, "opennero")
    counts = np.array([[True, False, True, False], [False] * 4])
    rewards = np.array([[1.0, 100.0, 2.0, -9.0], [5.0] * 4])[..., None]
    trials.record(rewards[:, :3], counts[:, :3])
    assert trials.counted.tolist() == [2, 0]
    trials.record(rewards[:, 3:], counts[:, 3:])
    # 3 in two ticks that count make 6 in four.
    assert trials.averages[:, 0].tolist() == [6.0, 0.0]
    trials.record(rewards)
    assert trials.averages[:, 0].tolist() == [6.0 + 94.0 / 2, 0.0 + 20.0 / 2]
    trials.record(rewards[:, :3], counts[:, :3])
    trials.reset(0)
    assert trials.counted.tolist() == [0, 0]


@given(st.lists(st.integers(0, 12), min_size=1, max_size=6), st.integers(0, 100))
def test_the_cut_into_batches_does_not_matter_to_ticks_that_count(
    batches: list[int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    rewards, counts = rng.normal(size=(3, sum(batches), 1)), rng.random((3, sum(batches))) < 0.7
    whole, parts = (Trials(3, 1, 4, "opennero") for _ in range(2))
    whole.record(rewards, counts)
    cuts = np.cumsum(batches)
    for some, flags in zip(np.split(rewards, cuts, 1), np.split(counts, cuts, 1), strict=True):
        parts.record(some, flags)
    for name, array in whole.state_dict().items():
        assert array.tobytes() == getattr(parts, name).tobytes()


def test_a_state_that_does_not_say_which_ticks_counted_means_all() -> None:
    trials, copy = (Trials(1, 1, 10, "opennero") for _ in range(2))
    trials.record(np.ones((1, 17, 1)))
    state = trials.state_dict()
    copy.load_state({name: array for name, array in state.items() if name != "counted"})
    assert copy.counted.tolist() == trials.counted.tolist() == [7]
    with pytest.raises(ValueError, match=r"\[robots, ticks\] = \[1, 5\], not \[1, 4\]"):
        copy.record(np.ones((1, 5, 1)), np.ones((1, 4)))


def test_sums_are_kept_in_double_precision() -> None:
    trials = Trials(1, 1, 3000, "opennero")
    trials.record(np.full((1, 2000, 1), 0.1, dtype=np.float32))
    exact = 2000 * float(np.float32(0.1))
    assert trials.sums[0, 0] == pytest.approx(exact, rel=1e-12)


def test_rewards_of_the_wrong_shape_or_not_finite_are_refused() -> None:
    trials = Trials(2, 3, 10, "opennero")
    for shape in ((2, 5, 2), (3, 5, 3), (2, 3)):
        with pytest.raises(ValueError, match=r"\[robots = 2, ticks, dimensions = 3\]"):
            trials.record(np.zeros(shape))
    rewards = np.zeros((2, 5, 3))
    rewards[1, 4, 2] = np.nan
    with pytest.raises(ValueError, match="reward nan of robot 1, tick 4, dimension 2"):
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
