"""rtNEAT: one robot is replaced at a time while the others go on living.

Stanley, Bryant & Miikkulainen 2005, in the form that OpenNERO's source code gives it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.chance import generator_from
from neatq_torch.evolution.eligibility import interval_ticks, intervals_until
from neatq_torch.evolution.novelty import Novelty, mixed
from neatq_torch.evolution.reproduction import OPENNERO, Parent, ReproductionConfig, offspring
from neatq_torch.evolution.selection import choose_parents, worst
from neatq_torch.evolution.species import Speciation, Species, SpeciesConfig
from neatq_torch.evolution.trials import TrialAverage, Trials, relative_fitness
from neatq_torch.genome import (
    Genome,
    InnovationLedger,
    ScalesOf,
    initial_genome,
    pack_genomes,
    unpack_genomes,
)


@dataclass(frozen=True, kw_only=True)
class RtNEATConfig:
    """How a population evolves; the defaults are those of OpenNERO.

    Attributes:
        reproduction: how offspring come about.
        species: how genomes are sorted into species.
        minimum_life_ticks: age of a genome, over all lives of its robot, at which it can be judged;
            also the length of a trial.
        ineligible_fraction: share of the population that is too young to be judged, in (0, 1].
        reward_weights: weight of each reward dimension in the fitness.
        trial_average: how trials are averaged, see `Trials`.
        novelty: weight of novelty beside fitness in who lives and who breeds, in (0, 1]; None for
            fitness alone.
    """

    reproduction: ReproductionConfig = OPENNERO
    species: SpeciesConfig = field(default_factory=SpeciesConfig)
    minimum_life_ticks: int = 1000
    ineligible_fraction: float = 0.5
    reward_weights: tuple[float, ...] = (1.0,)
    trial_average: TrialAverage = "opennero"
    novelty: float | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        if self.minimum_life_ticks < 1:
            raise ValueError(
                f"minimum_life_ticks must be at least 1, not {self.minimum_life_ticks}."
            )
        if not 0.0 < self.ineligible_fraction <= 1.0:
            raise ValueError(
                f"ineligible_fraction must lie in (0, 1], not {self.ineligible_fraction}."
            )
        if not self.reward_weights or not np.isfinite(self.reward_weights).all():
            raise ValueError(
                "reward_weights must be one finite number for each reward dimension, not "
                f"{self.reward_weights}."
            )
        if self.trial_average not in ("opennero", "exponential"):
            raise ValueError(
                f"trial_average must be 'opennero' or 'exponential', not {self.trial_average!r}."
            )
        if self.novelty is not None and not 0.0 < self.novelty <= 1.0:
            raise ValueError(f"novelty must lie in (0, 1], or be None, not {self.novelty}.")


class Replacement(NamedTuple):
    """What happened to one slot.

    Attributes:
        slot: place of the robot that got a new genome.
        genome: the offspring that lives there now.
        removed_genome_id: the genome that lived there before.
        parents: genome ids of the one or two parents, that of the fitter one first.
    """

    slot: int
    genome: Genome
    removed_genome_id: int
    parents: tuple[int, ...]


class RtNEAT:
    """The population of one arena: slot i holds the genome of robot i.

    Attributes:
        genomes: [robots] the genomes alive; only `replace` and `write_back` exchange them.
        births: offspring so far.
        tick: ticks recorded so far.
        rng: the only source of chance.
        ledger: historical markings.
        speciation: species and their threshold.
        trials: ages and rewards.
        novelty: behaviours; None where they do not count.
    """

    def __init__(
        self,
        config: RtNEATConfig,
        genomes: Sequence[Genome],
        rng: np.random.Generator,
        ledger: InnovationLedger,
        first_genome_id: int,
    ) -> None:
        """Start with founders of age 0.

        Args:
            config: how the population evolves.
            genomes: [robots] the founders, at least two, all with the same inputs and outputs.
            rng: the only source of chance; nobody else should draw from it.
            ledger: historical markings that know the founders.
            first_genome_id: number of the first offspring, beyond those of the founders.

        Raises:
            ValueError: there are fewer than two founders, or the number is taken.
        """
        if len(genomes) < 2:
            raise ValueError(f"a population needs at least 2 genomes, not {len(genomes)}.")
        highest = max(genome.genome_id for genome in genomes)
        if first_genome_id <= highest:
            raise ValueError(
                f"first_genome_id must be beyond the founders' highest id {highest}, not "
                f"{first_genome_id}."
            )
        self.config = config
        self.genomes = list(genomes)
        self.rng = rng
        self.ledger = ledger
        self.births = 0
        self.tick = 0
        dimensions = len(config.reward_weights)
        self.trials = Trials(
            len(genomes), dimensions, config.minimum_life_ticks, config.trial_average
        )
        self.novelty = (
            None if config.novelty is None else Novelty(len(genomes), config.minimum_life_ticks)
        )
        self.speciation = Speciation(config.species, config.reproduction.distance)
        for slot in range(len(genomes)):
            self.speciation.add(slot, self.genomes)
        self._next_genome_id = first_genome_id
        # Who came first: the older one goes first where the rules leave the order open.
        self._birth_order = np.arange(len(genomes))
        self._settled = self._intervals_until(config.minimum_life_ticks)

    @classmethod
    def start(
        cls,
        config: RtNEATConfig,
        *,
        robots: int,
        inputs: int,
        outputs: int,
        seed: int,
        observation_schema: str = "",
    ) -> Self:
        """Return a population of fully connected founders, numbered from 1.

        Outputs have the activation that mutation gives to hidden nodes.
        """
        rng = np.random.default_rng(seed)
        founders = [
            initial_genome(
                inputs,
                outputs,
                rng=rng,
                activation=config.reproduction.mutation.hidden_activation,
                observation_schema=observation_schema,
                genome_id=number,
            )
            for number in range(1, robots + 1)
        ]
        return cls(config, founders, rng, InnovationLedger.for_genomes(founders), robots + 1)

    @property
    def age_ticks(self) -> NDArray[np.int64]:
        """Int64 [robots], ticks since the genome of each slot was born."""
        return self.trials.age_ticks

    @property
    def eligible(self) -> NDArray[np.bool_]:
        """Bool [robots], whether a robot is old enough to be judged and to breed."""
        return self.trials.eligible

    @property
    def fitness(self) -> NDArray[np.float64]:
        """Float64 [robots] >= 0; the worst eligible robot and all ineligible ones have 0."""
        weights = np.asarray(self.config.reward_weights, dtype=np.float64)
        return relative_fitness(self.trials.averages, self.eligible, weights)

    @property
    def score(self) -> NDArray[np.float64]:
        """Float64 [robots] >= 0, by which robots live and breed: fitness, mixed with novelty."""
        if self.novelty is None or self.config.novelty is None:
            return self.fitness
        eligible = self.eligible
        novelty = self.novelty.of(np.flatnonzero(eligible))
        return mixed(self.fitness, novelty, eligible, self.config.novelty)

    @property
    def champion(self) -> int | None:
        """Slot of the fittest eligible robot, None if nobody is eligible."""
        eligible = np.flatnonzero(self.eligible)
        return int(eligible[np.argmax(self.fitness[eligible])]) if eligible.size else None

    @property
    def species(self) -> list[Species]:
        """All species, in the order they were founded."""
        return self.speciation.species

    @property
    def interval_ticks(self) -> float:
        """Ticks between replacements: the law of eligibility n = m / (|P| I)."""
        life, share = self.config.minimum_life_ticks, self.config.ineligible_fraction
        return interval_ticks(life, len(self.genomes), share)

    def record(
        self,
        rewards: ArrayLike,
        behaviour: ArrayLike | None = None,
        counts: ArrayLike | None = None,
    ) -> None:
        """Let all robots live through some ticks.

        Args:
            rewards: [robots, ticks, dimensions].
            behaviour: [robots, ticks, dimensions of behaviour], such as where the robots are, if
                novelty counts; what stands at the end of a trial is how the robot behaved.
            counts: bool [robots, ticks], the ticks by which robots are judged; None for all.

        Raises:
            ValueError: a shape is wrong, something is not finite, or behaviour is missing.
        """
        rewards = np.asarray(rewards, dtype=np.float64)
        if self.novelty is None:
            self.trials.record(rewards, counts)
        else:
            ages, behaviour = self.age_ticks.copy(), self.novelty.checked(behaviour)
            self.trials.record(rewards, counts)
            self.novelty.record(ages, behaviour)
        self.tick += rewards.shape[1]

    def due(self) -> int:
        """Return how many replacements are due since the last call of `replace`.

        One is due at every multiple of the interval beyond `minimum_life_ticks`.
        """
        return max(0, self._intervals_until(self.tick) - self._settled)

    def replace(self, scales_of: ScalesOf | None = None) -> list[Replacement]:
        """Perform the replacements that are due, and return them.

        Each time the eligible robot with the lowest score / species size makes room for one
        offspring of age 0. Where nobody is eligible nothing happens and nothing stays due.

        Args:
            scales_of: how far mutation moves each weight of a genome, as a multiple; None moves all
                alike.
        """
        due = self.due()
        self._settled += due
        replacements: list[Replacement] = []
        while len(replacements) < due and self.eligible.any():
            replacements.append(self._replace_worst(scales_of))
        return replacements

    def write_back(self, slot: int, weights: ArrayLike) -> None:
        """Give the genome of a slot the weights, float32 [links], that its robot learned."""
        self.genomes[slot] = self.genomes[slot].with_weights(weights)
        self.speciation.changed(slot)

    def state_dict(self) -> dict[str, Any]:
        """Return the whole state as JSON values and numpy arrays."""
        state = {
            "genomes": pack_genomes(self.genomes),
            "rng": self.rng.bit_generator.state,
            "ledger": self.ledger.state_dict(),
            "speciation": self.speciation.state_dict(),
            "trials": self.trials.state_dict(),
            "births": self.births,
            "tick": self.tick,
            "next_genome_id": self._next_genome_id,
            "birth_order": self._birth_order.tolist(),
            "settled": self._settled,
        }
        return state if self.novelty is None else state | {"novelty": self.novelty.state_dict()}

    @classmethod
    def from_state(cls, config: RtNEATConfig, state: Mapping[str, Any]) -> Self:
        """Return a population that continues bit for bit where `state_dict` was taken."""
        genomes = unpack_genomes(state["genomes"])
        ledger = InnovationLedger.from_state(state["ledger"])
        rng = generator_from(state["rng"])
        population = cls(config, genomes, rng, ledger, state["next_genome_id"])
        population.speciation = Speciation.from_state(
            config.species, config.reproduction.distance, state["speciation"]
        )
        population.trials.load_state(state["trials"])
        if population.novelty is not None:
            population.novelty.load_state(state["novelty"])
        population.births = state["births"]
        population.tick = state["tick"]
        population._birth_order = np.array(state["birth_order"], dtype=np.int64)
        population._settled = state["settled"]
        return population

    def _intervals_until(self, tick: int) -> int:
        life, share = self.config.minimum_life_ticks, self.config.ineligible_fraction
        return intervals_until(tick, life, len(self.genomes), share)

    def _replace_worst(self, scales_of: ScalesOf | None) -> Replacement:
        fitness, eligible = self.score, self.eligible
        adjusted = fitness / self.speciation.sizes(len(self.genomes))
        slot = worst(adjusted, self._birth_order[eligible[self._birth_order]])
        removed = self.genomes[slot].genome_id
        self.speciation.remove(slot)
        slots, interspecies = choose_parents(
            self.species, fitness, eligible, self.config.reproduction, self.rng
        )
        parents = tuple(Parent(self.genomes[one], float(fitness[one])) for one in slots)
        genome = offspring(
            parents,
            self.config.reproduction,
            self.ledger,
            self.rng,
            genome_id=self._next_genome_id,
            interspecies=interspecies,
            scales_of=scales_of,
        )
        self._settle(slot, genome)
        ranked = sorted(parents, key=lambda parent: -parent.fitness)
        return Replacement(slot, genome, removed, tuple(one.genome.genome_id for one in ranked))

    def _settle(self, slot: int, genome: Genome) -> None:
        """Start the life of an offspring in an empty slot."""
        self.genomes[slot] = genome
        self.trials.reset(slot)
        self._next_genome_id += 1
        self.births += 1
        order = self._birth_order
        order[:-1], order[-1] = order[order != slot], slot
        self.speciation.add(slot, self.genomes)
        self.speciation.count_offspring(self.genomes, self._birth_order)
