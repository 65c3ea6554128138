"""Reproduction: who breeds, and from parents to one offspring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.species import Species
from neatq_torch.genome import (
    CrossoverConfig,
    DistanceConfig,
    Genome,
    InnovationLedger,
    MutationConfig,
    compatibility,
    first_is_fitter,
    multipoint,
    mutate,
)
from neatq_torch.kinds import check_fields


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
        check_fields(self, **{name: "[0, 1]" for name in vars(self) if name.endswith("_prob")})


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
which is also OpenNERO's. Two more things are in the code only: small genomes split their old links
first, without which XOR takes nearly half more evaluations, and a gene that is copied disabled
stays so. Recurrent links are off; a task that needs memory raises `recurrent_link_prob`.
"""


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
) -> Genome:
    """One offspring of one parent (a mutant) or of two.

    Two parents that are the same, by number or by distance 0, always have a mutated child. Parents
    of different species (`interspecies`) pass on all their genes.
    """
    if len(parents) == 1:
        child = mutate(parents[0].genome, config.mutation, ledger, rng)
        return child.unchecked(genome_id=genome_id)
    first, second = parents
    genomes = first.genome, second.genome
    average = rng.random() >= config.multipoint_prob
    genes = replace(config.crossover, keep_all_genes=True) if interspecies else config.crossover
    fitter = first_is_fitter(*genomes, first.fitness, second.fitness)
    child = multipoint(*genomes, fitter, genes, rng, average=average)
    mated_only = rng.random() < config.mate_only_prob
    same = first.genome.genome_id == second.genome.genome_id
    if not mated_only or same or compatibility(*genomes, config.distance) == 0.0:
        child = mutate(child, config.mutation, ledger, rng)
    return child.unchecked(genome_id=genome_id)


def roulette(shares: ArrayLike, rng: np.random.Generator) -> int:
    """An index with probability proportional to its share, uniform if all are 0."""
    bounds = np.add.accumulate(shares, dtype=np.float64)
    if not bounds[-1] > 0.0:
        return int(rng.integers(bounds.size))
    index = bounds.searchsorted(rng.random() * bounds[-1], side="right")
    # Rounding can lift the ball to the very end: the last share above 0 catches it there.
    return int(min(index, bounds.searchsorted(bounds[-1])))


def choose_parents(
    species: Sequence[Species],
    fitness: NDArray[np.float64],
    eligible: NDArray[np.bool_],
    config: ReproductionConfig,
    rng: np.random.Generator,
) -> tuple[tuple[int, ...], bool]:
    """Slots of one or two parents, and whether these are of different species.

    A species is drawn by the mean fitness of its eligible members, parents by fitness among
    them; among all members, uniformly, where none is eligible. The only candidate of a species
    breeds alone. The species is ranked, so that its fittest member represents it from now on,
    as in OpenNERO. A mate from outside is the fittest of another species. All species must have
    members, and those that are not eligible [slots] fitness 0 [slots].
    """
    able = [one.members[eligible[one.members]] for one in species]
    # Their means, 0 of nobody, as `mean` has them at three times the cost.
    means = [np.add.reduce(fitness[slots]) / max(slots.size, 1) for slots in able]
    chosen = roulette(means, rng)
    home = species[chosen]
    home.rank(fitness)
    pool = able[chosen] if able[chosen].size else home.members
    shares = fitness[pool]
    first = int(pool[roulette(shares, rng)])
    if rng.random() < config.mutate_only_prob or pool.size == 1:
        return (first,), False
    others = [one for one in species if one is not home]
    if rng.random() < config.interspecies_mate_prob and others:
        mates = others[int(rng.integers(len(others)))].members
        return (first, int(mates[fitness[mates].argmax()])), True
    return (first, int(pool[roulette(shares, rng)])), False


def choose_breeders(
    species: Sequence[Species],
    fitness: NDArray[np.float64],
    breeders: NDArray[np.intp],
    config: ReproductionConfig,
    rng: np.random.Generator,
) -> tuple[tuple[int, ...], bool]:
    """As `choose_parents`, among some slots alone, each of them as likely.

    Mates are those of them that are of the same species.
    """
    first = int(rng.choice(breeders))
    home = next(one for one in species if first in one.members)
    home.rank(fitness)
    if rng.random() < config.mutate_only_prob:
        return (first,), False
    pool = breeders[np.isin(breeders, home.members)]
    return (first,) if pool.size == 1 else (first, int(rng.choice(pool))), False
