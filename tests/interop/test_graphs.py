"""Genomes as graphs of other packages."""

from __future__ import annotations

import re
import shutil
import subprocess
from typing import Any

import networkx
import pytest

from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind
from neatq_torch.interop import to_graphviz, to_networkx


@pytest.fixture
def genome() -> Genome:
    """1 and the bias 2 into 4 and 3; 4 into 3 twice, once with the value of the call before."""
    fields: dict[str, Any] = {
        "node_id": [1, 2, 3, 4],
        "node_kind": [NodeKind.INPUT, NodeKind.BIAS, NodeKind.OUTPUT, NodeKind.HIDDEN],
        "node_activation": [0, 0, ACTIVATIONS.index("tanh"), ACTIVATIONS.index("relu")],
        "link_innovation": [3, 5, 6, 9],
        "link_source": [1, 2, 4, 4],
        "link_target": [4, 3, 3, 3],
        "link_weight": [2.0, 0.5, -0.25, 9.0],
        "link_enabled": [True, False, True, True],
        "link_recurrent": [False, False, False, True],
    }
    return Genome(genome_id=7, **fields)


def test_a_graph_of_networkx_holds_every_gene(genome: Genome) -> None:
    graph = to_networkx(genome)
    assert isinstance(graph, networkx.DiGraph)
    assert dict(graph.nodes(data=True)) == {
        1: {"kind": "input", "activation": "identity"},
        2: {"kind": "bias", "activation": "identity"},
        3: {"kind": "output", "activation": "tanh"},
        4: {"kind": "hidden", "activation": "relu"},
    }
    assert [edge[:3] for edge in graph.edges(keys=True)] == [
        (1, 4, 3),
        (2, 3, 5),
        (4, 3, 6),
        (4, 3, 9),
    ]
    assert graph.edges[4, 3, 9] == {"weight": 9.0, "enabled": True, "recurrent": True}
    assert graph.edges[2, 3, 5] == {"weight": 0.5, "enabled": False, "recurrent": False}
    assert networkx.shortest_path(graph, 1, 3) == [1, 4, 3]


def test_without_networkx_the_error_says_what_to_install(
    genome: Genome, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("neatq_torch.interop.extras.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match="to_networkx needs networkx: pip install"):
        to_networkx(genome)


def test_graphviz_gets_every_node_and_link(genome: Genome) -> None:
    text = to_graphviz(genome)
    assert '"1" [label="1\\ninput", shape=box];' in text
    assert '"4" [label="4\\nrelu", shape=circle];' in text
    assert '{ rank=source; "1"; "2"; }' in text
    assert '{ rank=sink; "3"; }' in text
    links = dict(re.findall(r'("\d+" -> "\d+") \[label="(?:-0.25|2|0.5)", (.*)\];', text))
    assert links == {
        '"1" -> "4"': "color=blue, penwidth=2.50, style=solid",
        '"2" -> "3"': "color=grey, penwidth=1.00, style=dotted",
        '"4" -> "3"': "color=red, penwidth=0.75, style=solid",
    }
    assert 'label="9", color=blue, penwidth=5.00, style=dashed, constraint=false' in text


@pytest.mark.skipif(shutil.which("dot") is None, reason="no Graphviz")
def test_graphviz_takes_it(genome: Genome) -> None:
    drawn = subprocess.run(
        ["dot", "-Tsvg"], input=to_graphviz(genome), capture_output=True, text=True, check=True
    )
    assert "</svg>" in drawn.stdout
