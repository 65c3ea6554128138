"""Crossover: a child from two parents whose genes are lined up by innovation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.graph import node_levels
from neatq_torch.genome.rules import LINK_FIELDS, NODE_FIELDS, GenomeError
from neatq_torch.jit import cached_njit
from neatq_torch.kinds import check_fields


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
        check_fields(self, inherit_disabled_prob="[0, 1]")


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
    *,
    average: bool = False,
) -> Genome:
    """Return a child with each matching gene from either parent with equal chance.

    With `average`, the weights of matching genes are the mean of the parents' instead.
    """
    same_world = first.observation_schema == second.observation_schema
    if not same_world or first.interface != second.interface:
        raise GenomeError(
            f"genomes {first.genome_id} and {second.genome_id} differ in their observation "
            "schema, input, bias or output nodes; only genomes with the same ones can mate."
        )
    parents = first, second
    matched = matching(first.link_innovation, second.link_innovation)
    weights = [one.link_weight[at] for one, at in zip(parents, matched, strict=True)]
    switches = [one.link_enabled[at] for one, at in zip(parents, matched, strict=True)]
    matches = matched[0].size
    from_second = np.zeros(matches, bool) if average else rng.random(matches) < 0.5
    spared = rng.random(matches) >= config.inherit_disabled_prob
    on = (switches[0] & switches[1]) | spared
    if average:
        # Halves are added, as the sum of two large float32 weights could overflow.
        inherited = weights[0] / 2 + weights[1] / 2
    else:
        inherited = np.where(from_second, weights[1], weights[0])
        if config.copy_disabled:
            on &= np.where(from_second, switches[1], switches[0])
    fitter, other = (0, 1) if first_fitter else (1, 0)
    weight, enabled = parents[fitter].link_weight.copy(), parents[fitter].link_enabled.copy()
    weight[matched[fitter]], enabled[matched[fitter]] = inherited, on
    child = parents[fitter].unchecked(
        genome_id=first.genome_id, link_weight=weight, link_enabled=enabled
    )
    if not config.keep_all_genes or matches == parents[other].link_innovation.size:
        return child
    return _with_extra_genes(child, parents[other]) or child


@cached_njit()
def matching(
    first: NDArray[np.int64], second: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices [matches] into two sorted lists of innovations that both have."""
    in_first = np.empty(min(first.size, second.size), np.int64)
    in_second = np.empty_like(in_first)
    i = j = matches = 0
    while i < first.size and j < second.size:
        if first[i] == second[j]:
            in_first[matches], in_second[matches] = i, j
            matches += 1
        step_first, step_second = first[i] <= second[j], second[j] <= first[i]
        i += step_first
        j += step_second
    return in_first[:matches], in_second[:matches]


def _with_extra_genes(child: Genome, other: Genome) -> Genome | None:
    """Return the child with another genome's extra genes too; None if that makes a cycle."""
    joined = child.node_index(other.node_id)
    new = np.flatnonzero(child.node_id[joined] != other.node_id)
    joined[new] = child.node_id.size + np.arange(new.size)
    source = np.concatenate((child.source_index, joined[other.source_index]))
    target = np.concatenate((child.target_index, joined[other.target_index]))
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
    index, new = used.cumsum() - 1, new[used[child.node_id.size :]]
    node_columns = {
        name: np.concatenate((getattr(child, name), getattr(other, name)[new]))
        for name in (NODE_FIELDS if new.size else ())
    }
    return child.unchecked(
        **{name: column[kept] for name, column in links.items()},
        **node_columns,
        source_index=index[source],
        target_index=index[target],
    )


@cached_njit()
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
