"""One network as plain numbers in the order of computation, for programs without torch."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind, node_levels
from neatq_torch.kinds import ConfigError
from neatq_torch.network import Evaluation, check_evaluation

Scaling = tuple[ArrayLike, ArrayLike, float]
"""Offset and scale [inputs], and the largest value: a network that was trained on scaled
observations reads (observation - offset) / scale, clipped to [-largest, largest]."""


class RecipeNode(NamedTuple):
    """A hidden node or output: its activation, and the value that each of its links weighs."""

    activation: str
    sources: tuple[int, ...]
    weights: tuple[np.float32, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Recipe:
    """The computation of one network.

    Its values stand in this order: inputs, a one for the bias, the state, and the nodes in the
    order in which they are computed.

    Attributes:
        inputs: Numbers of an observation.
        state: Numbers that are kept from call to call.
        nodes: In the order in which they are computed.
        outputs: Which values are the outputs [outputs].
        kept: Which values are the state of the next call [state].
    """

    inputs: int
    state: int
    nodes: tuple[RecipeNode, ...]
    outputs: tuple[int, ...]
    kept: tuple[int, ...]

    @property
    def first_node(self) -> int:
        """The value of the first node."""
        return self.inputs + 1 + self.state

    @property
    def links(self) -> int:
        """Enabled links."""
        return sum(len(node.weights) for node in self.nodes)

    @staticmethod
    def of(genome: Genome, evaluation: Evaluation) -> Recipe:
        """The computation of a genome's network; see `Evaluation`."""
        check_evaluation(evaluation)
        kind = genome.node_kind
        sensor = kind <= NodeKind.BIAS
        on = np.flatnonzero(genome.link_enabled)
        source, target = genome.source_index[on], genome.target_index[on]
        weight = genome.link_weight[on]
        late = ~sensor[source] if evaluation == "synchronous" else genome.link_recurrent[on]
        level = node_levels(source[~late], target[~late], kind.size)
        assert level is not None, "a valid genome has no cycle of forward links"
        computed = np.flatnonzero(~sensor)
        computed = computed[np.argsort(level[computed], kind="stable")]
        remembered = np.unique(source[late])
        inputs = int((kind == NodeKind.INPUT).sum())

        at = np.empty(kind.size, np.int64)
        at[kind == NodeKind.INPUT] = np.arange(inputs)
        at[kind == NodeKind.BIAS] = inputs
        at[computed] = inputs + 1 + remembered.size + np.arange(computed.size)
        read = at[source]
        read[late] = inputs + 1 + np.searchsorted(remembered, source[late])
        nodes = (
            RecipeNode(
                ACTIVATIONS[genome.node_activation[node]],
                tuple(read[target == node].tolist()),
                tuple(weight[target == node]),
            )
            for node in computed
        )
        return Recipe(
            inputs=inputs,
            state=remembered.size,
            nodes=tuple(nodes),
            outputs=tuple(at[kind == NodeKind.OUTPUT].tolist()),
            kept=tuple(at[remembered].tolist()),
        )


def scaling_columns(
    scaling: Scaling, inputs: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offset and scale, float64 [inputs] each; ConfigError if they are something else."""
    offset, scale = (np.asarray(column, np.float64) for column in scaling[:2])
    if offset.shape != (inputs,) or scale.shape != (inputs,):
        raise ConfigError(
            f"scaling: expected an offset and a scale for each of the {inputs} inputs, got shapes "
            f"{offset.shape} and {scale.shape}."
        )
    with np.errstate(over="ignore"):
        single = offset.astype(np.float32), scale.astype(np.float32)
    if not (np.isfinite(single).all() and (single[1] != 0).all()):
        raise ConfigError(
            "scaling: expected finite offsets and finite scales other than 0, in single precision."
        )
    return offset, scale


def described(genome: Genome, recipe: Recipe, comment: Sequence[str]) -> list[str]:
    """What a source says of itself at its top, as lines of ASCII."""
    lines = [
        f"A network of neatq_torch: {recipe.inputs} inputs, {len(recipe.outputs)} outputs, "
        f"{len(recipe.nodes)} nodes,",
        f"{recipe.links} links and a state of {recipe.state} numbers; genome {genome.genome_id}.",
    ]
    if genome.observation_schema:
        lines.append(f"It reads the observations {genome.observation_schema!r}.")
    plain = (ascii(line)[1:-1] for text in (*lines, *comment) for line in text.splitlines())
    return [part for line in plain for part in textwrap.wrap(line, 94) or [""]]
