"""The two tables of a comparison, from which everything else can be made again.

`results.csv` has a row for each task, arm, seed and every 500 ticks; `seeds.csv` has a row for
each task, arm and seed. Both may be compressed (`.csv.gz`).
"""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from neatq_experiments.compare.statistics import mean_of_known
from neatq_torch.atomic import write_atomic
from neatq_trainers.folder import RunFolderError
from neatq_trainers.rows import ROW_TICKS

RESULTS, SEEDS = "results.csv", "seeds.csv"
POINT_ROWS = 5
"""Rows of metrics in one row of `results.csv`."""
POINT_TICKS = POINT_ROWS * ROW_TICKS


PointRow = TypeVar("PointRow", bound=tuple[Any, ...])
SeedRow = TypeVar("SeedRow", bound=tuple[Any, ...])
TableRow = TypeVar("TableRow", bound=tuple[Any, ...])


class Point(NamedTuple):
    """A row of `results.csv`: means over the 500 ticks up to `tick`, from a row every 100 ticks.

    Distances are to the flag, in units. None is an empty cell: an arm without evolution has
    neither eligible robots nor newborns nor a champion.

    Attributes:
        task: Where it ran.
        arm: What ran.
        seed: Of worlds and genomes.
        tick: The last of the 500.
        team: Mean distance of all robots.
        eligible: Of the robots that are old enough to be judged.
        newborn: Of the others.
        champion: Of the fittest.
        nearest: Of the robot that is nearest at the time.
        births: Births since the beginning of the run.
    """

    task: str
    arm: str
    seed: int
    tick: int
    team: float
    eligible: float | None
    newborn: float | None
    champion: float | None
    nearest: float
    births: int


class SeedOutcome(NamedTuple):
    """A row of `seeds.csv`.

    Attributes:
        task: Where it ran.
        arm: What ran.
        seed: Of worlds and genomes.
        ticks: Length of the run.
        first_contact: Tick; see `cells.first_contact`. None: never.
        stable_contact: Tick; see `cells.stable_contact`. None: never.
        champion_reaches: 1 if the champion gets to the flag in the last tenth, else 0.
        cpu_seconds: CPU seconds of 1,000 ticks, a share of those of the arenas side by side. None
            if it was not measured.
        digest: Of the configuration; see `cells.digest`.
    """

    task: str
    arm: str
    seed: int
    ticks: int
    first_contact: int | None
    stable_contact: int | None
    champion_reaches: int
    cpu_seconds: float | None
    digest: str


class Curves(NamedTuple):
    """One column of one arm on one task.

    Attributes:
        seeds: [seeds].
        ticks: [rows].
        values: [seeds, rows]; NaN is an empty cell.
    """

    seeds: NDArray[np.int64]
    ticks: NDArray[np.int64]
    values: NDArray[np.float64]

    def last_tenth(self) -> NDArray[np.float64]:
        """Mean of each seed over the last tenth of the run [seeds]; NaN where it is empty."""
        return mean_of_known(self.values[:, self.ticks > 0.9 * self.ticks[-1]], axis=1)


@dataclass(frozen=True, kw_only=True)
class Tables:
    """Two tables whose rows have a `task` and an `arm`: in the one many of a run, else one.

    Attributes:
        points: What happened during runs.
        outcomes: What runs came to.
    """

    points: tuple[Any, ...]
    outcomes: tuple[Any, ...]

    @property
    def tasks(self) -> list[str]:
        """The tasks, in the order of the table."""
        return list(dict.fromkeys(one.task for one in self.outcomes))

    def arms(self, task: str | None = None) -> list[str]:
        """The arms of a task, or of all tasks, in the order of the table."""
        rows = (one for one in self.outcomes if task in (None, one.task))
        return list(dict.fromkeys(one.arm for one in rows))

    def outcomes_of(self, task: str, arm: str) -> list[Any]:
        """The rows of one arm on one task."""
        return [one for one in self.outcomes if (one.task, one.arm) == (task, arm)]

    def only(self, tasks: Sequence[str] | None, arms: Sequence[str] | None) -> Self:
        """The rows of some tasks and arms; None: of all.

        Raises:
            RunFolderError: If one of them is not in the tables.
        """
        for name, asked, known in (("tasks", tasks, self.tasks), ("arms", arms, self.arms())):
            for one in asked or ():
                if one not in known:
                    raise RunFolderError(f"{name}: the tables hold {', '.join(known)}; got {one!r}")
        pairs = {(task, arm) for task in tasks or self.tasks for arm in arms or self.arms()}
        return replace(
            self,
            points=tuple(one for one in self.points if (one.task, one.arm) in pairs),
            outcomes=tuple(one for one in self.outcomes if (one.task, one.arm) in pairs),
        )


