"""A genome as a graph that a person can read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path

from neatq_torch.genome import Genome, NodeKind
from neatq_trainers.genome_layout import node_names, node_places

POSITIVE, NEGATIVE, GREY = "#1565c0", "#d84315", "#4d4d4d"
FILL = {
    NodeKind.INPUT: "#cfd8dc",
    NodeKind.BIAS: "#ffffff",
    NodeKind.HIDDEN: "#ffe082",
    NodeKind.OUTPUT: "#a5d6a7",
}
COLUMN_INCHES, WIDEST_INCHES, ROW_INCHES = 1.9, 16.0, 0.33
FAINTEST, GROWN_FAINTEST = 0.05, 0.5
"""Least opacity of links; links that evolution added must be seen, however weak."""


def draw_genome(
    genome: Genome,
    *,
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
) -> Figure:
    """Draw inputs on the left, outputs on the right, and hidden nodes by level between them.

    Enabled links are drawn, disabled ones left out and counted in the title. Blue is a positive
    weight and red a negative one; the larger a weight, the wider and darker its link. Weak links
    are faint, unless they belong to a hidden node or are recurrent. Forward links are straight,
    recurrent ones curved and dashed. Every artist of a gene has a `gid`, "node 17" or "link 23"
    (its innovation), which an SVG keeps.

    Args:
        genome: What to draw.
        input_names: One for each input. Default: those of the genome's observation schema, else
            "input 0", "input 1", ...
        output_names: One for each output. Default: candidates and Q-values if the genome has a
            known schema and as many outputs as they need, else "output 0", "output 1", ...

    Raises:
        ValueError: If there are more or fewer names than nodes.
    """
    names = node_names(genome, input_names, output_names)
    places = node_places(genome, names)
    width, height = np.ptp(places, axis=0)
    inches = (min(WIDEST_INCHES, 4.4 + COLUMN_INCHES * width), 2.0 + ROW_INCHES * height)
    figure = Figure(figsize=inches, layout="constrained")
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.set_xlim(-0.1, width + 0.1)
    axes.set_ylim(places[:, 1].max() + 1.2, places[:, 1].min() - 1.6)
    _draw_links(axes, genome, places)
    _draw_nodes(axes, genome, places, names)
    axes.set_title(_title(genome), fontsize=11)
    figure.legend(handles=_legend(genome), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _draw_links(axes: Axes, genome: Genome, places: np.ndarray) -> None:
    """Draw the enabled links, strong ones on top."""
    enabled = np.flatnonzero(genome.link_enabled)
    size = np.abs(genome.link_weight)
    largest = size[enabled].max(initial=0.0) or 1.0
    recurrent, grown = genome.link_recurrent, _grown(genome)
    middle = places[:, 1].max() / 2
    crowded = FAINTEST + min(GROWN_FAINTEST - FAINTEST, 5 / max(1, enabled.size))
    for link in enabled[np.lexsort((size[enabled], grown[enabled]))]:
        strength = float(size[link] / largest)
        start, end = places[genome.source_index[link]], places[genome.target_index[link]]
        patch = _link_patch(start, end, middle, curved=bool(recurrent[link]))
        patch.set(
            gid=f"link {genome.link_innovation[link]}",
            color=POSITIVE if genome.link_weight[link] >= 0 else NEGATIVE,
            alpha=max(_alpha(strength), GROWN_FAINTEST if grown[link] else crowded),
            linewidth=_width(strength),
            linestyle=(0, (4, 1.5)) if recurrent[link] else "-",
            zorder=1 + strength,
        )
        axes.add_patch(patch)


def _grown(genome: Genome) -> np.ndarray:
    """Links that evolution added [links]: those of hidden nodes and recurrent ones."""
    hidden = genome.node_kind == NodeKind.HIDDEN
    return hidden[genome.source_index] | hidden[genome.target_index] | genome.link_recurrent


def _alpha(strength: float) -> float:
    return 0.95 * strength**2.2


def _width(strength: float) -> float:
    return 0.7 + 2.5 * strength**1.5


def _link_patch(
    start: np.ndarray, end: np.ndarray, middle: float, *, curved: bool
) -> FancyArrowPatch:
    """A line; an arrow where it does not simply lead to the right. `middle` is a row."""
    if (start == end).all():
        x, y = start
        loop = [(x, y), (x - 0.18, y - 1), (x + 0.18, y - 1), (x, y)]
        path = Path(loop, [Path.MOVETO, Path.CURVE4, Path.CURVE4, Path.CURVE4])
        return FancyArrowPatch(path=path, arrowstyle="-", fill=False)
    if not curved and start[0] < end[0]:
        return FancyArrowPatch(tuple(start), tuple(end), arrowstyle="-", shrinkA=0, shrinkB=0)
    if start[0] == end[0]:
        to_left = end[1] > start[1]  # away from the names beside outputs
    else:
        to_left = ((start[1] + end[1]) / 2 > middle) == (end[0] < start[0])  # towards the middle
    return FancyArrowPatch(
        tuple(start),
        tuple(end),
        arrowstyle="-|>",
        connectionstyle=f"arc3,rad={0.25 if to_left else -0.25}",
        shrinkA=0,
        shrinkB=8,
        mutation_scale=9,
    )


def _draw_nodes(axes: Axes, genome: Genome, places: np.ndarray, names: Sequence[str]) -> None:
    ids, kinds = genome.node_id.tolist(), genome.node_kind.tolist()
    for node, kind, (x, y), name in zip(ids, kinds, places, names, strict=True):
        hidden = kind == NodeKind.HIDDEN
        axes.plot(
            x,
            y,
            "o",
            ms=15 if hidden else 9,
            color=FILL[NodeKind(kind)],
            mec="black",
            mew=0.8,
            zorder=4,
            gid=f"node {node}",
            clip_on=False,
        )
        if hidden:
            axes.text(x, y, name, ha="center", va="center", fontsize=6.5, zorder=5)
            continue
        side, offset = ("left", 9) if kind == NodeKind.OUTPUT else ("right", -9)
        axes.annotate(
            name, (x, y), (offset, 0), textcoords="offset points", ha=side, va="center", fontsize=9
        )


def _title(genome: Genome) -> str:
    enabled = int(genome.link_enabled.sum())
    disabled = genome.link_enabled.size - enabled
    hidden = int((genome.node_kind == NodeKind.HIDDEN).sum())
    left_out = f" (and {disabled} disabled, not drawn)" if disabled else ""
    return (
        f"Genome {genome.genome_id}: {genome.input_ids.size} inputs, {hidden} hidden, "
        f"{genome.output_ids.size} outputs, {enabled} links{left_out}\n"
        "signals run from left to right"
    )


def _legend(genome: Genome) -> list[Artist]:
    size = np.abs(genome.link_weight[genome.link_enabled])
    largest = float(size.max(initial=0.0))
    handles: list[Artist] = [
        Line2D([], [], color=POSITIVE, lw=2, label="positive weight"),
        Line2D([], [], color=NEGATIVE, lw=2, label="negative weight"),
    ]
    for strength in (1.0, 0.6):
        line = Line2D([], [], color=GREY, lw=_width(strength), alpha=_alpha(strength))
        line.set_label(f"weight of size {strength * largest:.2g}")
        handles.append(line)
    if (genome.node_kind == NodeKind.HIDDEN).any():
        node = Line2D([], [], color=FILL[NodeKind.HIDDEN], marker="o", ls="", ms=11, mec="black")
        node.set_label("hidden node (its id)")
        handles.append(node)
    if genome.link_recurrent[genome.link_enabled].any():
        label = "recurrent (value of the tick before)"
        handles.append(Line2D([], [], color=GREY, ls="--", lw=1.6, label=label))
    return handles
