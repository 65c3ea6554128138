"""What the commands of `neatq` do; see `cli`."""

from __future__ import annotations

import argparse
import gc
import io
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
import tyro

from neatq_envs.episodes import EpisodeError
from neatq_envs.gymnasium_task import TaskError, assignments
from neatq_envs.machines import ClusterError
from neatq_envs.processes import ProcessEnded
from neatq_envs.scenario import ScenarioError
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.evolution import population_kinds
from neatq_torch.genome import GenomeError
from neatq_torch.kinds import ARMS_PAGE, WORLDS_PAGE, ConfigError
from neatq_torch.learning import learner_kinds
from neatq_trainers import arms
from neatq_trainers import train as trainer
from neatq_trainers.config import LENGTHS, RunConfig
from neatq_trainers.effects import refuse_without_effect
from neatq_trainers.folder import CHECKPOINT, FILES, RunFolder, load_run
from neatq_trainers.live.command import opened, window_options
from neatq_trainers.nero.nero_world import NERO
from neatq_trainers.options import chosen_names, options_of, refuse_strangers, with_options
from neatq_trainers.signals import Terminated
from neatq_trainers.worlds import env_kinds

Command = TypeVar("Command")
_STOPS = (KeyboardInterrupt, Terminated, EpisodeError, ProcessEnded, MemoryError, OSError)
"""What stops a run that can go on."""
TASK_LINES = {
    "flag": "robots run to a flag in an open field",
    "moving": "the same, and the flag moves now and then",
    "wall": "a wall stands between robots and flag",
    "trap": "robots must first get out of a pocket",
    "maze": "the hard maze of Lehman & Stanley (2011)",
    "switch": "two flags, of which one counts, and not always the same",
    "behind": "the same two flags behind a wall",
    NERO: "teams that shoot: train one against turrets or a team (neatq battle lets two fight)",
    "FILE.json": "an arena of your own",
    "gym:ID": "any Gymnasium environment, such as gym:CartPole-v1 or gym:my_module:Mine-v0",
}
"""What `neatq list` says of tasks."""


def run_command(command: Callable[[list[str]], None], arguments: list[str]) -> int:
    """Run a command; returns the exit status of the process."""
    try:
        torch.set_num_threads(1)  # small tensors: a second thread only gets in the way
        gc.freeze()  # the garbage collector need not look through torch again and again
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # a terminal that knows no ± gets a ?
        command(arguments)
    except BaseException as error:
        return _status(error)
    return 0


def _status(error: BaseException, advice: str = "") -> int:
    """Say in a line what ended a command; returns the exit status."""
    match error:
        case RunStopped(cause=cause, advice=advice):
            return _status(cause, advice)
        case ConfigError() | TaskError() | ScenarioError() | CheckpointError() | GenomeError():
            return _fail(str(error))
        case ClusterError():
            return _fail(str(error))
        case EpisodeError() | ProcessEnded():
            return _fail(f"{error}{advice}")
        case MemoryError():
            return _fail(f"out of memory; try fewer --workers or --arenas{advice}")
        case BrokenPipeError():  # whoever read the output has read enough
            return 0
        case OSError():
            where = f"{error.filename}: " if error.filename else ""
            return _fail(f"{where}{error.strerror or error}{advice}")
        case KeyboardInterrupt():
            print(f"neatq: stopped{error}{advice}", file=sys.stderr)
            return 130
        case Terminated(code=status):
            print(f"neatq: stopped{advice}", file=sys.stderr)
            return int(status or 0)
    raise error


def _fail(message: str) -> int:
    with suppress(OSError):  # the working directory may be gone
        message = message.replace(f"{Path.cwd()}{os.sep}", "")
    print(f"neatq: error: {message}", file=sys.stderr)
    return 2


def train_command(arguments: list[str], window: argparse.Namespace | None = None) -> None:
    """`neatq train`, with the options of a window through which somebody looks."""
    if "--live" in arguments:
        window, arguments = window_options([one for one in arguments if one != "--live"])
    here = Path.cwd()  # an environment may go elsewhere
    chosen, rest = _chosen(arguments)
    given = chosen_names(rest)
    default = arms.preset(
        chosen.task,
        chosen.arm,
        env_kwargs=assignments(chosen.env_kwargs) | _of_nero(chosen),
        population=chosen.population,
        learner=chosen.learner,
        length={unit: 1 for unit in LENGTHS if unit in given},
    )
    refuse_strangers(default, given)
    options = parse(options_of(default, given), "train", rest)
    config = _with_islands(with_options(default, options), chosen)
    refuse_without_effect(config, given)
    folder = trainer.default_folder(config) if options.out is None else options.out
    with _saying_how_to_go_on(folder, here, "resume" if window is None else "play"):
        with opened(window, options.workers) as (workers, callbacks):
            how: Any = {"changes": chosen.changes, "callbacks": callbacks}
            how["cluster"] = options.cluster
            run = trainer.start(config, here / folder, workers=workers, **how)
        _say(run, folder)


