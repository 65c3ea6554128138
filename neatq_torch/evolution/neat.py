"""NEAT: generations.

Stanley & Miikkulainen 2002, and where the paper is silent their published code (NEAT 1.2.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.parsimony import enabled_links, front_ranks, lowest_good
from neatq_torch.evolution.population import Generational, Replacement, Start
from neatq_torch.evolution.reproduction import NEAT_2002, Child, ReproductionConfig, litters
from neatq_torch.evolution.species import Speciation, Species, SpeciesConfig
from neatq_torch.evolution.trials import checked
from neatq_torch.genome import Genome
from neatq_torch.kinds import check_fields

Numbering = Literal["generation", "run"]
Representative = Literal["champion", "random"]


@dataclass(frozen=True, kw_only=True)
class NEATConfig:
    """Generations: all genomes are replaced at once; the defaults are those of the paper.

    The ablations of the paper (its section 5) are settings: without growth
    (`add_node_prob` and `add_link_prob` 0, `start` "layered"), without mating (`mutate_only_prob`
    1), without speciation (`speciate` False, `start` "random"), from random topologies (`start`
    "random").

    Attributes:
        reproduction: how offspring come about.
        species: how genomes are sorted into species. The threshold stays, unless `step` lets it
            move; it moves once a generation, `adjust_every` has no meaning here.
        representative: which member of the generation before represents a species: "random", as
            in the paper, or "champion", as in the authors' code. Where weights count much in the
            distance, species around random members scatter into twos and threes.
        speciate: whether there are species; else all genomes are of one.
        survival_share: share of a species, the fittest, that may breed; one more may always.
        stagnation_generations: a species whose best fitness did not rise for so long has no
            offspring.
        refocus_generations: if the best fitness of the whole population did not rise for so long,
            only the two best species have offspring, half of them each.
        innovations: for how long equal mutations have equal numbers: "generation", as in the paper,
            or "run", as in rtNEAT.
        elite_members: the champion of a species with more members than this lives on unchanged.
        start: what founders look like.
        start_hidden: hidden nodes of "layered" founders, and the most that "random" ones have.
        episodes: episodes of a life; fitness is the mean over them.
        parsimony: the champion is the smallest network whose fitness is within this share of the
            best one, in [0, 1). Who breeds is then decided by size, too: the better half is ranked
            by the fronts of high fitness and few enabled links. None: size does not matter.

    Example:
        >>> config = NEATConfig(survival_share=0.3, start="layered")
    """

    reproduction: ReproductionConfig = NEAT_2002
    species: SpeciesConfig = field(default_factory=lambda: SpeciesConfig(threshold=3.0, step=0.0))
    representative: Representative = "random"
    speciate: bool = True
    survival_share: float = 0.2
    stagnation_generations: int = 15
    refocus_generations: int = 20
    innovations: Numbering = "generation"
    elite_members: int = 5
    start: Start = "minimal"
    start_hidden: int = 10
    episodes: int = 1
    parsimony: float | None = None

    def __post_init__(self) -> None:
        check_fields(self, survival_share="[0, 1]", elite_members="[0, inf]", start=Start)
        for name in ("stagnation_generations", "refocus_generations", "start_hidden", "episodes"):
            check_fields(self, **{name: "[1, inf]"})
        check_fields(self, parsimony="[0, 1)", innovations=Numbering, representative=Representative)


class NEAT(Generational):
    """A population of which all members are replaced at once; see `Generational`.

    Champions that live on keep their `genome_id` and are no births.

    Attributes:
        speciation: species and their threshold.
        records: of the population (0) and of each of its species by number: the best fitness so
            far, and its generation.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> population = NEAT.start(NEATConfig(), slots=20, inputs=2, outputs=1, rng=rng)
        >>> fitness = [genome.link_weight.sum() ** 2 for genome in population.genomes]
        >>> replacements = population.tell(fitness)
    """

    config: NEATConfig
    kept = (*Generational.kept, "speciation", "records")

    def begin(self) -> None:
        """See `Population`."""
        super().begin()
        config = self.config
        self.speciation = Speciation(config.species, config.reproduction.distance)
        if not config.speciate:
            # Everybody is compatible. Finite, because a state is kept as JSON.
            self.speciation.threshold = float(np.finfo(np.float64).max)
        self.speciation.renew(self.genomes, [])
        self.records: list[list[Any]] = [[0, None, 0]]

    @property
    def species(self) -> list[Species]:
        """See `Population`."""
        return self.speciation.species

    def advance(self) -> list[Replacement]:
        """See `Population`; replaces all once all have had all their episodes."""
        return self.tell(self.fitness) if self.due() else []

    def tell(self, fitness: ArrayLike) -> list[Replacement]:
        """Replace this generation by the next.

        Species are ranked and have offspring in proportion to their mean fitness; the fittest of
        each breed, all with equal chance. If all species stagnate the two best of them breed, so a
        population never dies out. As in the paper, the best genome of a small or stagnating species
        is lost, even if it is the best of all: where it was always kept, single runs of double pole
        balancing hung on to it for hundreds of generations.

        Raises:
            ValueError: the shape is not [slots] or a fitness, which may be negative, not finite.
        """
        mend = " Give a genome that could not be judged the lowest fitness of the task."
        earned = checked("fitness", fitness, mend=mend, slots=len(self.genomes))
        fitness = earned
        if self.config.parsimony is not None:
            fitness = front_ranks(earned, enabled_links(self.genomes))
        for species in self.species:
            species.rank(fitness)
        champions = fitness[[species.members[0] for species in self.species]]
        self._note(np.array([self._reached(one.members, earned) for one in self.species]))
        counts = self._offspring_counts(shared_fitness(fitness, self.species), champions)
        children = self._children(counts, fitness)
        removed = self.genomes
        self._settle([genome for genome, _ in children])
        slots = enumerate(zip(children, removed, strict=True))
        return [Replacement(slot, one, old.genome_id, ids) for slot, ((one, ids), old) in slots]

    def _reached(self, members: NDArray[np.int64], fitness: NDArray[np.float64]) -> float:
        """What a species must raise, lest it stagnate: its best fitness, or a good one's size."""
        best, share = float(fitness[members].max()), self.config.parsimony
        if share is None:
            return best
        good = members[fitness[members] >= lowest_good(best, share)]
        links = enabled_links([self.genomes[slot] for slot in good]).min()
        return best + share * abs(best) / (1 + links)

    def _note(self, champions: NDArray[np.float64]) -> None:
        """Bring the records of the population and of all [species] up to date."""
        old, self.records = {key: record for key, *record in self.records}, []
        keys = [0, *(one.species_id for one in self.species)]
        for key, fitness in zip(keys, [float(champions.max()), *champions.tolist()], strict=True):
            best, reached = old.get(key, (None, 0))
            if best is None or fitness > best:
                best, reached = fitness, self.generation
            self.records.append([key, best, reached])

    def _offspring_counts(
        self, shares: NDArray[np.float64], champions: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """How many genomes come from each of [species]; `shares`, their fitness, is written."""
        reached = np.array([reached for _, _, reached in self.records[1:]])
        shares[self.generation - reached >= self.config.stagnation_generations] = 0.0
        waited = self.generation - self.records[0][2]
        if waited >= self.config.refocus_generations or not shares.any():
            # Equal shares for the two best, who are given time again.
            best = np.argsort(-champions, kind="stable")[:2]
            shares = np.isin(np.arange(champions.size), best).astype(np.float64)
            for one in (0, *(best + 1)):
                self.records[one][2] = self.generation
        return offspring_counts(shares, len(self.genomes))

    def _children(self, counts: NDArray[np.int64], fitness: NDArray[np.float64]) -> list[Child]:
        """As many as `counts` [species] says: of large species the champion, then offspring."""
        ranked = [one.members for one in self.species]
        large = np.array([some.size > self.config.elite_members for some in ranked])
        births = np.maximum(counts - large, 0)
        pools = [breeders(some, self.config.survival_share) for some in ranked]
        genomes = [[self.genomes[slot] for slot in pool] for pool in pools]
        home, fit = np.repeat(np.arange(births.size), births), fitness[np.concatenate(pools)]
        means = self.reproduction, self.ledger, self.rng
        born = litters(genomes, fit, home, *means, self.next_genome_id)
        children: list[Child] = []
        for pool, count, births_of_it in zip(genomes, counts, births, strict=True):
            if count > births_of_it:
                children.append((pool[0], (pool[0].genome_id,)))
            children += islice(born, int(births_of_it))
        self.next_genome_id += home.size
        self.births += home.size
        return children

    def _settle(self, genomes: list[Genome]) -> None:
        """Make genomes the next generation and sort them into the species, which are ranked."""
        members = [one.members for one in self.species]
        if self.config.representative == "random":
            members = [some[self.rng.integers(some.size) :] for some in members]
        self.speciation.renew(genomes, [self.genomes[some[0]] for some in members])
        if self.config.species.step and self.config.speciate:
            self.speciation.move_threshold()
        if self.config.innovations == "generation":
            self.ledger.forget()
        self.genomes = genomes
        self.go_on()


def shared_fitness(fitness: NDArray[np.float64], species: Sequence[Species]) -> NDArray[np.float64]:
    """For each of [species] the sum of fitness / species size over its members.

    That is the mean of its members. Where a fitness is negative, all are first lifted by so much
    that the lowest is 0; where nobody is fit, all count the same.
    """
    lifted = fitness - min(0.0, float(fitness.min()))
    shared = np.array([lifted[one.members].mean() for one in species])
    return shared if shared.any() else np.ones(len(species))


def offspring_counts(shares: ArrayLike, offspring: int) -> NDArray[np.int64]:
    """Int64 [species] that add up to `offspring`, in proportion to `shares` [species].

    Everybody gets the whole part of what is due; those with the largest remainders get one more,
    the first of equals first.
    """
    shares = np.asarray(shares, dtype=np.float64)
    due = shares / shares.sum() * offspring
    counts = np.floor(due).astype(np.int64)
    order = np.argsort(counts - due, kind="stable")
    counts[order[: offspring - counts.sum()]] += 1
    return counts


def breeders(ranked: NDArray[np.int64], survival_share: float) -> NDArray[np.int64]:
    """Those of a species' members, the fittest first, that may breed: at least one."""
    return ranked[: int(survival_share * ranked.size) + 1]
