"""The `neatq` command. What a command needs is imported when it is called: help is quick."""

from __future__ import annotations

import importlib
import os
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from neatq_trainers.signals import handling, is_main_thread

_COMMANDS = {
    "train": ("neatq_trainers.commands", "train_command"),
    "resume": ("neatq_trainers.commands", "resume_command"),
    "play": ("neatq_trainers.live.command", "play_command"),
    "export": ("neatq_trainers.export", "export_command"),
    "compare": ("neatq_experiments.command", "compare_command"),
    "reproduce": ("neatq_experiments.command", "reproduce_command"),
    "battle": ("neatq_trainers.nero.commands", "battle_command"),
    "tournament": ("neatq_trainers.nero.commands", "tournament_command"),
    "list": ("neatq_trainers.commands", "list_command"),
    "info": ("neatq_trainers.info", "info_command"),
}
"""Where the function of each command is."""

_USAGE = """usage: neatq COMMAND ...

Neuroevolution that learns during life, on robots in an arena, on any Gymnasium task and in worlds
of your own.

  neatq train       train a population and write a run folder   (neatq train --help)
  neatq resume      go on with a run, exactly where it stopped  (neatq resume --help)
  neatq play        watch and steer a run in the browser        (neatq play --help)
  neatq export      write a champion as ONNX, C or Python       (neatq export --help)
  neatq compare     run arms beside each other on tasks         (neatq compare --list)
  neatq reproduce   run a published experiment                  (neatq reproduce list)
  neatq battle      let two teams of NERO fight                 (neatq battle --help)
  neatq tournament  let teams of NERO all fight each other      (neatq tournament --help)
  neatq list        say which tasks, arms, populations and learners there are
  neatq info        say which versions run on which machine, for reports of faults

Examples: neatq train --task wall --arm neatq --ticks 70000 --seed 0 --out runs/first
          neatq train --task gym:CartPole-v1 --arm neat
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 2 for bad input, 130 after Ctrl-C."""
    _open_standard_streams()
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_USAGE, end="")
        return 0 if arguments else 2
    if arguments[0] not in _COMMANDS:
        known = ", ".join(_COMMANDS)
        print(
            f"neatq: error: expected one of {known}; got {arguments[0]!r}; see neatq --help",
            file=sys.stderr,
        )
        return 2
    module, name = _COMMANDS[arguments[0]]
    with _stopping_at_once(arguments):
        command = getattr(importlib.import_module(module), name)
        run_command = importlib.import_module("neatq_trainers.commands").run_command
    return run_command(command, arguments[1:])


def _open_standard_streams() -> None:
    """Where a daemon or pythonw has closed stdin, stdout or stderr, let them lead nowhere.

    Else the next file that is opened gets the number of stderr, and what libraries write there.
    """
    while (opened := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(opened)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115


@contextmanager
def _stopping_at_once(arguments: Sequence[str]) -> Iterator[None]:
    """Ctrl-C ends the process with a line: imports would turn it into errors of their own."""

    def stop(*_: object) -> None:
        again = shlex.join(["neatq", *arguments])
        print(f"neatq: stopped before it began; begin with: {again}", file=sys.stderr, flush=True)
        os._exit(130)

    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with handling([signal.SIGINT] if ours and is_main_thread() else [], stop):
        yield


if __name__ == "__main__":
    sys.exit(main())
