"""The words that genes are written in and the rules that every genome keeps.

Each breach is a GenomeError that names the gene.
"""

from __future__ import annotations

from enum import IntEnum
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.heredity import node_levels
from neatq_torch.jit import cached_njit

if TYPE_CHECKING:
    from neatq_torch.genome.genome import Genome

ACTIVATIONS: tuple[str, ...] = ("identity", "sigmoid", "steep_sigmoid", "tanh", "relu")
"""Names of the node activations; a gene holds the index.

"sigmoid" has slope 1, as in OpenNERO; "steep_sigmoid" slope 4.9 (Stanley & Miikkulainen 2002).
"""

NODE_FIELDS = {"node_id": np.int32, "node_kind": np.uint8, "node_activation": np.uint8}
LINK_FIELDS = {
    "link_innovation": np.int64,
    "link_source": np.int32,
    "link_target": np.int32,
    "link_weight": np.float32,
    "link_enabled": np.bool_,
    "link_recurrent": np.bool_,
}


class NodeKind(IntEnum):
    """What a node is for."""

    INPUT = 0
    BIAS = 1
    OUTPUT = 2
    HIDDEN = 3


class GenomeError(ValueError):
    """A genome breaks a rule; the message names the gene or the key and how to mend it."""


def index_of(word: str, words: tuple[str, ...], noun: str) -> int:
    """Return the index of a word; GenomeError, which calls it by the noun, if it is unknown."""
    if word not in words:
        raise GenomeError(f"{noun} {word!r} is unknown; choose one of {', '.join(words)}.")
    return words.index(word)


def frozen_array(name: str, value: object, dtype: type[np.generic]) -> NDArray[Any]:
    """Return `value` as a read-only array [entries] of `dtype` that nobody else can write to."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise GenomeError(f"{name} must be a 1-D array: {error}.") from error
    if array.ndim != 1:
        raise GenomeError(f"{name} must be a 1-D array, not one of shape {array.shape}.")
    if array.dtype == dtype and array.flags.owndata and not array.flags.writeable:
        return array
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            converted = array.astype(dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise GenomeError(f"{name} cannot be read as {dtype.__name__}: {error}.") from error
    # Weights may be rounded to float32; ids and flags must arrive as they were.
    if array.dtype != dtype and dtype is not np.float32 and array.size:
        text = f"{name}[{{}}] is {{}}, which is no {dtype.__name__}."
        _refuse(converted != array, text, np.arange(array.size), array)
    converted.flags.writeable = False
    return converted


def _refuse(wrong: NDArray[np.bool_], text: str, *columns: NDArray[Any]) -> None:
    """Raise a GenomeError if an entry is wrong; the first one's values in columns fill the text."""
    if wrong.any():
        first = wrong.argmax()
        raise GenomeError(text.format(*(column[first] for column in columns)))


def check_genome(genome: Genome) -> None:
    """Raise a GenomeError if the genome breaks a rule."""
    check_label(genome)
    for fields in (NODE_FIELDS, LINK_FIELDS):
        lengths = {name: getattr(genome, name).size for name in fields}
        if len(set(lengths.values())) > 1:
            raise GenomeError(f"arrays must have one entry for each gene, not {lengths}.")
    _check_nodes(genome)
    check_weights(genome.link_innovation, genome.link_weight)
    if genome.link_innovation.size:
        check_innovations(genome.link_innovation)
        _check_ends(genome)
        _check_links_once(genome)
        _check_acyclic(genome)


def check_label(genome: Genome) -> None:
    """Raise a GenomeError unless id and schema are an int64 and a text."""
    number, schema = genome.genome_id, genome.observation_schema
    whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
    if not (whole and -(2**63) <= number < 2**63):
        raise GenomeError("genome_id must be a whole number from -2^63 to 2^63 - 1.")
    if not isinstance(schema, str):
        raise GenomeError(f"observation_schema must be a text, not {type(schema).__name__}.")


