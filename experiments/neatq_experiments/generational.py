"""Runs on Gymnasium tasks as parts of an experiment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neatq_experiments.seeds import Result, SeedTask, run_seeds
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import load_run


def run_rows(task: SeedTask, config: RunConfig) -> list[Result]:
    """Run a configuration over the seeds of a task, side by side; go on if it was interrupted.

    Each result has the `return` of the seed's champion in the final test, the `generation` it comes
    from, all `episodes` and `steps`, and the champion's evaluations over time: `curve`, pairs
    (episodes so far, return).
    """
    run, first = load_run(run_seeds(task, config)), task.seeds[0]
    metrics, tested = run.metrics(), run.result()
    assert tested is not None
    results = []
    for seed in task.seeds:
        own = metrics["arena"] == seed - first
        evaluated = own & ~np.isnan(metrics["evaluated_return"])
        curve = np.stack([metrics[name][evaluated] for name in ("episodes", "champion_return")], 1)
        champion = tested["arenas"][seed - first]
        results.append(
            {
                "return": champion["mean"],
                "generation": champion["generation"],
                "episodes": int(metrics["episodes"][own][-1]),
                "steps": int(metrics["steps"][own][-1]),
                "curve": curve.tolist(),
            }
        )
    return results


def champion_at(results: Sequence[Result], episodes: float) -> np.ndarray:
    """Return of each seed's champion as it was evaluated by so many episodes, float64 [seeds]."""
    return np.array(
        [[value for seen, value in one["curve"] if seen <= episodes][-1] for one in results]
    )
