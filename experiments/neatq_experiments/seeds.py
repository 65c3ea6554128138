"""Runs over seeds: on all cores, one file for each finished seed, never twice."""

from __future__ import annotations

import json
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tqdm import tqdm

from neatq_envs.machines import open_machines
from neatq_envs.pool import Outcome, performed
from neatq_envs.processes import ProcessEnded
from neatq_experiments.storage import mirrored
from neatq_torch.atomic import write_atomic
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHECKPOINT, RunFolderError, load_run
from neatq_trainers.train import resume, start

LOOK_SECONDS = 1.0
"""Time between two looks at how far the tasks are."""

Result = dict[str, Any]
"""What one seed gave, as JSON values."""
Results = Mapping[str, list[Result]]
"""The results of each arm, by seed."""


class SeedTask(NamedTuple):
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
    run: Callable[[SeedTask], list[Result]]
    share: Callable[[SeedTask], float] | None = None


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Where runs are made; their results do not depend on it.

    Attributes:
        jobs: Most processes at a time. None: one for each core that there is.
        cluster: Address of a Ray cluster, see `open_machines`; None: this machine.
        storage: Where runs that are under way are mirrored, for machines that have no folder in
            common: a URL of fsspec (s3://bucket/study) or a folder. None: nowhere, as all machines
            have the folder of the results.
    """

    jobs: int | None = None
    cluster: str | None = None
    storage: str | None = None


def run_seeds(task: SeedTask, config: RunConfig) -> Path:
    """Run a configuration over the seeds of a task, side by side; go on if it was interrupted.

    What is there of another configuration is removed.

    Returns:
        The folder of the run; its arena i has the seed `task.seeds[0] + i`.
    """
    folder, first, last = seeds_folder(task), task.seeds[0], task.seeds[-1]
    wanted = replace(config, arenas=last - first + 1, seed=first)
    if (folder / CHECKPOINT).exists() and load_run(folder).config == wanted:
        resume(folder, workers=1)
        return folder
    shutil.rmtree(folder, ignore_errors=True)  # of another run, or without a checkpoint
    start(wanted, folder)
    return folder


def seeds_folder(task: SeedTask) -> Path:
    """Where `run_seeds` runs the seeds of a task."""
    return task.folder / f"seeds-{task.seeds[0]}-{task.seeds[-1]}"


def run_missing(
    runs: Runs, folder: Path, *, seeds: int, quick: bool, spread: Spread, begin: int = 0
) -> None:
    """Run so many seeds of all arms, from `begin` on, that have no result in the folder yet."""
    folder = folder.absolute()  # machines of a cluster stand elsewhere
    missing = tasks(runs, folder, seeds=seeds, quick=quick, begin=begin)
    if missing:
        _run(runs, missing, spread)


def tasks(runs: Runs, folder: Path, *, seeds: int, quick: bool, begin: int = 0) -> list[SeedTask]:
    """The tasks that have no result yet; the same seed of all arms comes before the next seed."""
    tasks = []
    for first in range(begin, begin + seeds, runs.batch):
        batch = range(first, min(first + runs.batch, begin + seeds))
        for arm in runs.arms:
            missing = tuple(seed for seed in batch if not result_path(folder, arm, seed).is_file())
            if missing:
                work = folder / arm / f"work-{first}"
                tasks.append(SeedTask(arm, missing, quick, work))
    return tasks


def result_path(folder: Path, arm: str, seed: int) -> Path:
    """The file of one seed's result."""
    return folder / arm / f"seed-{seed}.json"


def read_results(runs: Runs, folder: Path, seeds: int, begin: int = 0) -> Results:
    """The results of so many seeds of every arm from `begin` on, as far as they are there."""
    return {
        arm: [
            _read_result(path)
            for seed in range(begin, begin + seeds)
            if (path := result_path(folder, arm, seed)).exists()
        ]
        for arm in runs.arms
    }


def _read_result(path: Path) -> Result:
    try:
        return json.loads(path.read_bytes())
    except ValueError as error:
        raise RunFolderError(
            f"{path}: damaged ({error}); delete it, and its seed is run again"
        ) from error


def _run(runs: Runs, tasks: list[SeedTask], spread: Spread) -> None:
    """Run all tasks; the first error is raised when all others are finished."""
    errors: list[BaseException] = []
    over, hosts = set[SeedTask](), Counter[str]()
    begin = _Performer, runs.run, storage_of(runs, tasks[0], spread)
    with _progress(runs, tasks) as bar, open_machines(spread.cluster) as machines:
        if machines.dashboard:
            print(f"neatq: {runs.name}: dashboard of Ray at {machines.dashboard}", file=sys.stderr)
        how: Any = {"jobs": spread.jobs, "seconds": LOOK_SECONDS}
        for outcome in performed(machines, begin, tasks, **how):
            if outcome is not None:
                over.add(outcome.task)
                hosts[outcome.host] += len(outcome.task.seeds)
                if outcome.error is None:
                    _keep(outcome.task, outcome.answer)
                else:
                    outcome.error.add_note(f"in {runs.name}: {outcome.task}")
                    errors.append(outcome.error)
                if outcome.tries > 1:
                    bar.write(_lost_and_done(runs, outcome), file=sys.stderr)
                _show_hosts(bar, hosts)
            finished = sum(len(task.seeds) for task in over)
            bar.n = round(finished + begun(runs, [one for one in tasks if one not in over]), 1)
            bar.refresh()
    if errors:
        raise errors[0]


def storage_of(runs: Runs, task: SeedTask, spread: Spread) -> str | None:
    """Where an experiment mirrors its tasks, quick ones apart."""
    if spread.storage is None:
        return None
    there = spread.storage if "://" in spread.storage else str(Path(spread.storage).absolute())
    return f"{there.rstrip('/')}/{runs.name}-{'quick' if task.quick else 'full'}"


def _lost_and_done(runs: Runs, outcome: Outcome) -> str:
    """What is to be said of a task whose process or machine was lost."""
    seeds = " ".join(map(str, outcome.task.seeds))
    lost = outcome.tries - (not isinstance(outcome.error, ProcessEnded))
    end = "given up" if outcome.error is not None else f"done on {outcome.host}"
    return f"neatq: {runs.name}: {outcome.task.arm}, seeds {seeds}: lost {lost} times, {end}"


def _show_hosts(bar: tqdm, hosts: Counter[str]) -> None:
    """Say at which rate each machine finishes runs, where there are several."""
    hours = max(bar.format_dict["elapsed"], 1.0) / 3600
    if len(hosts) > 1:
        rates = (f"{host} {count / hours:.0f}/h" for host, count in sorted(hosts.items()))
        bar.set_postfix_str(", ".join(rates), refresh=False)


def _progress(runs: Runs, tasks: list[SeedTask]) -> tqdm:
    seeds = sum(len(task.seeds) for task in tasks)
    silent = not sys.stderr.isatty()
    before = 0 if silent else round(begun(runs, tasks), 1)
    return tqdm(total=seeds, initial=before, desc=runs.name, unit=" runs", disable=silent)


def begun(runs: Runs, tasks: Iterable[SeedTask]) -> float:
    """How many seeds' worth of tasks without results is done."""
    if runs.share is None:
        return 0.0
    return sum(runs.share(task) * len(task.seeds) for task in tasks)


class _Performer:
    """Runs tasks in a process of its own."""

    def __init__(self, run: Callable[[SeedTask], list[Result]], storage: str | None) -> None:
        torch.set_num_threads(1)
        self._run, self._storage = run, storage

    def __call__(self, task: SeedTask) -> list[Result]:
        """The results of its seeds; its folder is mirrored in the storage until they are there."""
        with mirrored(task.folder, self._storage) as folder:
            return self._run(task._replace(folder=folder))


def _keep(task: SeedTask, results: Sequence[Result]) -> None:
    """Write the results of a task."""
    folder = task.folder.parent.parent
    result_path(folder, task.arm, 0).parent.mkdir(parents=True, exist_ok=True)
    for seed, result in zip(task.seeds, results, strict=True):
        text = json.dumps({"seed": seed, **result}, indent=1) + "\n"
        write_atomic(result_path(folder, task.arm, seed), text)
