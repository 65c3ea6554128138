"""`neatq battle` and `neatq tournament`: how matches are asked for, and what is said of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from neatq_envs.processes import ProcessEnded
from neatq_torch.atomic import write_atomic
from neatq_trainers.commands import RunStopped, parse
from neatq_trainers.names import file_name
from neatq_trainers.nero.figures import draw_duel, draw_matrix
from neatq_trainers.nero.match import BattleRules, filmed
from neatq_trainers.nero.match_table import MATCHES, MatchRow
from neatq_trainers.nero.ranking import (
    RANKING,
    Standing,
    agreement,
    ranking_csv,
    read_published,
    standings,
    standings_text,
)
from neatq_trainers.nero.run_teams import find_team
from neatq_trainers.nero.schedule import MOST_MATCHES, MOST_SEED, check_range, check_teams
from neatq_trainers.nero.teams import Team
from neatq_trainers.nero.tournament import play_tournament
from neatq_trainers.report import save_figure
from neatq_trainers.signals import Terminated

DUEL, MATRIX = "duel.png", "matrix.png"
BATTLE_FILM, BATTLE_PAGE = "battle.gif", "battle.html"
TeamPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TEAM")]
TeamPaths = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="TEAM ...")]
_MOST_OF = {"ticks": 1_000_000, "robots": 1000, "hit_points": 100_000, "jobs": 1000}
_INTERRUPTS = (KeyboardInterrupt, Terminated, ProcessEnded, MemoryError, OSError)
"""What stops matches that the same command goes on with."""


@dataclass(frozen=True, kw_only=True)
class _MatchOptions:
    seed: int = 0
    """Of the first match of two teams and of its return match with the colours changed; the next
    two have the next seed, and so on. The same seeds give the same matches."""
    ticks: int = BattleRules.ticks
    """After so many ticks a match is over; less damage taken wins."""
    robots: int = BattleRules.robots
    """Robots of each team. Of fewer networks in a file each plays several, of more only the first
    play."""
    hit_points: int = BattleRules.hit_points
    """Hits that take a robot off the field."""
    jobs: int | None = None
    """Processes; the results do not depend on it. Default: one for each core."""
    cluster: str | None = None
    """A Ray cluster on which these live: auto, ray://HOST:10001, or local, which begins one."""
    out: Path | None = None
    """Where everything is written: a new or empty folder, or one with matches of the same rules,
    which are not played again."""

    @property
    def rules(self) -> BattleRules:
        """What matches are played by."""
        return BattleRules(ticks=self.ticks, robots=self.robots, hit_points=self.hit_points)


@dataclass(frozen=True, kw_only=True)
class BattleCommand(_MatchOptions):
    """Let two teams fight, half of the matches in each colour; write a table and figures.

    A team is a team file of OpenNERO (such as synth.pop.txt.gz) or a run folder, of several arenas
    FOLDER:N. In --out: matches.csv with a row for each match, ranking.csv, duel.png. Matches that
    are over are not played again, so an interrupted battle goes on where it was.
    """

    first: TeamPath
    """A team; it is blue in the first match, and in every other one."""
    second: TeamPath
    """The other team."""
    matches: int = 20
    """How many."""


@dataclass(frozen=True, kw_only=True)
class TournamentCommand(_MatchOptions):
    """Let every team fight every other one on all cores; write a table, a ranking and a matrix.

    A team is a team file of OpenNERO (such as synth.pop.txt.gz) or a run folder, of several arenas
    FOLDER:N. In --out: matches.csv with a row for each match, ranking.csv, matrix.png. Matches that
    are over are not played again: an interrupted tournament goes on where it was, and one to which
    teams or matches are added plays what is missing.
    """

    teams: TeamPaths
    """At least two teams, whose files have different names."""
    matches: int = 2
    """Of each team against each other one: 2 is one in each colour."""
    published: Path | None = None
    """A table to compare the ranking with, with tabs between its columns file (names of team
    files), wins... and mean_score; prints rank correlations."""


