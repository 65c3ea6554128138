"""Do the tests notice it? Mutants of the learning, of evolution and of the arms' settings.

    python -m benchmarks.mutants --sample 100            # of all rooms, drawn by --seed
    python -m benchmarks.mutants --rooms settings        # every number and switch of every arm

A mutant is the code with one change by Cosmic Ray: another number, a comparison, a sign, a switch.
It is killed if the tests of its room fail, or do not end. Each is tried in a copy of the project,
so that nothing here changes; what numba has compiled here before is compiled there already.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from cosmic_ray import plugins
from cosmic_ray.mutating import mutate_code

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("neatq_torch", "envs", "trainers", "experiments", "tests", "examples", "pyproject.toml")


class Room(NamedTuple):
    """What is changed, and the tests that should notice."""

    files: str
    tests: tuple[str, ...]


_RUNS = ("tests/trainers/test_arms.py", "tests/trainers/test_golden.py")
ROOMS = {
    "settings": Room(
        "trainers/neatq_trainers/arms.py",
        (
            "tests/trainers/test_arms.py",
            "tests/trainers/test_golden.py",
            "tests/trainers/test_command_line.py",
            "tests/trainers/test_gymnasium.py",
        ),
    ),
    "learning": Room("neatq_torch/learning/*.py", ("tests/learning", *_RUNS)),
    "evolution": Room("neatq_torch/evolution/*.py", ("tests/evolution", *_RUNS)),
}
_COMPARED = ("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is")
_COUNTED = ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul")
OPERATORS = (
    "core/NumberReplacer",
    "core/ReplaceTrueWithFalse",
    "core/ReplaceFalseWithTrue",
    "core/ReplaceAndWithOr",
    "core/ReplaceOrWithAnd",
    "core/AddNot",
    "core/ZeroIterationForLoop",
    *(f"core/ReplaceComparisonOperator_{one}" for one in _COMPARED),
    *(f"core/ReplaceBinaryOperator_{one}" for one in _COUNTED),
)


class Mutant(NamedTuple):
    """One change.

    Attributes:
        room: Whose tests should notice it.
        path: The file, from the project's folder.
        operator: What changes it.
        occurrence: Which of the places where it could.
    """

    room: str
    path: str
    operator: str
    occurrence: int


@dataclass(frozen=True, kw_only=True)
class Mutants:
    """Try mutants, and print which the tests do not notice."""

    rooms: tuple[str, ...] = tuple(ROOMS)
    """Which rooms: settings, learning, evolution."""
    sample: int | None = None
    """So many mutants, drawn at random. Default: all."""
    seed: int = 0
    """Of the sample."""
    jobs: int = 2
    """Mutants that are tried at a time."""
    timeout_seconds: float = 600.0
    """Tests that do not end by then have noticed the mutant."""


def mutants_of(room: str) -> Iterator[Mutant]:
    """All mutants of a room."""
    for path in sorted(ROOT.glob(ROOMS[room].files)):
        code = path.read_text()
        for operator in OPERATORS:
            occurrence = 0
            while mutate_code(code, plugins.get_operator(operator)(), occurrence) is not None:
                mutant = Mutant(room, str(path.relative_to(ROOT)), operator, occurrence)
                if ": @" not in changed_line(mutant)[1]:  # decorators change no result
                    yield mutant
                occurrence += 1


def changed_line(mutant: Mutant) -> tuple[str, str, str]:
    """The mutated file, and the first line that differs: as it was, and as it is."""
    code = (ROOT / mutant.path).read_text()
    operator = plugins.get_operator(mutant.operator)()
    mutated = mutate_code(code, operator, mutant.occurrence)
    assert mutated is not None
    pairs = zip(code.splitlines(), mutated.splitlines(), strict=False)
    number, before, after = next(
        (i, a.strip(), b.strip()) for i, (a, b) in enumerate(pairs, 1) if a != b
    )
    return mutated, f"{mutant.path}:{number}: {before}", after


def survives(mutant: Mutant, timeout_seconds: float) -> bool:
    """Whether the tests of its room do not notice a mutant."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "project"
        copy.mkdir()
        for name in PACKAGES:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, copy / name)
            else:
                shutil.copy(ROOT / name, copy / name)
        (copy / mutant.path).write_text(changed_line(mutant)[0])
        paths = ":".join(str(copy / one) for one in ("", "envs", "trainers", "experiments"))
        command = ["env", f"PYTHONPATH={paths}", "OMP_NUM_THREADS=1", sys.executable, "-m"]
        command += ["pytest", "-x", "-q", "-p", "no:cacheprovider", *ROOMS[mutant.room].tests]
        try:
            done = subprocess.run(
                command,
                cwd=copy,
                capture_output=True,
                timeout=timeout_seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return False
        return done.returncode == 0


def main(options: Mutants) -> None:
    """Try mutants; prints the survivors as Markdown."""
    mutants = [mutant for room in options.rooms for mutant in mutants_of(room)]
    total = len(mutants)
    if options.sample is not None:
        rng = np.random.default_rng(options.seed)
        drawn = rng.choice(total, min(options.sample, total), replace=False)
        mutants = [mutants[number] for number in drawn]
    print(f"{len(mutants)} of {total} mutants", flush=True)
    with ThreadPoolExecutor(options.jobs) as pool:
        tried = pool.map(lambda one: survives(one, options.timeout_seconds), mutants)
        survivors = []
        for number, (mutant, alive) in enumerate(zip(mutants, tried, strict=True), 1):
            if alive:
                survivors.append(mutant)
                _, before, after = changed_line(mutant)
                print(f"- `{before}` -> `{after}` ({number} tried)", flush=True)
    killed = len(mutants) - len(survivors)
    print(f"killed: {killed} of {len(mutants)} ({100 * killed / max(1, len(mutants)):.0f} %)")


if __name__ == "__main__":
    main(tyro.cli(Mutants))
