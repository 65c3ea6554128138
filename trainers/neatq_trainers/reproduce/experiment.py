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
class Experiment:
    """A published result and what it takes to meet it.

    Attributes:
        name: what it is called on the command line.
        summary: one line on what is run.
        arms: what is compared.
        seeds: seeds of each arm.
        quick_seeds: seeds of each arm with `--quick`.
        batch: most seeds of one task.
        run: runs a task; returns one result for each of its seeds. A function of a module, because
            it is called in other processes.
        table: Markdown, ours beside what was published.
        figure: draws the results.
    """

    name: str
    summary: str
    arms: tuple[str, ...]
    seeds: int
    quick_seeds: int
    batch: int = 1
    run: Callable[[Task], list[Result]]
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
    mean = f"{values.mean():,.{digits}f}"
    if values.size == 1:
        return mean
    return f"{mean} ± {values.std(ddof=1) / np.sqrt(values.size):,.{digits}f}"


def bootstrap_interval(values: ArrayLike, resamples: int = 10_000) -> tuple[float, float]:
    """The 95 % percentile interval of the mean by bootstrap (Efron & Tibshirani 1993).

    Args:
        values: [seeds]; of paired seeds, their differences.
        resamples: how often they are drawn again, with replacement. Always the same draws.
    """
    values = np.asarray(values, np.float64)
    drawn = np.random.default_rng(0).integers(values.size, size=(resamples, values.size))
    low, high = np.quantile(values[drawn].mean(1), (0.025, 0.975))
    return float(low), float(high)
