"""Genomes as graphs, for other people's drawing and analysis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind
from neatq_torch.interop.extras import refuse_missing

if TYPE_CHECKING:
    import networkx

_SHAPES = {"input": "box", "bias": "box", "output": "doublecircle", "hidden": "circle"}


def to_networkx(genome: Genome) -> networkx.MultiDiGraph:
    """The genome as a directed graph of networkx.

    A multigraph, as a forward link and a recurrent one may lead between the same nodes.

    Args:
        genome: What to convert; disabled links come, too.

    Returns:
        Nodes are named by their ids, with `kind` ("input", "bias", "output", "hidden") and
        `activation`; edges have the innovation as key, and `weight`, `enabled` and `recurrent`.

    Raises:
        ModuleNotFoundError: networkx is not installed.

    Example:
        >>> graph = to_networkx(genome)
        >>> networkx.shortest_path(graph, 1, 4)
    """
    refuse_missing("to_networkx", networkx="networkx")
    import networkx

    graph = networkx.MultiDiGraph()
    for node, kind, activation in graph_nodes(genome):
        graph.add_node(node, kind=kind, activation=activation)
    for source, target, innovation, link in graph_links(genome):
        graph.add_edge(source, target, key=innovation, **link)
    return graph


def to_graphviz(genome: Genome) -> str:
    """The genome in the language of Graphviz (DOT), from the inputs at the left to the outputs.

    Positive weights are blue and negative ones red, and the greater the wider; recurrent links are
    dashed, disabled ones grey and dotted.

    Args:
        genome: What to draw.

    Returns:
        A text for `dot -Tsvg`, https://graphviz.org.

    Example:
        >>> Path("champion.dot").write_text(to_graphviz(genome))
    """
    lines = [f"digraph genome_{abs(genome.genome_id)} {{", "    rankdir=LR;"]
    ranks: dict[str, list[int]] = {}
    for node, kind, activation in graph_nodes(genome):
        words = kind if kind in ("input", "bias") else activation
        lines.append(f'    "{node}" [label="{node}\\n{words}", shape={_SHAPES[kind]}];')
        ranks.setdefault("min" if kind in ("input", "bias") else kind, []).append(node)
    for rank, kind in (("source", "min"), ("sink", "output")):
        members = " ".join(f'"{node}";' for node in ranks[kind])
        lines.append(f"    {{ rank={rank}; {members} }}")
    for source, target, _, link in graph_links(genome):
        weight = link["weight"]
        color = "blue" if weight >= 0 else "red"
        style = "dashed, constraint=false" if link["recurrent"] else "solid"
        if not link["enabled"]:
            color, style = "grey", "dotted"
        width = f"{min(0.5 + abs(weight), 5.0):.2f}"
        attributes = f'label="{weight:.3g}", color={color}, penwidth={width}, style={style}'
        lines.append(f'    "{source}" -> "{target}" [{attributes}];')
    return "\n".join([*lines, "}", ""])


def graph_nodes(genome: Genome) -> list[tuple[int, str, str]]:
    """Id, kind and activation of each node."""
    kinds = [NodeKind(kind).name.lower() for kind in genome.node_kind]
    activations = [ACTIVATIONS[code] for code in genome.node_activation]
    return list(zip(genome.node_id.tolist(), kinds, activations, strict=True))


def graph_links(genome: Genome) -> list[tuple[int, int, int, dict[str, Any]]]:
    """Source, target, innovation and what else there is of each link."""
    names = ("source", "target", "innovation", "weight", "enabled", "recurrent")
    columns = (getattr(genome, f"link_{name}").tolist() for name in names)
    return [
        (source, target, innovation, dict(zip(names[3:], rest, strict=True)))
        for source, target, innovation, *rest in zip(*columns, strict=True)
    ]
