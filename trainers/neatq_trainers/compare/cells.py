"""The grid of a comparison: every arm on every task, over the same seeds.

A seed makes the same world for every arm: the flag stands at the same places at the same ticks,
the first lives begin at the same places and headings, and later ones draw from the same random
numbers, whenever an arm's robots begin them. So seeds are pairs over arms.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from neatq_envs.scenario import TASKS
from neatq_trainers.compare.contact import champion_reaches, first_contact, stable_contact
from neatq_trainers.compare.statistics import mean_of_known
from neatq_trainers.compare.tables import POINT_ROWS, POINT_TICKS, Outcome, Point, Study
from neatq_trainers.compare.variants import config_of
from neatq_trainers.config import ConfigError, RunConfig
from neatq_trainers.report import Metrics, read_metrics
from neatq_trainers.reproduce.arena import run_seeds, seeds_folder
from neatq_trainers.reproduce.experiment import Result, Results, Runs, Task
from neatq_trainers.run_folder import CHECKPOINT, METRICS, RunFolder

SEEDS_TOGETHER = 10
"""Arenas side by side in one process: a tick of ten costs far less than ten of one."""
QUICK_SHARE = 10
"""With `--quick` only the first tenth of a run is made."""
_ANY = ("task", "arm", "ticks", "arenas", "seed", "checkpoint_seconds", "logger")
_COLUMNS = {
    "team": "mean_distance",
    "eligible": "eligible_mean_distance",
    "newborn": "newborn_mean_distance",
    "champion": "champion_distance",
    "nearest": "min_distance",
}


class Cell(NamedTuple):
    """An arm on a task.

    Attributes:
        task: What the task is called in tables.
        arm: An arm or a variant.
        config: How it runs, for any seed.
    """

    task: str
    arm: str
    config: RunConfig

    @property
    def name(self) -> str:
        """Folder of its results. Another configuration or length has another one."""
        return f"{self.task}-{self.arm}-{self.config.ticks}-{digest(self.config)}"


def digest(config: RunConfig) -> str:
    """Twelve digits that are the same for all runs which differ in seed and length alone.

    They are the beginning of the SHA-256 of the configuration as JSON with sorted keys, without
    the names of task and arm (what these stand for is in the other fields), ticks, arenas, seed,
    checkpoint_seconds and logger. Nor does None count, with which a setting is switched off: so a
    later version's settings leave the digests of runs without them as they are.
    """
    values = RunConfig.from_dict(config.to_dict()).to_dict()  # 1 and 1.0 are the same number
    kept = _without_none({name: value for name, value in values.items() if name not in _ANY})
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return value


def grid(tasks: Sequence[str], arms: Sequence[str], *, quick: bool) -> list[Cell]:
    """Every arm on every task.

    Args:
        tasks: Built-in tasks or paths of scenario files.
        arms: Arms or variants.
        quick: Whether the first tenth of each run is enough.

    Raises:
        ConfigError: If there is no such task or arm, or two have the same name.
        ScenarioError: If a scenario file cannot be used.
    """
    labels = [_label(task) for task in tasks]
    for name, values in (("tasks", labels), ("arms", arms)):
        if not values or len(set(values)) < len(values):
            raise ConfigError(
                f"{name}: expected at least one, and none twice; got {' '.join(values) or 'none'}"
            )
    cells = []
    for task, label in zip(tasks, labels, strict=True):
        for arm in arms:
            config = config_of(task, arm)
            ticks = config.ticks // (QUICK_SHARE if quick else 1)
            whole = max(1, ticks // POINT_TICKS) * POINT_TICKS
            cells.append(Cell(label, arm, replace(config, ticks=whole)))
    return cells


def _label(task: str) -> str:
    """What a task is called in tables: its name, or that of its file without the ending."""
    if task in TASKS:
        return task
    label = Path(task).stem
    if label in TASKS:
        raise ConfigError(
            f"tasks: {task} would be called {label}, which is another task; rename it"
        )
    return label


def runs_of(cells: Sequence[Cell]) -> Runs:
    """The grid for the runner, which keeps one file for each finished seed of a cell."""
    configs = {cell.name: cell.config for cell in cells}
    return Runs(
        name="compare",
        arms=tuple(configs),
        batch=SEEDS_TOGETHER,
        run=partial(run_cell, configs),
        share=partial(share_done, configs),
    )


def run_cell(configs: Mapping[str, RunConfig], task: Task) -> list[Result]:
    """Run some seeds of a cell, or go on with them; one result for each seed."""
    config = configs[task.arm]
    done, began = _ticks_done(seeds_folder(task)), time.process_time()
    folder = run_seeds(task, config)
    used, ran = time.process_time() - began, max(0, config.ticks - done)
    metrics = read_metrics(folder)
    first, arenas = task.seeds[0], task.seeds[-1] - task.seeds[0] + 1
    cpu_seconds = used / (ran / 1000 * arenas) if ran else None
    return [
        {**seed_result(metrics, seed - first, config.ticks), "cpu_seconds": cpu_seconds}
        for seed in task.seeds
    ]


def _ticks_done(folder: Path) -> int:
    """Ticks that the run in a folder has, if there is one."""
    if not (folder / CHECKPOINT).exists():
        return 0
    _, states = RunFolder.open(folder).load()
    return states[0]["tick"]


def share_done(configs: Mapping[str, RunConfig], task: Task) -> float:
    """How much of a task is done, 0 to 1, by the last whole line of its metrics."""
    try:
        with (seeds_folder(task) / METRICS).open("rb") as file:
            file.seek(max(0, file.seek(0, 2) - 1000))
            tick = int(file.read().split(b"\n")[-2].split(b",")[1])
    except (OSError, ValueError, IndexError):  # not begun, or no row yet
        return 0.0
    return min(1.0, tick / configs[task.arm].ticks)


def seed_result(metrics: Metrics, arena: int, ticks: int) -> Result:
    """What one seed gave: a row for every 500 ticks, and when the flag was found.

    Args:
        metrics: Columns of `metrics.csv` of all arenas.
        arena: The seed's.
        ticks: Length of the run; a run ends up to a stride later, which does not count.
    """
    own = (metrics["arena"] == arena) & (metrics["tick"] <= ticks)
    tick, nearest = metrics["tick"][own].astype(np.int64), metrics["min_distance"][own]
    rows = [_points(metrics[column][own]) for column in _COLUMNS.values()]
    births = metrics["births"][own][POINT_ROWS - 1 :: POINT_ROWS].astype(int)
    return {
        "tick": tick[POINT_ROWS - 1 :: POINT_ROWS].tolist(),
        **dict(zip(_COLUMNS, rows, strict=True)),
        "births": births.tolist(),
        "first_contact": first_contact(tick, nearest),
        "stable_contact": stable_contact(tick, nearest),
        "champion_reaches": int(champion_reaches(metrics["champion_distance"][own])),
    }


def _points(values: NDArray[np.float64]) -> list[float | None]:
    """Means over five rows each, of what is known of them."""
    whole = values[: values.size // POINT_ROWS * POINT_ROWS].reshape(-1, POINT_ROWS)
    means = mean_of_known(whole, axis=1).tolist()
    return [None if np.isnan(value) else round(value, 4) for value in means]


def study_of(cells: Sequence[Cell], results: Results) -> Study:
    """The tables of the results of cells."""
    points, outcomes = [], []
    for cell in cells:
        for result in results[cell.name]:
            key = cell.task, cell.arm, result["seed"]
            columns = zip(*(result[name] for name in Point._fields[3:]), strict=True)
            points += [Point(*key, *values) for values in columns]
            extras = {name: result[name] for name in Outcome._fields if name in result}
            outcomes.append(
                Outcome(
                    task=cell.task,
                    arm=cell.arm,
                    ticks=cell.config.ticks,
                    digest=digest(cell.config),
                    **extras,
                )
            )
    return Study(points=tuple(points), outcomes=tuple(outcomes))
