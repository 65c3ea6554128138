"""The published arms against their specification.

The specification is a replica of OpenNERO's rtNEAT experiments that was written from its source
code, independently of this project: the mean distance of the team to the flag, as means over each
quarter of a run and over its last tenth, over 8 seeds. The curves of Robertson & Wu (2014), one
run each, are read off their figures.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from neatq_envs.render import plain_title
from neatq_experiments.experiment import Experiment
from neatq_experiments.published import PAPER_NAMES, published_curves
from neatq_experiments.seeds import Result, Results, SeedTask, run_seeds
from neatq_trainers.arms import TASK_TICKS, preset
from neatq_trainers.folder import load_run
from neatq_trainers.rows import ROW_TICKS


class Specification(NamedTuple):
    """Means of the quarters, of the last tenth, and the spread of the latter over seeds.

    The one run of qlearning gives its quarters only.
    """

    seeds: int
    means: tuple[float, ...]
    spread: float | None = None


SPECIFICATION: dict[tuple[str, str], Specification] = {
    ("flag", "rtneat"): Specification(8, (116, 81, 69, 58, 56.3), 7.5),
    ("flag", "committed"): Specification(8, (117, 86, 76, 71, 69.6), 5.6),
    ("flag", "qlearning"): Specification(1, (142, 140, 134, 133)),
    ("wall", "rtneat"): Specification(8, (255, 221, 191, 172, 167.8), 18.7),
    ("wall", "committed"): Specification(8, (248, 220, 204, 190, 187.9), 17.3),
    ("wall", "qlearning"): Specification(1, (268, 268, 268, 266)),
}
QUICK_QUARTER = 4
"""With `--quick` only the first quarter of a run is made."""


def run_arm(task: SeedTask) -> list[Result]:
    """Run an arm over its seeds side by side; goes on with a run that was interrupted."""
    name, arm = split(task.arm)
    ticks = TASK_TICKS[name] // (QUICK_QUARTER if task.quick else 1)
    folder = run_seeds(task, preset(name, arm, length={"ticks": ticks}))
    first = task.seeds[0]
    curves = mean_distances(folder)[[seed - first for seed in task.seeds]]
    return [{"mean_distance": np.round(curve, 4).tolist()} for curve in curves]


def split(cell: str) -> tuple[str, str]:
    """Task and arm of an arm of the experiment, which is called `task-arm`."""
    return next(key for key in SPECIFICATION if "-".join(key) == cell)


def curves_of(results: Results) -> dict[tuple[str, str], np.ndarray]:
    """Mean distance of each team at each row [seeds, rows], of each task and arm with results."""
    return {
        split(cell): np.array([result["mean_distance"] for result in one])
        for cell, one in results.items()
        if one
    }


def mean_distances(folder: Path) -> np.ndarray:
    """The mean distance of each team at each row [seeds, rows]."""
    metrics = load_run(folder).metrics()
    seeds = len(np.unique(metrics["arena"]))
    return metrics["mean_distance"].reshape(-1, seeds).T


def quarter_means(curve: np.ndarray, rows: int) -> np.ndarray:
    """Means over the quarters and the last tenth of curves [seeds, rows done]: [seeds, <= 5].

    Args:
        curve: The rows that there are.
        rows: Those of a whole run; quarters that are not over are left out.
    """
    done = [(i * rows // 4, (i + 1) * rows // 4) for i in range(4)] + [(rows - rows // 10, rows)]
    parts = [curve[:, start:end].mean(1) for start, end in done if end <= curve.shape[1]]
    return np.stack(parts, 1)


def arena_table(results: Results) -> str:
    """A Markdown table: ours with standard errors, the specification, and the difference.

    Beside each difference stands what is allowed: two of our standard errors, widened by the
    specification's own spread over seeds. That is known for the last tenth only, and stands for
    all five columns.
    """
    lines = [
        "| task | arm | seeds | quarter 1 | quarter 2 | quarter 3 | quarter 4 | last tenth |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (task, arm), curve in curves_of(results).items():
        spec = SPECIFICATION[task, arm]
        ours = quarter_means(curve, TASK_TICKS[task] // ROW_TICKS)
        mean, error = ours.mean(0), ours.std(0, ddof=1) / np.sqrt(len(ours))
        cells = [f"{m:.1f} ± {e:.1f}" for m, e in zip(mean, error, strict=True)]
        lines.append(f"| {task} | {arm} | {len(ours)} | {' | '.join(cells)} |")
        known = [f"{value:g}" for value in spec.means[: mean.size]]
        cells = known + [""] * (mean.size - len(known))
        lines.append(f"| | specification | {spec.seeds} | {' | '.join(cells)} |")
        if spec.spread is not None:
            apart = mean - spec.means[: mean.size]
            both = zip(apart, 2 * error + spec.spread, strict=True)
            cells = [f"{apart:+.1f} ({allowed:.1f})" for apart, allowed in both]
            lines.append(f"| | difference (allowed) | | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw_arms(results: Results) -> Figure:
    """One panel for each task and arm: our seeds, their mean, and the published run."""
    curves = curves_of(results)
    tasks = list(dict.fromkeys(task for task, _ in curves))
    arms = list(dict.fromkeys(arm for _, arm in curves))
    figure = Figure(figsize=(4.2 * len(arms), 3.2 * len(tasks)), layout="constrained")
    panels = figure.subplots(len(tasks), len(arms), squeeze=False, sharey="row", sharex="row")
    published = published_curves()
    for (task, arm), curve in curves.items():
        axes = panels[tasks.index(task), arms.index(arm)]
        ticks = np.arange(1, curve.shape[1] + 1)
        axes.fill_between(ticks, curve.min(0), curve.max(0), color="tab:green", alpha=0.2, lw=0)
        axes.plot(ticks, curve.mean(0), color="tab:green", label=f"mean, range of {len(curve)}")
        paper = published[task, PAPER_NAMES[arm]]
        axes.plot(paper[:, 0], paper[:, 1], color="black", lw=0.8, label="published run")
        plain_title(axes, f"{task}: {arm}")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    for axes in panels[:, 0]:
        axes.set_ylabel("mean distance to the flag (units)")
    for axes in panels[-1]:
        axes.set_xlabel(f"figure tick ({ROW_TICKS} ticks)")
    panels[0, 0].legend(frameon=False, fontsize=8)
    return figure


ARENA = Experiment(
    name="arena",
    summary="Robertson & Wu (2014): the published arms on the flag and on the wall",
    arms=tuple("-".join(key) for key in SPECIFICATION),
    seeds=16,
    quick_seeds=2,
    batch=8,
    run=run_arm,
    table=arena_table,
    figure=draw_arms,
)
