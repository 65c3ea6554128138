"""The grid of a comparison: every arm on every task, over the same seeds.

A seed makes the same world for every arm: the flag stands at the same places at the same ticks,
the first lives begin at the same places and headings, and later ones draw from the same random
numbers, whenever an arm's robots begin them. So seeds are pairs over arms.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from neatq_envs.gymnasium_task import PREFIX
from neatq_envs.scenario import TASKS
from neatq_experiments.anchors.anchor import AnchorConfig, anchor_config
from neatq_experiments.anchors.run import trainer_of
from neatq_experiments.compare.statistics import mean_of_known
from neatq_experiments.compare.tables import POINT_ROWS, POINT_TICKS, Point, SeedOutcome, Study
from neatq_experiments.compare.variants import config_of, default_arms, known_variants
from neatq_experiments.seeds import Result, Results, Runs, SeedTask, run_seeds, seeds_folder
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import ANCHORS, ARMS
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHECKPOINT, METRICS, Columns, RunFolder, load_run
from neatq_trainers.names import file_name
from neatq_trainers.train import LENGTHS
from neatq_trainers.worlds import ArenaConfig, GymnasiumConfig

SEEDS_TOGETHER = 10
"""Arenas side by side in one process: a tick of ten costs far less than ten of one."""
CONTACT = 10.0
"""Units. Twice the radius of the tightest circle at full speed (1 unit per tick over 0.2 rad per
tick), so that a robot which circles round the flag has found it."""

STABLE_SHARE = 0.9
LIFE_ROWS = 10
"""Rows of metrics in one life of 1000 ticks."""
QUICK_TENTH = 10
"""With `--quick` only the first tenth of a run is made."""
STEPS = 500_000
"""Length of a run on a Gymnasium task: the same for arms that differ in what a generation is."""
_ANY = ("task", "arm", *LENGTHS, "until", "arenas", "seed", "checkpoint_seconds", "logger")
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
        arm: An arm, a variant or an anchor.
        config: How it runs, for any seed.
    """

    task: str
    arm: str
    config: RunConfig | AnchorConfig

    @property
    def name(self) -> str:
        """Folder of its results. Another configuration or length has another one."""
        unit, number = self.config.length
        return f"{file_name(self.task)}-{self.arm}-{number}-{unit}-{digest(self.config)}"

    @property
    def in_arena(self) -> bool:
        """Whether it is judged by distances; else by returns of episodes."""
        return isinstance(self.config.world, ArenaConfig)

    @property
    def is_anchor(self) -> bool:
        """Whether another algorithm runs than those of this project."""
        return isinstance(self.config, AnchorConfig)


def digest(config: RunConfig | AnchorConfig) -> str:
    """Twelve digits that are the same for all runs which differ in seed and length alone.

    They are the beginning of the SHA-256 of the configuration as JSON with sorted keys, without
    the names of task and arm (what these stand for is in the other fields), length, until, arenas,
    seed, checkpoint_seconds and logger. Nor does None count, with which a setting is switched off:
    so a later version's settings leave the digests of runs without them as they are.
    """
    values = config.to_dict()
    if isinstance(config, RunConfig):
        values = RunConfig.from_dict(values).to_dict()  # 1 and 1.0 are the same number
    kept = _without_none({name: value for name, value in values.items() if name not in _ANY})
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return value


def grid(
    tasks: Sequence[str],
    arms: Sequence[str] | None,
    *,
    quick: bool,
    env_kwargs: Mapping[str, Any] | None = None,
    length: Mapping[str, int | None] | None = None,
) -> list[Cell]:
    """Every arm on every task.

    Args:
        tasks: As `preset` takes them.
        arms: Arms, variants or anchors; None: those that a task has by default.
        quick: Whether the first tenth of each run is enough.
        env_kwargs: Keys of the scenario, or arguments of the environment, with other values.
        length: Of each run, by unit; those of a unit are for the worlds that count in it.

    Raises:
        ConfigError: If there is no such task or arm, two have the same name, or a length is no
            world's.
        ScenarioError: If a scenario file cannot be used.
    """
    labels = [_label(task) for task in tasks]
    for name, values in (("tasks", labels), ("arms", arms)):
        if values is not None and (not values or len(set(values)) < len(values)):
            raise ConfigError(
                f"{name}: expected at least one, and none twice; got {' '.join(values) or 'none'}"
            )
    given = {unit: value for unit, value in (length or {}).items() if value is not None}
    cells = [
        Cell(label, arm, _with_length(_config_of(task, arm, env_kwargs), given, quick=quick))
        for task, label in zip(tasks, labels, strict=True)
        for arm in (default_arms(task) if arms is None else arms)
    ]
    for unit in given.keys() - {cell.config.length[0] for cell in cells}:
        raise ConfigError(f"{unit}: no run is that long: none of the tasks counts in {unit}")
    return cells


