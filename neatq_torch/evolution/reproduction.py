"""Reproduction: who breeds, and from parents to one offspring."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
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
    first_is_fitter,
)
from neatq_torch.genome.crossover import check_mates, packed, with_genes
from neatq_torch.genome.genes import Genes, Means
from neatq_torch.genome.heredity import LINK_GENE, born, conceived
from neatq_torch.genome.mutation import restructured
from neatq_torch.genome.rules import check_weights
from neatq_torch.kinds import check_fields

Child = tuple[Genome, tuple[int, ...]]
"""A genome, and the ids of its parents, that of the fitter one first."""

BATCH = 64
"""Births after which compiled code hands over what it has, lest it need a lot of memory."""


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

    @cached_property
    def means(self) -> Means:
        """What compiled code reads."""
        shares = self.mutate_only_prob, self.interspecies_mate_prob
        mating = float(self.multipoint_prob), float(self.mate_only_prob)
        crossing = self.crossover.keep_all_genes, self.crossover.shares
        rates = self.distance.coefficients, self.mutation.rates
        return tuple(map(float, shares)), (*mating, *crossing, *rates)


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
    first, second = parents[0], parents[-1]
    genomes, two = (first.genome, second.genome), len(parents) == 2
    if two:
        check_mates(*genomes)
    fitter = not two or first_is_fitter(*genomes, first.fitness, second.fitness)
    kinship = two, fitter, interspecies, first.genome.genome_id == second.genome.genome_id
    base, other = genomes if fitter else genomes[::-1]
    couple = packed(base.genes), packed(other.genes)
    genes, new, joined, mutation = conceived(rng, *couple, kinship, config.means[1])
    child = with_genes(base, other, genome_id, genes, new, joined)
    check_weights(child.link_innovation, child.link_weight)
    return restructured(child, mutation, config.mutation, ledger)


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


def litters(
    pools: Sequence[Sequence[Genome]],
    fitness: NDArray[np.float64],
    home: NDArray[np.int64],
    config: ReproductionConfig,
    ledger: InnovationLedger,
    rng: np.random.Generator,
    next_genome_id: int,
) -> Iterator[Child]:
    """The offspring of a generation, one after the other, each as `offspring` makes it.

    A parent, and a mate of its species, are drawn with equal chance; a mate from outside is the
    first of another species. The only candidate of a species breeds alone.

    Args:
        pools: Those of each species who breed, the fittest first.
        fitness: Of all of them [genomes], one species behind the other.
        home: Species that each child is of [children].
        config: How offspring come about.
        ledger: Historical markings.
        rng: The source of chance.
        next_genome_id: Number of the first child.
    """
    genomes = [genome for pool in pools for genome in pool]
    for genome in genomes:
        check_mates(genomes[0], genome)
    sizes = [(one.link_weight.size, one.node_id.size, one.genome_id) for one in genomes]
    links, nodes, numbers = np.array(sizes, np.int64).T
    columns = zip(*(one.genes for one in genomes), strict=True)
    homes = _bounds([len(pool) for pool in pools])
    genes = packed(Genes(*(np.concatenate(column) for column in columns)))
    herd = genes, (_bounds(links), _bounds(nodes), homes), numbers.copy(), fitness
    size = min(home.size, BATCH)
    rows = np.empty((size, links.max()), LINK_GENE)
    parents, mutations, done = np.empty((size, 4), np.int64), np.empty((size, 4)), 0
    while done < home.size:
        batch = home[done : done + BATCH]
        born_now, *joined = born(rng, *herd, batch, (rows, parents, mutations), config.means)
        for row, (base, other, *ids) in enumerate(parents[:born_now].tolist()):
            done, fitter, size = done + 1, genomes[base], links[base]
            if joined[-1] and row + 1 == born_now:
                child = with_genes(fitter, genomes[other], next_genome_id, *joined)
            else:
                own = rows[row, :size], genes[1]
                child = with_genes(fitter, fitter, next_genome_id, own, joined[1], False)
            check_weights(child.link_innovation, child.link_weight)
            child = restructured(child, mutations[row], config.mutation, ledger)
            yield child, tuple(genomes[one].genome_id for one in ids if one >= 0)
            next_genome_id += 1


def _bounds(sizes: ArrayLike) -> NDArray[np.int64]:
    """Where parts of these sizes begin and end, one behind the other."""
    return np.concatenate(([0], np.cumsum(sizes)))
