"""The parts of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from neatq_envs.random_play import ObservationScaling
from neatq_torch.evolution import Population, Replacement
from neatq_torch.genome import Genome
from neatq_torch.learning import (
    CandidatePolicy,
    Heads,
    Learner,
    RunningNormalization,
    Teachers,
)
from neatq_torch.network import PopulationNetwork
from neatq_trainers.config import RunConfig
from neatq_trainers.worlds import World

EXPLORATION_STREAM = 5
"""Of the random numbers of exploration in generations: [seed, stream, generation, slot]."""

State = dict[str, Any]


class Stateful(Protocol):
    """What a checkpoint keeps."""

    def state_dict(self) -> State:
        """Everything that a checkpoint must keep."""
        ...

    def load_state_dict(self, state: State) -> None:
        """Go on from `state_dict`."""
        ...


class Policy(Stateful, Protocol):
    """What a run asks of a policy."""

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add every robot's action."""
        ...

    def reset(self, newborn: Tensor) -> None:
        """Let newborns (mask [arenas, slots]) start afresh."""
        ...


class Champion(NamedTuple):
    """The best genome of an arena.

    Attributes:
        genome: With the weights that it had at the end of its life.
        score: Mean return, of held-out episodes where there are such.
        generation: In which it lived, from 1.
        scaling: Of the observations that it read; None: that of the world.
    """

    genome: Genome
    score: float
    generation: int
    scaling: ObservationScaling | None = None


class Metrics(Stateful, Protocol):
    """Watches a run: makes its rows of numbers, and remembers its champions.

    Attributes:
        champions: That of each arena, where one is remembered.
    """

    champions: list[Champion | None]

    def add(self, run: Run, batch: TensorDictBase, error: Tensor) -> Sequence[Any]:
        """The rows that fall into a batch, after evolution has been told of it.

        Args:
            run: The run, its `tick` at the end of the batch.
            batch: [arenas, slots, ticks].
            error: Mean squared TD error of each slot in the batch [arenas, slots].
        """
        ...

    def steps(self, run: Run) -> int:
        """Steps so far of the arena that has fewest."""
        ...


@dataclass(kw_only=True)
class Run:
    """The parts of a run.

    Attributes:
        config: What it was made from.
        world: Where all live.
        heads: How outputs of networks are read.
        policy: Acts for all slots.
        learner: Learns for all slots.
        network: All networks; None if robots learn in tables.
        populations: The genomes of each arena; empty without evolution.
        teachers: By whom newborns are taught; None where all have the same.
        normalization: Of what networks read; None where it is read as it comes.
        metrics: Watches it.
        tick: Ticks so far.
        replacements: What evolution replaced last, of each arena.
        migrations: How many times genomes have come from other arenas.
        disturbed: Whether somebody has changed the world between two strides, so that robots must
            look again.
    """

    config: RunConfig
    world: World
    heads: Heads
    policy: Policy
    learner: Learner
    network: PopulationNetwork | None
    populations: list[Population]
    teachers: Teachers | None = None
    normalization: RunningNormalization | None = None
    metrics: Metrics
    tick: int = 0
    replacements: list[list[Replacement]] = field(default_factory=list)
    migrations: int = 0
    disturbed: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """(arenas, slots)."""
        return self.world.shape

    @property
    def generation(self) -> int:
        """Generations that all arenas have lived through."""
        return min((one.generations for one in self.populations), default=0)

    def begin_generation(self) -> None:
        """Where generations live: say which one begins, and with which chance it explores."""
        if self.config.generational:
            self.world.begin(self.generation)
            if isinstance(self.policy, CandidatePolicy):
                self.policy.begin([self._chances(seed) for seed in self.config.seeds])

    def _chances(self, seed: int) -> list[int]:
        """The seed of exploration of each slot of an arena, in this generation."""
        words = seed, EXPLORATION_STREAM, self.generation
        sequences = (np.random.SeedSequence([*words, slot]) for slot in range(self.shape[1]))
        return [int(one.generate_state(1)[0]) for one in sequences]

    def genome(self, arena: int, slot: int) -> Genome:
        """The genome in a slot, with the weights that were learnt."""
        assert self.network is not None
        return self.network.genome(arena * self.shape[1] + slot)

    def champion(self, arena: int) -> Genome | None:
        """The fittest genome of an arena, with the weights that were learnt."""
        slot = self.populations[arena].champion if self.populations else None
        remembered = self.metrics.champions[arena]
        if remembered is not None:
            return remembered.genome
        return None if slot is None else self.genome(arena, slot)

    def state_dict(self) -> State:
        """Everything from which `build` goes on bit for bit; take it between two strides."""
        state = {
            "tick": self.tick,
            "policy": self.policy.state_dict(),
            "learner": self.learner.state_dict(),
            "weight": None if self.network is None else self.network.weight,
            "populations": [population.state_dict() for population in self.populations],
            "metrics": self.metrics.state_dict(),
        }
        if hasattr(self.world.env, "world_state"):
            state["world"] = self.world.env.world_state()
        if self.config.migration is not None:
            state["migrations"] = self.migrations
        if self.normalization is not None:
            state["normalization"] = self.normalization.state_dict()
        return state if self.teachers is None else state | {"teachers": self.teachers.state_dict()}