def _check_nodes(genome: Genome) -> None:
    ids, kinds, activations = genome.node_id, genome.node_kind, genome.node_activation
    ordered = ids[genome.node_order]
    twice = "node id {} occurs more than once; node ids must be unique."
    _refuse(ordered[1:] == ordered[:-1], twice, ordered)
    unknown = f"node {{}}: kind {{}} is no NodeKind: these are below {len(NodeKind)}."
    _refuse(kinds >= len(NodeKind), unknown, ids, kinds)
    for kind in (NodeKind.INPUT, NodeKind.OUTPUT):
        if kind not in kinds:
            missing = kind.name.lower()
            raise GenomeError(f"the genome has no {missing} node; it needs at least one.")
    biases = ids[kinds == NodeKind.BIAS].tolist()
    if len(biases) > 1:
        raise GenomeError(f"nodes {biases} are all of kind bias; a genome has at most one.")
    unknown = f"node {{}}: activation {{}} is no index into the {len(ACTIVATIONS)} ACTIVATIONS."
    _refuse(activations >= len(ACTIVATIONS), unknown, ids, activations)


def check_weights(innovation: NDArray[np.int64], weight: NDArray[np.float32]) -> None:
    """Raise a GenomeError naming the first link whose weight is not finite."""
    if not _all_finite(weight):
        text = "link with innovation {}: weight {} is not a finite float32 number."
        _refuse(~np.isfinite(weight), text, innovation, weight)


@cached_njit()
def _all_finite(weight: NDArray[np.float32]) -> bool:
    # Runs for every genome whenever robots write back what they learned: np.isfinite(...).all()
    # takes seven times as long.
    finite = True
    for one in weight:
        finite &= np.isfinite(one)
    return finite


def check_innovations(innovation: NDArray[np.int64]) -> None:
    """Raise a GenomeError naming the first link whose innovation does not rise."""
    before, after = innovation[:-1], innovation[1:]
    _refuse(before == after, "link with innovation {} occurs more than once.", after)
    text = "link with innovation {} follows the one with {}; links must be sorted by innovation."
    _refuse(before > after, text, after, before)


def _check_ends(genome: Genome) -> None:
    link = "link with innovation {}: "
    for end, ids in (("source", genome.link_source), ("target", genome.link_target)):
        text = f"{link}{end} {{}} is not a node of the genome; add the node or remove the link."
        unknown = genome.node_id[genome.node_index(ids)] != ids
        _refuse(unknown, text, genome.link_innovation, ids)
    text = f"{link}target {{}} is an input or bias node; links enter outputs and hidden nodes only."
    into_sensor = genome.node_kind[genome.target_index] <= NodeKind.BIAS
    _refuse(into_sensor, text, genome.link_innovation, genome.link_target)


def _check_links_once(genome: Genome) -> None:
    nodes = genome.node_id.size
    key = (genome.source_index * nodes + genome.target_index) * 2 + genome.link_recurrent
    ordered = np.sort(key)
    twice = ordered[1:] == ordered[:-1]
    if twice.any():
        same = np.flatnonzero(key == ordered[twice.argmax()])
        ends = f"from {genome.link_source[same[0]]} to {genome.link_target[same[0]]}"
        raise GenomeError(
            f"links with innovations {genome.link_innovation[same].tolist()} all lead {ends} with "
            f"recurrent={genome.link_recurrent[same[0]]}; keep one of them."
        )


def _check_acyclic(genome: Genome) -> None:
    forward = ~genome.link_recurrent
    sources, targets = genome.source_index[forward], genome.target_index[forward]
    if node_levels(sources, targets, genome.node_id.size) is None:
        nodes = genome.node_id[find_cycle(sources, targets)].tolist()
        raise GenomeError(
            f"forward links form the cycle {' -> '.join(map(str, nodes))} over nodes {nodes[:-1]}; "
            "one of these links must be marked recurrent."
        )


def find_cycle(sources: NDArray[np.integer], targets: NDArray[np.integer]) -> list[int]:
    """Return node indices along one cycle of the links, the first again at the end; or []."""
    sorter: TopologicalSorter[int] = TopologicalSorter()
    for source, target in zip(sources.tolist(), targets.tolist(), strict=True):
        sorter.add(target, source)
    try:
        sorter.prepare()
    except CycleError as error:
        return error.args[1]
    return []
