"""Crossover: a child from two parents whose genes are lined up by innovation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neatq_torch.genome.genes import GeneNumbers, Genes
from neatq_torch.genome.genome import Genome
from neatq_torch.genome.heredity import LINK_GENE, NODE_GENE, Packed, crossed
from neatq_torch.genome.rules import GenomeError
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

    @property
    def shares(self) -> tuple[float, bool]:
        """What compiled code reads beside `keep_all_genes`."""
        return float(self.inherit_disabled_prob), self.copy_disabled


def packed(genes: Genes) -> Packed:
    """The same genes as the compiled code of breeding takes them."""
    links, nodes = np.empty(genes.weight.size, LINK_GENE), np.empty(genes.kind.size, NODE_GENE)
    for records in (links, nodes):
        for name in records.dtype.names or ():
            records[name] = getattr(genes, name)
    return links, nodes


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
    fitter, other = (first, second) if first_fitter else (second, first)
    how = bool(first_fitter), average, config.keep_all_genes, config.shares
    made = crossed(rng, packed(fitter.genes), packed(other.genes), *how)
    return with_genes(fitter, other, first.genome_id, *made)


def check_mates(first: Genome, second: Genome) -> None:
    """Raise a GenomeError unless both have the same inputs and outputs and sense the same."""
    same_world = first.observation_schema == second.observation_schema
    if not same_world or first.interface != second.interface:
        raise GenomeError(
            f"genomes {first.genome_id} and {second.genome_id} differ in their observation "
            "schema, input, bias or output nodes; only genomes with the same ones can mate."
        )


def with_genes(
    fitter: Genome, other: Genome, genome_id: int, genes: Packed, new: GeneNumbers, joined: bool
) -> Genome:
    """Return the genome of the fitter parent with what `crossed` made of it and the other one."""
    links, nodes = genes
    weight, enabled = links["weight"].copy(), links["enabled"].copy()
    own = {"genome_id": genome_id, "link_weight": weight, "link_enabled": enabled}
    if not joined:
        return fitter.unchecked(**own)
    node_id, source, target = nodes["node_id"], links["source"].copy(), links["target"].copy()
    activation = np.concatenate((fitter.node_activation, other.node_activation[new]))
    grown = {"node_id": node_id.copy(), "node_kind": nodes["kind"].copy()}
    return fitter.unchecked(
        **own,
        **(grown | {"node_activation": activation} if new.size else {}),
        link_innovation=links["innovation"].copy(),
        link_source=node_id[source],
        link_target=node_id[target],
        link_recurrent=links["recurrent"].copy(),
        source_index=source,
        target_index=target,
    )
