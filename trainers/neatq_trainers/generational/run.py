"""All parts of a run on a Gymnasium task, and its state at the border of generations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from neatq_envs.gymnasium_task import PREFIX, Interface
from neatq_torch.evolution import NEAT
from neatq_torch.genome import Genome
from neatq_trainers.config import ConfigError
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.fixed import FixedPopulation, Population
from neatq_trainers.generational.lives import make_heads
from neatq_trainers.generational.purposes import EVOLUTION
from neatq_trainers.generational.recording import Transitions
from neatq_trainers.generational.scout import Surroundings

State = dict[str, Any]


class Champion(NamedTuple):
    """The best genome that was evaluated so far.

    Attributes:
        genome: With the weights that it had at the end of its life.
        score: Mean return of its held-out episodes.
        generation: In which it lived, from 1.
    """

    genome: Genome
    score: float
    generation: int


@dataclass(kw_only=True)
class Run:
    """A run between two generations. Everything that a generation changes is here.

    Attributes:
        config: What it was made from.
        surroundings: What random play has shown.
        populations: The genomes of each arena.
        champions: The champion of each arena; none before the first generation.
        generation: Generations so far.
        steps: Steps so far in each arena, int64 [arenas].
        memories: What the last generation of each arena left to the next; none without
            pre-training, and before the first generation.
    """

    config: GenerationalConfig
    surroundings: Surroundings
    populations: list[Population]
    champions: list[Champion]
    generation: int = 0
    steps: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    memories: list[Transitions] = field(default_factory=list)

    @property
    def best(self) -> Champion | None:
        """The best champion of all arenas, of equal ones that of the first."""
        return max(self.champions, key=lambda one: one.score) if self.champions else None

    def state(self) -> State:
        """Everything from which `load_run` goes on bit for bit."""
        return {
            "generation": self.generation,
            "steps": self.steps,
            "surroundings": self.surroundings.to_dict(),
            "populations": [population.state_dict() for population in self.populations],
            "champions": [
                {"genome": one.genome.to_dict(), "score": one.score, "generation": one.generation}
                for one in self.champions
            ],
            "memories": self.memories,
        }


def begin_run(config: GenerationalConfig, surroundings: Surroundings, interface: Interface) -> Run:
    """A run before its first generation.

    Raises:
        ConfigError: If there is nothing to choose from, and so nothing to learn.
    """
    heads = make_heads(config, interface, surroundings.value_range)
    if config.learning.rule != "none" and heads.candidates < 2:
        raise ConfigError(
            f"network.candidates: expected at least 2, got {heads.candidates}; with one there is "
            "no Q-value to learn (--learning.rule none goes without)"
        )
    if config.learning.rule == "wire_fitting" and interface.choices is not None:
        raise ConfigError(
            f"learning.rule: expected traces or none, got wire_fitting; {config.environment.id} "
            f"has {interface.choices} actions to choose from, between which nothing can be "
            "interpolated (wire_fitting needs a box of actions)"
        )
    only_ranks = interface.choices is not None and config.learning.rule == "none"
    activation = config.network.activation or ("identity" if only_ranks else "sigmoid")
    kind = NEAT if config.evolves else FixedPopulation
    populations: list[Population] = [
        kind.start(
            config.evolution,
            population=config.population,
            inputs=interface.inputs,
            outputs=heads.outputs,
            rng=np.random.default_rng([seed, EVOLUTION]),
            activation=activation,
            observation_schema=observation_schema(config),
        )
        for seed in config.seeds
    ]
    return Run(
        config=config,
        surroundings=surroundings,
        populations=populations,
        champions=[],
        steps=np.zeros(config.arenas, np.int64),
    )


def load_run(config: GenerationalConfig, state: Mapping[str, Any]) -> Run:
    """The run whose `state` was saved."""
    kind = NEAT if config.evolves else FixedPopulation
    return Run(
        config=config,
        surroundings=Surroundings.from_dict(state["surroundings"]),
        populations=[kind.from_state(config.evolution, one) for one in state["populations"]],
        champions=_champions(state["champions"]),
        generation=state["generation"],
        steps=np.asarray(state["steps"]),
        memories=state["memories"],
    )


def _champions(saved: Sequence[Mapping[str, Any]]) -> list[Champion]:
    return [
        Champion(Genome.from_dict(one["genome"]), one["score"], one["generation"]) for one in saved
    ]


def observation_schema(config: GenerationalConfig) -> str:
    """Name of the observations of an environment, by which its genomes know them."""
    return PREFIX + config.environment.id
