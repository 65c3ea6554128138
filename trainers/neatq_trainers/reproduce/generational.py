"""Runs of the trainer for Gymnasium tasks as parts of an experiment."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.folder import RESULT
from neatq_trainers.generational.train import resume, start
from neatq_trainers.report import read_metrics
from neatq_trainers.reproduce.experiment import Result, Task
from neatq_trainers.run_files import CHECKPOINT


def run_seeds(task: Task, config: GenerationalConfig) -> list[Result]:
    """Run a configuration over the seeds of a task, side by side; go on if it was interrupted.

    Each result has the `return` of the seed's champion in the final test, the `generation` it comes
    from, all `episodes` and `steps`, and the champion's evaluations over time: `curve`, pairs
    (episodes so far, return).
    """
    first, last = task.seeds[0], task.seeds[-1]
    folder = task.folder / f"seeds-{first}-{last}"
    if (folder / CHECKPOINT).exists():
        resume(folder)
    else:
        start(replace(config, seed=first, arenas=last - first + 1), folder)
    metrics = read_metrics(folder)
    tested = json.loads((folder / RESULT).read_bytes())["arenas"]
    results = []
    for seed in task.seeds:
        own = metrics["arena"] == seed - first
        evaluated = own & ~np.isnan(metrics["evaluated_return"])
        curve = np.stack([metrics[name][evaluated] for name in ("episodes", "champion_return")], 1)
        champion = tested[seed - first]
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


def episodes_to(result: Result, threshold: float) -> float | None:
    """Episodes until a champion was evaluated at the threshold or above; None if none was."""
    for episodes, value in result["curve"]:
        if value >= threshold:
            return episodes
    return None


def champion_at(results: Sequence[Result], episodes: float) -> np.ndarray:
    """Return of each seed's champion as it was evaluated by so many episodes, float64 [seeds]."""
    return np.array(
        [[value for seen, value in one["curve"] if seen <= episodes][-1] for one in results]
    )
