"""Crossover: a child from two parents whose genes are lined up by innovation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome, GenomeError
from neatq_torch.genome.graph import node_levels
from neatq_torch.genome.innovation import matching
from neatq_torch.genome.validation import LINK_FIELDS, NODE_FIELDS


@dataclass(frozen=True, kw_only=True)
class CrossoverConfig:
    """What a child takes from its parents.

    Attributes:
        keep_all_genes: the child gets the disjoint and excess genes of both parents, as in
            OpenNERO; else those of the fitter one (Stanley & Miikkulainen 2002). Where the
            genes of both would form a cycle of forward links, the fitter one's are taken.
        inherit_disabled_prob: probability that a matching gene which is disabled in either
            parent is disabled in the child; it is enabled otherwise.
        copy_disabled: a gene taken from a parent that has it disabled stays disabled even if
            `inherit_disabled_prob` spared it, as in OpenNERO's code (multipoint only).
    """

    keep_all_genes: bool = True
    inherit_disabled_prob: float = 0.75
    copy_disabled: bool = False

    def __post_init__(self) -> None:
        """Check every value."""
        if not 0.0 <= self.inherit_disabled_prob <= 1.0:
            raise ValueError(
                "inherit_disabled_prob must be a probability in [0, 1], not "
                f"{self.inherit_disabled_prob}."
            )


def first_is_fitter(
    first: Genome, second: Genome, first_fitness: float, second_fitness: float
) -> bool:
    """Tell whose extra genes count; of equally fit parents the smaller one's."""
    if first_fitness == second_fitness:
        return first.link_innovation.size < second.link_innovation.size
    return first_fitness > second_fitness


def multipoint(
    first: Genome,
    second: Genome,
    first_fitter: bool,
    config: CrossoverConfig,
    rng: np.random.Generator,
) -> Genome:
    """Return a child with each matching gene from either parent with equal chance."""
    genes = _lined_up(first, second)
    from_second = rng.random(genes.in_first.size) < 0.5
    weight = np.where(from_second, genes.second_weight, genes.first_weight)
    enabled = _inherited_enabled(genes, config, rng)
    if config.copy_disabled:
        enabled &= np.where(from_second, genes.second_enabled, genes.first_enabled)
    return _child(first, second, genes, (weight, enabled), first_fitter, config)


def multipoint_average(
    first: Genome,
    second: Genome,
    first_fitter: bool,
    config: CrossoverConfig,
    rng: np.random.Generator,
) -> Genome:
    """Return a child whose matching genes have the mean of its parents' weights."""
    genes = _lined_up(first, second)
    # Halves are added, as the sum of two large float32 weights could overflow.
    weight = genes.first_weight / 2 + genes.second_weight / 2
    enabled = _inherited_enabled(genes, config, rng)
    return _child(first, second, genes, (weight, enabled), first_fitter, config)


class _LinedUp(NamedTuple):
    """Where the matching genes lie, and what they say in each parent."""

    in_first: NDArray[np.intp]
    in_second: NDArray[np.intp]
    first_weight: NDArray[np.float32]
    second_weight: NDArray[np.float32]
    first_enabled: NDArray[np.bool_]
    second_enabled: NDArray[np.bool_]


def _lined_up(first: Genome, second: Genome) -> _LinedUp:
    same_world = first.observation_schema == second.observation_schema
    if not same_world or first.interface != second.interface:
        raise GenomeError(
            f"genomes {first.genome_id} and {second.genome_id} differ in their observation "
            "schema, input, bias or output nodes; only genomes with the same ones can mate."
        )
    in_first, in_second = matching(first.link_innovation, second.link_innovation)
    return _LinedUp(
        in_first,
        in_second,
        first.link_weight[in_first],
        second.link_weight[in_second],
        first.link_enabled[in_first],
        second.link_enabled[in_second],
    )


def _inherited_enabled(
    genes: _LinedUp, config: CrossoverConfig, rng: np.random.Generator
) -> NDArray[np.bool_]:
    spared = rng.random(genes.in_first.size) >= config.inherit_disabled_prob
    return (genes.first_enabled & genes.second_enabled) | spared