@dataclass(frozen=True, kw_only=True)
class Study(Tables):
    """What a comparison found in the arena.

    Attributes:
        points: The rows of `results.csv`.
        outcomes: The rows of `seeds.csv`.
    """

    points: tuple[Point, ...]
    outcomes: tuple[SeedOutcome, ...]

    def curves(self, task: str, arm: str, column: str) -> Curves:
        """One column of one arm on one task."""
        points = self._points[task, arm]
        seeds, row = np.unique([point.seed for point in points], return_inverse=True)
        ticks, at = np.unique([point.tick for point in points], return_inverse=True)
        values = np.full((seeds.size, ticks.size), np.nan)
        values[row, at] = [getattr(point, column) for point in points]
        return Curves(seeds, ticks, values)

    @cached_property
    def _points(self) -> dict[tuple[str, str], list[Point]]:
        points: dict[tuple[str, str], list[Point]] = {}
        for point in self.points:
            points.setdefault((point.task, point.arm), []).append(point)
        return points


def write_tables(study: Study, folder: Path, *, compress: bool = False) -> None:
    """Write both tables.

    Args:
        study: What to write.
        folder: Where; it is made if it is not there.
        compress: Whether as `.csv.gz`; the same tables give the same bytes each time.
    """
    write_table(folder, RESULTS, Point, study.points, compress=compress)
    write_table(folder, SEEDS, SeedOutcome, study.outcomes, compress=compress)


def write_table(
    folder: Path, name: str, kind: Any, rows: Sequence[NamedTuple], *, compress: bool
) -> None:
    """Write rows of a kind of named tuple; see `write_tables`."""
    folder.mkdir(parents=True, exist_ok=True)
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(kind._fields)
    writer.writerows([_written(value) for value in row] for row in rows)
    content = text.getvalue().encode()
    plain, packed = folder / name, folder / f"{name}.gz"
    new, old = (packed, plain) if compress else (plain, packed)
    write_atomic(new, gzip.compress(content, mtime=0) if compress else content)
    old.unlink(missing_ok=True)  # it would be read


def holds(folder: Path, name: str) -> bool:
    """Whether a table is in a folder, compressed or not."""
    return any((folder / one).is_file() for one in (name, f"{name}.gz"))


def read_tables(folder: Path) -> Study:
    """Read what `write_tables` wrote, compressed or not.

    Raises:
        RunFolderError: If a table is missing, damaged or has other columns.
    """
    points, outcomes = read_pair(folder, (RESULTS, Point), (SEEDS, SeedOutcome))
    return Study(points=tuple(points), outcomes=tuple(outcomes))


def read_pair(
    folder: Path, first: tuple[str, type[PointRow]], second: tuple[str, type[SeedRow]]
) -> tuple[list[PointRow], list[SeedRow]]:
    """Read two tables, each with its name and rows, that must hold the same runs.

    Raises:
        RunFolderError: If a table is missing, damaged or has other columns.
    """
    points, outcomes = _read_table(folder, *first), _read_table(folder, *second)
    runs = [{one[:3] for one in rows} for rows in (points, outcomes)]  # task, arm, seed
    if runs[0] != runs[1] or not runs[0]:
        raise RunFolderError(
            f"{folder}: {first[0]} and {second[0]} do not hold the same runs ({len(runs[0])} and "
            f"{len(runs[1])}); take both from the same comparison"
        )
    return points, outcomes


def _read_table(folder: Path, name: str, kind: type[TableRow]) -> list[TableRow]:
    path = folder / name
    path = path if path.is_file() else folder / f"{name}.gz"
    try:
        content = path.read_bytes()
        text = (gzip.decompress(content) if path.suffix == ".gz" else content).decode()
    except FileNotFoundError as error:
        raise RunFolderError(
            f"{folder}: expected {name} or {name}.gz, as neatq compare writes them; found neither"
        ) from error
    except (EOFError, gzip.BadGzipFile, UnicodeDecodeError) as error:
        raise RunFolderError(f"{path}: damaged ({error}); take another copy") from error
    return list(_parsed(path, text, kind))


def _parsed(path: Path, text: str, kind: type[TableRow]) -> Iterable[TableRow]:
    lines = csv.reader(io.StringIO(text, newline=""))
    header = next(lines, [])
    types = get_type_hints(kind)
    later: Any = getattr(kind, "_field_defaults", {})  # columns that older tables lack
    if header not in ([*types], [name for name in types if name not in later]):
        raise RunFolderError(
            f"{path}: expected the columns {','.join(types)}; got {','.join(header)}"
        )
    types = {name: types[name] for name in header}
    for number, line in enumerate(lines, 2):
        try:
            yield kind(*(_value(cell, of) for cell, of in zip(line, types.values(), strict=True)))
        except ValueError as error:
            raise RunFolderError(f"{path}, line {number}: {error}") from error


def _value(cell: str, of: Any) -> Any:
    """A cell as a value of a type: str, int, float, or one of the latter or None."""
    if of is str:
        return cell
    if not cell and of not in (int, float):
        return None
    return int(cell) if of in (int, int | None) else float(cell)


def _written(value: str | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
