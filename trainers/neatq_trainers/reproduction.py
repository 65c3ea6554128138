"""The published arms against their specification: `python -m neatq_trainers.reproduction`.

The specification is a replica of OpenNERO's rtNEAT experiments that was written from its source
code, independently of this project: the mean distance of the team to the flag, as means over each
quarter of a run and over its last tenth, over 8 seeds. The curves of Robertson & Wu (2014), one
run each, are read off their figures.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import tyro
from matplotlib.figure import Figure

from neatq_torch.atomic import write_atomic
from neatq_trainers.config import TASK_TICKS, Arm, preset
from neatq_trainers.metrics import ROW_TICKS
from neatq_trainers.report import read_metrics, save_figure
from neatq_trainers.run_folder import CHECKPOINT
from neatq_trainers.train import resume, start
from neatq_trainers.workers import fitting_workers


class Specification(NamedTuple):
    """Means of the quarters, of the last tenth, and the spread of the latter over seeds.

    The one run of qlearning gives its quarters only.
    """

    seeds: int
    means: tuple[float, ...]
    spread: float | None = None


SPECIFICATION: dict[tuple[str, Arm], Specification] = {
    ("flag", "rtneat"): Specification(8, (116, 81, 69, 58, 56.3), 7.5),
    ("flag", "committed"): Specification(8, (117, 86, 76, 71, 69.6), 5.6),
    ("flag", "qlearning"): Specification(1, (142, 140, 134, 133)),
    ("wall", "rtneat"): Specification(8, (255, 221, 191, 172, 167.8), 18.7),
    ("wall", "committed"): Specification(8, (248, 220, 204, 190, 187.9), 17.3),
    ("wall", "qlearning"): Specification(1, (268, 268, 268, 266)),
}
Curves = dict[tuple[str, Arm], np.ndarray]
"""Mean distance of each team at each row [seeds, rows], of each task and arm."""
PUBLISHED = {"rtneat": "rtneat", "committed": "rtneat+q", "qlearning": "qlearning"}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Run the published arms over many seeds and compare them with their specification.

    Cells that are finished are not run again; interrupted ones go on.
    """

    out: Path = Path("runs/reproduction")
    """Where the run folders, the table and the figure go."""
    seeds: int = 16
    """Seeds 0, 1, ... of each cell, side by side in one run."""
    tasks: tuple[str, ...] = ("flag", "wall")
    """Tasks to run."""
    arms: tuple[Arm, ...] = ("rtneat", "committed", "qlearning")
    """Arms to run."""


def main() -> None:
    """Run what is missing, then write `reproduction.md` and `reproduction.png`."""
    options = tyro.cli(Options, prog="python -m neatq_trainers.reproduction")
    torch.set_num_threads(1)
    curves: Curves = {}
    for task, arm in SPECIFICATION:
        folder = options.out / f"{task}-{arm}"
        if task in options.tasks and arm in options.arms:
            if (folder / CHECKPOINT).exists():
                resume(folder)
            else:
                config = replace(preset(task, arm), arenas=options.seeds)
                start(config, folder, workers=fitting_workers(options.seeds))
        if (folder / CHECKPOINT).exists():
            curve = mean_distances(folder)
            if curve.shape[1] == TASK_TICKS[task] // ROW_TICKS:  # else another process is at it
                curves[task, arm] = curve
    write_atomic(options.out / "reproduction.md", table(curves))
    save_figure(draw(curves), options.out / "reproduction.png")
    print(table(curves))


def mean_distances(folder: Path) -> np.ndarray:
    """The mean distance of each team at each row [seeds, rows]."""
    metrics = read_metrics(folder)
    seeds = len(np.unique(metrics["arena"]))
    return metrics["mean_distance"].reshape(-1, seeds).T


def summary(curve: np.ndarray) -> np.ndarray:
    """Means over the quarters and the last tenth of curves [seeds, rows]: [seeds, 5]."""
    rows = curve.shape[1]
    quarters = [curve[:, i * rows // 4 : (i + 1) * rows // 4].mean(1) for i in range(4)]
    return np.stack([*quarters, curve[:, -rows // 10 :].mean(1)], 1)


def table(curves: Curves) -> str:
    """A Markdown table: ours with standard errors, the specification, and the difference.

    Beside each difference stands what is allowed: two of our standard errors, widened by the
    specification's own spread over seeds. That is known for the last tenth only, and stands for
    all five columns.
    """
    lines = [
        "| task | arm | seeds | quarter 1 | quarter 2 | quarter 3 | quarter 4 | last tenth |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (task, arm), curve in curves.items():
        ours, spec = summary(curve), SPECIFICATION[task, arm]
        mean, error = ours.mean(0), ours.std(0, ddof=1) / np.sqrt(len(ours))
        cells = [f"{m:.1f} ± {e:.1f}" for m, e in zip(mean, error, strict=True)]
        lines.append(f"| {task} | {arm} | {len(ours)} | {' | '.join(cells)} |")
        cells = [f"{value:g}" for value in spec.means] + [""] * (mean.size - len(spec.means))
        lines.append(f"| | specification | {spec.seeds} | {' | '.join(cells)} |")
        if spec.spread is not None:
            both = zip(mean - spec.means, 2 * error + spec.spread, strict=True)
            cells = [f"{apart:+.1f} ({allowed:.1f})" for apart, allowed in both]
            lines.append(f"| | difference (allowed) | | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def published_curves() -> dict[tuple[str, str], np.ndarray]:
    """Mean distance over figure ticks of each published run, (task, algorithm): [points, 2]."""
    text = (files("neatq_trainers") / "data" / "paper_curves.csv").read_text()
    points: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in csv.DictReader(text.splitlines()):
        if row["statistic"] == "mean":
            point = float(row["figure_tick"]), float(row["distance"])
            points.setdefault((row["task"], row["algorithm"]), []).append(point)
    return {key: np.array(value) for key, value in points.items()}


def draw(curves: Curves) -> Figure:
    """One panel for each task and arm: our seeds, their mean, and the published run."""
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
        paper = published[task, PUBLISHED[arm]]
        axes.plot(paper[:, 0], paper[:, 1], color="black", lw=0.8, label="published run")
        axes.set_title(f"{task}: {arm}")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    for axes in panels[:, 0]:
        axes.set_ylabel("mean distance to the flag (units)")
    for axes in panels[-1]:
        axes.set_xlabel(f"figure tick ({ROW_TICKS} ticks)")
    panels[0, 0].legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    main()
