"""What a published experiment is, and how it is run again beside its published figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neatq_experiments.seeds import Result, Results, Runs, Spread, read_results, run_missing
from neatq_torch.atomic import write_atomic
from neatq_trainers.report import save_figure

TABLE, FIGURE = "table.md", "figure.png"


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


def run_again(experiment: Experiment, out: Path, *, seeds: int, quick: bool, spread: Spread) -> str:
    """Run what is missing of an experiment, and write its table and figure.

    Args:
        experiment: What to run.
        out: Folder of its results; those that are there are kept.
        seeds: Seeds 0, 1, ... of each arm.
        quick: Whether a small part of the work is enough; such results are kept apart.
        spread: Where the work is done.

    Returns:
        The table, Markdown.

    Raises:
        RunFolderError: If a result in the folder cannot be read.
    """
    folder = out / ("quick" if quick else "full")
    run_missing(experiment, folder, seeds=seeds, quick=quick, spread=spread)
    results = read_results(experiment, folder, seeds)
    table = experiment.table(results)
    write_atomic(folder / TABLE, table)
    if experiment.figure is not None:
        save_figure(experiment.figure(results), folder / FIGURE)
    return table
