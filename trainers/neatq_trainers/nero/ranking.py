"""How good teams are by the matches that they played against each other."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from neatq_torch.kinds import ConfigError
from neatq_trainers.nero.match_table import MatchRow

RANKING = "ranking.csv"
ELO_POINTS = 400 / math.log(10)
"""Of a strength of 1: with 400 points more a team wins ten times as often as it loses."""
LIKELY = 0.95
_NORMAL = 1.959964
"""Standard deviations to either side that hold 95 % of a normal distribution."""
_DRAWS, _DRAWN_TOGETHER = 10_000, 1_000_000
"""Resamples of a bootstrap, and most of its values at a time, 8 MB."""
_SHOWN = 20
"""Most lines of a table that is printed."""


class Standing(NamedTuple):
    """A row of `ranking.csv`; `_low` and `_high` are ends of 95 % intervals.

    Attributes:
        team: Its name.
        matches: Which it played.
        wins: Matches in which it took less damage than it inflicted.
        draws: Matches of equal damage.
        losses: All others.
        share: Of its matches, those that it won; a draw is none. Wilson's interval (1927), as if
            matches were independent.
        share_low: See `share`.
        share_high: See `share`.
        score: Mean over matches of damage inflicted less damage taken, hit points. Percentile
            bootstrap over pairs of a match and its return match; NaN with a single pair.
        score_low: See `score`.
        score_high: See `score`.
        elo: Strength by the model of Bradley & Terry (1952) in points of Elo; the mean of all
            teams is 0. See `strengths`.
        elo_low: See `elo`.
        elo_high: See `elo`.
    """

    team: str
    matches: int
    wins: int
    draws: int
    losses: int
    share: float
    share_low: float
    share_high: float
    score: float
    score_low: float
    score_high: float
    elo: float
    elo_low: float
    elo_high: float


class Agreement(NamedTuple):
    """How well a ranking agrees with a published one: rank correlations by Spearman, -1 to 1.

    Attributes:
        teams: That are in both.
        wins: Of shares of wins; NaN if all are equal.
        scores: Of mean scores; likewise.
    """

    teams: int
    wins: float
    scores: float


def standings(rows: Sequence[MatchRow]) -> list[Standing]:
    """The ranking of all teams of a table, the one with the largest share of wins first."""
    names = sorted({name for row in rows for name in (row.blue, row.red)})
    elo, error = (ELO_POINTS * one for one in strengths(wins_over(rows, names)))
    found = [
        Standing(name, *_counts(own, name), *_score(own, name), points, points - off, points + off)
        for name, points, off in zip(names, elo.tolist(), (_NORMAL * error).tolist(), strict=True)
        if (own := [row for row in rows if name in (row.blue, row.red)])
    ]
    return sorted(found, key=lambda one: (-one.share, -one.score, one.team))


def _counts(rows: Sequence[MatchRow], team: str) -> tuple[int, int, int, int, float, float, float]:
    won = [row.won(team) for row in rows]
    wins, draws, matches = won.count(1.0), won.count(0.5), len(won)
    low, high = wilson(wins, matches)
    return matches, wins, draws, matches - wins - draws, wins / matches, low, high


def wilson(wins: int, matches: int) -> tuple[float, float]:
    """The 95 % interval of a share of wins, by Wilson (1927)."""
    from scipy.stats import binomtest  # a second to import, so only where it is used

    interval = binomtest(wins, matches).proportion_ci(LIKELY, method="wilson")
    return float(interval.low), float(interval.high)


def _score(rows: Sequence[MatchRow], team: str) -> tuple[float, float, float]:
    """Mean score of a team, hit points, and its interval."""
    pairs: dict[tuple[str, int], list[int]] = {}
    for row in rows:
        other = row.red if row.blue == team else row.blue
        pairs.setdefault((other, row.seed), []).append(row.score(team))
    scores = sum(map(sum, pairs.values())) / len(rows)
    return scores, *_mean_interval(np.array([sum(pair) / len(pair) for pair in pairs.values()]))


def _mean_interval(values: NDArray[np.float64]) -> tuple[float, float]:
    """The 95 % percentile bootstrap interval of the mean of values [values]; NaN of one value."""
    if values.size < 2:
        return math.nan, math.nan
    from scipy.stats import bootstrap

    low, high = bootstrap(
        (values,),
        np.mean,
        n_resamples=_DRAWS,
        batch=max(1, _DRAWN_TOGETHER // values.size),
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(low), float(high)


def wins_over(rows: Iterable[MatchRow], names: Sequence[str]) -> NDArray[np.float64]:
    """How often a team won against another one [teams, others]; a draw is half a win for each."""
    index = {name: number for number, name in enumerate(names)}
    wins = np.zeros((len(names), len(names)))
    for row in rows:
        blue, red = index[row.blue], index[row.red]
        wins[blue, red] += row.won(row.blue)
        wins[red, blue] += row.won(row.red)
    return wins


def strengths(wins: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Strengths of teams by the model of Bradley & Terry (1952), and their standard errors.

    The odds that a team wins against another one are exp(difference of their strengths); the mean
    is 0. They are most likely for the wins in the table and, for each team, half a win and half a
    loss more, evenly spread over the others (Haldane 1956, Anscombe 1956): else a team that always
    won would be infinitely strong. Errors are those of a normal approximation, from the inverse
    of the Fisher information. Where teams win in a circle no such number tells who beats whom.

    Args:
        wins: [teams, others], as `wins_over` has them.

    Returns:
        Strengths and standard errors [teams].
    """
    from choix import ilsr_pairwise_dense  # it imports scipy, which takes a second

    teams = len(wins)
    more = (1 - np.eye(teams)) / (2 * (teams - 1))
    strength = ilsr_pairwise_dense(wins + more, max_iter=10_000)
    strength = strength - strength.mean()
    chance = 1 / (1 + np.exp(strength[None] - strength[:, None]))
    known = (wins + wins.T + 2 * more) * chance * chance.T
    information = np.diag(known.sum(1)) - known
    return strength, np.sqrt(np.diag(np.linalg.pinv(information, hermitian=True)))


