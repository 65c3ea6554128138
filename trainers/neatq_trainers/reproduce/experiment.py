"""What an experiment is: arms, seeds, a function that runs some of them, and a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

Result = dict[str, Any]
"""What one seed gave, as JSON values."""
Results = Mapping[str, list[Result]]
"""The results of each arm, by seed."""


class Task(NamedTuple):
    """Some seeds of one arm, which are run together in one process.

    Attributes:
        arm: one of the experiment's arms.
        seeds: those to run.
        quick: whether a small part of the work is enough.
        folder: a folder of its own, for whatever a long run keeps to go on from.
    """

    arm: str
    seeds: tuple[int, ...]
    quick: bool
    folder: Path


@dataclass(frozen=True, kw_only=True)
class Runs:
    """Arms that are run over seeds.

    Attributes:
        name: what it is called on the command line.
        arms: what is compared.
        batch: most seeds of one task.
        run: runs a task; returns one result for each of its seeds. It is pickled, because it is
            called in other processes.
        share: how much of a task that has no results yet is done, from 0 to 1, for the progress
            bar.
    """

    name: str
    arms: tuple[str, ...]
    batch: int = 1
    run: Callable[[Task], list[Result]]
    share: Callable[[Task], float] | None = None


@dataclass(frozen=True, kw_only=True)
class Experiment(Runs):
    """A published result and what it takes to meet it.

    Attributes:
        summary: one line on what is run.
        seeds: seeds of each arm.
        quick_seeds: seeds of each arm with `--quick`.
        table: Markdown, ours beside what was published.
        figure: draws the results.
    """

    summary: str
    seeds: int
    quick_seeds: int
    table: Callable[[Results], str]
    figure: Callable[[Results], Figure] | None = None


def column(results: list[Result], name: str) -> np.ndarray:
    """One value of every seed, float64 [seeds]; seeds that have none are left out."""
    return np.array([result[name] for result in results if result[name] is not None], np.float64)


def mean_and_error(values: ArrayLike, digits: int = 1) -> str:
    """Mean and standard error of the mean, as `1.0 ± 0.1`; no error for a single value."""
    values = np.asarray(values, np.float64)
    if not values.size:
        return "none"
    middle = f"{values.mean():,.{digits}f}"
    if values.size == 1:
        return middle
    return f"{middle} ± {values.std(ddof=1) / np.sqrt(values.size):,.{digits}f}"


def mean(values: np.ndarray) -> np.ndarray:
    """Mean over the last axis."""
    return values.mean(-1)


def bootstrap_interval(
    values: ArrayLike,
    resamples: int = 10_000,
    statistic: Callable[[np.ndarray], np.ndarray] = mean,
) -> tuple[float, float]:
    """The 95 % percentile interval of a statistic by bootstrap (Efron & Tibshirani 1993).

    Args:
        values: [seeds]; of paired seeds, their differences.
        resamples: how often they are drawn again, with replacement. Always the same draws.
        statistic: of values along the last axis.
    """
    values = np.asarray(values, np.float64)
    drawn = np.random.default_rng(0).integers(values.size, size=(resamples, values.size))
    low, high = np.quantile(statistic(values[drawn]), (0.025, 0.975))
    return float(low), float(high)
