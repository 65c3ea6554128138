"""What every population is and can do, and the kinds there are, by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.parsimony import enabled_links, good_ranks, shrinking
from neatq_torch.evolution.reproduction import NEAT_2002, Parent, ReproductionConfig, offspring
from neatq_torch.evolution.species import Species
from neatq_torch.evolution.trials import Kept, checked, weighted
from neatq_torch.genome import (
    ACTIVATIONS,
    Genome,
    InnovationLedger,
    initial_genome,
    layered_genome,
    pack_genomes,
    random_genome,
    unpack_genomes,
)
from neatq_torch.genome.rules import index_of
from neatq_torch.kinds import Kinds, check_fields

Data = ArrayLike | None
"""An array, or nothing where it does not matter."""

Start = Literal["minimal", "layered", "random"]
"""What founders look like: no hidden nodes; one hidden layer; a random topology."""


@dataclass(frozen=True, kw_only=True)
class LayeredFounders:
    """Founders with one hidden layer, made for learning by gradient.

    Attributes:
        hidden: hidden nodes of each.
        activation: of the hidden nodes.

    Example:
        >>> config = RtNEATConfig(founders=LayeredFounders(hidden=4))
    """

    hidden: int = 8
    activation: str = "tanh"

    def __post_init__(self) -> None:
        check_fields(self, hidden="[1, inf]")
        index_of(self.activation, ACTIVATIONS, "activation")


class Replacement(NamedTuple):
    """What happened to one slot.

    Attributes:
        slot: that got a new genome.
        genome: lives there now.
        removed_genome_id: of the genome that lived there before.
        parents: genome ids of the one or two parents, that of the fitter one first; a genome that
            lives on is its own.

    Example:
        >>> for replacement in population.advance():
        ...     network.replace(replacement.slot, replacement.genome)
    """

    slot: int
    genome: Genome
    removed_genome_id: int
    parents: tuple[int, ...]


class Population(Kept, ABC):
    """The genomes of one arena: slot i holds that of robot i.

    One of your own derives from this class, or from `FixedPopulation` as examples/map_elites.py.
    Make what it needs beside founders in `begin`, name its state in `kept`, say in the abstract
    members who is judged and what is due, and exchange genomes in `advance`: `breed` makes an
    offspring; one that is made otherwise takes `next_genome_id`, which then grows by 1, as do
    `births`. `register_population` gives it a name.

    Attributes:
        least: genomes that a population of this kind needs.
        config: how the population evolves.
        reward_weights: float64 [dimensions], of the rewards in the fitness.
        genomes: [slots] those alive; only `advance` and `write_back` exchange them.
        births: offspring so far.
        next_genome_id: number of the next offspring.
        rng: the only source of chance.
        ledger: historical markings.
        kept: attributes that are the state, beside genomes, chance and ledger: numbers, arrays
            whose shape does not change, and what has `state_dict` and `load_state` itself.
    """

    least = 1
    kept = ("births", "next_genome_id")

    def __init__(
        self,
        config: Any,
        genomes: Sequence[Genome],
        rng: np.random.Generator,
        ledger: InnovationLedger,
        first_genome_id: int,
        reward_weights: Sequence[float] = (1.0,),
    ) -> None:
        """Start with founders [slots], all with the same inputs and outputs.

        Nobody else should draw from `rng`, the ledger must know the founders, and the first
        offspring has the number `first_genome_id`.

        Raises:
            ValueError: there are too few founders, the number is taken, or a weight is not finite.
        """
        if len(genomes) < self.least:
            raise ValueError(f"expected at least {self.least} genomes, got {len(genomes)}.")
        highest = max(genome.genome_id for genome in genomes)
        if first_genome_id <= highest:
            wanted = f"one beyond the founders' highest id {highest}"
            raise ValueError(f"first_genome_id: expected {wanted}, got {first_genome_id}.")
        self.config = config
        self.weigh(reward_weights)
        self.genomes = list(genomes)
        self.births = 0
        self.rng = rng
        self.ledger = ledger
        self.next_genome_id = first_genome_id
        self.begin()

    @classmethod
    def start(
        cls,
        config: Any,
        *,
        slots: int,
        inputs: int,
        outputs: int,
        rng: int | np.random.Generator,
        reward_weights: Sequence[float] = (1.0,),
        activation: str | None = None,
        bias: bool = True,
        observation_schema: str = "",
    ) -> Self:
        """A population of founders, numbered from 1, that look as the configuration says.

        That is `config.founders` or `config.start`, if it has such; else they are minimal.

        Args:
            config: of this kind of population.
            slots: number of genomes, always the same.
            inputs: number of inputs, without the bias.
            outputs: number of outputs.
            rng: the only source of chance, or its seed.
            reward_weights: weight of each reward dimension in the fitness.
            activation: of the outputs, and of hidden nodes that founders have; if None that which
                mutation gives to hidden nodes, by `config.reproduction` or else by NEAT's.
            bias: whether there is a bias node.
            observation_schema: name of the meaning and order of the inputs.
        """
        rng = np.random.default_rng(rng)
        usual = getattr(config, "reproduction", NEAT_2002).mutation.hidden_activation
        settings: dict[str, Any] = {"rng": rng, "bias": bias, "activation": activation or usual}
        settings["observation_schema"] = observation_schema
        make, look = initial_genome, getattr(config, "start", "minimal")
        layered: LayeredFounders | None = getattr(config, "founders", None)
        if layered is not None:
            make, settings["hidden"] = layered_genome, layered.hidden
            settings["hidden_activation"] = layered.activation
        elif look != "minimal":
            make = layered_genome if look == "layered" else random_genome
            settings["hidden"] = config.start_hidden
        numbers = range(1, slots + 1)
        founders = [make(inputs, outputs, genome_id=one, **settings) for one in numbers]
        ledger = InnovationLedger.for_genomes(founders)
        return cls(config, founders, rng, ledger, slots + 1, reward_weights)

    @property
    def species(self) -> list[Species]:
        """All species, in the order they were founded; none where there are no such things."""
        return []

    @property
    @abstractmethod
    def eligible(self) -> NDArray[np.bool_]:
        """Bool [slots], whether a genome has lived long enough to be judged and to breed."""

    @property
    @abstractmethod
    def fitness(self) -> NDArray[np.float64]:
        """Float64 [slots], by which eligible genomes are judged."""

    @property
    def merit(self) -> NDArray[np.float64]:
        """Float64 [slots], the champion has most: fitness, or with parsimony `good_ranks`."""
        share = getattr(self.config, "parsimony", None)
        return self.fitness if share is None else self.ranked(partial(good_ranks, share=share))

    def ranked(self, rank: Callable[..., NDArray[np.float64]]) -> NDArray[np.float64]:
        """Ranks [slots] of eligible genomes, by their returns and enabled links; others have 0."""
        slots, ranks = np.flatnonzero(self.eligible), np.zeros(len(self.genomes))
        if slots.size:
            links = enabled_links([self.genomes[slot] for slot in slots])
            ranks[slots] = rank(self.mean_returns[slots], links)
        return ranks

    @property
    def mean_returns(self) -> NDArray[np.float64]:
        """Float64 [slots], weighted reward of a life of each eligible genome, on average."""
        return self.fitness

    @property
    def returns(self) -> NDArray[np.float64]:
        """Float64 [slots], weighted reward of the last closed life; NaN before the first."""
        return self.fitness

    @property
    @abstractmethod
    def generations(self) -> int:
        """Generations lived through: as many lives as there are slots make one."""

    @property
    def champion(self) -> int | None:
        """Slot of the eligible genome with most `merit`, None if nobody is eligible."""
        eligible = np.flatnonzero(self.eligible)
        return int(eligible[np.argmax(self.merit[eligible])]) if eligible.size else None

    def ask(self) -> list[Genome]:
        """The genomes alive, for a loop of one's own: judge them, then `tell`."""
        return list(self.genomes)

    @abstractmethod
    def record(self, rewards: ArrayLike, done: Data = None, *, behaviour: Data = None) -> None:
        """Let all live through some ticks; how they are cut into batches is no matter.

        Args:
            rewards: [slots, ticks, dimensions].
            done: bool [slots, ticks], the ticks with which an episode ends; needed where lives are
                made of episodes.
            behaviour: [slots, ticks, dimensions of behaviour], such as where the robots are, for
                populations of one's own that seek variety.

        Raises:
            ValueError: a shape is wrong, something is not finite, or something is missing.
        """

    @abstractmethod
    def due(self) -> int:
        """How many things `advance` has to do: replacements, or a whole generation."""

    @abstractmethod
    def advance(self) -> list[Replacement]:
        """Replace what is due, and tell what happened."""

    def weigh(self, reward_weights: Sequence[float]) -> None:
        """Let rewards count so much in the fitness from now on, also those that were earned."""
        weights = tuple(reward_weights)
        self.reward_weights = checked("reward_weights", weights, dimensions=max(1, len(weights)))

    def write_back(self, slot: int, weights: ArrayLike) -> None:
        """Give the genome of a slot the weights, float32 [links], that it learned in its life."""
        self.genomes[slot] = self.genomes[slot].with_weights(weights)

    def state_dict(self) -> dict[str, Any]:
        """The whole state as JSON values and numpy arrays."""
        return {
            "genomes": pack_genomes(self.genomes),
            "rng": self.rng.bit_generator.state,
            "ledger": self.ledger.state_dict(),
            **super().state_dict(),
        }

    @classmethod
    def from_state(
        cls, config: Any, state: Mapping[str, Any], *, reward_weights: Sequence[float] = (1.0,)
    ) -> Self:
        """A population that continues bit for bit where `state_dict` was taken."""
        ledger, rng = InnovationLedger.from_state(state["ledger"]), generator_from(state["rng"])
        genomes, first = unpack_genomes(state["genomes"]), state["next_genome_id"]
        population = cls(config, genomes, rng, ledger, first, reward_weights)
        population.load_state(state)
        return population

    @abstractmethod
    def begin(self) -> None:
        """Make what a kind of population needs beside its founders; draws no chance."""

    @property
    def reproduction(self) -> ReproductionConfig:
        """How offspring come about: with parsimony `shrinking`."""
        own = self.config.reproduction
        return own if getattr(self.config, "parsimony", None) is None else shrinking(own)

    def breed(
        self, slots: Sequence[int], fitness: NDArray[np.float64], *, interspecies: bool
    ) -> tuple[Genome, tuple[int, ...]]:
        """An offspring of the genomes in one or two slots, and their ids, the fitter one first."""
        parents = tuple(Parent(self.genomes[slot], float(fitness[slot])) for slot in slots)
        means = self.reproduction, self.ledger, self.rng
        number = self.next_genome_id
        genome = offspring(parents, *means, genome_id=number, interspecies=interspecies)
        self.next_genome_id += 1
        self.births += 1
        ranked = sorted(parents, key=lambda parent: -parent.fitness)
        return genome, tuple(one.genome.genome_id for one in ranked)


