"""`neatq compare`: runs what is missing of a grid of tasks and arms, and says what came of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro
from matplotlib.figure import Figure

from neatq_envs.gymnasium_task import assignments
from neatq_envs.scenario import TASKS
from neatq_experiments.compare import figures, variants
from neatq_experiments.compare.cells import grid, outdated, runs_of, study_of
from neatq_experiments.compare.report import (
    DIFFERENCES_FIGURE,
    HALVES_FIGURE,
    OVERVIEW_FIGURE,
    report,
)
from neatq_experiments.compare.returns import (
    RETURNS,
    Returns,
    draw_returns,
    read_returns,
    returns_of,
    returns_of_seed,
    returns_report,
    write_returns,
)
from neatq_experiments.compare.tables import (
    RESULTS,
    Study,
    Tables,
    holds,
    read_tables,
    write_tables,
)
from neatq_experiments.seeds import Results, Runs, Spread, read_results, run_missing
from neatq_torch.atomic import write_atomic
from neatq_torch.kinds import ConfigError
from neatq_trainers.names import file_name
from neatq_trainers.report import save_figure
from neatq_trainers.train import LENGTHS

_OF_RUNS = ("env_kwargs", *LENGTHS)
REPORT, CELLS = "report.md", "cells"
FULL_SEEDS, QUICK_SEEDS = 20, 2
PAPER_TASKS = "flag", "moving", "wall"
Some = TypeVar("Some", bound=Tables)


@dataclass(frozen=True, kw_only=True)
class CompareCommand:
    """Run arms beside each other on tasks, over the same seeds, and write tables, figures, report.

    Seeds that are finished are not run again, so an interrupted comparison goes on where it was;
    an arm whose configuration has changed since is run anew. --list tells which arms, variants
    and tasks there are.
    """

    tasks: tuple[str, ...] | None = None
    """Built-in tasks, scenario files, gym:ID, or registered worlds. Default: those of the paper."""
    arms: tuple[str, ...] | None = None
    """Arms, variants or groups of variants, such as ladder (from described to replay, one part at
    a time) and without (replay without one part each), and anchors, which one would otherwise take:
    ppo; in the arena ppo-novelty, sac and sac-novelty; on Gymnasium tasks sb3-ppo, sb3-sac,
    sb3-td3 and sb3-dqn. Default: the five arms of the arena; on other tasks rtneat, neat, neatq
    and neat+q."""
    seeds: int | None = None
    """Seeds 0, 1, ... of each arm on each task. Default: 20; with --quick 2."""
    first_seed: int = 0
    """The seeds are so much greater: for seeds with which no setting was chosen."""
    quick: bool = False
    """Only the first tenth of each run: the same runs, stopped earlier."""
    ticks: int | None = None
    """Length of each run in the arena and in worlds of one's own. Default: that of the task."""
    steps: int | None = None
    """Length of each run on a Gymnasium task, in steps of the environment. Default: 500,000."""
    generations: int | None = None
    """Length of each run on a Gymnasium task; a generation of one arm may have more steps than
    one of another."""
    env_kwargs: tuple[str, ...] = ()
    """Keys of the scenario, such as robots=30, or arguments of the environment; values are JSON."""
    results: Path | None = None
    """Run nothing: make figures and report from the tables in this folder (results.csv and
    seeds.csv, returns.csv and return_seeds.csv, or any as .csv.gz). With another --out, the
    tables are put there as .csv.gz."""
    jobs: int | None = None
    """Processes; the results do not depend on it. Default: one for each core."""
    cluster: str | None = None
    """Run it on a Ray cluster: auto (the one that this machine belongs to), ray://HOST:10001, or
    local, which begins one. Machines may come and go."""
    storage: str | None = None
    """Where a cluster mirrors what is under way if its machines do not share the folder --out: a
    URL such as s3://bucket/study, or a folder that they share."""
    out: Path | None = None
    """Where everything is written. Default: runs/compare, with --quick runs/compare-quick, with
    --results that folder."""
    overview: Annotated[bool, tyro.conf.arg(name="list")] = False
    """Say which arms, anchors, variants and tasks there are, and do nothing."""

    @property
    def folder(self) -> Path:
        """Where everything is written."""
        if self.out is not None:
            return self.out
        return self.results or Path("runs", "compare-quick" if self.quick else "compare")


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What a comparison found, and where it is written.

    Attributes:
        folder: With tables, figures and report.
        study: What was found in the arena; None if nothing ran there.
        returns: What was found where returns of episodes count; None likewise.
    """

    folder: Path
    study: Study | None = None
    returns: Returns | None = None

    def report(self) -> str:
        """The report, Markdown."""
        parts = [] if self.study is None else [report(self.study)]
        parts += [] if self.returns is None else [returns_report(self.returns)]
        return "\n".join(parts)


def compare(  # noqa: PLR0913  (as many as the command has options)
    tasks: str | Sequence[str],
    arms: Sequence[str] | None = None,
    *,
    seeds: int = FULL_SEEDS,
    first_seed: int = 0,
    quick: bool = False,
    ticks: int | None = None,
    steps: int | None = None,
    generations: int | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    storage: str | None = None,
    out: Path | str | None = None,
) -> Comparison:
    """Run arms beside each other on tasks, over the same seeds; write tables, figures and report.

    Seeds that are finished are not run again. Called from a script it must stand below
    `if __name__ == "__main__":`, as other processes import the script.

    Args:
        tasks: Built-in tasks, scenario files, "gym:ID", or registered worlds.
        arms: Arms, variants, groups of variants or anchors. None: the five of the arena; on other
            tasks rtneat, neat, neatq and neat+q.
        seeds: Seeds 0, 1, ... of each arm on each task.
        first_seed: By how much the seeds are greater.
        quick: Whether the first tenth of each run is enough.
        ticks: Length of each run in the arena and in worlds of one's own.
        steps: Length of each run on a Gymnasium task. Default: 500,000.
        generations: Length of each run on a Gymnasium task.
        env_kwargs: Keys of the scenario, or arguments of the environment, with other values.
        jobs: Processes; the results do not depend on it. Default: one for each core.
        cluster: A Ray cluster to run it on: "auto", "local", "ray://HOST:10001".
        storage: Where that mirrors what is under way, if its machines do not share the folder.
        out: Where everything is written. Default: runs/compare, if quick runs/compare-quick.

    Raises:
        ConfigError: If there is no such task or arm, or it cannot run as asked.

    Example:
        >>> found = compare("gym:CartPole-v1", ["neat", "neatq"], seeds=5, steps=100_000)
        >>> print(found.report())
    """
    command = CompareCommand(
        tasks=(tasks,) if isinstance(tasks, str) else tuple(tasks),
        arms=None if arms is None else tuple(arms),
        seeds=seeds,
        first_seed=first_seed,
        quick=quick,
        ticks=ticks,
        steps=steps,
        generations=generations,
        env_kwargs=tuple(f"{key}={json.dumps(one)}" for key, one in (env_kwargs or {}).items()),
        **{"jobs": jobs, "cluster": cluster, "storage": storage},
        out=None if out is None else Path(out),
    )
    found = _found(command)
    write_comparison(found)
    return found


def run_comparison(command: CompareCommand, behind: figures.Behind | None = None) -> None:
    """Do what the command asks for.

    Args:
        command: What was asked for.
        behind: Other curves to draw behind those of the arms.

    Raises:
        ConfigError: If there is no such task, arm or table.
    """
    if command.overview:
        tasks = f"tasks:\n  {', '.join(TASKS)}, a scenario file, gym:ID, a registered world\n"
        print(f"arms:\n{variants.arms_overview()}{tasks}", end="")
        return
    found = _found(command)
    print(f"neatq: {found.folder}: {', '.join(write_comparison(found, behind))}")


def _found(command: CompareCommand) -> Comparison:
    """What was asked for, run or read, with its tables where they belong."""
    _refuse_impossible(command)
    folder, saved = command.folder, command.results
    found = _run_grid(command) if saved is None else _read_saved(command, saved)
    if saved is None or folder.resolve() != saved.resolve():
        if found.study is not None:
            write_tables(found.study, folder, compress=saved is not None)
        if found.returns is not None:
            write_returns(found.returns, folder, compress=saved is not None)
    return found


def _refuse_impossible(command: CompareCommand) -> None:
    """Check ranges and what goes together."""
    for name in ("seeds", "jobs", *LENGTHS):
        value = getattr(command, name)
        if value is not None and value < 1:
            raise ConfigError(f"{name}: expected at least 1, got {value}")
    if command.first_seed < 0:
        raise ConfigError(f"first_seed: expected at least 0, got {command.first_seed}")
    for name in ("seeds", "first_seed", "jobs", "cluster", "storage", "quick", *_OF_RUNS):
        if getattr(command, name) and command.results is not None:
            raise ConfigError(f"{name}: nothing is run with --results; leave one of them out")


def _run_grid(command: CompareCommand) -> Comparison:
    """Run what is missing; returns all that was asked for."""
    cells = grid(
        command.tasks or PAPER_TASKS,
        command.arms and variants.expanded(command.arms),
        quick=command.quick,
        env_kwargs=assignments(command.env_kwargs),
        length={unit: getattr(command, unit) for unit in LENGTHS},
    )
    seeds = command.seeds or (QUICK_SEEDS if command.quick else FULL_SEEDS)
    spread = Spread(jobs=command.jobs, cluster=command.cluster, storage=command.storage)
    folder = command.folder / CELLS

    def results(runs: Runs) -> Results:
        begin = command.first_seed
        if runs.arms:
            asked: Any = {"seeds": seeds, "quick": command.quick, "begin": begin}
            run_missing(runs, folder, **asked, spread=spread)
        return read_results(runs, folder, seeds, begin)

    near = [cell for cell in cells if cell.in_arena]
    others = [cell for cell in cells if not cell.in_arena]
    study = None
    if near:
        anchors = [cell for cell in near if cell.is_anchor]
        found = results(runs_of([cell for cell in near if not cell.is_anchor]))
        study = study_of(near, {**found, **results(runs_of(anchors, batch=1))})
    # One seed at a time: side by side, all would go on until the slowest has its steps.
    alone = runs_of(others, read=returns_of_seed, batch=1)
    returns = returns_of(others, results(alone)) if others else None
    return Comparison(folder=command.folder, study=study, returns=returns)


def _read_saved(command: CompareCommand, source: Path) -> Comparison:
    """Read saved tables, and say which arms are not what they were."""
    returns = read_returns(source) if holds(source, RETURNS) else None
    study = read_tables(source) if returns is None or holds(source, RESULTS) else None
    there: list[Tables] = [tables for tables in (study, returns) if tables is not None]
    study = study and _asked(study, command, there)
    for task, arm in [] if study is None else outdated(study):
        print(f"neatq: {source}: {arm} on {task} has another configuration in this version")
    returns = returns and _asked(returns, command, there)
    return Comparison(folder=command.folder, study=study, returns=returns)


def _asked(tables: Some, command: CompareCommand, there: Sequence[Tables]) -> Some | None:
    """What is asked for of tables, without what only the others hold; None: nothing."""

    def own(asked: Sequence[str] | None, of: Callable[[Tables], list[str]]) -> list[str] | None:
        known = {name for one in there for name in of(one)}
        names = [name for name in asked or () if name in of(tables) or name not in known]
        return names if asked else None

    tasks = own(command.tasks, lambda one: one.tasks)
    arms = own(command.arms and variants.expanded(command.arms), lambda one: one.arms())
    return None if [] in (tasks, arms) else tables.only(tasks, arms)


def write_comparison(found: Comparison, behind: figures.Behind | None = None) -> list[str]:
    """Write report and figures; returns their names."""
    write_atomic(found.folder / REPORT, found.report())
    drawn: dict[str, Figure] = {}
    if (study := found.study) is not None:
        drawn = {f"{task}.png": figures.draw_task(study, task, behind) for task in study.tasks}
        if len(study.tasks) > 1:
            drawn[OVERVIEW_FIGURE] = figures.draw_overview(study, behind)
        if len(study.arms()) > 1:
            drawn[DIFFERENCES_FIGURE] = figures.draw_differences(study)
        if (halves := figures.draw_halves(study)) is not None:
            drawn[HALVES_FIGURE] = halves
    if (returns := found.returns) is not None:
        drawn |= {f"{file_name(task)}.png": draw_returns(returns, task) for task in returns.tasks}
    for name, figure in drawn.items():
        save_figure(figure, found.folder / name)
    return [REPORT, *drawn]
