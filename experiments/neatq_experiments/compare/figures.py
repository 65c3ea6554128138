"""The figures of a comparison, drawn from its tables alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from neatq_envs.render import plain_title
from neatq_experiments.compare.report import paired_differences, reference_of
from neatq_experiments.compare.statistics import band, mean_estimate, mean_of_known
from neatq_experiments.compare.tables import POINT_TICKS, Curves, Study
from neatq_experiments.compare.variants import PAPER_ARMS
from neatq_trainers.rows import ROW_TICKS

_ARM_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple")
_OTHER_COLOURS = (
    *("tab:brown", "tab:cyan", "tab:olive", "tab:pink", "black", "navy", "gold", "lime"),
    *("magenta", "teal", "salmon", "slategray", "indigo", "darkgreen"),
)
"""As many as the largest group of variants has members."""
_BEHIND_STYLES = (":", "-", "--", "-.")
HALVES = {
    "eligible": "robots old enough to be judged",
    "newborn": "newborns, too young to be judged",
}
LINE_TICKS = 2 * POINT_TICKS
"""Ticks in one point of a line: one life. Lives begin together, and in half a life a team is far
from the flag by habit, so points of half a life would go up and down."""
MOST_COLUMNS = 4
"""Panels beside each other in the overview."""
X_LABEL = f"figure tick ({ROW_TICKS} simulation ticks)"


Behind = Mapping[str, Mapping[str, NDArray[np.float64]]]
"""Other curves to draw behind, by task and label: figure ticks and distances [points, 2]."""


def colours_of(arms: Sequence[str]) -> dict[str, str]:
    """A colour for each arm, the same in all figures; those of the paper always have theirs."""
    colours = dict(zip(PAPER_ARMS, _ARM_COLOURS, strict=True))
    others = (arm for arm in arms if arm not in colours)
    return colours | dict(zip(others, cycle(_OTHER_COLOURS), strict=False))


def draw_task(study: Study, task: str, behind: Behind | None = None) -> Figure:
    """Mean distance of the team over time, in the axes of Robertson & Wu (2014).

    Each arm's mean over seeds with its 95 % interval; behind them, in grey, other curves.
    """
    figure = Figure(figsize=(8.5, 5), layout="constrained")
    axes = figure.add_subplot()
    _draw_mean_distance(axes, study, task, behind)
    plain_title(axes, f"Task {task}: how far the team is from the flag")
    legend_beside(figure, *axes.get_legend_handles_labels())
    return figure


def draw_overview(study: Study, behind: Behind | None = None) -> Figure:
    """All tasks, up to four side by side, a panel as `draw_task` draws it for each."""
    rows = -(-len(study.tasks) // MOST_COLUMNS)
    columns = -(-len(study.tasks) // rows)
    figure = Figure(figsize=(1.8 + 3.6 * columns, 3.8 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    handles: dict[str, Artist] = {}
    for axes in grid.flat[len(study.tasks) :]:
        axes.set_axis_off()
    for axes, task in zip(grid.flat, study.tasks, strict=False):
        _draw_mean_distance(axes, study, task, behind)
        plain_title(axes, task)
        lines, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, lines, strict=True))
    for axes in grid[:, 1:].flat:
        axes.set_ylabel("")
    legend_beside(figure, list(handles.values()), list(handles))
    return figure


def _draw_mean_distance(axes: Axes, study: Study, task: str, behind: Behind | None) -> None:
    for arm in study.arms(task):
        _draw_arm(axes, study.curves(task, arm, "team"), colours_of(study.arms())[arm], arm)
    others = (behind or {}).get(task, {})
    for (label, curve), style in zip(others.items(), cycle(_BEHIND_STYLES), strict=False):
        axes.plot(*curve.T, color="0.6", lw=0.9, ls=style, label=label, zorder=1)
    _frame(axes, study, task)
    axes.set_ylabel("mean distance to the flag (units)")
    axes.set_xlabel(X_LABEL)


def draw_differences(study: Study) -> Figure:
    """Each arm's distance less that of the reference, over the last tenth, with 95 % intervals.

    Means over pairs of equal seeds, a panel for each task; left of the line is nearer to the flag.
    """
    reference = reference_of(study.arms())
    arms = [arm for arm in study.arms() if arm != reference]
    size = 3 + 2.6 * len(study.tasks), 1.2 + 0.28 * len(arms)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(1, len(study.tasks), squeeze=False, sharey=True)[0]
    for axes, task in zip(panels, study.tasks, strict=True):
        for row, arm in enumerate(arms):
            _draw_difference(axes, study, task, (reference, arm), row)
        axes.axvline(0, color="0.4", lw=0.8)
        plain_title(axes, task, fontsize=10)
        axes.grid(alpha=0.3, axis="x")
        axes.margins(x=0.1)
    panels[0].set_yticks(range(len(arms)), arms)
    panels[0].set_ylim(len(arms) - 0.5, -0.5)
    figure.supxlabel(
        f"difference to {reference} (units; left of the line is nearer to the flag)", fontsize=10
    )
    return figure


def _draw_difference(axes: Axes, study: Study, task: str, arms: tuple[str, str], row: int) -> None:
    theirs, ours = arms
    if not set(arms) <= set(study.arms(task)):
        return
    curves = (study.curves(task, arm, "team") for arm in (ours, theirs))
    apart = paired_differences(*curves)
    if apart.size:
        mean, low, high = mean_estimate(apart)
        colour = "tab:green" if high < 0 else "tab:red" if low > 0 else "0.4"
        axes.errorbar(mean, row, xerr=[[mean - low], [high - mean]], fmt="o", ms=4, color=colour)


def draw_halves(study: Study) -> Figure | None:
    """The robots old enough to be judged and the newborn, a row of panels for each task.

    What newborns can do, nobody has selected yet: only what they inherit and learn shows there.
    None if no arm has births.
    """
    tasks = [task for task in study.tasks if any(_evolving(study, task))]
    if not tasks:
        return None
    figure = Figure(figsize=(10.5, 0.6 + 3 * len(tasks)), layout="constrained")
    panels = figure.subplots(len(tasks), len(HALVES), squeeze=False, sharex="row", sharey="row")
    for task, row in zip(tasks, panels, strict=True):
        for axes, (column, title) in zip(row, HALVES.items(), strict=True):
            for arm in _evolving(study, task):
                _draw_arm(axes, study.curves(task, arm, column), colours_of(study.arms())[arm], arm)
            plain_title(axes, f"{task}: {title}", fontsize=10)
        for axes in row:  # both panels of a row share their axes: not before both have lines
            _frame(axes, study, task)
        row[0].set_ylabel("mean distance\nto the flag (units)")
    for axes in panels[-1]:
        axes.set_xlabel(X_LABEL)
    arms = _evolving(study, *tasks)
    lines = [Line2D([], [], color=colours_of(study.arms())[arm], lw=1.6) for arm in arms]
    legend_beside(figure, lines, arms)
    return figure


def _evolving(study: Study, *tasks: str) -> list[str]:
    """The arms that have newborns in some of these tasks."""
    pairs = [(task, arm) for task in tasks for arm in study.arms(task)]
    newborn = ((arm, study.curves(task, arm, "newborn").values) for task, arm in pairs)
    return list(dict.fromkeys(arm for arm, values in newborn if not np.isnan(values).all()))


def _draw_arm(axes: Axes, curves: Curves, colour: str, arm: str) -> None:
    middle, values = by_life(curves)
    low, high = band(values)
    label = f"{arm} ({len(curves.seeds)} seed{'s' * (len(curves.seeds) > 1)})"
    axes.plot(middle, mean_of_known(values), color=colour, lw=1.6, label=label, zorder=3)
    axes.fill_between(middle, low, high, color=colour, alpha=0.2, lw=0, zorder=2)


def by_life(curves: Curves) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means over one life a point.

    Returns:
        The middle of each point in figure ticks [points], and its values [seeds, points].
    """
    life = (curves.ticks - 1) // LINE_TICKS
    middle = (curves.ticks - (POINT_TICKS - ROW_TICKS) / 2) / ROW_TICKS
    lives = np.unique(life)
    values = [mean_of_known(curves.values[:, life == one], axis=1) for one in lives]
    return np.array([middle[life == one].mean() for one in lives]), np.stack(values, 1)


def _frame(axes: Axes, study: Study, task: str) -> None:
    last = max(outcome.ticks for outcome in study.outcomes if outcome.task == task)
    axes.set_xlim(0, last / ROW_TICKS)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)


def legend_beside(
    figure: Figure,
    lines: Sequence[Artist],
    labels: Sequence[str],
    line: str = f"mean over seeds,\n{LINE_TICKS:,} ticks a point",
) -> None:
    """A legend to the right of all panels, which says what lines and bands are."""
    title = f"line: {line}\nband: its 95 % interval\n"
    style = {"frameon": False, "fontsize": 9, "title_fontsize": 9, "alignment": "left"}
    figure.legend(lines, labels, loc="outside right upper", title=title, **style)
