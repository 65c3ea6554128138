"""Crossover: a child from two parents whose genes are lined up by innovation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome, GenomeError
from neatq_torch.genome.graph import node_levels
from neatq_torch.genome.innovation import match
from neatq_torch.genome.validation import LINK_FIELDS, NODE_FIELDS
from neatq_torch.genome.vocabulary import NodeKind


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


@dataclass(frozen=True)
class _LinedUp:
    """Where the matching genes lie, and what they say in each parent."""

    in_first: NDArray[np.intp]
    in_second: NDArray[np.intp]
    first_weight: NDArray[np.float32]
    second_weight: NDArray[np.float32]
    first_enabled: NDArray[np.bool_]
    second_enabled: NDArray[np.bool_]


def _lined_up(first: Genome, second: Genome) -> _LinedUp:
    if not _same_interface(first, second):
        raise GenomeError(
            f"genomes {first.genome_id} and {second.genome_id} differ in their observation "
            "schema, input, bias or output nodes; only genomes with the same ones can mate."
        )
    place, matching = match(second.link_innovation, first.link_innovation)
    in_first, in_second = np.flatnonzero(matching), place[matching]
    return _LinedUp(
        in_first,
        in_second,
        first.link_weight[in_first],
        second.link_weight[in_second],
        first.link_enabled[in_first],
        second.link_enabled[in_second],
    )


def _same_interface(first: Genome, second: Genome) -> bool:
    if first.observation_schema != second.observation_schema:
        return False
    outer_first = first.node_kind != NodeKind.HIDDEN
    outer_second = second.node_kind != NodeKind.HIDDEN
    return all(
        np.array_equal(getattr(first, name)[outer_first], getattr(second, name)[outer_second])
        for name in ("node_id", "node_kind")
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
    child = fitter.replaced(genome_id=first.genome_id, link_weight=weight, link_enabled=enabled)
    other, other_at = (second, genes.in_second) if first_fitter else (first, genes.in_first)
    if not config.keep_all_genes or other_at.size == other.link_innovation.size:
        return child
    extra = np.ones(other.link_innovation.size, dtype=bool)
    extra[other_at] = False
    return _with_extra_genes(child, other, extra) or child


def _with_extra_genes(child: Genome, other: Genome, extra: NDArray[np.bool_]) -> Genome | None:
    """Return the child with these genes of another genome too; None if that makes a cycle."""
    links = {
        name: np.concatenate([getattr(child, name), getattr(other, name)[extra]])
        for name in LINK_FIELDS
    }
    order = np.argsort(links["link_innovation"], kind="stable")
    links = {name: column[order] for name, column in links.items()}
    ends = np.stack([links["link_source"], links["link_target"]])
    known, (source, target) = np.unique(ends, return_inverse=True)
    kept = _first_of_each_link(source, target, links["link_recurrent"])
    forward = kept[~links["link_recurrent"][kept]]
    if node_levels(source[forward], target[forward], known.size) is None:
        return None
    links = {name: column[kept] for name, column in links.items()}
    return child.replaced(**_joined_nodes(child, other, links), **links)


def _first_of_each_link(
    source: NDArray[np.intp], target: NDArray[np.intp], recurrent: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """Return the places of links that remain when the oldest of rivals is kept.

    Rivals lead from the same node to the same node and are both recurrent or both forward;
    forward links are rivals in opposite directions too.
    """
    low = np.where(recurrent, source, np.minimum(source, target))
    high = np.where(recurrent, target, np.maximum(source, target))
    nodes = int(max(source.max(), target.max())) + 1
    key = (low * nodes + high) * 2 + recurrent
    return np.sort(np.unique(key, return_index=True)[1])


def _joined_nodes(
    child: Genome, other: Genome, links: dict[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Return the child's nodes and those hidden nodes of the other genome that links use."""
    used = np.isin(other.node_id, links["link_source"])
    used |= np.isin(other.node_id, links["link_target"])
    new = used & ~np.isin(other.node_id, child.node_id)
    return {
        name: np.concatenate([getattr(child, name), getattr(other, name)[new]])
        for name in NODE_FIELDS
    }


def with_all_genes(config: CrossoverConfig) -> CrossoverConfig:
    """Return the config for parents of different species: all genes pass, as in OpenNERO."""
    return config if config.keep_all_genes else replace(config, keep_all_genes=True)
