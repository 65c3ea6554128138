"""A genome as a graph that a person can read."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path

from neatq_envs.render import ShownFigure
from neatq_envs.sensors import SCHEMAS
from neatq_torch.genome import Genome, NodeKind, node_levels

Names = Sequence[str] | None
"""One for each input or output; None for the usual ones, see `node_names`."""
POSITIVE, NEGATIVE, GREY = "#1565c0", "#d84315", "#4d4d4d"
FILL = {NodeKind.INPUT: "#cfd8dc", NodeKind.BIAS: "#ffffff"}
FILL |= {NodeKind.HIDDEN: "#ffe082", NodeKind.OUTPUT: "#a5d6a7"}
COLUMN_INCHES, WIDEST_INCHES, ROW_INCHES = 1.9, 16.0, 0.33
GAP_ROWS, HIDDEN_ROWS = 0.7, 1.3
"""Extra room between groups of inputs or outputs, and least room between two hidden nodes."""
FAINTEST, GROWN_FAINTEST = 0.05, 0.5
"""Least opacity of links; links that evolution added must be seen, however weak."""


def draw_genome(genome: Genome, *, input_names: Names = None, output_names: Names = None) -> Figure:
    """Draw inputs on the left, outputs on the right, and hidden nodes by level between them.

    Disabled links are left out and counted in the title. Blue is a positive weight and red a
    negative one; the larger, the wider and darker. Links that evolution did not add may be faint.
    Recurrent links are curved and dashed. A gene's artist has a `gid`, which an SVG keeps: "node
    17" or "link 23" (its innovation).

    Raises:
        ValueError: If there are more or fewer names than nodes.

    Example:
        >>> draw_genome(load_genome("champion.json")).savefig("champion.png")
    """
    names = node_names(genome, input_names, output_names)
    points = node_points(genome, names)
    width, height = np.ptp(points, axis=0)
    inches = (min(WIDEST_INCHES, 4.4 + COLUMN_INCHES * width), 2.0 + ROW_INCHES * height)
    rows = points[:, 1].max() + 1.2, points[:, 1].min() - 1.6
    figure = ShownFigure(figsize=inches, layout="constrained")
    axes = figure.add_subplot(xlim=(-0.1, width + 0.1), ylim=rows)
    axes.set_axis_off()
    _draw_links(axes, genome, points)
    _draw_nodes(axes, genome, points, names)
    axes.set_title(_title(genome), fontsize=11)
    figure.legend(handles=_legend(genome), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _draw_links(axes: Axes, genome: Genome, points: np.ndarray) -> None:
    """Draw the enabled links, strong ones on top."""
    enabled, size = np.flatnonzero(genome.link_enabled), np.abs(genome.link_weight)
    strength = size / (size[enabled].max(initial=0.0) or 1.0)
    recurrent, hidden = genome.link_recurrent, genome.node_kind == NodeKind.HIDDEN
    # Links that evolution added are those of hidden nodes and recurrent ones.
    grown = hidden[genome.source_index] | hidden[genome.target_index] | recurrent
    crowded = FAINTEST + min(GROWN_FAINTEST - FAINTEST, 5 / max(1, enabled.size))
    for link in enabled[np.lexsort((size[enabled], grown[enabled]))]:
        alpha, width = _stroke(float(strength[link]))
        start, end = points[genome.source_index[link]], points[genome.target_index[link]]
        patch = _link_patch(start, end, points[:, 1].max() / 2, curved=bool(recurrent[link]))
        patch.set(color=POSITIVE if genome.link_weight[link] >= 0 else NEGATIVE, linewidth=width)
        patch.set(alpha=max(alpha, GROWN_FAINTEST if grown[link] else crowded))
        patch.set(linestyle=(0, (4, 1.5)) if recurrent[link] else "-")
        patch.set(gid=f"link {genome.link_innovation[link]}", zorder=1 + float(strength[link]))
        axes.add_patch(patch)


def _stroke(strength: float) -> tuple[float, float]:
    """Opacity and width [points] of a link whose weight has this share of the largest."""
    return 0.95 * strength**2.2, 0.7 + 2.5 * strength**1.5


def _link_patch(start: np.ndarray, end: np.ndarray, middle: float, curved: bool) -> FancyArrowPatch:
    """A line; an arrow where it does not simply lead to the right. `middle` is a row."""
    if (start == end).all():
        loop = start + np.array([(0, 0), (-0.18, -1), (0.18, -1), (0, 0)])
        path = Path(loop, [Path.MOVETO, *3 * [Path.CURVE4]])
        return FancyArrowPatch(path=path, arrowstyle="-", fill=False)
    ends = tuple(start), tuple(end)
    if not curved and start[0] < end[0]:
        return FancyArrowPatch(*ends, arrowstyle="-", shrinkA=0, shrinkB=0)
    inwards = ((start[1] + end[1]) / 2 > middle) == (end[0] < start[0])
    # Within a column away from the names beside outputs, else towards the middle.
    to_left = end[1] > start[1] if start[0] == end[0] else inwards
    arc = f"arc3,rad={0.25 if to_left else -0.25}"
    arrow: dict[str, Any] = {"arrowstyle": "-|>", "shrinkB": 8, "mutation_scale": 9}
    return FancyArrowPatch(*ends, connectionstyle=arc, shrinkA=0, **arrow)


def _draw_nodes(axes: Axes, genome: Genome, points: np.ndarray, names: Sequence[str]) -> None:
    ids, kinds = genome.node_id.tolist(), genome.node_kind.tolist()
    style: dict[str, Any] = {"mec": "black", "mew": 0.8, "zorder": 4, "clip_on": False}
    plain: dict[str, Any] = {"va": "center", "parse_math": False}
    beside = {"textcoords": "offset points", "fontsize": 9, **plain}
    for node, kind, (x, y), name in zip(ids, kinds, points, names, strict=True):
        size, fill = 15 if kind == NodeKind.HIDDEN else 9, FILL[NodeKind(kind)]
        axes.plot(x, y, "o", ms=size, color=fill, gid=f"node {node}", **style)
        if kind == NodeKind.HIDDEN:
            axes.text(x, y, name, ha="center", fontsize=6.5, zorder=5, **plain)
        else:
            side, offset = ("left", 9) if kind == NodeKind.OUTPUT else ("right", -9)
            axes.annotate(name, (x, y), (offset, 0), ha=side, **beside)


def _title(genome: Genome) -> str:
    inputs, outputs, enabled = genome.input_ids.size, genome.output_ids.size, genome.link_enabled
    hidden = np.count_nonzero(genome.node_kind == NodeKind.HIDDEN)
    left_out = f" (and {(~enabled).sum()} disabled, not drawn)" if not enabled.all() else ""
    return (
        f"Genome {genome.genome_id}: {inputs} inputs, {hidden} hidden, {outputs} outputs, "
        f"{enabled.sum()} links{left_out}\nsignals run from left to right"
    )


def _legend(genome: Genome) -> list[Line2D]:
    largest = float(np.abs(genome.link_weight[genome.link_enabled]).max(initial=0.0))
    signs = ((POSITIVE, "positive weight"), (NEGATIVE, "negative weight"))
    lines: list[dict[str, Any]] = [{"color": one, "lw": 2, "label": name} for one, name in signs]
    for strength in (1.0, 0.6):
        (alpha, width), label = _stroke(strength), f"weight of size {strength * largest:.2g}"
        lines.append({"color": GREY, "lw": width, "alpha": alpha, "label": label})
    if (genome.node_kind == NodeKind.HIDDEN).any():
        node = {"color": FILL[NodeKind.HIDDEN], "mec": "black", "marker": "o", "ls": "", "ms": 11}
        lines.append(node | {"label": "hidden node (its id)"})
    if genome.link_recurrent[genome.link_enabled].any():
        label = "recurrent (value of the tick before)"
        lines.append({"color": GREY, "ls": "--", "lw": 1.6, "label": label})
    return [Line2D([], [], **line) for line in lines]


def candidate_names(candidates: int, actions: Sequence[str]) -> tuple[str, ...]:
    """Names of the outputs that `CandidateHeads` reads, in their order; one candidate has no Q."""
    if candidates == 1:
        return tuple(actions)
    parts = [f"candidate {c} {action}" for c in range(candidates) for action in actions]
    return (*parts, *(f"Q {c}" for c in range(candidates)))


def node_names(genome: Genome, input_names: Names, output_names: Names) -> list[str]:
    """One name for each node, in the order of the genome's arrays; that of a hidden node is its id.

    Names that are None come from the genome's observation schema if it is known (outputs are
    candidates and Q-values if there are as many as these need), else "input 0", "output 0", ...

    Raises:
        ValueError: If there are more or fewer names than nodes.
    """
    schema = {one.name: one for one in SCHEMAS.values()}.get(genome.observation_schema)
    inputs, outputs = genome.input_ids.size, genome.output_ids.size
    if input_names is None:
        input_names = schema.observations if schema else [f"input {i}" for i in range(inputs)]
    if output_names is None:
        known = [candidate_names(k + 1, schema.actions) for k in range(outputs)] if schema else []
        plain = [f"output {i}" for i in range(outputs)]
        output_names = next((names for names in known if len(names) == outputs), plain)
    shown = genome.node_id.astype(object)
    shown[genome.node_kind == NodeKind.BIAS] = "bias"
    for kind, names in ((NodeKind.INPUT, input_names), (NodeKind.OUTPUT, output_names)):
        noun, of_kind = kind.name.lower(), genome.node_kind == kind
        if len(names) != of_kind.sum():
            wanted = f"one name for each of the genome's {of_kind.sum()} {noun}s"
            raise ValueError(f"{noun}_names: expected {wanted}, got {len(names)}")
        shown[of_kind] = list(names)
    return [str(name).replace("_", " ") for name in shown]


def node_points(genome: Genome, names: list[str]) -> np.ndarray:
    """Where nodes stand, float64 [nodes, 2]: column (0 = inputs) and row (downwards).

    Hidden nodes stand in columns by level, between inputs and outputs. There is a gap between the
    rows where the first word of an input's name changes, or an output's before its last word.
    """
    kind = genome.node_kind
    points = np.stack([node_columns(genome), np.zeros(kind.size)], 1)
    sensors = np.argsort(kind, kind="stable")[: (kind <= NodeKind.BIAS).sum()]  # the bias below
    outputs = np.flatnonzero(kind == NodeKind.OUTPUT)
    left = _name_rows([names[node].split(" ")[0] for node in sensors])
    right = _name_rows([names[node].rpartition(" ")[0] for node in outputs])
    points[:, 1] = middle = max(left[-1], right[-1]) / 2
    points[sensors, 1] = left + middle - left[-1] / 2
    points[outputs, 1] = right + middle - right[-1] / 2
    for _ in range(4):  # hidden nodes move to the middle of their neighbours
        _pull_hidden(genome, points)
    return points


def node_columns(genome: Genome) -> np.ndarray:
    """Column of each node: hidden nodes by level, at least 1; outputs behind all of them."""
    kind, forward = genome.node_kind, ~genome.link_recurrent
    hidden = np.flatnonzero(kind == NodeKind.HIDDEN)
    # One more link from the first input to each hidden node keeps those without any at level 1.
    sources = np.append(genome.source_index[forward], np.full(hidden.size, kind.argmin()))
    levels = node_levels(sources, np.append(genome.target_index[forward], hidden), kind.size)
    assert levels is not None  # a genome's forward links form no cycle
    distinct, rank = np.unique(levels[hidden], return_inverse=True)
    columns = np.where(kind == NodeKind.OUTPUT, max(distinct.size, 1) + 1.0, 0.0)
    columns[hidden] = rank + 1
    return columns


def _name_rows(groups: Sequence[str]) -> np.ndarray:
    """One row for each name [names], with a gap where the next group begins."""
    return np.cumsum([0.0, *(1 + GAP_ROWS * (a != b) for a, b in pairwise(groups))])


def _pull_hidden(genome: Genome, points: np.ndarray) -> None:
    """Move each hidden node to the mean row of its neighbours, one row from the next at least."""
    rows, ends = points[:, 1], np.stack([genome.source_index, genome.target_index])
    ends = ends[:, ends[0] != ends[1]]
    near, far = ends.ravel(), ends[::-1].ravel()
    total, count = (np.bincount(near, one, rows.size) for one in (rows[far], None))
    wanted = np.where(count > 0, total / np.maximum(count, 1), rows)
    hidden = genome.node_kind == NodeKind.HIDDEN
    for column in np.unique(points[hidden, 0]):
        nodes = np.flatnonzero(hidden & (points[:, 0] == column))
        nodes = nodes[np.argsort(wanted[nodes], kind="stable")]
        room = HIDDEN_ROWS * np.arange(nodes.size)
        free = wanted[nodes] - room
        pushed = np.maximum.accumulate(free) + np.minimum.accumulate(free[::-1])[::-1]
        points[nodes, 1] = pushed / 2 + room
