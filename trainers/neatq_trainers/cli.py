"""The `neatq` command. What a command needs is imported when it is called: help is quick."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

_COMMANDS = {
    "train": ("neatq_trainers.commands", "train_command"),
    "resume": ("neatq_trainers.commands", "resume_command"),
    "export": ("neatq_trainers.export", "export_command"),
    "compare": ("neatq_experiments.command", "compare_command"),
    "reproduce": ("neatq_experiments.command", "reproduce_command"),
    "list": ("neatq_trainers.commands", "list_command"),
}
"""Where the function of each command is."""

_USAGE = """usage: neatq {train,resume,export,compare,reproduce,list} ...

Neuroevolution that learns during life, on robots in an arena, on any Gymnasium task and in worlds
of your own.

  neatq train      train a population and write a run folder   (neatq train --help)
  neatq resume     go on with a run, exactly where it stopped  (neatq resume --help)
  neatq export     write a champion as ONNX, C or Python       (neatq export --help)
  neatq compare    run arms beside each other on tasks         (neatq compare --list)
  neatq reproduce  run a published experiment                  (neatq reproduce list)
  neatq list       say which tasks, arms, populations and learners there are

Examples: neatq train --task wall --arm neatq --ticks 70000 --seed 0 --out runs/first
          neatq train --task gym:CartPole-v1 --arm neat
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status (2 for bad input, 130 after Ctrl-C)."""
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
    command = getattr(importlib.import_module(module), name)
    run_command = importlib.import_module("neatq_trainers.commands").run_command
    return run_command(command, arguments[1:])


if __name__ == "__main__":
    sys.exit(main())
