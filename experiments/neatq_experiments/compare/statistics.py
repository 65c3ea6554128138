"""How arms are compared over few seeds, as Agarwal et al. (2021) advise.

Agarwal, Schwarzer, Castro, Courville & Bellemare: Deep Reinforcement Learning at the Edge of the
Statistical Precipice, NeurIPS 2021. All intervals are 95 % percentile bootstrap intervals over
seeds, always from the same draws, so that a table can be made again to the last digit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

RESAMPLES, MEAN_RESAMPLES = 2000, 10_000
"""Draws for bands and probabilities, and for intervals of a mean."""
Values = NDArray[np.float64]


class Estimate(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float


def interquartile_mean(values: Values, axis: int = -1) -> Values:
    """Mean of the middle half along an axis.

    A quarter of the values, rounded down, is left out at either end (Agarwal et al. 2021).
    """
    from scipy.stats import trim_mean  # a second to import, so only where it is used

    return trim_mean(values, 0.25, axis=axis)


def bootstrap_interval(
    values: ArrayLike, statistic: Callable[..., Values] = np.mean
) -> tuple[float, float]:
    """The 95 % percentile interval of a statistic by bootstrap (Efron & Tibshirani 1993).

    Args:
        values: [seeds], at least one; of paired seeds, their differences.
        statistic: Of values along an axis, which it is called with.
    """
    from scipy.stats import bootstrap

    values = np.asarray(values, np.float64)
    if values.size == 1:  # which scipy refuses
        return float(values[0]), float(values[0])
    low, high = bootstrap(
        (values,),
        statistic,
        n_resamples=MEAN_RESAMPLES,
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(low), float(high)


def mean_estimate(values: Values) -> Estimate:
    """Mean of values [seeds]; of the differences of paired seeds it is the paired bootstrap."""
    return Estimate(float(values.mean()), *bootstrap_interval(values))


def iqm_estimate(values: Values) -> Estimate:
    """Interquartile mean of values [seeds]."""
    value = float(interquartile_mean(values))
    return Estimate(value, *bootstrap_interval(values, interquartile_mean))


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
