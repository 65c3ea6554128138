"""NEAT: generations.

Stanley & Miikkulainen 2002, and where the paper is silent their published code (NEAT 1.2.1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.chance import generator_from
from neatq_torch.evolution.generation import breeders, judged, offspring_counts, shared_fitness
from neatq_torch.evolution.reproduction import NEAT_2002, Parent, ReproductionConfig, offspring
from neatq_torch.evolution.species import Speciation, Species, SpeciesConfig
from neatq_torch.genome import (
    Genome,
    InnovationLedger,
    initial_genome,
    layered_genome,
    pack_genomes,
    random_genome,
    unpack_genomes,
)

Innovations = Literal["generation", "run"]
"""For how long equal mutations have equal numbers."""

Representative = Literal["champion", "random"]
"""Which member of a species newcomers are compared with."""

Start = Literal["minimal", "layered", "random"]
"""What founders look like: no hidden nodes; one hidden layer; a random topology."""


@dataclass(frozen=True, kw_only=True)
class NEATConfig:
    """How generations follow each other; the defaults are those of the paper.

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
    """

    reproduction: ReproductionConfig = NEAT_2002
    species: SpeciesConfig = field(default_factory=lambda: SpeciesConfig(threshold=3.0, step=0.0))
    representative: Representative = "random"
    speciate: bool = True
    survival_share: float = 0.2
    stagnation_generations: int = 15
    refocus_generations: int = 20
    innovations: Innovations = "generation"
    elite_members: int = 5
    start: Start = "minimal"
    start_hidden: int = 10

    def __post_init__(self) -> None:
        """Check every value."""
        if not 0.0 <= self.survival_share <= 1.0:
            raise ValueError(f"survival_share must lie in [0, 1], not {self.survival_share}.")
        for name in ("stagnation_generations", "refocus_generations", "start_hidden"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}.")
        if self.elite_members < 0:
            raise ValueError(f"elite_members must be >= 0, not {self.elite_members}.")
        if self.innovations not in ("generation", "run"):
            raise ValueError(
                f"innovations must be 'generation' or 'run', not {self.innovations!r}."
            )
        if self.representative not in ("champion", "random"):
            raise ValueError(
                f"representative must be 'champion' or 'random', not {self.representative!r}."
            )
        if self.start not in ("minimal", "layered", "random"):
            raise ValueError(f"start must be 'minimal', 'layered' or 'random', not {self.start!r}.")


@dataclass
class _Record:
    """The best fitness so far, and the generation in which it was reached."""

    best: float | None = None
    generation: int = 0

    def note(self, fitness: float, generation: int) -> None:
        if self.best is None or fitness > self.best:
            self.best, self.generation = fitness, generation


class NEAT:
    """A population of which all members are replaced at once.

    Attributes:
        genomes: [population] the genomes of this generation; only `advance` and `write_back`
            exchange them. Champions that live on keep their `genome_id`.
        generation: generations so far; the founders are generation 0.
        births: offspring so far, without the champions that lived on.
        rng: the only source of chance.
        ledger: historical markings.
        speciation: species and their threshold.
    """

    def __init__(
        self,
        config: NEATConfig,
        genomes: Sequence[Genome],
        rng: np.random.Generator,
        ledger: InnovationLedger,
        first_genome_id: int,
    ) -> None:
        """Start with founders.

        Args:
            config: how generations follow each other.
            genomes: [population] the founders, all with the same inputs and outputs.
            rng: the only source of chance; nobody else should draw from it.
            ledger: historical markings that know the founders.
            first_genome_id: number of the first offspring, beyond those of the founders.

        Raises:
            ValueError: there is no founder, or the number is taken.
        """
        highest = max((genome.genome_id for genome in genomes), default=None)
        if highest is None:
            raise ValueError("a population needs at least 1 genome, not 0.")
        if first_genome_id <= highest:
            raise ValueError(
                f"first_genome_id must be beyond the founders' highest id {highest}, not "
                f"{first_genome_id}."
            )
        self.config = config
        self.genomes = list(genomes)
        self.generation = 0
        self.births = 0
        self.rng = rng
        self.ledger = ledger
        self.speciation = Speciation(config.species, config.reproduction.distance)
        if not config.speciate:
            # Everybody is compatible. Finite, because a state is kept as JSON.
            self.speciation.threshold = float(np.finfo(np.float64).max)
        self.speciation.renew(self.genomes, [])
        self._next_genome_id = first_genome_id
        self._record = _Record()
        self._records: dict[int, _Record] = {}

    @classmethod
    def start(
        cls,
        config: NEATConfig,
        *,
        population: int,
        inputs: int,
        outputs: int,
        rng: np.random.Generator,
        bias: bool = True,
        activation: str | None = None,
        observation_schema: str = "",
    ) -> Self:
        """Return a population of founders, numbered from 1, that look as `config.start` says.

        Args:
            config: how generations follow each other.
            population: number of genomes, the same in all generations.
            inputs: number of inputs, without the bias.
            outputs: number of outputs.
            rng: the only source of chance.
            bias: whether there is a bias node.
            activation: activation of the outputs, and of hidden nodes that founders have; that
                which mutation gives to hidden nodes if None.
            observation_schema: name of the meaning and order of the inputs.
        """
        settings: dict[str, Any] = {
            "rng": rng,
            "bias": bias,
            "activation": activation or config.reproduction.mutation.hidden_activation,
            "observation_schema": observation_schema,
        }
        make = initial_genome
        if config.start != "minimal":
            make = layered_genome if config.start == "layered" else random_genome
            settings["hidden"] = config.start_hidden
        numbers = range(1, population + 1)
        founders = [make(inputs, outputs, genome_id=one, **settings) for one in numbers]
        return cls(config, founders, rng, InnovationLedger.for_genomes(founders), population + 1)

    @property
    def species(self) -> list[Species]:
        """All species of this generation, in the order they were founded."""
        return self.speciation.species

    def write_back(self, slot: int, weights: ArrayLike) -> None:
        """Give the genome of a slot the weights, float32 [links], that it learned in its life."""
        self.genomes[slot] = self.genomes[slot].with_weights(weights)

    def advance(self, fitness: ArrayLike) -> None:
        """Replace this generation by the next.

        Species are ranked and have offspring in proportion to their mean fitness; the fittest of
        each breed, all with equal chance. If all species stagnate the two best of them breed, so a
        population never dies out. As in the paper, the best genome of a small or stagnating species
        is lost, even if it is the best of all: where it was always kept, single runs of double pole
        balancing hung on to it for hundreds of generations.

        Args:
            fitness: [population] of the genomes in their slots, finite. May be negative.

        Raises:
            ValueError: the shape is wrong or a fitness is not finite.
        """
        fitness = judged(fitness, len(self.genomes))
        for species in self.species:
            species.rank(fitness)
        champions = fitness[[species.members[0] for species in self.species]]
        self._note(champions)
        counts = self._offspring_counts(shared_fitness(fitness, self.species), champions)
        genomes: list[Genome] = []
        for species, count in zip(self.species, counts.tolist(), strict=True):
            genomes += self._children(species, count, fitness)
        self._settle(genomes)

    def _note(self, champions: NDArray[np.float64]) -> None:
        """Bring the records of the population and of all [species] up to date."""
        self._record.note(float(champions.max()), self.generation)
        records: dict[int, _Record] = {}
        for species, fitness in zip(self.species, champions.tolist(), strict=True):
            record = self._records.get(species.species_id, _Record())
            record.note(fitness, self.generation)
            records[species.species_id] = record
        self._records = records

    def _offspring_counts(
        self, shares: NDArray[np.float64], champions: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Return how many genomes of the next generation come from each of [species].

        Args:
            shares: their shared fitness; written.
            champions: the fitness of their champions.
        """
        records = [self._records[one.species_id] for one in self.species]
        waited = np.array([self.generation - one.generation for one in records])
        shares[waited >= self.config.stagnation_generations] = 0.0
        all_waited = self.generation - self._record.generation
        if all_waited >= self.config.refocus_generations or not shares.any():
            shares = self._refocused(champions)
        return offspring_counts(shares, len(self.genomes))

    def _refocused(self, champions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return equal shares for the two best of [species], who are given time again."""
        best = np.argsort(-champions, kind="stable")[:2]
        self._record.generation = self.generation
        for one in best:
            self._records[self.species[one].species_id].generation = self.generation
        shares = np.zeros(champions.size)
        shares[best] = 1.0
        return shares

    def _children(self, species: Species, count: int, fitness: NDArray[np.float64]) -> list[Genome]:
        """Return what comes from a ranked species: its champion, if it is large, and offspring."""
        large = species.members.size > self.config.elite_members
        children = [self.genomes[species.members[0]]] if count and large else []
        pool = breeders(species.members, self.config.survival_share)
        while len(children) < count:
            children.append(self._child(species, pool, fitness))
        return children

    def _child(
        self, home: Species, pool: NDArray[np.int64], fitness: NDArray[np.float64]
    ) -> Genome:
        reproduction = self.config.reproduction
        slots = [int(pool[self.rng.integers(pool.size)])]
        outside = False
        if pool.size > 1 and self.rng.random() >= reproduction.mutate_only_prob:
            others = [one for one in self.species if one is not home]
            outside = bool(others) and self.rng.random() < reproduction.interspecies_mate_prob
            if outside:
                mate = others[self.rng.integers(len(others))].members[0]
            else:
                mate = pool[self.rng.integers(pool.size)]
            slots.append(int(mate))
        child = offspring(
            tuple(Parent(self.genomes[slot], float(fitness[slot])) for slot in slots),
            reproduction,
            self.ledger,
            self.rng,
            genome_id=self._next_genome_id,
            interspecies=outside,
        )
        self._next_genome_id += 1
        self.births += 1
        return child

    def _settle(self, genomes: list[Genome]) -> None:
        """Make genomes the next generation and sort them into the species, which are ranked."""
        random = self.config.representative == "random"
        slots = [
            one.members[self.rng.integers(one.members.size) if random else 0]
            for one in self.species
        ]
        representatives = [self.genomes[slot] for slot in slots]
        self.speciation.renew(genomes, representatives)
        if self.config.species.step and self.config.speciate:
            self.speciation.move_threshold()
        if self.config.innovations == "generation":
            self.ledger.forget()
        self.genomes = genomes
        self.generation += 1

    def state_dict(self) -> dict[str, Any]:
        """Return the whole state as JSON values and numpy arrays."""
        records = {0: self._record, **self._records}
        return {
            "genomes": pack_genomes(self.genomes),
            "rng": self.rng.bit_generator.state,
            "ledger": self.ledger.state_dict(),
            "speciation": self.speciation.state_dict(),
            "records": [[key, one.best, one.generation] for key, one in records.items()],
            "generation": self.generation,
            "births": self.births,
            "next_genome_id": self._next_genome_id,
        }

    @classmethod
    def from_state(cls, config: NEATConfig, state: Mapping[str, Any]) -> Self:
        """Return a population that continues bit for bit where `state_dict` was taken."""
        genomes = unpack_genomes(state["genomes"])
        rng = generator_from(state["rng"])
        ledger = InnovationLedger.from_state(state["ledger"])
        population = cls(config, genomes, rng, ledger, state["next_genome_id"])
        population.speciation = Speciation.from_state(
            config.species, config.reproduction.distance, state["speciation"]
        )
        records = {key: _Record(best, generation) for key, best, generation in state["records"]}
        population._record = records.pop(0)
        population._records = records
        population.generation = state["generation"]
        population.births = state["births"]
        return population