class Generational(Population):
    """A population whose members all live through `config.episodes` episodes, then go on at once.

    Attributes:
        generation: generations so far; the founders are generation 0.
        earned: float64 [slots, episodes], weighted rewards.
        ended: int64 [slots], episodes that ended; after the last one nothing counts any more.
    """

    kept = (*Population.kept, "generation", "earned", "ended")

    def begin(self) -> None:
        """See `Population`."""
        self.generation = 0
        self.earned = np.zeros((len(self.genomes), self.config.episodes))
        self.ended = np.zeros(len(self.genomes), dtype=np.int64)

    @property
    def eligible(self) -> NDArray[np.bool_]:
        """See `Population`: a genome that had all its episodes."""
        return self.ended == self.config.episodes

    @property
    def fitness(self) -> NDArray[np.float64]:
        """Float64 [slots], mean weighted reward of the episodes of a life; NaN until it is over."""
        return np.where(self.eligible, self.earned.mean(1), np.nan)

    @property
    def generations(self) -> int:
        """Generations whose lives are over."""
        return self.generation + self.due()

    def record(self, rewards: ArrayLike, done: Data = None, *, behaviour: Data = None) -> None:
        """See `Population`; `behaviour` makes no difference here."""
        slots, dimensions = len(self.genomes), self.reward_weights.size
        rewards = checked("rewards", rewards, slots=slots, ticks=None, dimensions=dimensions)
        done = checked("done", done, bool, slots=slots, ticks=rewards.shape[1])
        rewards = weighted(rewards, self.reward_weights)
        # Strictly one tick after the other, so that the cut into batches is no matter.
        for tick in range(rewards.shape[1]):
            living = np.flatnonzero(~self.eligible)
            self.earned[living, self.ended[living]] += rewards[living, tick]
            self.ended[living] += done[living, tick]

    def due(self) -> int:
        """1 when all have had all their episodes, else 0."""
        return int(self.eligible.all())

    def go_on(self) -> None:
        """Begin the lives of another generation."""
        self.generation += 1
        self.earned[:] = 0.0
        self.ended[:] = 0