def _child(
    first: Genome,
    second: Genome,
    genes: _LinedUp,
    inherited: tuple[NDArray[Any], NDArray[np.bool_]],
    first_fitter: bool,
    config: CrossoverConfig,
) -> Genome:
    """Return the child with the matching genes' (weights, enabled) and the extra genes."""
    fitter, at = (first, genes.in_first) if first_fitter else (second, genes.in_second)
    weight, enabled = fitter.link_weight.copy(), fitter.link_enabled.copy()
    weight[at], enabled[at] = inherited
    child = fitter.unchecked(genome_id=first.genome_id, link_weight=weight, link_enabled=enabled)
    other, other_at = (second, genes.in_second) if first_fitter else (first, genes.in_first)
    if not config.keep_all_genes or other_at.size == other.link_innovation.size:
        return child
    return _with_extra_genes(child, other) or child


def _with_extra_genes(child: Genome, other: Genome) -> Genome | None:
    """Return the child with another genome's extra genes too; None if that makes a cycle."""
    place, new = _joined_nodes(child.node_id, other.node_id)
    source = np.concatenate((child.source_index, place[other.source_index]))
    target = np.concatenate((child.target_index, place[other.target_index]))
    links = {
        name: np.concatenate((getattr(child, name), getattr(other, name))) for name in LINK_FIELDS
    }
    innovation, recurrent = links["link_innovation"], links["link_recurrent"]
    kept = _without_rivals(innovation, source, target, recurrent, child.link_weight.size)
    kept = kept[innovation[kept].argsort()]
    source, target, forward = source[kept], target[kept], ~recurrent[kept]
    nodes = child.node_id.size + new.size
    if node_levels(source[forward], target[forward], nodes) is None:
        return None
    used = np.zeros(nodes, dtype=bool)
    used[source] = used[target] = used[: child.node_id.size] = True
    index = used.cumsum() - 1
    return child.unchecked(
        **{name: column[kept] for name, column in links.items()},
        **_with_nodes(child, other, new[used[child.node_id.size :]]),
        source_index=index[source],
        target_index=index[target],
    )


def _with_nodes(child: Genome, other: Genome, new: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Return the child's node columns and behind them the `new` ones of another genome."""
    if not new.size:
        return {}
    return {
        name: np.concatenate((getattr(child, name), getattr(other, name)[new]))
        for name in NODE_FIELDS
    }


@njit(cache=True)
def _joined_nodes(
    own: NDArray[np.int32], other: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Append another genome's new nodes to one's own, both given as ids.

    Returns:
        The index among all nodes of each of the `other` nodes, and which of these are new.
    """
    place, new = np.empty(other.size, np.int64), np.empty(other.size, np.int64)
    count = 0
    for one in range(other.size):
        known = 0
        while known < own.size and own[known] != other[one]:
            known += 1
        place[one] = known
        if known == own.size:
            place[one] += count
            new[count] = one
            count += 1
    return place, new[:count]


@njit(cache=True)
def _without_rivals(
    innovation: NDArray[np.int64],
    source: NDArray[np.int64],
    target: NDArray[np.int64],
    recurrent: NDArray[np.bool_],
    own: int,
) -> NDArray[np.int64]:
    """Return which links remain of one's `own` and those of another genome behind them.

    Both are sorted by innovation. Matching genes are one's own. Of rivals the older remains:
    links from the same node to the same node that are both recurrent or both forward; forward
    ones are rivals in opposite directions too. No genome holds rivals of its own.
    """
    gone = np.zeros(innovation.size, np.bool_)
    older = 0
    for new in range(own, innovation.size):
        while older < own and innovation[older] < innovation[new]:
            older += 1
        if older < own and innovation[older] == innovation[new]:
            gone[new] = True
            continue
        for old in range(own):
            same = source[old] == source[new] and target[old] == target[new]
            opposite = source[old] == target[new] and target[old] == source[new]
            if recurrent[old] == recurrent[new] and (same or (opposite and not recurrent[old])):
                gone[new if old < older else old] = True
    return np.flatnonzero(~gone)


def with_all_genes(config: CrossoverConfig) -> CrossoverConfig:
    """Return the config for parents of different species: all genes pass, as in OpenNERO."""
    return config if config.keep_all_genes else replace(config, keep_all_genes=True)
