"""Crossover: a child from two parents whose genes are lined up by innovation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genes, Genome
from neatq_torch.genome.graph import node_levels
from neatq_torch.genome.rules import GenomeError
from neatq_torch.jit import cached_njit
from neatq_torch.kinds import check_fields

Indices = NDArray[np.int64]


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

    @property
    def shares(self) -> tuple[float, bool]:
        """What compiled code reads beside `keep_all_genes`."""
        return float(self.inherit_disabled_prob), self.copy_disabled


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
    check_mates(first, second)
    crossing = rng, first.genes, second.genes, first_fitter, average, config.keep_all_genes
    fitter, other = (first, second) if first_fitter else (second, first)
    return with_genes(fitter, other, first.genome_id, *crossed(*crossing, config.shares))


def check_mates(first: Genome, second: Genome) -> None:
    """Raise a GenomeError unless both have the same inputs and outputs and sense the same."""
    same_world = first.observation_schema == second.observation_schema
    if not same_world or first.interface != second.interface:
        raise GenomeError(
            f"genomes {first.genome_id} and {second.genome_id} differ in their observation "
            "schema, input, bias or output nodes; only genomes with the same ones can mate."
        )


def with_genes(
    fitter: Genome, other: Genome, genome_id: int, genes: Genes, new: Indices, joined: bool
) -> Genome:
    """Return the genome of the fitter parent with what `crossed` made of it and the other one."""
    own = {"genome_id": genome_id, "link_weight": genes.weight, "link_enabled": genes.enabled}
    if not joined:
        return fitter.unchecked(**own)
    nodes = {"node_id": genes.node_id, "node_kind": genes.kind}
    activation = np.concatenate((fitter.node_activation, other.node_activation[new]))
    return fitter.unchecked(
        **own,
        **(nodes | {"node_activation": activation} if new.size else {}),
        link_innovation=genes.innovation,
        link_source=genes.node_id[genes.source],
        link_target=genes.node_id[genes.target],
        link_recurrent=genes.recurrent,
        source_index=genes.source,
        target_index=genes.target,
    )


@cached_njit()
def copied(genes: Genes) -> Genes:
    """Return the same genes, to be written to."""
    ends = genes.source.copy(), genes.target.copy()
    links = genes.innovation.copy(), genes.weight.copy(), genes.enabled.copy()
    return Genes(*links, genes.recurrent.copy(), *ends, genes.node_id.copy(), genes.kind.copy())


@cached_njit()
def crossed(
    rng: np.random.Generator,
    first: Genes,
    second: Genes,
    first_fitter: bool,
    average: bool,
    keep_all_genes: bool,
    shares: tuple[float, bool],
) -> tuple[Genes, Indices, bool]:
    """Return a child's genes; which nodes of the less fit parent are new in them; whether any are.

    Without genes of the less fit parent alone (the last is False) only weights and `enabled` are
    other than those of the fitter one. `shares` are those of `CrossoverConfig`.
    """
    disabled_prob, copy_disabled = shares
    own, other = (first, second) if first_fitter else (second, first)
    in_first, in_second = matching(first.innovation, second.innovation)
    matches = in_first.size
    choice = rng.random(0 if average else matches)
    spared = rng.random(matches)
    child = copied(own)
    for match in range(matches):
        a, b = in_first[match], in_second[match]
        on = (first.enabled[a] and second.enabled[b]) or spared[match] >= disabled_prob
        if average:
            # Halves are added, as the sum of two large float32 weights could overflow.
            half = np.float32(0.5)
            inherited = first.weight[a] * half + second.weight[b] * half
        else:
            from_second = choice[match] < 0.5
            inherited = second.weight[b] if from_second else first.weight[a]
            if copy_disabled:
                on = on and (second.enabled[b] if from_second else first.enabled[a])
        at = a if first_fitter else b
        child.weight[at], child.enabled[at] = inherited, on
    if keep_all_genes and matches < other.innovation.size:
        return _with_extra_genes(child, other)
    return child, np.empty(0, np.int64), False


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


@cached_njit()
def _with_extra_genes(child: Genes, other: Genes) -> tuple[Genes, Indices, bool]:
    """Return a child with another genome's extra genes too, unless that makes a cycle."""
    own, nodes = child.node_id.size, child.node_id.size
    joined, new = np.empty(other.node_id.size, np.int64), np.empty(other.node_id.size, np.int64)
    for node in range(other.node_id.size):
        at = node  # mostly
        if node >= own or child.node_id[node] != other.node_id[node]:
            at = 0
            while at < own and child.node_id[at] != other.node_id[node]:
                at += 1
        if at == own:
            new[nodes - own], at = node, nodes
            nodes += 1
        joined[node] = at
    innovation = np.concatenate((child.innovation, other.innovation))
    recurrent = np.concatenate((child.recurrent, other.recurrent))
    source = np.concatenate((child.source, joined[other.source]))
    target = np.concatenate((child.target, joined[other.target]))
    kept = _without_rivals(innovation, source, target, recurrent, child.weight.size)
    kept = kept[np.argsort(innovation[kept])]
    source, target, recurrent = source[kept], target[kept], recurrent[kept]
    if node_levels(source[~recurrent], target[~recurrent], nodes) is None:
        return child, np.empty(0, np.int64), False
    used = np.zeros(nodes, np.int64)
    used[:own] = 1
    for link in range(kept.size):
        used[source[link]] = used[target[link]] = 1
    index, new = np.cumsum(used) - 1, new[: nodes - own][used[own:] > 0]
    genes = Genes(
        innovation[kept],
        np.concatenate((child.weight, other.weight))[kept],
        np.concatenate((child.enabled, other.enabled))[kept],
        recurrent,
        index[source],
        index[target],
        np.concatenate((child.node_id, other.node_id[new])),
        np.concatenate((child.kind, other.kind[new])),
    )
    return genes, new, True


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
