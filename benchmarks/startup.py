"""How long `neatq --help` takes, from a new process to its end.

Beside it stands the same Python doing nothing (`python -c pass`), in the same rounds: the
difference is what the command itself costs. `neatq train --help`, which needs torch and all options
of an arm, and `import neatq_torch` only explain. Wall clock; all files were read before.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable

from benchmarks.measure import interleaved
from benchmarks.result import Line, compare, cost_at_most

NOTHING = "python -c pass"
HELP_GOAL = cost_at_most(1.0, "less than a second")
COMMANDS = {
    NOTHING: ["-c", "pass"],
    "neatq --help": ["-m", "neatq_trainers.cli", "--help"],
    "import neatq_torch": ["-c", "import neatq_torch"],
    "neatq train --help": ["-m", "neatq_trainers.cli", "train", "--help"],
}


def run(quick: bool) -> list[Line]:
    """Measure the commands one after the other, round by round."""
    actions = {name: _command(arguments) for name, arguments in COMMANDS.items()}
    rounds = 3 if quick else 9
    samples = interleaved(actions, rounds=rounds, seconds=0.0, clock=time.perf_counter)
    nothing = samples.pop(NOTHING)
    return [
        compare(
            name,
            seconds,
            NOTHING,
            nothing,
            unit="s",
            goal=HELP_GOAL if name == "neatq --help" else None,
        )
        for name, seconds in samples.items()
    ]


def _command(arguments: list[str]) -> Callable[[], object]:
    command = [sys.executable, *arguments]
    return lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
