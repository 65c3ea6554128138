from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neatq_torch.genome import Genome, NodeKind

Link = tuple[int, int, int, float]


def build(links: list[Link], hidden: tuple[int, ...] = (), **changes: Any) -> Genome:
    """Inputs 1 and 2, bias 3, output 4; links are (innovation, source, target, weight)."""
    outer = [NodeKind.INPUT, NodeKind.INPUT, NodeKind.BIAS, NodeKind.OUTPUT]
    columns = list(zip(*links, strict=True)) if links else [[], [], [], []]
    fields: dict[str, Any] = {
        "genome_id": 7,
        "node_id": [1, 2, 3, 4, *hidden],
        "node_kind": [*outer, *[NodeKind.HIDDEN] * len(hidden)],
        "node_activation": [0, 0, 0, 1, *[1] * len(hidden)],
        "link_innovation": columns[0],
        "link_source": columns[1],
        "link_target": columns[2],
        "link_weight": columns[3],
        "link_enabled": [True] * len(links),
        "link_recurrent": [False] * len(links),
    }
    return Genome(**(fields | changes))


@pytest.fixture(scope="session")
def make_genome() -> Callable[..., Genome]:
    return build


@pytest.fixture(scope="session")
def small(make_genome: Callable[..., Genome]) -> Genome:
    """Three links into the output and one hidden node on the way from input 1."""
    links = [(1, 1, 4, 0.5), (2, 2, 4, -1.0), (3, 3, 4, 0.1), (4, 1, 5, 1.0), (5, 5, 4, 0.3)]
    return make_genome(links, hidden=(5,))
