"""The words that genes are written in."""

from __future__ import annotations

from enum import IntEnum

ACTIVATIONS: tuple[str, ...] = ("identity", "sigmoid", "steep_sigmoid", "tanh", "relu")
"""Names of the node activations; a gene holds the index.

"sigmoid" has slope 1, as in OpenNERO; "steep_sigmoid" slope 4.9 (Stanley & Miikkulainen 2002).
"""


class NodeKind(IntEnum):
    """What a node is for."""

    INPUT = 0
    BIAS = 1
    OUTPUT = 2
    HIDDEN = 3


class GenomeError(ValueError):
    """A genome breaks a rule; the message names the gene or the key and how to mend it."""


def activation_index(name: str) -> int:
    """Return the index of an activation in `ACTIVATIONS`; GenomeError if it has none."""
    if name not in ACTIVATIONS:
        raise GenomeError(
            f"activation {name!r} is unknown; choose one of {', '.join(ACTIVATIONS)}."
        )
    return ACTIVATIONS.index(name)
