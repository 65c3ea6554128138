"""The pictures of battles and tournaments, drawn from the table of matches alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from neatq_envs.render import ShownFigure, plain_title
from neatq_trainers.nero.match_table import MatchRow
from neatq_trainers.nero.ranking import wilson

_ENDINGS = (".gz", ".txt")
_LONGEST_LABEL = 30
"""Letters of a name in a figure."""
_NUMBERED = 12
"""Most teams with numbers in the cells of their matrix."""
_FIRST, _SECOND = "#0072b2", "#d55e00"
"""Two teams whatever their side, in colours that everybody can tell apart (Okabe & Ito 2008)."""
_UNPLAYED = "0.72"


def draw_matrix(rows: Sequence[MatchRow]) -> Figure:
    """Who beats whom: a cell for each pair of teams and each choice of sides.

    Rows play as blue, columns as red; a cell has the colour of the side that wins, stronger for
    a larger mean score. Teams are sorted by mean score over all matches, the best at the top and
    at the left, as OpenNERO sorted the figure of its tournament of 2011.
    """
    names, means = _mean_scores(rows)
    cell = 0.6 if len(names) <= _NUMBERED else max(0.13, 0.34 - 0.003 * len(names))
    side = max(4.2, cell * len(names))
    figure = ShownFigure(figsize=(side + 3.6, side + 2.4), layout="constrained")
    axes = figure.add_subplot()
    limit = float(np.nanmax(np.abs(means), initial=1.0))
    image = axes.imshow(means, cmap="RdBu", vmin=-limit, vmax=limit, interpolation="nearest")
    axes.set_facecolor(_UNPLAYED)
    if len(names) <= _NUMBERED:
        _number_cells(axes, means, 0.6 * limit)
    _name_teams(axes, names, min(9.0, 72 * cell * 0.8))
    title = f"Who beats whom: {len(names)} teams, {len(rows):,} matches\n"
    title += "a cell has the colour of the side that wins; best mean score first"
    plain_title(axes, title, fontsize=10)
    bar = figure.colorbar(image, ax=axes, shrink=min(0.8, 4.2 / side), aspect=25)
    bar.set_label(
        "mean score of blue: damage inflicted\nless damage taken (hit points)", fontsize=9
    )
    bar.ax.set_title("blue wins", fontsize=9)
    bar.ax.set_xlabel("red wins", fontsize=9)
    return figure


def _mean_scores(rows: Sequence[MatchRow]) -> tuple[list[str], NDArray[np.float64]]:
    """Teams, the best mean score first, and blue's mean score [blue, red]; NaN without a match."""
    scores: dict[str, list[int]] = {}
    cells: dict[tuple[str, str], list[int]] = {}
    for row in rows:
        cells.setdefault((row.blue, row.red), []).append(row.score(row.blue))
        for team in (row.blue, row.red):
            scores.setdefault(team, []).append(row.score(team))
    names = sorted(scores, key=lambda name: (-np.mean(scores[name]), name))
    means = [[np.mean(cells.get((blue, red), np.nan)) for red in names] for blue in names]
    return names, np.array(means, np.float64)


def _number_cells(axes: Axes, means: NDArray[np.float64], dark: float) -> None:
    for blue, red in product(range(len(means)), repeat=2):
        mean = means[blue, red]
        if not np.isnan(mean):
            colour = "white" if abs(mean) > dark else "black"
            axes.text(red, blue, f"{mean:+.0f}", ha="center", va="center", fontsize=8, color=colour)


def _name_teams(axes: Axes, names: Sequence[str], fontsize: float) -> None:
    labels, numbers = short_names(names), range(len(names))
    style = {"fontsize": fontsize, "parse_math": False}
    axes.set_yticks(numbers, labels, **style)
    axes.set_xticks(numbers, labels, rotation=90, **style)
    axes.tick_params(length=0)
    axes.set_ylabel("team that plays as blue")
    axes.set_xlabel("team that plays as red")


def short_names(names: Sequence[str]) -> list[str]:
    """Names without the endings of files and not too long, where they still differ then."""
    short = []
    for name in names:
        for ending in _ENDINGS:
            name = name.removesuffix(ending) or name
        short.append(name if len(name) <= _LONGEST_LABEL else f"{name[: _LONGEST_LABEL - 1]}…")
    return [one if short.count(one) == 1 else name for one, name in zip(short, names, strict=True)]


