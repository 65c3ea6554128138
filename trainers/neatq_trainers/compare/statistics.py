"""How arms are compared over few seeds, as Agarwal et al. (2021) advise.

Agarwal, Schwarzer, Castro, Courville & Bellemare: Deep Reinforcement Learning at the Edge of the
Statistical Precipice, NeurIPS 2021. All intervals are 95 % percentile bootstrap intervals over
seeds, always from the same draws, so that a table can be made again to the last digit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from neatq_trainers.reproduce.experiment import bootstrap_interval, mean

RESAMPLES = 2000
Values = NDArray[np.float64]


class Estimate(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float


def interquartile_mean(values: Values) -> Values:
    """Mean of the middle half along the last axis [..., seeds].

    A quarter of the values, rounded down, is left out at either end (Agarwal et al. 2021).
    """
    seeds = values.shape[-1]
    cut = seeds // 4
    return np.sort(values, axis=-1)[..., cut : seeds - cut].mean(-1)


def mean_estimate(values: Values) -> Estimate:
    """Mean of values [seeds]; of the differences of paired seeds it is the paired bootstrap."""
    return Estimate(float(values.mean()), *bootstrap_interval(values, statistic=mean))


def iqm_estimate(values: Values) -> Estimate:
    """Interquartile mean of values [seeds]."""
    value = float(interquartile_mean(values))
    return Estimate(value, *bootstrap_interval(values, statistic=interquartile_mean))


def probability_of_improvement(ours: Values, theirs: Values) -> Estimate:
    """Share of all pairs of seeds in which ours is the smaller distance; a tie counts half.

    Each arm's seeds are drawn again on their own (Agarwal et al. 2021).

    Args:
        ours: [seeds].
        theirs: [other seeds], of the arm that ours is compared with.
    """
    better = (ours[:, None] < theirs) + 0.5 * (ours[:, None] == theirs)
    rng = np.random.default_rng(0)
    rows, columns = (_draws(rng, size) for size in better.shape)
    shares = np.einsum("rs,st,rt->r", rows, better, columns) / better.size
    low, high = np.quantile(shares, (0.025, 0.975))
    return Estimate(float(better.mean()), float(low), float(high))


def band(values: Values) -> tuple[Values, Values]:
    """The interval of the mean over seeds at each row.

    Args:
        values: [seeds, rows]; NaN where a seed has none.

    Returns:
        Lower and upper end [rows]; NaN where no seed has a value.
    """
    known = ~np.isnan(values)
    drawn = _draws(np.random.default_rng(0), len(values))
    weight = drawn @ known
    means = np.full(weight.shape, np.nan)
    np.divide(drawn @ np.where(known, values, 0.0), weight, out=means, where=weight > 0)
    low, high = np.full((2, values.shape[1]), np.nan)
    seen = known.any(0)
    if seen.any():
        low[seen], high[seen] = np.nanquantile(means[:, seen], (0.025, 0.975), axis=0)
    return low, high


def mean_of_known(values: Values, axis: int = 0) -> Values:
    """Mean along an axis without NaNs; NaN where there is nothing else."""
    known = ~np.isnan(values)
    count = known.sum(axis)
    means = np.full(count.shape, np.nan)
    return np.divide(np.where(known, values, 0.0).sum(axis), count, out=means, where=count > 0)


def _draws(rng: np.random.Generator, seeds: int) -> Values:
    """How often each seed is drawn in each resample, float64 [resamples, seeds]."""
    return rng.multinomial(seeds, np.full(seeds, 1 / seeds), size=RESAMPLES).astype(np.float64)
