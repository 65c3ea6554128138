"""`neatq reproduce` and `neatq compare`: what there is, and how it is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from neatq_experiments import (
    arena,
    double_pole,
    foraging,
    gymnasium_tasks,
    islands,
    neat_q,
    nero_sliders,
    published,
    variants,
    xor,
)
from neatq_experiments.compare.command import CompareCommand, run_comparison
from neatq_experiments.experiment import Experiment, run_again
from neatq_experiments.seeds import Spread
from neatq_torch.kinds import ConfigError
from neatq_trainers.commands import parse

EXPERIMENTS: tuple[Experiment, ...] = (
    arena.ARENA,
    xor.XOR,
    *double_pole.DOUBLE_POLE,
    *neat_q.NEAT_Q,
    *foraging.FORAGING,
    nero_sliders.NERO_SLIDERS,
    islands.ISLAND_STUDY,
    gymnasium_tasks.GYMNASIUM,
)


@dataclass(frozen=True, kw_only=True)
class ReproduceCommand:
    """Run a published experiment on all cores, and print it beside the published figures.

    Seeds that are finished are not run again, so an interrupted experiment goes on where it was.
    """

    name: tyro.conf.Positional[str]
    """Which experiment; `neatq reproduce list` tells what there is."""
    quick: bool = False
    """Run a small part only, with fewer seeds: minutes instead of hours."""
    seeds: int | None = None
    """Seeds 0, 1, ... of each arm. Default: as many as the documentation's table has."""
    arms: tuple[str, ...] | None = None
    """Which of the experiment's arms. Default: all."""
    jobs: int | None = None
    """Processes; the results do not depend on it. Default: one for each core."""
    cluster: str | None = None
    """Do it on a Ray cluster: auto (the one that this machine belongs to), ray://HOST:10001, or
    local, which begins one. Machines may come and go."""
    storage: str | None = None
    """Where a cluster mirrors what is under way if its machines do not share the folder --out: a
    URL such as s3://bucket/study, or a folder that they share."""
    out: Path = Path("runs/reproduce")
    """Where results are kept, in a folder for each experiment."""

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("seeds", "jobs"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ConfigError(f"{name}: expected at least 1, got {value}")


@contextmanager
def _keeping_what_is_finished() -> Iterator[None]:
    """Add to Ctrl-C that nothing is lost."""
    try:
        yield
    except KeyboardInterrupt as error:
        advice = "; what is finished is kept: the same command goes on"
        raise KeyboardInterrupt(advice) from error


def reproduce_command(arguments: list[str]) -> None:
    """`neatq reproduce`."""
    command = parse(ReproduceCommand, "reproduce", arguments)
    with _keeping_what_is_finished():
        run_experiment(command)


def compare_command(arguments: list[str]) -> None:
    """`neatq compare`; it knows the study's variants, and draws the published curves."""
    variants.register()
    command = parse(CompareCommand, "compare", arguments)
    with _keeping_what_is_finished():
        run_comparison(command, published.curves_behind())


def run_experiment(command: ReproduceCommand) -> None:
    """Do what the command asks for, and print the table.

    Raises:
        ConfigError: If there is no such experiment or arm.
    """
    if command.name == "list":
        print(experiments_overview(), end="")
        return
    experiment = _with_arms(find(command.name), command.arms)
    planned = experiment.quick_seeds if command.quick else experiment.seeds
    seeds = planned if command.seeds is None else command.seeds
    spread = Spread(jobs=command.jobs, cluster=command.cluster, storage=command.storage)
    out = command.out / experiment.name
    print(run_again(experiment, out, seeds=seeds, quick=command.quick, spread=spread), end="")


def find(name: str) -> Experiment:
    """The experiment of that name; ConfigError if there is none."""
    for experiment in EXPERIMENTS:
        if experiment.name == name:
            return experiment
    known = ", ".join(experiment.name for experiment in EXPERIMENTS)
    raise ConfigError(f"reproduce: expected list or one of {known}; got {name!r}")


def _with_arms(experiment: Experiment, arms: tuple[str, ...] | None) -> Experiment:
    for arm in arms or ():
        if arm not in experiment.arms:
            raise ConfigError(f"arms: expected some of {', '.join(experiment.arms)}; got {arm!r}")
    return experiment if arms is None else replace(experiment, arms=arms)


def experiments_overview() -> str:
    """One line for each experiment."""
    width = max((len(experiment.name) for experiment in EXPERIMENTS), default=0)
    return "".join(f"{one.name:{width}}  {one.summary}\n" for one in EXPERIMENTS)
