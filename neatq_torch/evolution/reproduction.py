"""Reproduction: from parents to one offspring."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from neatq_torch.genome import (
    CrossoverConfig,
    DistanceConfig,
    Genome,
    InnovationLedger,
    MutationConfig,
    ScalesOf,
    compatibility,
    first_is_fitter,
    multipoint,
    multipoint_average,
    mutate,
)
from neatq_torch.genome.crossover import with_all_genes


@dataclass(frozen=True, kw_only=True)
class ReproductionConfig:
    """How offspring come about; the presets are `OPENNERO` and `NEAT_2002`.

    Attributes:
        mutation: how genomes mutate.
        crossover: what a child takes from each parent.
        distance: how far apart two genomes are.
        mutate_only_prob: share of offspring of a single parent.
        mate_only_prob: share of offspring of two parents that are not mutated.
        multipoint_prob: share of crossovers that choose genes; the others average weights.
        interspecies_mate_prob: probability that the second parent is of another species.
    """

    mutation: MutationConfig = field(default_factory=MutationConfig)
    crossover: CrossoverConfig = field(default_factory=CrossoverConfig)
    distance: DistanceConfig = field(default_factory=DistanceConfig)
    mutate_only_prob: float = 0.25
    mate_only_prob: float = 0.2
    multipoint_prob: float = 0.6
    interspecies_mate_prob: float = 0.001

    def __post_init__(self) -> None:
        """Check every value."""
        for name, value in vars(self).items():
            if name.endswith("_prob") and not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} must be a probability in [0, 1], not {value}.")


OPENNERO = ReproductionConfig(crossover=CrossoverConfig(copy_disabled=True))
"""rtNEAT as OpenNERO ran it (its neat-params.dat and source/rtneat)."""

NEAT_2002 = ReproductionConfig(
    mutation=MutationConfig(
        weight_mutation_power=2.5,
        max_link_weight=8.0,
        recurrent_link_prob=0.0,
        forward_from_outputs=False,
        split_old_below=15,
        split_weight_scale=1.0,
        hidden_activation="steep_sigmoid",
    ),
    crossover=CrossoverConfig(keep_all_genes=False, copy_disabled=True),
)
"""Stanley & Miikkulainen 2002, section 4.1.

The paper names neither the size of a weight mutation nor a cap: 2.5, the cap of 8 and the shares of
the two crossovers are those of the authors' published code. Weights mutate as in that code, too,
which is also OpenNERO's; `AS_WRITTEN` has the paper's words instead. Two more things are in the
code only: small genomes split their old links first, without which XOR takes nearly half more
evaluations, and a gene that is copied disabled stays so. Recurrent links are off; a task that needs
memory raises `recurrent_link_prob`.
"""

AS_WRITTEN = replace(
    NEAT_2002,
    mutation=replace(NEAT_2002.mutation, weight_scheme="uniform", link_weights_prob=0.8),
)
"""`NEAT_2002` with weights that mutate as the paper says: those of 80 % of the offspring, nine
of ten perturbed and the others new. Some runs of double pole balancing then get lost."""


class Parent(NamedTuple):
    """A genome that breeds, and how fit it is."""

    genome: Genome
    fitness: float


def offspring(
    parents: tuple[Parent, ...],
    config: ReproductionConfig,
    ledger: InnovationLedger,
    rng: np.random.Generator,
    *,
    genome_id: int,
    interspecies: bool = False,
    scales_of: ScalesOf | None = None,
) -> Genome:
    """Return one offspring of one parent (a mutant) or of two.

    Two parents that are the same, by number or by distance 0, always have a mutated child. Parents
    of different species (`interspecies`) pass on all their genes. `scales_of`: see `mutate`.
    """
    if len(parents) == 1:
        child = mutate(parents[0].genome, config.mutation, ledger, rng, scales_of)
        return child.unchecked(genome_id=genome_id)
    first, second = parents
    child = _cross(first, second, config, rng, interspecies=interspecies)
    if rng.random() >= config.mate_only_prob or _are_twins(first, second, config):
        child = mutate(child, config.mutation, ledger, rng, scales_of)
    return child.unchecked(genome_id=genome_id)


def _cross(
    first: Parent,
    second: Parent,
    config: ReproductionConfig,
    rng: np.random.Generator,
    *,
    interspecies: bool,
) -> Genome:
    cross = multipoint if rng.random() < config.multipoint_prob else multipoint_average
    crossover = with_all_genes(config.crossover) if interspecies else config.crossover
    fitter = first_is_fitter(first.genome, second.genome, first.fitness, second.fitness)
    return cross(first.genome, second.genome, fitter, crossover, rng)


def _are_twins(first: Parent, second: Parent, config: ReproductionConfig) -> bool:
    if first.genome.genome_id == second.genome.genome_id:
        return True
    return compatibility(first.genome, second.genome, config.distance) == 0.0
