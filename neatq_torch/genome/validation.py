"""The rules every genome keeps; each breach is a GenomeError that names the gene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_torch.genome.graph import find_cycle, node_levels
from neatq_torch.genome.vocabulary import ACTIVATIONS, GenomeError, NodeKind

if TYPE_CHECKING:
    from neatq_torch.genome.genome import Genome

NODE_FIELDS = {"node_id": np.int32, "node_kind": np.uint8, "node_activation": np.uint8}
LINK_FIELDS = {
    "link_innovation": np.int64,
    "link_source": np.int32,
    "link_target": np.int32,
    "link_weight": np.float32,
    "link_enabled": np.bool_,
    "link_recurrent": np.bool_,
}


def frozen_array(name: str, value: object, dtype: type[np.generic]) -> NDArray[Any]:
    """Return `value` as a read-only array [entries] of `dtype` that nobody else can write to."""
    array = np.asarray(value)
    if array.ndim != 1:
        raise GenomeError(f"{name} must be a 1-D array, not one of shape {array.shape}.")
    owned = array.dtype == dtype and array.flags.owndata and not array.flags.writeable
    if owned:
        return array
    converted = _converted(name, array, dtype)
    converted.flags.writeable = False
    return converted


def _converted(name: str, array: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
    if array.dtype == dtype or array.size == 0:
        return array.astype(dtype)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            converted = array.astype(dtype)
    except (TypeError, ValueError) as error:
        raise GenomeError(f"{name} cannot be read as {dtype.__name__}: {error}.") from error
    # Weights may be rounded to float32; ids and flags must arrive as they were.
    if dtype is not np.float32 and not np.array_equal(converted, array):
        wrong = int(np.flatnonzero(converted != array)[0])
        raise GenomeError(f"{name}[{wrong}] is {array[wrong]}, which is no {dtype.__name__}.")
    return converted


def check(genome: Genome) -> None:
    """Raise a GenomeError if the genome breaks a rule."""
    _check_lengths(genome, NODE_FIELDS)
    _check_lengths(genome, LINK_FIELDS)
    _check_nodes(genome)
    check_weights(genome.link_innovation, genome.link_weight)
    if genome.link_innovation.size:
        check_innovations(genome.link_innovation)
        _check_ends(genome)
        _check_links_once(genome)
        _check_acyclic(genome)


def _check_lengths(genome: Genome, fields: dict[str, type[np.generic]]) -> None:
    lengths = {name: getattr(genome, name).size for name in fields}
    if len(set(lengths.values())) > 1:
        raise GenomeError(f"arrays must have one entry for each gene, not {lengths}.")


def _check_nodes(genome: Genome) -> None:
    ids, kinds = genome.node_id, genome.node_kind
    ordered = ids[genome.node_order]
    if (ordered[1:] == ordered[:-1]).any():
        twice = ordered[1:][ordered[1:] == ordered[:-1]][0]
        raise GenomeError(f"node id {twice} occurs more than once; node ids must be unique.")
    counts = np.bincount(kinds, minlength=len(NodeKind))
    if counts.size > len(NodeKind):
        wrong = int(np.flatnonzero(kinds >= len(NodeKind))[0])
        raise GenomeError(f"node {ids[wrong]}: kind {kinds[wrong]} is none of {list(NodeKind)}.")
    if counts[NodeKind.INPUT] == 0 or counts[NodeKind.OUTPUT] == 0:
        missing = "input" if counts[NodeKind.INPUT] == 0 else "output"
        raise GenomeError(f"the genome has no {missing} node; it needs at least one.")
    if counts[NodeKind.BIAS] > 1:
        biases = ids[kinds == NodeKind.BIAS].tolist()
        raise GenomeError(f"nodes {biases} are all of kind bias; a genome has at most one.")
    if (genome.node_activation >= len(ACTIVATIONS)).any():
        wrong = int(np.flatnonzero(genome.node_activation >= len(ACTIVATIONS))[0])
        raise GenomeError(
            f"node {ids[wrong]}: activation {genome.node_activation[wrong]} is no index into "
            f"{ACTIVATIONS}."
        )


def check_weights(innovation: NDArray[np.int64], weight: NDArray[np.float32]) -> None:
    """Raise a GenomeError naming the first link whose weight is not finite."""
    if not _all_finite(weight):
        wrong = int(np.flatnonzero(~np.isfinite(weight))[0])
        raise GenomeError(
            f"link with innovation {innovation[wrong]}: weight {weight[wrong]} is not finite; "
            "weights are finite float32 numbers."
        )


@njit(cache=True)
def _all_finite(weight: NDArray[np.float32]) -> bool:
    # Runs for every genome whenever robots write back what they learned: np.isfinite(...).all()
    # takes seven times as long.
    finite = True
    for one in weight:
        finite &= np.isfinite(one)
    return finite


def check_innovations(innovation: NDArray[np.int64]) -> None:
    """Raise a GenomeError naming the first link whose innovation does not rise."""
    rising = innovation[1:] > innovation[:-1]
    if rising.all():
        return
    wrong = int(np.flatnonzero(~rising)[0])
    before, after = innovation[wrong], innovation[wrong + 1]
    if before == after:
        raise GenomeError(f"link with innovation {before} occurs more than once.")
    raise GenomeError(
        f"link with innovation {after} follows the one with {before}; links must be sorted by "
        "innovation."
    )


def _check_ends(genome: Genome) -> None:
    for end, ids in (("source", genome.link_source), ("target", genome.link_target)):
        unknown = genome.node_id[genome.node_index(ids)] != ids
        if unknown.any():
            wrong = int(np.flatnonzero(unknown)[0])
            raise GenomeError(
                f"link with innovation {genome.link_innovation[wrong]}: {end} {ids[wrong]} is "
                "not a node of the genome; add the node or remove the link."
            )
    into_sensor = genome.node_kind[genome.target_index] <= NodeKind.BIAS
    if into_sensor.any():
        wrong = int(np.flatnonzero(into_sensor)[0])
        raise GenomeError(
            f"link with innovation {genome.link_innovation[wrong]}: target "
            f"{genome.link_target[wrong]} is an input or bias node; links enter outputs and "
            "hidden nodes only."
        )


def _check_links_once(genome: Genome) -> None:
    nodes = genome.node_id.size
    key = (genome.source_index * nodes + genome.target_index) * 2 + genome.link_recurrent
    ordered = np.sort(key)
    if not (ordered[1:] == ordered[:-1]).any():
        return
    first = ordered[:-1][ordered[1:] == ordered[:-1]][0]
    innovations = genome.link_innovation[key == first].tolist()
    wrong = int(np.flatnonzero(key == first)[0])
    raise GenomeError(
        f"links with innovations {innovations} all lead from {genome.link_source[wrong]} to "
        f"{genome.link_target[wrong]} with recurrent={bool(genome.link_recurrent[wrong])}; "
        "keep one of them."
    )


def _check_acyclic(genome: Genome) -> None:
    forward = ~genome.link_recurrent
    sources, targets = genome.source_index[forward], genome.target_index[forward]
    if node_levels(sources, targets, genome.node_id.size) is None:
        nodes = genome.node_id[find_cycle(sources, targets)].tolist()
        path = " -> ".join(str(node) for node in [*nodes, nodes[0]])
        raise GenomeError(
            f"forward links form the cycle {path} over nodes {nodes}; one of these links must "
            "be marked recurrent."
        )
