"""Runs over seeds: on all cores, one file for each finished seed, never twice."""

from __future__ import annotations

import json
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tqdm import tqdm

from neatq_envs.processes import end_with_parent, refuse_unguarded_script
from neatq_torch.atomic import write_atomic
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHECKPOINT, RunFolderError
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


def run_seeds(task: SeedTask, config: RunConfig) -> Path:
    """Run a configuration over the seeds of a task, side by side; go on if it was interrupted.

    Returns:
        The folder of the run; its arena i has the seed `task.seeds[0] + i`.
    """
    folder = seeds_folder(task)
    if (folder / CHECKPOINT).exists():
        resume(folder, workers=1)
    else:
        first, last = task.seeds[0], task.seeds[-1]
        start(replace(config, arenas=last - first + 1, seed=first), folder)
    return folder


def seeds_folder(task: SeedTask) -> Path:
    """Where `run_seeds` runs the seeds of a task."""
    return task.folder / f"seeds-{task.seeds[0]}-{task.seeds[-1]}"


def run_missing(
    runs: Runs, folder: Path, *, seeds: int, quick: bool, jobs: int, begin: int = 0
) -> None:
    """Run so many seeds of all arms, from `begin` on, that have no result in the folder yet."""
    _run(runs, tasks(runs, folder, seeds=seeds, quick=quick, begin=begin), jobs)


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


def _run(runs: Runs, tasks: list[SeedTask], jobs: int) -> None:
    """Run all tasks; the first error is raised when all others are finished."""
    errors: list[BaseException] = []
    with _progress(runs, tasks) as progress, _processes(jobs) as pool:
        waiting = {pool.submit(_perform, runs.run, task): task for task in tasks}
        finished = 0
        while waiting:
            over, _ = wait(waiting, LOOK_SECONDS, FIRST_COMPLETED)
            for future in over:
                task = waiting.pop(future)
                finished += len(task.seeds)
                if (error := future.exception()) is not None:
                    error.add_note(f"in {runs.name}: {task}")
                    errors.append(error)
            progress.n = round(finished + begun(runs, waiting.values()), 1)
            progress.refresh()
    if errors:
        raise errors[0]


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


@contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that do not outlive an error or Ctrl-C."""
    refuse_unguarded_script()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, _begin_process) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def _begin_process() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    torch.set_num_threads(1)
    end_with_parent()  # a task takes minutes


def _perform(run: Callable[[SeedTask], list[Result]], task: SeedTask) -> None:
    """Run a task and keep its results."""
    task.folder.mkdir(parents=True, exist_ok=True)
    folder = task.folder.parent.parent
    for seed, result in zip(task.seeds, run(task), strict=True):
        text = json.dumps({"seed": seed, **result}, indent=1) + "\n"
        write_atomic(result_path(folder, task.arm, seed), text)
