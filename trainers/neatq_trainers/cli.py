"""The `neatq` command."""

from __future__ import annotations

import argparse
import gc
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import torch
import tyro

from neatq_envs.scenario import ScenarioError
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.genome import GenomeError
from neatq_trainers.config import ConfigError, RunConfig, preset
from neatq_trainers.report import write_report
from neatq_trainers.reproduce.command import ReproduceCommand, run_command
from neatq_trainers.run_folder import (
    ANIMATION,
    ARENA,
    CHAMPION,
    CHECKPOINT,
    CURVES,
    METRICS,
    RunFolder,
)
from neatq_trainers.train import resume, start
from neatq_trainers.workers import fitting_workers

Command = TypeVar("Command")

_RESULTS = (METRICS, CURVES, ARENA, ANIMATION, CHAMPION)

_USAGE = """usage: neatq {train,resume,reproduce} ...

Neuroevolution that learns during life: robots, a flag, rtNEAT and Q-learning.

  neatq train      train a population and write a run folder   (neatq train --help)
  neatq resume     go on with a run, exactly where it stopped  (neatq resume --help)
  neatq reproduce  run a published experiment                  (neatq reproduce list)

Example: neatq train --task wall --arm neatq --ticks 70000 --seed 0 --out runs/first
"""


@dataclass(frozen=True, kw_only=True)
class TrainCommand:
    """Train a population and write a run folder.

    --task and --arm choose the defaults of all other options, which this help shows.
    """

    config: Annotated[RunConfig, tyro.conf.arg(name="")]
    out: Path | None = None
    """The run folder; new or empty. Default: runs/TASK-ARM-seedSEED."""
    workers: int | None = None
    """Processes among which the arenas are dealt; the results do not depend on it. Default: one
    for each core, but at least four arenas each."""


@dataclass(frozen=True, kw_only=True)
class ResumeCommand:
    """Go on with a run, exactly where it stopped."""

    folder: tyro.conf.Positional[Path]
    """The run folder."""
    ticks: int | None = None
    """Another length for the run; may be longer than first asked."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status (2 for bad input, 130 after Ctrl-C)."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    commands = {"train": _train, "resume": _resume, "reproduce": _reproduce}
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_USAGE, end="")
        return 0 if arguments else 2
    if arguments[0] not in commands:
        return _fail(f"expected train, resume or reproduce; got {arguments[0]!r}; see neatq --help")
    torch.set_num_threads(1)  # small tensors: a second thread only gets in the way
    gc.freeze()  # the garbage collector need not look through torch again and again
    try:
        commands[arguments[0]](arguments[1:])
    except (ConfigError, ScenarioError, CheckpointError, GenomeError) as error:
        return _fail(str(error))
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
    first.add_argument("--arm", default="neatq")
    try:
        chosen, _ = first.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise ConfigError(str(error)) from error
    default = TrainCommand(config=preset(chosen.task, chosen.arm))
    command = _parse(TrainCommand, "train", arguments, default)
    config = command.config
    workers = fitting_workers(config.arenas) if command.workers is None else command.workers
    name = f"{config.scenario.name}-{config.arm}-seed{config.seed}"
    out = command.out or Path("runs") / name
    with _saying_how_to_go_on(out):
        _finish(start(config, out, workers=workers))


def _resume(arguments: list[str]) -> None:
    command = _parse(ResumeCommand, "resume", arguments)
    with _saying_how_to_go_on(command.folder):
        _finish(resume(command.folder, command.ticks))


def _reproduce(arguments: list[str]) -> None:
    command = _parse(ReproduceCommand, "reproduce", arguments)
    try:
        run_command(command)
    except KeyboardInterrupt as error:
        advice = "; what is finished is kept: the same command goes on"
        raise KeyboardInterrupt(advice) from error


@contextmanager
def _saying_how_to_go_on(out: Path) -> Iterator[None]:
    """Add to a KeyboardInterrupt what to type to go on with the run in folder `out`."""
    try:
        yield
    except KeyboardInterrupt as error:
        begun = (out / CHECKPOINT).is_file()
        advice = f"; go on with: neatq resume {shlex.quote(str(out))}" if begun else ""
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
    written = [name for name in _RESULTS if (folder.path / name).is_file()]
    print(f"neatq: {folder.path}: {', '.join(written)}")
