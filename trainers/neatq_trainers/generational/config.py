"""What a run on a Gymnasium task is: one frozen configuration, and a preset for each arm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

from neatq_envs.gymnasium_task import PREFIX, GymnasiumTask, TaskError
from neatq_torch.evolution import NEATConfig
from neatq_torch.genome import ACTIVATIONS
from neatq_torch.learning import Inheritance, TraceConfig
from neatq_torch.network import Evaluation
from neatq_trainers.config import (
    ConfigError,
    LoggerName,
    from_plain,
    to_plain,
)

Arm = Literal["neat", "neatq", "qnetwork"]


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """How a genome's network is made and evaluated.

    Attributes:
        candidates: Candidate actions in a box; with 1 there is nothing to choose and no Q-value.
            Without meaning where the environment has a few actions to choose from.
        evaluation: settle: forward links within one step; synchronous: one propagation a step.
        activation: Of the outputs of the first genomes. None: sigmoid; but identity where outputs
            only say which action is best, so that none of them saturates.
    """

    candidates: int = 5
    evaluation: Evaluation = "settle"
    activation: str | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        if self.candidates < 1:
            raise ConfigError(f"network.candidates: expected at least 1, got {self.candidates}")
        if self.activation is not None and self.activation not in ACTIVATIONS:
            raise ConfigError(
                f"network.activation: expected one of {', '.join(ACTIVATIONS)}; got "
                f"{self.activation!r}"
            )


@dataclass(frozen=True, kw_only=True)
class LifeLearningConfig:
    """What a genome's network learns during its life.

    Attributes:
        rule: none: evolution alone; traces: Q(lambda) with eligibility traces, at every step;
            wire_fitting: one-step Q-learning on the value interpolated between the candidate
            actions, which moves the candidates too. It needs a box of actions.
        step: Learning rate, in units of the network outputs, discount and trace decay (which
            wire_fitting does not use).
        anneal: Let the learning rate fall to 0 over the episodes of a life.
        epsilon: Probability of starting to explore, per step.
        max_hold_steps: Longest run of an explored action; 1 is plain epsilon-greedy.
        value_range: Q-values that the outputs 0 and 1 of a network stand for. None: from rewards
            and lengths of episodes of random play, see `neatq_trainers.generational.scout`.
        inheritance: darwinian: genes stay as they were born; lamarckian: what was learnt is
            written into the genome before it breeds.
    """

    rule: Literal["none", "traces", "wire_fitting"] = "traces"
    step: TraceConfig = field(default_factory=lambda: TraceConfig(discount=0.99))
    anneal: bool = True
    epsilon: float = 0.05
    max_hold_steps: int = 1
    value_range: tuple[float, float] | None = None
    inheritance: Inheritance = "darwinian"

    def __post_init__(self) -> None:
        """Check ranges."""
        if not 0 <= self.epsilon <= 1:
            raise ConfigError(f"learning.epsilon: expected a number in [0, 1], got {self.epsilon}")
        if self.max_hold_steps < 1:
            raise ConfigError(
                f"learning.max_hold_steps: expected at least 1, got {self.max_hold_steps}"
            )
        if self.value_range is not None:
            low, high = self.value_range
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ConfigError(
                    f"learning.value_range: expected two numbers, the smaller first, got {low} "
                    f"and {high}"
                )


NO_LEARNING = LifeLearningConfig(rule="none", epsilon=0.0)


@dataclass(frozen=True, kw_only=True)
class PretrainingConfig:
    """What newborns learn from the transitions of the generation before them.

    It costs no step in the environment (Whiteson & Stone 2006, "Sample-efficient evolutionary
    function approximation").

    Attributes:
        steps: Minibatches on which each network is trained before its first step; 0 goes without.
        batch: Transitions of a minibatch; all networks of an arena see the same.
        learning_rate: Of Adam, whose steps do not depend on the range of Q-values.
        transitions: How many an arena remembers: the same share of each life, drawn from all of it.
    """

    steps: int = 0
    batch: int = 32
    learning_rate: float = 0.01
    transitions: int = 10_000

    def __post_init__(self) -> None:
        """Check ranges."""
        for name, least in (("steps", 0), ("batch", 1), ("transitions", 1)):
            if getattr(self, name) < least:
                raise ConfigError(
                    f"pretraining.{name}: expected at least {least}, got {getattr(self, name)}"
                )
        if not 0 < self.learning_rate < math.inf:
            raise ConfigError(
                "pretraining.learning_rate: expected a finite number above 0, got "
                f"{self.learning_rate}"
            )


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """How the champion is found: without exploration, without learning, on episodes of its own.

    Attributes:
        every: Generations from one evaluation to the next; the first generation has one, too.
        genomes: How many of a generation, the fittest, are evaluated.
        episodes: Held-out episodes, the same at every evaluation.
        test_episodes: Episodes, others again, in which the champion is tested after the run.
    """

    every: int = 5
    genomes: int = 3
    episodes: int = 20
    test_episodes: int = 100

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("every", "genomes", "episodes", "test_episodes"):
            if getattr(self, name) < 1:
                raise ConfigError(
                    f"evaluation.{name}: expected at least 1, got {getattr(self, name)}"
                )


@dataclass(frozen=True, kw_only=True)
class GenerationalConfig:
    """A whole run on a Gymnasium task.

    Attributes:
        task: "gym:" and the id of a Gymnasium environment, such as gym:CartPole-v1, or
            gym:my_module:MyEnv-v0 for one that my_module registers.
        env_kwargs: Arguments of the environment, each name=value: continuous=true. Values are
            JSON; max_episode_steps=500 sets a time limit.
        arm: neat, neatq or qnetwork; sets the defaults of what follows.
        population: Genomes of each arena.
        generations: Length of the run.
        episodes: Episodes in the life of each genome.
        arenas: Independent populations side by side; arena i is the run with seed + i.
        seed: Of arena 0.
        checkpoint_seconds: Time between two checkpoints. Does not change the run.
        logger: Also log to TorchRL's csv or tensorboard logger.
        network: How networks are made.
        evolution: NEAT. The arm qnetwork takes its founders from here (start, start_hidden).
        learning: What a genome learns.
        pretraining: What it has learnt before its first step.
        evaluation: How the champion is found.
    """

    task: str = "gym:CartPole-v1"
    env_kwargs: tuple[str, ...] = ()
    arm: Arm = "neat"
    population: int = 150
    generations: int = 50
    episodes: int = 2
    arenas: int = 1
    seed: int = 0
    checkpoint_seconds: float = 30.0
    logger: LoggerName | None = None
    network: NetworkConfig = field(default_factory=NetworkConfig)
    evolution: NEATConfig = field(default_factory=NEATConfig)
    learning: LifeLearningConfig = field(default_factory=LifeLearningConfig)
    pretraining: PretrainingConfig = field(default_factory=PretrainingConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("population", "generations", "episodes", "arenas"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}: expected at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise ConfigError(f"seed: expected at least 0, got {self.seed}")
        if not self.checkpoint_seconds >= 0:
            raise ConfigError(
                f"checkpoint_seconds: expected at least 0, got {self.checkpoint_seconds}"
            )
        if not self.task.removeprefix(PREFIX):
            raise ConfigError("task: expected gym: and an id, such as gym:CartPole-v1")
        self._check_arm()
        try:
            _ = self.environment
        except TaskError as error:
            raise ConfigError(str(error)) from error

    def _check_arm(self) -> None:
        """Check what an arm needs."""
        if self.evolves and self.population < 2:
            raise ConfigError(
                f"population: expected at least 2, got {self.population}; one genome is no "
                "population that could evolve (the arm qnetwork can do with one)"
            )
        if not self.evolves and self.learning.rule == "none":
            raise ConfigError("learning.rule: qnetwork without learning would never change")
        if self.pretraining.steps:
            self._check_pretraining()

    def _check_pretraining(self) -> None:
        if self.learning.rule == "none":
            raise ConfigError(
                "pretraining.steps: expected 0 with learning.rule none, got "
                f"{self.pretraining.steps}; without learning networks have no Q-values (the arm "
                "neatq learns)"
            )
        if self.pretraining.transitions < self.population:
            raise ConfigError(
                f"pretraining.transitions: expected at least one for each of {self.population} "
                f"genomes, got {self.pretraining.transitions}"
            )

    @property
    def evolves(self) -> bool:
        """Whether genomes breed."""
        return self.arm != "qnetwork"

    @property
    def environment(self) -> GymnasiumTask:
        """The environment, not made yet."""
        return GymnasiumTask.parse(self.task, self.env_kwargs)

    @property
    def seeds(self) -> range:
        """That of each arena."""
        return range(self.seed, self.seed + self.arenas)

    def to_dict(self) -> dict[str, Any]:
        """JSON values from which `from_dict` makes an equal configuration."""
        return to_plain(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> GenerationalConfig:
        """Read what `to_dict` wrote.

        Raises:
            ConfigError: Naming the field that is missing, of a wrong type or out of range.
        """
        return from_plain(GenerationalConfig, values)


_ARMS: dict[str, dict[str, Any]] = {
    "neat": {
        "network": NetworkConfig(candidates=1),
        "learning": NO_LEARNING,
    },
    "neatq": {
        "episodes": 10,
    },
    "qnetwork": {
        "population": 1,
        "episodes": 50,
        "evolution": NEATConfig(start="layered"),
        "learning": LifeLearningConfig(anneal=False, inheritance="lamarckian"),
        "evaluation": EvaluationConfig(genomes=1),
    },
}


def preset(task: str, arm: str) -> GenerationalConfig:
    """The configuration of an arm on a Gymnasium task.

    Args:
        task: "gym:" and an id.
        arm: neat, neatq or qnetwork.

    Raises:
        ConfigError: If there is no such arm.
    """
    if arm not in _ARMS:
        raise ConfigError(
            f"arm: expected one of {', '.join(get_args(Arm))} on a Gymnasium task; got {arm!r}"
        )
    return replace(GenerationalConfig(), task=task, arm=arm, **_ARMS[arm])