def agreement(ranking: Sequence[Standing], published: Path) -> Agreement:
    """How well a ranking agrees with a published table.

    Args:
        ranking: What came of a tournament.
        published: See `read_published`.

    Raises:
        ConfigError: If it cannot be read, or fewer than three teams are in both.
        OSError: If there is no such file.
    """
    known = read_published(published, [one.team for one in ranking])
    both = [one for one in ranking if one.team in known]
    wins, scores = zip(*(known[one.team] for one in both), strict=True)
    shares, means = [one.share for one in both], [one.score for one in both]
    return Agreement(len(both), _spearman(shares, wins), _spearman(means, scores))


def _spearman(ours: Sequence[float], theirs: Sequence[float]) -> float:
    if min(len(set(ours)), len(set(theirs))) < 2:
        return math.nan
    from scipy.stats import spearmanr

    return float(np.asarray(spearmanr(ours, theirs))[0])


def read_published(path: Path, names: Collection[str]) -> dict[str, tuple[float, float]]:
    """Wins and mean score of some teams, from a table with tabs between its columns.

    Its columns are `file`, one whose name begins with `wins`, `mean_score`, and any others.

    Raises:
        ConfigError: If it is not such a table, or fewer than three of the teams are in it.
        OSError: If there is no such file.
    """
    expected = f"{path}: expected a table with tabs and the columns file, wins... and mean_score"
    try:
        lines = list(csv.reader(path.read_bytes().decode().splitlines(), delimiter="\t"))
        header = lines[0] if lines else []
        wins = next((name for name in header if name.startswith("wins")), "wins")
        file, won, score = (header.index(name) for name in ("file", wins, "mean_score"))
        known = {cells[file]: (float(cells[won]), float(cells[score])) for cells in lines[1:]}
    except (ValueError, IndexError, csv.Error) as error:
        raise ConfigError(f"{expected} ({error})") from error
    both = {name: numbers for name, numbers in known.items() if name in names}
    if len(both) < 3:
        raise ConfigError(
            f"{path}: expected at least three of the teams that play, by the names of their "
            f"files, got {', '.join(both) or 'none'}"
        )
    return both


def ranking_csv(ranking: Sequence[Standing]) -> str:
    """The content of `ranking.csv`."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(Standing._fields)
    lines.writerows([_cell_text(value) for value in one] for one in ranking)
    return text.getvalue()


def _cell_text(value: str | float) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return str(value)


def standings_text(ranking: Sequence[Standing], most: int = _SHOWN) -> str:
    """The first lines of a ranking, for a terminal."""
    table = [("", "team", "matches", "won", "drawn", "lost", "share won", "mean score", "Elo")]
    table += [(f"{rank}", *_standing_words(one)) for rank, one in enumerate(ranking[:most], 1)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if column == 1 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )
        for cells in table
    ]
    left = len(ranking) - most
    lines += [f"... and {left} more in {RANKING}"] if left > 0 else []
    return "".join(f"{line.rstrip()}\n" for line in lines)


def _standing_words(one: Standing) -> tuple[str, ...]:
    counts = (str(count) for count in one[1:5])
    share = f"{one.share:.2f} [{one.share_low:.2f}, {one.share_high:.2f}]"
    score = f"{one.score:+z.0f}"
    if not math.isnan(one.score_low):
        score += f" [{one.score_low:+z.0f}, {one.score_high:+z.0f}]"
    elo = f"{one.elo:+z.0f} [{one.elo_low:+z.0f}, {one.elo_high:+z.0f}]"
    return one.team, *counts, share, score, elo