def _config_of(
    task: str, arm: str, env_kwargs: Mapping[str, Any] | None = None
) -> RunConfig | AnchorConfig:
    return (anchor_config if arm in ANCHORS else config_of)(task, arm, env_kwargs)


def _with_length(
    config: RunConfig | AnchorConfig, given: Mapping[str, int], *, quick: bool
) -> RunConfig | AnchorConfig:
    own = {unit: value for unit, value in given.items() if unit in config.world.lengths}
    if isinstance(config.world, GymnasiumConfig):
        own = own or {"steps": STEPS}
    if own:
        config = config.changed(dict.fromkeys(LENGTHS) | own)
    unit, number = config.length
    least = POINT_TICKS if isinstance(config.world, ArenaConfig) else 1
    whole = max(1, number // (QUICK_TENTH if quick else 1) // least) * least
    return config.changed({unit: whole})


def _label(task: str) -> str:
    """What a task is called in tables: its name, or that of its file without the ending."""
    if task in TASKS or Path(task).suffix != ".json":
        return task.removeprefix(PREFIX)
    label = Path(task).stem
    if label in TASKS:
        raise ConfigError(
            f"tasks: {task} would be called {label}, which is another task; rename it"
        )
    return label


Read = Callable[[RunFolder, Columns, int], Result]
"""What one seed gave: called with the run, its metrics and the seed's arena."""


def distances(run: RunFolder, metrics: Columns, arena: int) -> Result:
    """What one seed gave in the arena."""
    return seed_result(metrics, arena, run.config.length[1])


def runs_of(cells: Sequence[Cell], read: Read = distances, batch: int = SEEDS_TOGETHER) -> Runs:
    """The grid for the runner, which keeps one file for each finished seed of a cell.

    Args:
        cells: All judged by distances, or all by returns.
        read: Says what one seed gave.
        batch: Most seeds side by side.
    """
    configs = {cell.name: cell.config for cell in cells}
    return Runs(
        name="compare",
        arms=tuple(configs),
        batch=batch,
        run=partial(run_cell, configs, read=read),
        share=partial(share_done, configs),
    )


def run_cell(
    configs: Mapping[str, RunConfig | AnchorConfig], task: SeedTask, read: Read = distances
) -> list[Result]:
    """Run some seeds of a cell, or go on with them; one result for each seed."""
    config = configs[task.arm]
    if isinstance(config, AnchorConfig):
        return [_anchor_result(config, seed) for seed in task.seeds]
    unit = "ticks" if config.ticks else "steps"
    done, began = _done(seeds_folder(task), unit), time.process_time()
    folder = run_seeds(task, config)
    used = time.process_time() - began
    ran = (config.ticks or _done(folder, "steps")) - done
    run, first = load_run(folder), task.seeds[0]
    metrics, arenas = run.metrics(), task.seeds[-1] - first + 1
    cpu = {"cpu_seconds": used / (ran / 1000 * arenas) if ran > 0 else None}
    return [{**read(run, metrics, seed - first), **cpu} for seed in task.seeds]


def _anchor_result(config: AnchorConfig, seed: int) -> Result:
    """Run an anchor with a seed, from the beginning."""
    train, began = trainer_of(config), time.process_time()
    came = train(config, seed)
    used = time.process_time() - began
    if config.ticks:
        return {**seed_result(came, 0, config.ticks), "cpu_seconds": 1000 * used / config.ticks}
    return {**came, "cpu_seconds": 1000 * used / came["all_steps"]}


def _done(folder: Path, unit: str) -> int:
    """Ticks or steps that the run in a folder has, if there is one."""
    if not (folder / CHECKPOINT).exists():
        return 0
    return load_run(folder).read()["done"][unit]


def share_done(configs: Mapping[str, RunConfig | AnchorConfig], task: SeedTask) -> float:
    """How much of a task is done, 0 to 1, by the last whole line of its metrics.

    Anchors write none: nothing of them is done before all is.
    """
    unit, total = configs[task.arm].length
    try:
        with (seeds_folder(task) / METRICS).open("rb") as file:
            names = file.readline().decode().strip().split(",")
            file.seek(max(0, file.seek(0, 2) - 1000))
            cells = file.read().split(b"\n")[-2].split(b",")
        done = int(cells[names.index(unit if unit in names else unit.removesuffix("s"))])
    except (OSError, ValueError, IndexError):  # not begun, or no row yet
        return 0.0
    return min(1.0, done / total)


def seed_result(metrics: Columns, arena: int, ticks: int) -> Result:
    """What one seed gave: a row for every 500 ticks, and when the flag was found.

    Args:
        metrics: Columns of `metrics.csv` of all arenas.
        arena: The seed's.
        ticks: Length of the run; a run ends up to a stride later, which does not count.
    """
    own = (metrics["arena"] == arena) & (metrics["tick"] <= ticks)
    tick, nearest = metrics["tick"][own].astype(np.int64), metrics["min_distance"][own]
    rows = [_means(metrics[column][own]) for column in _COLUMNS.values()]
    births = metrics["births"][own][POINT_ROWS - 1 :: POINT_ROWS].astype(int)
    return {
        "tick": tick[POINT_ROWS - 1 :: POINT_ROWS].tolist(),
        **dict(zip(_COLUMNS, rows, strict=True)),
        "births": births.tolist(),
        "first_contact": first_contact(tick, nearest),
        "stable_contact": stable_contact(tick, nearest),
        "champion_reaches": int(champion_reaches(metrics["champion_distance"][own])),
    }


def _means(values: NDArray[np.float64]) -> list[float | None]:
    """Means over five rows each, of what is known of them."""
    whole = values[: values.size // POINT_ROWS * POINT_ROWS].reshape(-1, POINT_ROWS)
    means = mean_of_known(whole, axis=1).tolist()
    return [None if np.isnan(value) else round(value, 4) for value in means]


def first_contact(tick: NDArray[np.int64], nearest: NDArray[np.float64]) -> int | None:
    """The first tick at which the nearest robot is in contact with the flag; None: never.

    Args:
        tick: Of each row of metrics, every 100 ticks [rows].
        nearest: Distance of the nearest robot to the flag, units [rows].
    """
    found = np.flatnonzero(nearest <= CONTACT)
    return int(tick[found[0]]) if found.size else None


def stable_contact(tick: NDArray[np.int64], nearest: NDArray[np.float64]) -> int | None:
    """The tick from which on a robot is in contact in at least nine of ten rows; None: never.

    It is the first row in contact from which to the end of the run at least nine of ten rows are
    in contact, and at least ten rows are left: one life. The nearest robot counts, not always the
    same one, because every robot is on its way for a part of its life; the tenth that is forgiven
    leaves time to find a flag that has moved. Arguments are those of `first_contact`.
    """
    near = nearest <= CONTACT
    left = np.arange(near.size, 0, -1)
    share = np.cumsum(near[::-1])[::-1] / left
    found = np.flatnonzero(near & (share >= STABLE_SHARE) & (left >= LIFE_ROWS))
    return int(tick[found[0]]) if found.size else None


def champion_reaches(champion: NDArray[np.float64]) -> bool:
    """Whether the champion is in contact in at least a tenth of the last tenth of a run.

    A life has ten rows, so a champion that gets to the flag in each of its lives is there in at
    least one row of ten, however long its way is.

    Args:
        champion: Its distance to the flag, units [rows]; NaN where there is none.
    """
    last = champion[-max(1, champion.size // 10) :]
    return bool((last <= CONTACT).mean() >= 1 / LIFE_ROWS)


def study_of(cells: Sequence[Cell], results: Results) -> Study:
    """The tables of the results of cells."""
    points, outcomes = [], []
    for cell in cells:
        for result in results[cell.name]:
            key = cell.task, cell.arm, result["seed"]
            columns = zip(*(result[name] for name in Point._fields[3:]), strict=True)
            points += [Point(*key, *values) for values in columns]
            extras = {name: result[name] for name in SeedOutcome._fields if name in result}
            extras |= {"ticks": cell.config.length[1], "digest": digest(cell.config)}
            outcomes.append(SeedOutcome(task=cell.task, arm=cell.arm, **extras))
    return Study(points=tuple(points), outcomes=tuple(outcomes))


def outdated(study: Study) -> list[tuple[str, str]]:
    """The tasks and arms that have another configuration in this version than in the tables.

    Tasks of scenario files and arms that this version does not know are left out.
    """
    return [
        (task, arm)
        for task in study.tasks
        for arm in study.arms(task)
        if task in TASKS
        and arm in (*ARMS, *ANCHORS, *known_variants())
        and {one.digest for one in study.outcomes_of(task, arm)} != {digest(_config_of(task, arm))}
    ]
