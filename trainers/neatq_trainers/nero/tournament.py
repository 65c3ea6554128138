"""Matches on all cores: each is in the table as soon as it is over, and is played once."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from neatq_envs.machines import open_machines
from neatq_envs.pool import performed
from neatq_envs.processes import usable_cores
from neatq_torch.atomic import leftovers, write_atomic
from neatq_torch.json_text import parse_json
from neatq_torch.kinds import ConfigError
from neatq_trainers.lock import HOLDER, LOCK, RunFolderError, locked
from neatq_trainers.nero.match import BattleRules, MatchResult, play
from neatq_trainers.nero.match_table import (
    MATCHES,
    MatchRow,
    add_match,
    read_matches,
    write_matches,
)
from neatq_trainers.nero.schedule import Pairing, check_teams, schedule
from neatq_trainers.nero.teams import Team
from neatq_trainers.signals import ending_by_signals

RULES = "rules.json"
TableSettings = dict[str, Any]
"""What rows of one table have in common: `rules`, and a digest of each of the `teams`."""
Playing = Callable[[Sequence[Pairing]], Generator[MatchRow]]
"""Plays matches, and gives the row of each as soon as it is over."""


@dataclass(frozen=True, kw_only=True)
class Hall:
    """Where matches are played; it is sent to other processes.

    Attributes:
        teams: By name.
        rules: Of all matches.
        play: Plays one.
    """

    teams: dict[str, Team]
    rules: BattleRules
    play: Callable[..., MatchResult] = play

    def row(self, pairing: Pairing) -> MatchRow:
        """Play a match."""
        blue, red = self.teams[pairing.blue], self.teams[pairing.red]
        result = self.play(blue, red, seed=pairing.seed, rules=self.rules)
        return MatchRow(
            blue=pairing.blue,
            red=pairing.red,
            seed=pairing.seed,
            damage_blue=result.damage_blue,
            damage_red=result.damage_red,
            ticks=result.ticks,
            winner=result.winner,
        )


def play_tournament(
    teams: Sequence[Team],
    *,
    matches: int = 2,
    seed: int = 0,
    rules: BattleRules | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    out: Path | str | None = None,
    play: Callable[..., MatchResult] = play,
) -> list[MatchRow]:
    """Let every team play against every other one; two teams make a battle.

    Called from a script with more than one job it must stand below `if __name__ == "__main__":`,
    as other processes import the script.

    Args:
        teams: At least two, with different names and the same sensors.
        matches: Of one team against another, half of them in each colour.
        seed: Of the first match of two teams and of its return match; the next have the next.
        rules: Default: those of the tournament of 2011.
        jobs: Processes; the results do not depend on it. Default: one for each core.
        cluster: A Ray cluster on which these live, see `open_machines`.
        out: A folder for `matches.csv` and `rules.json`, new, empty, or one in which a tournament
            of the same rules goes on or grows: its matches are not played again. None: nothing
            is written.
        play: Plays a match, as `match.play`; other processes must be able to import it.

    Returns:
        A row for each match, in the order of `schedule`.

    Raises:
        ConfigError: If the teams cannot meet, or the folder is for something else.
        ProcessEnded: If three processes end with one match; the same call goes on, as after Ctrl-C.

    Example:
        >>> teams = [read_team(path) for path in Path("teams").glob("*.gz")]
        >>> print(standings_text(standings(play_tournament(teams, out="runs/cup"))))
    """
    check_teams(teams)
    if jobs is not None and jobs < 1:
        raise ConfigError(f"jobs: expected at least 1, got {jobs}")
    rules = BattleRules() if rules is None else rules
    pairings = schedule([team.name for team in teams], matches, seed)
    settings = table_settings(teams, rules)
    hall = Hall(teams={team.name: team for team in teams}, rules=rules, play=play)
    rows_of = partial(_rows_of, hall, jobs, cluster)
    if out is None:
        rows: list[MatchRow] = []
        _play_missing(rows_of, pairings, 0, rows.append)
        return _in_order(rows, pairings)
    with _folder(Path(out)) as folder, ending_by_signals():
        return _play_in(folder, rows_of, pairings, settings)


def _play_in(
    folder: Path, rows_of: Playing, pairings: Sequence[Pairing], settings: TableSettings
) -> list[MatchRow]:
    """Play what is missing of the table in a folder."""
    path = folder / MATCHES
    rows = _begun_table(folder, pairings, settings)
    known = {row.pairing for row in rows}
    missing = [one for one in pairings if one not in known]
    with path.open("ab") as file:

        def keep(row: MatchRow) -> None:
            add_match(file, row)
            rows.append(row)

        _play_missing(rows_of, missing, len(known), keep)
    rows = _in_order(rows, pairings)
    write_matches(path, rows)
    return rows


def _in_order(rows: Sequence[MatchRow], pairings: Sequence[Pairing]) -> list[MatchRow]:
    """Rows as the schedule has them, whichever match was over first."""
    by_pairing = {row.pairing: row for row in rows}
    return [by_pairing[pairing] for pairing in pairings]


def table_settings(teams: Sequence[Team], rules: BattleRules) -> TableSettings:
    """What a table must have been made with, so that rows can be added to it.

    Raises:
        ScenarioError: If there is no such field, or it cannot be.
    """
    field = rules.scenario(teams[0].sensors).to_dict()
    return {
        "rules": {"ticks": rules.ticks} | field,
        "teams": {team.name: team_digest(team) for team in teams},
    }


def team_digest(team: Team) -> str:
    """Twelve digits of the SHA-256 of all of a team that counts in a match: not its name."""
    parts = [team.sensors, team.evaluation, str(team.candidates), repr(team.bias)]
    parts += [genome.to_json() for genome in team.genomes]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


@contextmanager
def _folder(path: Path) -> Iterator[Path]:
    """A folder that is for tournaments, for this process alone."""
    if path.exists() and not path.is_dir():
        raise RunFolderError(f"{path}: expected a folder, got a file; choose another --out")
    if path.is_dir() and not (path / RULES).is_file() and _in_use(path):
        raise RunFolderError(
            f"{path}: expected a new or empty folder, or one of a tournament ({RULES}); choose "
            "another --out"
        )
    path.mkdir(parents=True, exist_ok=True)
    with locked(path):
        yield path


def _in_use(path: Path) -> bool:
    """Whether there is anything in a folder that a tournament does not leave before it begins."""
    early = {LOCK, HOLDER, *(one.name for one in leftovers(path, (RULES, MATCHES)))}
    return any(one.name not in early for one in path.iterdir())


def _begun_table(
    folder: Path, pairings: Sequence[Pairing], settings: TableSettings
) -> list[MatchRow]:
    """The matches that are over; a table without half rows, and the settings, are in the folder.

    Raises:
        RunFolderError: If the table was made with other settings, or has rows of other matches.
    """
    path, rows = folder / MATCHES, []
    if (folder / RULES).is_file():
        _refuse_other_settings(folder / RULES, settings)
        rows = read_matches(path) if path.is_file() else []
        strange = {row.pairing for row in rows}.difference(pairings)
        for one in sorted(strange, key=str)[:1]:
            raise RunFolderError(
                f"{path}: has a match of {one.blue} as blue against {one.red} with seed "
                f"{one.seed}, which is none of those asked for; ask for all teams and matches that "
                "are in it and for more, or choose another --out"
            )
    for temporary in leftovers(folder, (RULES, MATCHES)):
        temporary.unlink(missing_ok=True)
    write_atomic(folder / RULES, json.dumps(settings, indent=1) + "\n")
    write_matches(path, rows)
    return rows


def _refuse_other_settings(path: Path, settings: TableSettings) -> None:
    """Check that rows can be added to those that are there.

    Raises:
        RunFolderError: If not.
    """
    try:
        saved = parse_json(path.read_bytes())
        rules, teams = dict(saved["rules"]), dict(saved["teams"])
    except (ValueError, LookupError, TypeError) as error:
        raise RunFolderError(f"{path}: damaged ({error}); choose another --out") from error
    for name, value in settings["rules"].items():
        if name not in rules or rules[name] != value:
            raise RunFolderError(
                f"{path}: {name}: the matches there were played with {rules.get(name)}, got "
                f"{value}; give the same, or choose another --out"
            )
    for name, value in settings["teams"].items():
        if teams.get(name, value) != value:
            raise RunFolderError(
                f"{path}: the team {name} is not the one that played there under this name; "
                "restore it, or choose another --out"
            )


def _play_missing(
    rows_of: Playing, pairings: Sequence[Pairing], before: int, keep: Callable[[MatchRow], None]
) -> None:
    """Play matches, and hand each row on when it is there; `before` so many were played."""
    silent = sys.stderr is None or not sys.stderr.isatty()
    total = before + len(pairings)
    with (
        tqdm(total=total, initial=before, unit=" matches", disable=silent) as bar,
        closing(rows_of(pairings)) as rows,
    ):
        for row in rows:
            keep(row)
            bar.update()


def _rows_of(
    hall: Hall, jobs: int | None, cluster: str | None, pairings: Sequence[Pairing]
) -> Generator[MatchRow]:
    """The rows of matches, with several jobs in whichever order they are over."""
    here = cluster is None and 1 in (usable_cores() if jobs is None else jobs, len(pairings))
    if here or not pairings:
        yield from map(hall.row, pairings)
        return
    play = partial, hall.row
    with (
        open_machines(cluster) as machines,
        closing(performed(machines, play, pairings, jobs=jobs)) as outcomes,
    ):
        for outcome in outcomes:
            if outcome is not None and outcome.error is not None:
                raise outcome.error
            if outcome is not None:
                yield outcome.answer
