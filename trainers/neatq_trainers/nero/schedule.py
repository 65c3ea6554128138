"""Which matches a battle or a tournament has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

from neatq_torch.kinds import ConfigError

if TYPE_CHECKING:
    from neatq_trainers.nero.teams import Team

MOST_MATCHES = 10_000
"""Of one team against another."""
MOST_SEED = 2_000_000_000


@dataclass(frozen=True, kw_only=True)
class Pairing:
    """One match that is to be played.

    Attributes:
        blue: Name of the team that plays as blue.
        red: Name of the other one.
        seed: Of everything that is drawn in the match.
    """

    blue: str
    red: str
    seed: int


def schedule(names: Sequence[str], matches: int, seed: int = 0) -> list[Pairing]:
    """Every team against every other one, in the order in which the table has them.

    Of the matches of two teams, the one that is named first is blue in every other one, beginning
    with the first; the next match has the same seed with the colours changed. Seeds are the same
    for all pairs, so all begin from the same spawns. Neither more matches nor more teams change
    the matches that there were.

    Args:
        names: Names of the teams; two of them for a battle.
        matches: Of one team against another.
        seed: Of the first match; the third has the next one, and so on.

    Raises:
        ConfigError: If there are no matches, or too many, or the seed is out of range.
    """
    check_range("matches", matches, 1, MOST_MATCHES)
    check_range("seed", seed, 0, MOST_SEED)
    return [
        Pairing(blue=pair[number % 2], red=pair[1 - number % 2], seed=seed + number // 2)
        for number in range(matches)
        for pair in combinations(names, 2)
    ]


def check_range(name: str, value: int, least: int, most: int) -> None:
    """Raise a ConfigError if a value is less than the least or more than the most."""
    if not least <= value <= most:
        raise ConfigError(f"{name}: expected {least:,} to {most:,}, got {value:,}")


def check_teams(teams: Sequence[Team], sources: Sequence[str] | None = None) -> None:
    """Check that teams can meet, and that a table can tell them apart.

    Args:
        teams: Those that are to meet.
        sources: Where each was read, for messages. Default: their names.

    Raises:
        ConfigError: If there are fewer than two, two have one name or other sensors, or a name
            has a line break in it.
    """
    if len(teams) < 2:
        raise ConfigError(f"teams: expected at least two, got {len(teams)}")
    sources = [team.name for team in teams] if sources is None else sources
    known: dict[str, str] = {}
    for team, source in zip(teams, sources, strict=True):
        if team.name.splitlines() != [team.name] or not _is_text(team.name):
            raise ConfigError(f"{source!r}: expected a name of one line of text; rename the file")
        if team.name in known:
            raise ConfigError(
                f"{source}: a team is called {team.name} already ({known[team.name]}); expected "
                "teams of different names: copy one under another name"
            )
        if team.sensors != teams[0].sensors:
            raise ConfigError(
                f"{source}: its sensors are {team.sensors}, those of {sources[0]} "
                f"{teams[0].sensors}; expected teams of the same sensors"
            )
        known[team.name] = source


def _is_text(name: str) -> bool:
    """Whether a name can be written as UTF-8: names of files may hold any bytes."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
