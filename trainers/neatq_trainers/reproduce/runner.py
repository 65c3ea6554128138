"""Running an experiment: on all cores, one file for each finished seed, never twice."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path

import torch
from tqdm import tqdm

from neatq_torch.atomic import write_atomic
from neatq_trainers.report import save_figure
from neatq_trainers.reproduce.experiment import Experiment, Result, Results, Runs, Task
from neatq_trainers.run_folder import RunFolderError

TABLE, FIGURE = "table.md", "figure.png"
LOOK_SECONDS = 1.0
"""Time between two looks at how far the tasks are."""


def reproduce(experiment: Experiment, out: Path, *, seeds: int, quick: bool, jobs: int) -> str:
    """Run what is missing of an experiment, and write its table and figure.

    Args:
        experiment: What to run.
        out: Folder of its results; those that are there are kept.
        seeds: Seeds 0, 1, ... of each arm.
        quick: Whether a small part of the work is enough; such results are kept apart.
        jobs: Processes.

    Returns:
        The table, Markdown.

    Raises:
        RunFolderError: If a result in the folder cannot be read.
    """
    folder = out / ("quick" if quick else "full")
    run_missing(experiment, folder, seeds=seeds, quick=quick, jobs=jobs)
    results = read_results(experiment, folder, seeds)
    table = experiment.table(results)
    write_atomic(folder / TABLE, table)
    if experiment.figure is not None:
        save_figure(experiment.figure(results), folder / FIGURE)
    return table


def run_missing(runs: Runs, folder: Path, *, seeds: int, quick: bool, jobs: int) -> None:
    """Run the seeds 0, 1, ... of all arms that have no result in the folder yet."""
    _run(runs, tasks(runs, folder, seeds=seeds, quick=quick), jobs)


def tasks(experiment: Runs, folder: Path, *, seeds: int, quick: bool) -> list[Task]:
    """The tasks that have no result yet; the same seed of all arms comes before the next seed."""
    tasks = []
    for first in range(0, seeds, experiment.batch):
        batch = range(first, min(first + experiment.batch, seeds))
        for arm in experiment.arms:
            missing = tuple(seed for seed in batch if not result_path(folder, arm, seed).is_file())
            if missing:
                work = folder / arm / f"work-{first}"
                tasks.append(Task(arm, missing, quick, work))
    return tasks


def result_path(folder: Path, arm: str, seed: int) -> Path:
    """The file of one seed's result."""
    return folder / arm / f"seed-{seed}.json"


def read_results(experiment: Runs, folder: Path, seeds: int) -> Results:
    """The results of seeds 0, 1, ... of every arm, as far as they are there."""
    return {
        arm: [
            _read(path)
            for seed in range(seeds)
            if (path := result_path(folder, arm, seed)).exists()
        ]
        for arm in experiment.arms
    }


def _read(path: Path) -> Result:
    try:
        return json.loads(path.read_bytes())
    except ValueError as error:
        raise RunFolderError(
            f"{path}: damaged ({error}); delete it, and its seed is run again"
        ) from error


def _run(runs: Runs, tasks: list[Task], jobs: int) -> None:
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


def _progress(runs: Runs, tasks: list[Task]) -> tqdm:
    seeds = sum(len(task.seeds) for task in tasks)
    silent = not sys.stderr.isatty()
    before = 0 if silent else round(begun(runs, tasks), 1)
    return tqdm(total=seeds, initial=before, desc=runs.name, unit=" runs", disable=silent)


def begun(runs: Runs, tasks: Iterable[Task]) -> float:
    """How many seeds' worth of tasks without results is done."""
    if runs.share is None:
        return 0.0
    return sum(runs.share(task) * len(task.seeds) for task in tasks)


@contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that do not outlive an error or Ctrl-C."""
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
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A task takes minutes: do not go on with it for somebody who was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _perform(run: Callable[[Task], list[Result]], task: Task) -> None:
    """Run a task and keep its results."""
    task.folder.mkdir(parents=True, exist_ok=True)
    folder = task.folder.parent.parent
    for seed, result in zip(task.seeds, run(task), strict=True):
        text = json.dumps({"seed": seed, **result}, indent=1) + "\n"
        write_atomic(result_path(folder, task.arm, seed), text)
