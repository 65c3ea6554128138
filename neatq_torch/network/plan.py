"""From genomes to integers: the one place that knows where a link's weight is kept.

A network's values stand in rows of its own count::

    [ inputs | bias | outputs | state | hidden ]

and its weights in one row of `Layout.columns` columns, as many for every network::

    [ (inputs + bias) x outputs, dense | other links ]

Links from an input to an output, with which every NEAT genome starts, are the dense part: a matrix
for each network, a row of it for each input. All other links are sparse, and their columns are in
the order in which they are evaluated. So an instruction need not say where its weights are: "add
the next `links` weights times values to this row, then activate it".

No number here depends on another network of the population. Replacing one genome writes its own
rows and nobody else's; when it needs more room than there is, every array gets more columns, and
nothing that was written moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.heredity import node_levels
from neatq_torch.genome.rules import ACTIVATIONS, NodeKind
from neatq_torch.kinds import ConfigError

Evaluation = Literal["settle", "synchronous"]
"""`settle`: forward links are evaluated in order within one call; recurrent links read the call
before. `synchronous`: one propagation a call, every link out of a hidden or output node reads the
call before (Stanley's C++ NEAT, OpenNERO)."""

IDENTITY = ACTIVATIONS.index("identity")
DIGEST_BYTES = 16
LAST_LEVEL = np.iinfo(np.int32).max
"""The level of outputs that no link reads within the call: after all others."""

Indices = NDArray[np.integer]


class Layout(NamedTuple):
    """How much room each network of a population has.

    Attributes:
        inputs: Observations of a network, without the bias.
        outputs: Outputs of a network.
        state: Values that recurrent links read from the call before.
        hidden: Hidden nodes.
        sparse: Links outside the dense part.
        instructions: Instructions of `Program`.
    """

    inputs: int
    outputs: int
    state: int = 0
    hidden: int = 0
    sparse: int = 0
    instructions: int = 0

    @property
    def dense(self) -> int:
        """Columns of the dense part."""
        return self.outputs * (self.inputs + 1)

    @property
    def columns(self) -> int:
        """Columns of the weight parameter."""
        return self.dense + self.sparse

    @property
    def first_state(self) -> int:
        """Row of the first value of the state."""
        return self.inputs + 1 + self.outputs

    @property
    def rows(self) -> int:
        """Values of one network."""
        return self.first_state + self.state + self.hidden

    @staticmethod
    def union(layouts: Sequence[Layout]) -> Layout:
        """The smallest layout that holds all of `layouts`, which agree in inputs and outputs."""
        return Layout._make(max(sizes) for sizes in zip(*layouts, strict=True))

    def with_slack(self) -> Layout:
        """A layout in which the next genomes fit as well: a quarter more, and at least four."""

        def more(size: int) -> int:
            return size + max(4, size // 4)

        grown = {name: more(getattr(self, name)) for name in ("hidden", "sparse", "instructions")}
        return self._replace(state=more(self.state) if self.state else 0, **grown)


@dataclass(frozen=True, eq=False, kw_only=True)
class GenomePlan:
    """One genome in evaluation order, independent of any population.

    Attributes:
        need: The smallest layout that holds it.
        enabled: Positions of the enabled links in the genome [enabled].
        column: Weight column of each enabled link [enabled].
        kept: Rows whose values the state keeps [state].
        instruction: See `Program` [instructions, 5].
        source: Row that each sparse link reads, in the order of the columns [sparse].
        digest: Of all that the meaning of the weights depends on: the same for two genomes of the
            same nodes and enabled links, in the same order, evaluated in the same way.
    """

    need: Layout
    enabled: Indices
    column: Indices
    kept: Indices
    instruction: Indices
    source: Indices
    digest: bytes


def check_evaluation(evaluation: str) -> None:
    """Refuse, as a ConfigError, what is no `Evaluation`: it would be taken for `settle`."""
    if evaluation not in get_args(Evaluation):
        raise ConfigError(f"evaluation: expected 'settle' or 'synchronous'; got {evaluation!r}")


def compile_genome(genome: Genome, evaluation: Evaluation) -> GenomePlan:
    """A valid genome's enabled links and nodes in evaluation order, to be read only.

    Most genomes of a population differ in weights only, so the plans of the last few thousand
    structures are kept.
    """
    check_evaluation(evaluation)
    columns = (
        *(genome.node_id, genome.node_kind, genome.node_activation),
        *(genome.link_source, genome.link_target, genome.link_enabled, genome.link_recurrent),
    )
    return _compile(_Structure(tuple(column.tobytes() for column in columns), genome), evaluation)


@dataclass(frozen=True)
class _Structure:
    """A genome that equals all others of the same plan."""

    key: tuple[bytes, ...]
    genome: Genome = field(compare=False)


@lru_cache(4096)
def _compile(structure: _Structure, evaluation: Evaluation) -> GenomePlan:
    genome = structure.genome
    kind = genome.node_kind
    sensor = (kind == NodeKind.INPUT) | (kind == NodeKind.BIAS)
    inputs, outputs = len(genome.input_ids), len(genome.output_ids)
    enabled = np.flatnonzero(genome.link_enabled)
    source, target = genome.source_index[enabled], genome.target_index[enabled]
    synchronous = evaluation == "synchronous"
    delayed = ~sensor[source] if synchronous else genome.link_recurrent[enabled]
    now = ~delayed
    level = node_levels(source[now], target[now], len(kind))
    assert level is not None, "a valid genome has no cycle of forward links"

    state = np.unique(source[delayed])
    row = _rows(kind, len(state))
    dense = sensor[source] & now & (kind[target] == NodeKind.OUTPUT)
    dense &= ~_second(source, target, genome.link_recurrent[enabled], len(kind))
    sparse = np.flatnonzero(~dense)
    sparse = sparse[np.lexsort((target[sparse], level[target[sparse]]))]
    column = np.empty(len(enabled), np.int32)
    column[dense] = row[source[dense]] * outputs + row[target[dense]] - (inputs + 1)
    column[sparse] = outputs * (inputs + 1) + np.arange(len(sparse))

    source_row = row[source]
    source_row[delayed] = inputs + 1 + outputs + np.searchsorted(state, source[delayed])
    read = np.zeros(len(kind), bool)
    read[source[now]] = True
    links = np.bincount(target[sparse], minlength=len(kind))
    instruction = _instructions(genome, row, level, links, read)
    hidden = int((kind == NodeKind.HIDDEN).sum())
    return GenomePlan(
        need=Layout(inputs, outputs, len(state), hidden, len(sparse), len(instruction)),
        enabled=enabled.astype(np.int32),
        column=column,
        kept=row[state],
        instruction=instruction,
        source=source_row[sparse],
        digest=_digest(genome, evaluation),
    )


def _digest(genome: Genome, evaluation: Evaluation) -> bytes:
    digest = blake2b(evaluation.encode(), digest_size=DIGEST_BYTES)
    links = genome.link_source, genome.link_target, genome.link_recurrent
    columns = genome.node_id, genome.node_kind, genome.node_activation
    for column in (*columns, *(link[genome.link_enabled] for link in links)):
        digest.update(len(column).to_bytes(8, "little") + column.tobytes())
    return digest.digest()


def _second(
    source: Indices, target: Indices, recurrent: NDArray[np.bool_], nodes: int
) -> NDArray[np.bool_]:
    """Which links are the recurrent one of two that lead from one node to one other [enabled].

    The dense part has one column for each pair of nodes, and that is the other's.
    """
    pair = source * nodes + target
    return recurrent & np.isin(pair, pair[~recurrent])


def _rows(kind: Indices, state: int) -> NDArray[np.int32]:
    """The value row of each node [nodes], in a network that keeps `state` values."""
    row = np.empty(len(kind), np.int32)
    row[np.argsort(kind, kind="stable")] = np.arange(len(kind))
    if NodeKind.BIAS not in kind:  # which has its row nevertheless
        row[kind > NodeKind.BIAS] += 1
    row[kind == NodeKind.HIDDEN] += state
    return row


def _instructions(
    genome: Genome, row: Indices, level: Indices, links: Indices, read: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """The instructions of a genome, see `Program` [instructions, 5].

    For each node: its value row, the longest path of links that ends in it, the number of sparse
    links into it, and whether a link reads it within the call [nodes].
    """
    kind, activation = genome.node_kind, genome.node_activation
    hidden, output = kind == NodeKind.HIDDEN, kind == NodeKind.OUTPUT
    own = hidden | (output & read)  # these are activated before the last level
    nodes = np.flatnonzero(own | (output & (links > 0)))
    nodes = nodes[np.lexsort((nodes, level[nodes]))]
    code = np.where(own[nodes], activation[nodes], IDENTITY)
    single = _instruction_rows(row[nodes], 1, links[nodes], code, level[nodes])

    last = np.where(own, IDENTITY, activation)[output]
    start = np.flatnonzero(np.diff(last, prepend=-1))
    rows = np.diff(start, append=len(last))
    runs = _instruction_rows(len(genome.input_ids) + 1 + start, rows, 0, last[start], LAST_LEVEL)
    return np.concatenate([single, runs[runs[:, 3] != IDENTITY]])


def _instruction_rows(*columns: Indices | int) -> NDArray[np.int32]:
    return np.stack(np.broadcast_arrays(*columns), 1).astype(np.int32)


class Program(NamedTuple):
    """The evaluation order of a whole population, as arrays that begin with [networks].

    What lies beyond a network's own sizes are zeros that nobody reads.

    Attributes:
        size: Instructions, values of the state and hidden nodes of each network [networks, 3].
        instruction: [networks, instructions, 5]: a first row, a number of rows, links, activation,
            level. The next `links` sparse links add weight * value to the first row, if there are
            any; then all these rows are activated. Instructions stand in an order in which every
            row is read after its activation. The level is the longest path of links that ends in
            the row, and links only read rows of lower levels.
        source: Row that each sparse link reads [networks, sparse].
        kept: Rows whose values the state keeps [networks, state].
        live: Whether a link belongs to a dense column [networks, dense]. The weights of all other
            dense columns are read as zero and get no gradient.
    """

    size: NDArray[np.int32]
    instruction: NDArray[np.int32]
    source: NDArray[np.int32]
    kept: NDArray[np.int32]
    live: NDArray[np.bool_]