def draw_duel(rows: Sequence[MatchRow]) -> Figure:
    """The matches of two teams: the damage that both took in each, and who won how often."""
    first, second = rows[0].blue, rows[0].red
    figure = ShownFigure(figsize=(10.5, 5.2), layout="constrained")
    damage, wins = figure.subplots(1, 2, width_ratios=(1.15, 1))
    short = short_names((first, second))
    _draw_damage(damage, rows, first, short)
    _draw_wins(wins, rows, first, short)
    one_seed = len({row.seed for row in rows}) == 1
    title = f"{short[0]} against {short[1]}: {len(rows):,} match{'es' * (len(rows) > 1)}"
    title += "" if one_seed else f", seeds {rows[0].seed} to {max(row.seed for row in rows)}"
    figure.suptitle(title, parse_math=False)
    return figure


def _draw_damage(axes: Axes, rows: Sequence[MatchRow], first: str, names: Sequence[str]) -> None:
    """A point for each match: what either team took."""
    most = 1.06 * max(1, *(max(row.damage_blue, row.damage_red) for row in rows))
    least = -0.05 * most
    axes.fill_between((least, most), (least, most), most, color=_FIRST, alpha=0.15, lw=0)
    axes.fill_between((least, most), least, (least, most), color=_SECOND, alpha=0.15, lw=0)
    words = {"transform": axes.transAxes, "parse_math": False, "fontsize": 10, "zorder": 1}
    axes.text(0.04, 0.56, f"{names[0]} wins", color=_FIRST, **words)
    axes.text(0.96, 0.4, f"{names[1]} wins", color=_SECOND, ha="right", **words)
    for blue, marker, fill in ((True, "o", "0.15"), (False, "^", "none")):
        own = [row for row in rows if (row.blue == first) == blue]
        taken = [(row.damage_blue, row.damage_red)[:: 1 if blue else -1] for row in own]
        style = {"ls": "", "ms": 6, "alpha": 0.8 if len(rows) <= 100 else 0.3}
        label = f"{names[not blue]} plays as blue ({len(own):,})"
        x, y = np.array(taken).reshape(-1, 2).T
        axes.plot(x, y, marker, color="0.15", mfc=fill, label=label, **style)
    axes.set(xlim=(least, most), ylim=(least, most), aspect="equal")
    axes.set_xlabel(f"damage that {names[0]} took (hit points)", parse_math=False)
    axes.set_ylabel(f"damage that {names[1]} took (hit points)", parse_math=False)
    axes.set_title("each match", fontsize=10)
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.13), "frameon": False}
    for text in axes.legend(fontsize=9, **below).get_texts():
        text.set_parse_math(False)


def _draw_wins(axes: Axes, rows: Sequence[MatchRow], first: str, names: Sequence[str]) -> None:
    """How often the first team won in either colour, with intervals."""
    groups = {
        "all matches": rows,
        f"{names[0]}\nplays as blue": [row for row in rows if row.blue == first],
        f"{names[0]}\nplays as red": [row for row in rows if row.red == first],
    }
    for line, own in enumerate(groups.values()):
        _draw_share(axes, line, [row.won(first) for row in own])
    axes.axvline(0.5, color="0.4", lw=0.8, zorder=0)
    axes.set_yticks(range(len(groups)), list(groups), parse_math=False)
    axes.set(xlim=(0, 1), ylim=(len(groups) - 0.5, -0.5))
    axes.set_xlabel(f"share of matches that {names[0]} won", parse_math=False)
    axes.set_title("wins, with 95 % intervals (Wilson)", fontsize=10)
    axes.grid(alpha=0.3, axis="x")


def _draw_share(axes: Axes, line: int, won: Sequence[float]) -> None:
    """A share of wins with its interval, and the counts above it."""
    wins, draws = won.count(1.0), won.count(0.5)
    counts = f"{wins} won, {len(won) - wins - draws} lost" + f", {draws} drawn" * (draws > 0)
    axes.text(0.02, line - 0.12, counts if won else "no match", fontsize=9)
    if not won:
        return
    share, (low, high) = wins / len(won), wilson(wins, len(won))
    axes.plot((low, high), (line, line), color="0.35", lw=2, solid_capstyle="butt")
    colour = _FIRST if low > 0.5 else _SECOND if high < 0.5 else "0.35"
    axes.plot(share, line, "o", color=colour, ms=8, clip_on=False, zorder=4)