def battle_command(arguments: list[str]) -> None:
    """`neatq battle`."""
    command = parse(BattleCommand, "battle", arguments)
    _refuse_out_of_range(command, command.matches)
    teams = read_teams((command.first, command.second))
    default = Path("runs", f"battle-{file_name(teams[0].name)}-{file_name(teams[1].name)}")
    out = default if command.out is None else command.out
    with _going_on_later(out):
        rows = _matches(command, command.matches, teams, out)
        _write_ranking(rows, out)
        save_figure(draw_duel(rows), out / DUEL)
        film = _write_films(teams, rows[0], command.rules, out)
    print(f"neatq: {out}: {', '.join([MATCHES, RANKING, DUEL, *film])}")


def tournament_command(arguments: list[str]) -> None:
    """`neatq tournament`."""
    command = parse(TournamentCommand, "tournament", arguments)
    _refuse_out_of_range(command, command.matches)
    teams = read_teams(command.teams)
    if command.published is not None:
        read_published(command.published, [team.name for team in teams])  # told before hours
    out = Path("runs/tournament") if command.out is None else command.out
    with _going_on_later(out):
        rows = _matches(command, command.matches, teams, out)
        ranking = _write_ranking(rows, out)
        save_figure(draw_matrix(rows), out / MATRIX)
    print(f"neatq: {out}: {MATCHES}, {RANKING}, {MATRIX}")
    if command.published is not None:
        print(_agreement_text(ranking, command.published))


def _refuse_out_of_range(command: _MatchOptions, matches: int) -> None:
    """Check what tyro does not: it would draw a box round the sentence."""
    check_range("matches", matches, 1, MOST_MATCHES)
    check_range("seed", command.seed, 0, MOST_SEED)
    for name, most in _MOST_OF.items():
        value = getattr(command, name)
        if value is not None:
            check_range(name, value, 1, most)


def read_teams(paths: Sequence[Path]) -> list[Team]:
    """Teams that can meet, each with what was left out of its file said on stdout.

    Raises:
        ConfigError: If one cannot be read, or they cannot meet.
    """
    teams = [find_team(path) for path in paths]
    check_teams(teams, [str(path) for path in paths])
    for team in teams:
        for note in team.notes:
            print(f"neatq: {team.name}: {note}")
    return teams


def _matches(
    command: _MatchOptions, matches: int, teams: Sequence[Team], out: Path
) -> list[MatchRow]:
    """Play what is missing in a folder."""
    return play_tournament(
        teams,
        matches=matches,
        seed=command.seed,
        rules=command.rules,
        jobs=command.jobs,
        cluster=command.cluster,
        out=out,
    )


def _write_ranking(rows: Sequence[MatchRow], out: Path) -> list[Standing]:
    """Write the ranking, and print it."""
    ranking = standings(rows)
    write_atomic(out / RANKING, ranking_csv(ranking))
    print(standings_text(ranking), end="")
    return ranking


def _agreement_text(ranking: Sequence[Standing], published: Path) -> str:
    found = agreement(ranking, published)
    wins, scores = (
        "undefined" if math.isnan(value) else f"{value:.2f}" for value in (found.wins, found.scores)
    )
    return (
        f"neatq: {published}: {found.teams} teams of both tables; rank correlation (Spearman) of "
        f"wins {wins}, of mean scores {scores}"
    )


def _write_films(
    teams: Sequence[Team], row: MatchRow, rules: BattleRules, out: Path
) -> tuple[str, str]:
    """Write a match as an animation and as a page that plays it; returns their names."""
    from neatq_trainers.live.recording import page_with, record_battle
    from neatq_trainers.nero.animation import battle_gif

    blue, red = (next(one for one in teams if one.name == name) for name in row[:2])
    film, names = filmed(blue, red, seed=row.seed, rules=rules), (blue.name, red.name)
    write_atomic(out / BATTLE_FILM, battle_gif(film, names))
    write_atomic(out / BATTLE_PAGE, page_with(record_battle(film, names)))
    return BATTLE_FILM, BATTLE_PAGE


@contextmanager
def _going_on_later(out: Path) -> Iterator[None]:
    """Add to what stops matches in a folder that none of those that are over is lost."""
    try:
        yield
    except _INTERRUPTS as error:
        begun = (out / MATCHES).is_file()
        advice = "; what is finished is kept: the same command goes on" if begun else ""
        raise RunStopped(error, advice) from error