def _chosen(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """What chooses the defaults of all other options, and the rest."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    first.add_argument("--task", default="wall")
    first.add_argument("--arm", default="neatq")
    first.add_argument("--population")
    first.add_argument("--learner")
    first.add_argument("--env-kwargs", "--env_kwargs", nargs="*", action="extend", default=[])
    first.add_argument("--reward", nargs="*", action="extend")
    first.add_argument("--enemy")
    first.add_argument("--field")
    first.add_argument("--against", nargs="+", action="extend")
    first.add_argument("--changes", type=Path)
    first.add_argument("--held-out", "--held_out", nargs="+", action="extend")
    first.add_argument("--islands", type=int)
    first.add_argument("--migrate-every", type=int)
    first.add_argument("--migrate-to")
    first.add_argument("--emigrants", type=int)
    first.add_argument("--emigrants-are")
    try:
        return first.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise ConfigError(str(error).removeprefix("argument ")) from error


def _with_islands(config: RunConfig, chosen: argparse.Namespace) -> RunConfig:
    """The run, with what is said of arenas that exchange genomes.

    Raises:
        ConfigError: If something is said of them, and there are none.
    """
    names = {"migrate_every": "every_ticks", "migrate_to": "topology", "emigrants": "emigrants"}
    names["emigrants_are"] = "chosen"
    own = {to: getattr(chosen, name) for name, to in names.items()}
    own = {name: value for name, value in own.items() if value is not None}
    if chosen.islands is None:
        if own:
            raise ConfigError("islands: expected a number; the other options are about islands")
        return config
    if config.arenas != 1:
        raise ConfigError("arenas: leave it out; --islands says how many there are")
    return config.changed({"arenas": chosen.islands, "migration": own})


def _of_nero(chosen: argparse.Namespace) -> dict[str, Any]:
    """What the options of --task nero say, as keys of its world.

    Raises:
        ConfigError: If the task is another one, or a weight is none.
    """
    names = ("reward", "enemy", "field", "against", "held_out")
    given = {name: getattr(chosen, name) for name in names}
    given = {name: value for name, value in given.items() if value is not None}
    asked = [f"--{name.replace('_', '-')}" for name in given]
    if asked and chosen.task != NERO:
        raise ConfigError(f"{asked[0]}: it is for --task {NERO}; the task is {chosen.task}")
    if "reward" in given:
        given["reward_weights"] = assignments(given.pop("reward"))
    return given


@dataclass(frozen=True, kw_only=True)
class ResumeCommand:
    """Go on with a run, exactly where it stopped."""

    folder: tyro.conf.Positional[Path]
    """The run folder."""
    ticks: int | None = None
    """Another length for a run in a world of robots; may be longer than first asked."""
    steps: int | None = None
    """Another length for a run on a Gymnasium task."""
    generations: int | None = None
    """Another length for a run on a Gymnasium task."""
    until: float | None = None
    """Another return of the champion that ends a run on a Gymnasium task; without it the run's own
    counts on, but a run that has reached its own goes on, without one, to another length."""
    workers: int | None = None
    """Processes; default: those that fit the machines. Arenas stay in as many parts as the run was
    begun with, and no more processes than that have work."""
    cluster: str | None = None
    """A Ray cluster on which these live: auto, ray://HOST:10001, or local, which begins one."""


def resume_command(arguments: list[str], window: argparse.Namespace | None = None) -> None:
    """`neatq resume`, with the options of a window through which somebody looks."""
    command = parse(ResumeCommand, "resume", arguments)
    end: Any = {name: getattr(command, name) for name in (*LENGTHS, "until")}
    again = "resume" if window is None else "play"
    with _saying_how_to_go_on(command.folder, Path.cwd(), again):
        if window is not None:
            load_run(command.folder)  # before a page opens
        with opened(window, command.workers) as (workers, callbacks):
            how: Any = {"workers": workers, "cluster": command.cluster}
            run = trainer.resume(command.folder, **end, **how, callbacks=callbacks)
        _say(run, command.folder)


def list_command(arguments: list[str]) -> None:
    """`neatq list`."""
    if arguments:
        raise ConfigError(f"list: expected no arguments, got {' '.join(arguments)}")
    own = {name: make.__doc__ or "a world of your own" for name, make in env_kinds.items()}
    tables = {"tasks": TASK_LINES | own}
    tables["arms"] = {name: arm.summary for name, arm in arms.ARMS.items()}
    tables["anchors, for neatq compare alone"] = arms.ANCHORS
    for title, kinds in (("populations", population_kinds), ("learners", learner_kinds)):
        tables[title] = {name: kinds.config(name).__doc__ or "" for name in kinds}
    for title, table in tables.items():
        print(f"{title} ({WORLDS_PAGE if title == 'tasks' else ARMS_PAGE}):")
        for name, says in table.items():
            print(f"  {name:10}  {says.partition(chr(10))[0]}")


class RunStopped(Exception):
    """Something stopped a run, with what to type to go on with it."""

    def __init__(self, cause: BaseException, advice: str) -> None:
        self.cause, self.advice = cause, advice


@contextmanager
def _saying_how_to_go_on(out: Path, here: Path, command: str) -> Iterator[None]:
    """Add to what stopped a run in folder `out` with which `command` to go on from `here`."""
    try:
        yield
    except _STOPS as error:
        begun = (here / out / CHECKPOINT).is_file()
        advice = f"; go on with: neatq {command} {shlex.quote(str(out))}" if begun else ""
        raise RunStopped(error, advice) from error


def parse(command: type[Command], name: str, arguments: Sequence[str]) -> Command:
    """Parse with tyro; values that a configuration refuses become a ConfigError."""
    try:
        return tyro.cli(command, prog=f"neatq {name}", args=arguments)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _say(folder: RunFolder, name: Path) -> None:
    """Say what was written, and what is to be said of it; the user calls the folder `name`."""
    written = [one for one in FILES if (folder.path / one).is_file()]
    print(f"neatq: {name}: {', '.join(written)}")
    for note in folder.notes:
        print(f"neatq: {note}")
