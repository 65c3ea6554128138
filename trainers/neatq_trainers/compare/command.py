"""`neatq compare`: runs what is missing of a grid of tasks and arms, and says what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from neatq_envs.scenario import TASKS
from neatq_torch.atomic import write_atomic
from neatq_trainers.compare import variants
from neatq_trainers.compare.cells import grid, runs_of, study_of
from neatq_trainers.compare.check import outdated
from neatq_trainers.compare.figures import draw_differences, draw_halves, draw_overview, draw_task
from neatq_trainers.compare.report import DIFFERENCES_FIGURE, HALVES_FIGURE, OVERVIEW_FIGURE, report
from neatq_trainers.compare.tables import Study, read_tables, write_tables
from neatq_trainers.config import ConfigError
from neatq_trainers.published import published_curves
from neatq_trainers.report import save_figure
from neatq_trainers.reproduce.runner import read_results, run_missing
from neatq_trainers.workers import usable_cores

REPORT, CELLS = "report.md", "cells"
FULL_SEEDS, QUICK_SEEDS = 20, 2


@dataclass(frozen=True, kw_only=True)
class CompareCommand:
    """Run arms beside each other on tasks, over the same seeds, and write tables, figures, report.

    Seeds that are finished are not run again, so an interrupted comparison goes on where it was;
    an arm whose configuration has changed since is run anew. --list tells which arms, variants
    and tasks there are.
    """

    tasks: tuple[str, ...] | None = None
    """Built-in tasks or scenario files. Default: those of the paper."""
    arms: tuple[str, ...] | None = None
    """Arms, variants, or the groups of variants: ladder (from described to neatq, one part at a
    time), without (neatq without one part each), controls, alternatives. Default: the five arms."""
    seeds: int | None = None
    """Seeds 0, 1, ... of each arm on each task. Default: 20; with --quick 2."""
    quick: bool = False
    """Only the first tenth of each run: the same runs, stopped earlier."""
    results: Path | None = None
    """Run nothing: make figures and report from the tables in this folder (results.csv and
    seeds.csv, or both as .csv.gz). With another --out, the tables are put there as .csv.gz."""
    jobs: int | None = None
    """Processes; the results do not depend on it. Default: one for each core."""
    out: Path | None = None
    """Where everything is written. Default: runs/compare, with --quick runs/compare-quick, with
    --results that folder."""
    overview: Annotated[bool, tyro.conf.arg(name="list")] = False
    """Say which arms, variants and tasks there are, and do nothing."""

    @property
    def folder(self) -> Path:
        """Where everything is written."""
        if self.out is not None:
            return self.out
        return self.results or Path("runs", "compare-quick" if self.quick else "compare")


def run_command(command: CompareCommand) -> None:
    """Do what the command asks for.

    Raises:
        ConfigError: If there is no such task, arm or table.
    """
    if command.overview:
        print(overview(), end="")
        return
    _refuse_impossible(command)
    folder = command.folder
    study = _run(command) if command.results is None else _read(command, command.results)
    folder.mkdir(parents=True, exist_ok=True)
    if command.results is None:
        write_tables(study, folder)
    elif folder.resolve() != command.results.resolve():
        write_tables(study, folder, compress=True)
    written = write_report(study, folder)
    print(f"neatq: {folder}: {', '.join(written)}")


def _refuse_impossible(command: CompareCommand) -> None:
    """Check ranges and what goes together."""
    for name in ("seeds", "jobs"):
        value = getattr(command, name)
        if value is not None and value < 1:
            raise ConfigError(f"{name}: expected at least 1, got {value}")
    for name in ("seeds", "jobs", "quick"):
        if getattr(command, name) and command.results is not None:
            raise ConfigError(f"{name}: nothing is run with --results; leave one of them out")


def _run(command: CompareCommand) -> Study:
    """Run what is missing; returns all that was asked for."""
    tasks = tuple(dict.fromkeys(task for task, _ in published_curves()))
    arms = variants.expanded(command.arms or variants.ARMS)
    cells = grid(command.tasks or tasks, arms, quick=command.quick)
    seeds = command.seeds or (QUICK_SEEDS if command.quick else FULL_SEEDS)
    runs, place = runs_of(cells), command.folder / CELLS
    jobs = command.jobs or usable_cores()
    run_missing(runs, place, seeds=seeds, quick=command.quick, jobs=jobs)
    return study_of(cells, read_results(runs, place, seeds))


def _read(command: CompareCommand, source: Path) -> Study:
    """Read saved tables, and say which arms are not what they were."""
    study = read_tables(source).only(
        command.tasks, command.arms and variants.expanded(command.arms)
    )
    for task, arm in outdated(study):
        print(f"neatq: {source}: {arm} on {task} has another configuration in this version")
    return study


def write_report(study: Study, folder: Path) -> list[str]:
    """Write report and figures; returns their names."""
    write_atomic(folder / REPORT, report(study))
    figures = {f"{task}.png": draw_task(study, task) for task in study.tasks}
    if len(study.tasks) > 1:
        figures[OVERVIEW_FIGURE] = draw_overview(study)
    if len(study.arms()) > 1:
        figures[DIFFERENCES_FIGURE] = draw_differences(study)
    halves = draw_halves(study)
    if halves is not None:
        figures[HALVES_FIGURE] = halves
    for name, figure in figures.items():
        save_figure(figure, folder / name)
    return [REPORT, *figures]


def overview() -> str:
    """The arms, variants and tasks."""
    return f"arms:\n{variants.overview()}tasks:\n  {', '.join(TASKS)}, or a file\n"
