"""Do islands help? Eight populations that exchange genomes, eight that do not, and one as large.

All have 400 robots, equally many births and steps, and evolve alone (`rtneat`), where the straight
way to the flag deceives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from neatq_experiments.compare.cells import CONTACT
from neatq_experiments.compare.statistics import Estimate, mean_estimate
from neatq_experiments.experiment import Experiment, column
from neatq_experiments.seeds import Result, Results, SeedTask, run_seeds
from neatq_trainers.arms import preset
from neatq_trainers.folder import load_run

ISLANDS, ROBOTS, EVERY_TICKS = 8, 50, 1000
ISLAND_TICKS, QUICK_ISLAND_TICKS = 20_000, 2_000
SEEDS_APART = 100
"""Seed s begins with arena 100 s: no two runs have an island in common."""
WAYS: dict[str, dict[str, Any] | None] = {
    "ring": {"every_ticks": EVERY_TICKS},
    "apart": None,
}
"""How the islands of an arm exchange genomes; the arm `one` has no islands."""
DECEPTIVE_TASKS = ("maze", "trap")
ISLAND_ARMS = tuple(f"{task}-{arm}" for task in DECEPTIVE_TASKS for arm in (*WAYS, "one"))


def run_islands(task: SeedTask) -> list[Result]:
    """Train one seed of an arm, which is called TASK-ARM."""
    world, arm = task.arm.split("-")
    islands = ISLANDS if arm in WAYS else 1
    size = {"robots": ROBOTS * ISLANDS // islands}
    length = {"ticks": QUICK_ISLAND_TICKS if task.quick else ISLAND_TICKS}
    changes = {"arenas": islands, "migration": WAYS.get(arm)}
    (seed,) = task.seeds
    config = preset(world, "rtneat", env_kwargs=size, length=length)
    apart = task._replace(seeds=tuple(range(SEEDS_APART * seed, SEEDS_APART * seed + islands)))
    metrics = load_run(run_seeds(apart, config.changed(changes))).metrics()
    last = metrics["tick"] > 0.9 * metrics["tick"].max()
    teams = [metrics["mean_distance"][last & (metrics["arena"] == i)] for i in range(islands)]
    near = metrics["tick"][metrics["min_distance"] <= CONTACT]
    distances = [float(one.mean()) for one in teams]
    return [
        {
            "team": float(np.mean(distances)),
            "best": min(distances),
            "contact": int(near.min()) if near.size else None,
        }
    ]


def _between(found: Estimate) -> str:
    return f"{found.value:.1f} [{found.low:.1f}, {found.high:.1f}]"


def islands_table(results: Results) -> str:
    """A Markdown table: distances of all and of the best island, and who found the flag."""
    lines = [
        "| task | arm | seeds | all robots | best island | all, less `apart` | at the flag |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in ISLAND_ARMS:
        own, task = results.get(name, []), name.split("-")[0]
        if not own:
            continue
        apart = {one["seed"]: one["team"] for one in results.get(f"{task}-apart", [])}
        pairs = [one["team"] - apart[one["seed"]] for one in own if one["seed"] in apart]
        cells = [_between(mean_estimate(column(own, measure))) for measure in ("team", "best")]
        told = bool(pairs) and not name.endswith("-apart")
        cells.append(_between(mean_estimate(np.array(pairs))) if told else "")
        found = [one["contact"] for one in own if one["contact"] is not None]
        cells.append(
            f"{len(found)} of {len(own)}"
            + (f", first after {np.median(found):,.0f} ticks (median)" if found else "")
        )
        lines.append(f"| {task} | `{name.split('-')[1]}` | {len(own)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw_islands(results: Results) -> Figure:
    """A panel for each task: all robots of each seed, and their mean, for each arm."""
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    rng = np.random.default_rng(0)
    arms = (*WAYS, "one")
    for axes, task in zip(figure.subplots(1, len(DECEPTIVE_TASKS)), DECEPTIVE_TASKS, strict=True):
        for at, arm in enumerate(arms):
            values = column(results.get(f"{task}-{arm}", []), "team")
            if values.size:
                spread = at + rng.uniform(-0.12, 0.12, values.size)
                axes.plot(spread, values, "o", color="tab:blue", alpha=0.5, ms=4)
                axes.hlines(values.mean(), at - 0.3, at + 0.3, color="black")
        labels = ["8 islands, ring", "8 apart", "one of 400"]
        axes.set_xticks(range(len(arms)), labels, fontsize=8)
        axes.set_title(task, fontsize=10)
        axes.set_ylabel("distance to the flag, units (mean of all robots)", fontsize=8)
        axes.grid(alpha=0.3, axis="y")
    return figure


ISLAND_STUDY = Experiment(
    name="islands",
    summary="8 islands of 50 robots with and without migration, and one population of 400",
    arms=ISLAND_ARMS,
    seeds=10,
    quick_seeds=2,
    run=run_islands,
    table=islands_table,
    figure=draw_islands,
)
