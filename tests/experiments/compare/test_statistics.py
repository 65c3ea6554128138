"""Statistics over few seeds, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from neatq_experiments.compare.statistics import (
    band,
    bootstrap_interval,
    interquartile_mean,
    iqm_estimate,
    mean_estimate,
    mean_of_known,
    probability_of_improvement,
)


def array(*values: float) -> np.ndarray:
    return np.array(values, np.float64)


def test_the_interquartile_mean_leaves_out_a_quarter_at_either_end() -> None:
    # 8 values: 2 left out at either end, (3 + 4 + 5 + 6) / 4. Order does not matter.
    assert interquartile_mean(array(1000, 1, 5, 3, 2, 6, 4, 700)) == 4.5
    # 7 values: a quarter of 7, rounded down, is 1: (2 + 3 + 4 + 5 + 6) / 5.
    assert interquartile_mean(array(1, 2, 3, 4, 5, 6, 99)) == 4
    assert interquartile_mean(array(1, 2, 9)) == 4  # nothing to leave out
    assert interquartile_mean(np.array([[0.0, 1, 2, 9], [8, 6, 4, 2]])).tolist() == [1.5, 5]


def test_the_interval_of_the_interquartile_mean_does_not_know_an_outlier() -> None:
    calm, wild = np.arange(20.0), np.append(np.arange(19.0), 1e6)
    assert iqm_estimate(wild).value == iqm_estimate(calm).value == 9.5
    assert iqm_estimate(wild).high < 20 < mean_estimate(wild).high
    low, high = bootstrap_interval(calm, interquartile_mean)
    assert iqm_estimate(calm) == (9.5, low, high)


def test_the_probability_of_improvement_is_the_share_of_pairs_with_the_smaller_distance() -> None:
    # 1 < 2 and 1 < 3; 2 = 2 counts half, 2 < 3; 4 is never smaller: 3.5 of 6 pairs.
    estimate = probability_of_improvement(array(1, 2, 4), array(2, 3))
    assert estimate.value == pytest.approx(3.5 / 6)
    assert 0 <= estimate.low < estimate.value < estimate.high <= 1


def test_an_arm_is_as_good_as_itself_and_better_than_a_worse_one() -> None:
    values = np.random.default_rng(0).normal(size=12)
    assert probability_of_improvement(values, values).value == 0.5
    assert probability_of_improvement(values, values + 100) == (1, 1, 1)
    assert probability_of_improvement(values + 100, values) == (0, 0, 0)


def test_the_interval_of_the_probability_of_improvement_draws_each_arm_on_its_own() -> None:
    ours, theirs = np.random.default_rng(1).normal(size=(2, 9))
    rng = np.random.default_rng(5)
    shares = [(rng.choice(ours, 9)[:, None] < rng.choice(theirs, 9)).mean() for _ in range(4000)]
    plain = np.quantile(shares, (0.025, 0.975))
    assert probability_of_improvement(ours, theirs)[1:] == pytest.approx(plain, abs=0.03)


def test_the_band_is_the_interval_of_the_mean_at_each_row() -> None:
    values = np.random.default_rng(2).normal(5, [1.0, 10.0], (15, 2))
    low, high = band(values)
    for row, (wanted_low, wanted_high) in enumerate(map(bootstrap_interval, values.T)):
        width = wanted_high - wanted_low
        assert low[row] == pytest.approx(wanted_low, abs=0.05 * width)
        assert high[row] == pytest.approx(wanted_high, abs=0.05 * width)


def test_empty_cells_do_not_count() -> None:
    nan = np.nan
    values = np.array([[1.0, nan, nan], [3.0, 7.0, nan]])
    assert mean_of_known(values).tolist()[:2] == [2, 7]
    low, high = band(values)
    assert (low[1], high[1]) == (7, 7)
    assert np.isnan([mean_of_known(values)[2], low[2], high[2]]).all()
    assert np.isnan(band(np.full((2, 3), nan))).all()


def test_the_bootstrap_interval_is_that_of_the_normal_distribution_for_many_values() -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    low, high = bootstrap_interval(values)
    error = values.std(ddof=1) / 20
    assert low == pytest.approx(values.mean() - 1.96 * error, abs=0.15 * error)
    assert high == pytest.approx(values.mean() + 1.96 * error, abs=0.15 * error)


def test_the_interval_of_one_seed_is_its_value_and_of_equal_ones_theirs() -> None:
    assert bootstrap_interval([3.5]) == (3.5, 3.5)
    assert bootstrap_interval([2.0, 2.0, 2.0]) == (2, 2)


def test_intervals_are_those_of_the_same_draws_by_hand() -> None:
    values = np.random.default_rng(4).normal(100, 20, 12)
    drawn = values[np.random.default_rng(0).integers(12, size=(10_000, 12))]
    for statistic, wanted in (
        (np.mean, drawn.mean(-1)),
        (interquartile_mean, np.sort(drawn, -1)[:, 3:9].mean(-1)),
    ):
        ends = np.quantile(wanted, (0.025, 0.975))
        assert bootstrap_interval(values, statistic) == pytest.approx(ends, rel=1e-12)
