"""The `neatq` command."""

from __future__ import annotations

import argparse
import gc
import json
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import torch
import tyro

from neatq_envs.gymnasium_rows import EpisodeError
from neatq_envs.gymnasium_task import PREFIX, TaskError
from neatq_envs.scenario import ScenarioError
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.genome import GenomeError
from neatq_trainers.compare.command import CompareCommand
from neatq_trainers.compare.command import run_command as compare
from neatq_trainers.config import ConfigError, RunConfig, preset
from neatq_trainers.generational import folder as gymnasium_folder
from neatq_trainers.generational import report as gymnasium_report
from neatq_trainers.generational import train as gymnasium_train
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.config import preset as gymnasium_preset
from neatq_trainers.report import write_report
from neatq_trainers.reproduce.command import ReproduceCommand, run_command
from neatq_trainers.run_files import RunFiles
from neatq_trainers.run_folder import (
    ANIMATION,
    ARENA,
    CHAMPION,
    CHECKPOINT,
    CONFIG,
    CURVES,
    METRICS,
    RunFolder,
)
from neatq_trainers.train import resume, start
from neatq_trainers.workers import fitting_workers

Command = TypeVar("Command")

_RESULTS = (METRICS, CURVES, ARENA, ANIMATION, CHAMPION)
_GYMNASIUM_RESULTS = (
    METRICS,
    CURVES,
    CHAMPION,
    gymnasium_folder.SCALING,
    gymnasium_folder.RESULT,
    gymnasium_folder.PICTURE,
    gymnasium_folder.ANIMATION,
)

_USAGE = """usage: neatq {train,resume,compare,reproduce} ...

Neuroevolution that learns during life: robots, a flag, rtNEAT and Q-learning; or any Gymnasium
environment, NEAT and NEAT+Q.

  neatq train      train a population and write a run folder   (neatq train --help)
  neatq resume     go on with a run, exactly where it stopped  (neatq resume --help)
  neatq compare    run arms beside each other on tasks         (neatq compare --list)
  neatq reproduce  run a published experiment                  (neatq reproduce list)

Examples: neatq train --task wall --arm neatq --ticks 70000 --seed 0 --out runs/first
          neatq train --task gym:CartPole-v1             (neatq train --task gym:ID --help)
"""


@dataclass(frozen=True, kw_only=True)
class TrainCommand:
    """Train a population and write a run folder.

    --task and --arm choose the defaults of all other options, which this help shows. For any
    Gymnasium environment: --task gym:ID, such as gym:CartPole-v1, which has options of its own.
    """

    config: Annotated[RunConfig, tyro.conf.arg(name="")]
    out: Path | None = None
    """The run folder; new or empty. Default: runs/TASK-ARM-seedSEED."""
    workers: int | None = None
    """Processes among which the arenas are dealt; the results do not depend on it. Default: one
    for each core, but at least four arenas each."""


@dataclass(frozen=True, kw_only=True)
class TrainGymnasiumCommand:
    """Train on a Gymnasium environment and write a run folder.

    --arm (neat, neatq or qnetwork) chooses the defaults of all other options, which this help
    shows.
    """

    config: Annotated[GenerationalConfig, tyro.conf.arg(name="")]
    out: Path | None = None
    """The run folder; new or empty. Default: runs/ID-ARM-seedSEED."""
    workers: int | None = None
    """Processes among which the genomes are dealt; the results do not depend on it. Default: one
    for each core."""


