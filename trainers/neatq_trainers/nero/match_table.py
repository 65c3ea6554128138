"""The table of matches: a row for each, on disk as soon as it is over."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, NamedTuple

from neatq_torch.atomic import write_atomic
from neatq_trainers.lock import RunFolderError
from neatq_trainers.nero.schedule import Pairing

MATCHES = "matches.csv"
WINNERS = ("blue", "red", "draw")


class MatchRow(NamedTuple):
    """A row of `matches.csv`.

    Attributes:
        blue: Name of the blue team: its file without folder.
        red: Name of the red team.
        seed: Of everything that was drawn in the match.
        damage_blue: Hit points that blue lost; the team that lost fewer wins.
        damage_red: Hit points that red lost.
        ticks: How long it lasted.
        winner: "blue", "red" or "draw".
    """

    blue: str
    red: str
    seed: int
    damage_blue: int
    damage_red: int
    ticks: int
    winner: str

    @property
    def pairing(self) -> Pairing:
        """Which match it was."""
        return Pairing(blue=self.blue, red=self.red, seed=self.seed)

    def score(self, team: str) -> int:
        """Damage that one of the two teams inflicted less the damage that it took, hit points."""
        score = self.damage_red - self.damage_blue
        return score if team == self.blue else -score

    def won(self, team: str) -> float:
        """1 if one of the two teams won, 0.5 after a draw, else 0."""
        if self.winner == "draw":
            return 0.5
        return float((self.winner == "blue") == (team == self.blue))


def write_matches(path: Path, rows: Iterable[MatchRow]) -> None:
    """Write a table, whole or not at all; OSError if that cannot be."""
    write_atomic(path, csv_text([MatchRow._fields, *rows]))


def add_match(file: IO[bytes], row: MatchRow) -> None:
    """Add a row to a table that is open for adding to it.

    Raises:
        OSError: If it cannot be written; its `filename` is the file's.
    """
    try:
        file.write(csv_text([row]).encode())
        file.flush()
    except OSError as error:
        error.filename = file.name  # a full disk does not say which file
        raise


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Rows as lines of CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def read_matches(path: Path) -> list[MatchRow]:
    """The rows of a table; half of a row at its end, left by a kill, is left out.

    Raises:
        RunFolderError: If it is no table of matches, or damaged.
        OSError: If it cannot be read.
    """
    try:
        text = path.read_bytes().decode()
    except UnicodeDecodeError as error:
        raise RunFolderError(f"{path}: expected a table of matches, got {error}") from error
    whole = text[: text.rfind("\n") + 1]  # no cell has a line break in it
    return list(_parsed_rows(path, csv.reader(whole.splitlines())))


def _parsed_rows(path: Path, lines: Iterator[list[str]]) -> Iterator[MatchRow]:
    header = next(lines, [])
    if header != [*MatchRow._fields]:
        expected = ",".join(MatchRow._fields)
        raise RunFolderError(f"{path}: expected the columns {expected}; got {','.join(header)}")
    for number, cells in enumerate(lines, 2):
        try:
            blue, red, *counts, winner = cells
            seed, damage_blue, damage_red, ticks = map(int, counts)
            WINNERS.index(winner)
        except ValueError as error:
            raise RunFolderError(
                f"{path}: line {number} is damaged ({error}); delete the line, and its match is "
                "played again"
            ) from error
        yield MatchRow(blue, red, seed, damage_blue, damage_red, ticks, winner)