@dataclass(frozen=True, kw_only=True)
class FixedConfig:
    """Networks of fixed structure that stay: what is learnt is all that changes.

    Attributes:
        episodes: of a life, as in `NEATConfig`.
        start: what they look like.
        start_hidden: hidden nodes of "layered" ones, and the most that "random" ones have.
        founders: what they look like instead of `start`; None: as that says.

    Example:
        >>> config = FixedConfig(start_hidden=20)
    """

    episodes: int = 1
    start: Start = "layered"
    start_hidden: int = 10
    founders: LayeredFounders | None = None

    def __post_init__(self) -> None:
        check_fields(self, start=Start, start_hidden="[1, inf]", episodes="[1, inf]")


class FixedPopulation(Generational):
    """Genomes that stay, with the weights that they have learned; see `Generational`.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> config = FixedConfig(start_hidden=20)
        >>> population = FixedPopulation.start(config, slots=1, inputs=4, outputs=2, rng=rng)
    """

    def advance(self) -> list[Replacement]:
        """Begin other lives once all have had all their episodes: every slot by itself."""
        if not self.due():
            return []
        self.go_on()
        slots = [(slot, one, one.genome_id) for slot, one in enumerate(self.genomes)]
        return [Replacement(slot, genome, own, (own,)) for slot, genome, own in slots]


def generator_from(state: Mapping[str, Any]) -> np.random.Generator:
    """The generator whose `bit_generator.state` was saved."""
    bits = getattr(np.random, state["bit_generator"])()
    bits.state = state
    return np.random.Generator(bits)


population_kinds = Kinds("population")
"""All kinds of populations, by name."""

register_population = population_kinds.register
"""Add a kind of population, which `train` and the command line then know by its name.

One whose configuration has `episodes` lives generation by generation: all slots have so many
episodes each.
"""