@dataclass(frozen=True, kw_only=True)
class ResumeCommand:
    """Go on with a run, exactly where it stopped."""

    folder: tyro.conf.Positional[Path]
    """The run folder."""
    ticks: int | None = None
    """Another length for a run in the arena; may be longer than first asked."""
    generations: int | None = None
    """Another length for a run on a Gymnasium task."""
    workers: int | None = None
    """Processes of a run on a Gymnasium task; default: one for each core. A run in the arena goes
    on with as many as it was begun with."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status (2 for bad input, 130 after Ctrl-C)."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    commands = {
        "train": _train,
        "resume": _resume,
        "compare": _compare,
        "reproduce": _reproduce,
    }
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_USAGE, end="")
        return 0 if arguments else 2
    if arguments[0] not in commands:
        known = "train, resume, compare or reproduce"
        return _fail(f"expected {known}; got {arguments[0]!r}; see neatq --help")
    torch.set_num_threads(1)  # small tensors: a second thread only gets in the way
    gc.freeze()  # the garbage collector need not look through torch again and again
    try:
        commands[arguments[0]](arguments[1:])
    except (ConfigError, TaskError, ScenarioError, CheckpointError, GenomeError) as error:
        return _fail(str(error))
    except EpisodeError as error:
        _fail(str(error))
        return 1
    except BrokenPipeError:  # whoever read the output has read enough
        return 0
    except OSError as error:
        return _fail(f"{error.filename or ''}: {error.strerror or error}".lstrip(": "))
    except KeyboardInterrupt as error:
        print(f"neatq: stopped{error}", file=sys.stderr)
        return 130
    return 0


def _fail(message: str) -> int:
    print(f"neatq: error: {message}", file=sys.stderr)
    return 2


def _train(arguments: list[str]) -> None:
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    first.add_argument("--task", default="wall")
    first.add_argument("--arm")
    try:
        chosen, _ = first.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise ConfigError(str(error)) from error
    if chosen.task.startswith(PREFIX):
        _train_gymnasium(arguments, gymnasium_preset(chosen.task, chosen.arm or "neat"))
    else:
        _train_arena(arguments, preset(chosen.task, chosen.arm or "neatq"))


def _train_arena(arguments: list[str], default: RunConfig) -> None:
    command = _parse(TrainCommand, "train", arguments, TrainCommand(config=default))
    config = command.config
    workers = fitting_workers(config.arenas) if command.workers is None else command.workers
    name = f"{config.scenario.name}-{config.arm}-seed{config.seed}"
    out = command.out or Path("runs") / name
    with _saying_how_to_go_on(out):
        _finish(start(config, out, workers=workers))


def _train_gymnasium(arguments: list[str], default: GenerationalConfig) -> None:
    command = _parse(
        TrainGymnasiumCommand, "train", arguments, TrainGymnasiumCommand(config=default)
    )
    config = command.config
    name = re.sub(r"[^\w.-]+", "-", config.environment.id)
    out = command.out or Path("runs") / f"{name}-{config.arm}-seed{config.seed}"
    with _saying_how_to_go_on(out):
        _finish_gymnasium(gymnasium_train.start(config, out, workers=command.workers))


def _resume(arguments: list[str]) -> None:
    command = _parse(ResumeCommand, "resume", arguments)
    folder = command.folder
    with _saying_how_to_go_on(folder):
        if _is_gymnasium(folder):
            _refuse("ticks", command.ticks, "generations")
            _finish_gymnasium(
                gymnasium_train.resume(folder, command.generations, workers=command.workers)
            )
        else:
            _refuse("generations", command.generations, "ticks")
            _refuse("workers", command.workers, "ticks")
            _finish(resume(folder, command.ticks))


def _is_gymnasium(folder: Path) -> bool:
    """Whether a folder holds a run on a Gymnasium task; of a broken one its opener complains."""
    try:
        return json.loads((folder / CONFIG).read_bytes())["task"].startswith(PREFIX)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False


def _refuse(name: str, value: object, instead: str) -> None:
    if value is not None:
        raise ConfigError(f"{name}: this run does not know it; its length is --{instead}")


def _compare(arguments: list[str]) -> None:
    command = _parse(CompareCommand, "compare", arguments)
    with _keeping_what_is_finished():
        compare(command)


def _reproduce(arguments: list[str]) -> None:
    command = _parse(ReproduceCommand, "reproduce", arguments)
    with _keeping_what_is_finished():
        run_command(command)


@contextmanager
def _keeping_what_is_finished() -> Iterator[None]:
    """Add to Ctrl-C that nothing is lost."""
    try:
        yield
    except KeyboardInterrupt as error:
        advice = "; what is finished is kept: the same command goes on"
        raise KeyboardInterrupt(advice) from error


@contextmanager
def _saying_how_to_go_on(out: Path) -> Iterator[None]:
    """Add to what stopped a run what to type to go on with it; it is in folder `out`."""
    try:
        yield
    except (KeyboardInterrupt, EpisodeError) as error:
        begun = (out / CHECKPOINT).is_file()
        advice = f"; go on with: neatq resume {shlex.quote(str(out))}" if begun else ""
        if isinstance(error, EpisodeError):
            raise EpisodeError(f"{error}{advice}") from error
        raise KeyboardInterrupt(advice) from error


def _parse(
    command: type[Command], name: str, arguments: list[str], default: Command | None = None
) -> Command:
    """Parse with tyro; values that a configuration refuses become a ConfigError."""
    name = f"neatq {name}"
    try:
        if default is None:
            return tyro.cli(command, prog=name, args=arguments)
        return tyro.cli(command, prog=name, args=arguments, default=default)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _finish(folder: RunFolder) -> None:
    write_report(folder)
    _say_written(folder, _RESULTS)


def _finish_gymnasium(folder: gymnasium_folder.GenerationalFolder) -> None:
    for missing in gymnasium_report.write_report(folder):
        print(f"neatq: {missing}")
    _say_written(folder, _GYMNASIUM_RESULTS)
    print(f"neatq: {folder.read_result()}")


def _say_written(folder: RunFiles, results: Sequence[str]) -> None:
    written = [name for name in results if (folder.path / name).is_file()]
    print(f"neatq: {folder.path}: {', '.join(written)}")
