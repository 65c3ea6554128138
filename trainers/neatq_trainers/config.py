"""What a run is: one typed, frozen configuration, and a preset for each arm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import msgspec

from neatq_envs.scenario import TASKS, Scenario, load_scenario
from neatq_torch.evolution import RtNEATConfig, interval_ticks
from neatq_torch.genome import ACTIVATIONS
from neatq_torch.learning import Bootstrap, Inheritance, LearnerConfig, ReplayConfig
from neatq_torch.network import Evaluation

Arm = Literal["rtneat", "committed", "described", "neatq", "qlearning"]
LoggerName = Literal["csv", "tensorboard"]

TASK_TICKS = {
    "flag": 40_000,
    "moving": 60_000,
    "wall": 70_000,
    "trap": 70_000,
    "maze": 70_000,
    "switch": 70_000,
}
"""Length of the published runs (one tick of their figures is 100 ticks); of our own tasks, the
longest of them."""


STRIDE_TICKS = 40
"""Least ticks between two rebuilds of the physics, which cost as much as a few ticks."""


class ConfigError(ValueError):
    """A run cannot be made as asked; the message says what was expected and how to mend it."""


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """How a robot's network is made and evaluated.

    Attributes:
        candidates: Candidate actions K; with 1 there is nothing to choose and no Q-value.
        evaluation: settle: forward links within one tick; synchronous: one propagation a tick.
        activation: Of the outputs of the first genomes.
        double_activation: Activate again with the observation before (published rtNEAT+Q).
        value_range: The Q-values that outputs of 0 and 1 stand for (Whiteson & Stone 2006), for
            rewards that differ little; None is 0 and 1, the range of all rewards.
    """

    candidates: int = 10
    evaluation: Evaluation = "settle"
    activation: str = "sigmoid"
    double_activation: bool = False
    value_range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        if self.candidates < 1:
            raise ConfigError(f"network.candidates: expected at least 1, got {self.candidates}")
        if self.value_range is not None and not self.value_range[0] < self.value_range[1]:
            raise ConfigError(f"network.value_range: expected low < high, got {self.value_range}")
        if self.activation not in ACTIVATIONS:
            raise ConfigError(
                f"network.activation: expected one of {', '.join(ACTIVATIONS)}; got "
                f"{self.activation!r}"
            )


@dataclass(frozen=True, kw_only=True)
class LearningConfig:
    """What a robot learns during its life.

    Attributes:
        rule: none: evolution alone; td: TD error of the chosen candidate by autograd;
            wire_fitting: TD error of the value interpolated between all candidates, which moves
            them too; table: one Q-table for each robot and no evolution (OpenNERO's Q-learning).
        step: Learning rate, optimiser and target parameters.
        discount: gamma of the return.
        trace_decay: lambda of the return; 0 is one-step Q-learning, 1 the whole batch.
        bootstrap: What the next state is worth. None: the greatest value of its candidates.
            expected: the mean over epsilon-greedy. double: by the target weights the value of the
            candidate that is best by the network's own; needs target_tau.
        separation: With the rule wire_fitting, weight of a loss that keeps the candidates of a
            network apart (Korkmaz et al. 2025), above 0; None: nothing does.
        normalize_return: Weigh rewards by 1 - gamma, so that a sigmoid can reach the target.
        epsilon: Probability of starting to explore, per tick.
        max_hold_ticks: Longest run of an explored candidate; 1 is plain epsilon-greedy.
        inheritance: lamarckian: what was learnt is written into the genome before it breeds.
        inherited_share: With inheritance lamarckian, how much of what was learnt since birth is
            written into the genome, within (0, 1]; None: all of it.
        safe_mutation: Mutation moves those weights less to which the outputs react strongly over so
            many observations of the batch (Lehman et al. 2018); None: all weights alike.
        genes: Learning rate, epsilon and 1 - discount are genes, mutated by this standard deviation
            of their logarithm, and explored ticks do not count towards fitness; None: all robots
            have those given here.
        replay: What is learnt from the past of all robots; needs the rule wire_fitting.
    """

    rule: Literal["none", "td", "wire_fitting", "table"] = "td"
    step: LearnerConfig = field(default_factory=LearnerConfig)
    discount: float = 0.8
    trace_decay: float = 0.0
    bootstrap: Bootstrap | None = None
    normalize_return: bool = True
    epsilon: float = 0.1
    max_hold_ticks: int = 1
    inheritance: Inheritance = "lamarckian"
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    inherited_share: float | None = None
    safe_mutation: int | None = None
    genes: float | None = None
    separation: float | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("discount", "trace_decay", "epsilon"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ConfigError(f"learning.{name}: expected a number in [0, 1], got {value}")
        if self.max_hold_ticks < 1:
            raise ConfigError(
                f"learning.max_hold_ticks: expected at least 1, got {self.max_hold_ticks}"
            )
        if self.bootstrap == "double" and self.step.target_tau is None:
            raise ConfigError(
                "learning.bootstrap: double needs learning.step.target_tau, without which there "
                "are no target weights that could value what the network's own choose"
            )
        self._check_rule()
        self._check_inheritance()
        if self.safe_mutation is not None and self.safe_mutation < 1:
            raise ConfigError(
                "learning.safe_mutation: expected at least 1 observation, or none, got "
                f"{self.safe_mutation}"
            )
        self._check_genes()

    def _check_rule(self) -> None:
        if self.replay.updates and self.rule != "wire_fitting":
            raise ConfigError(
                f"learning.replay.updates: expected 0 with learning.rule {self.rule}, got "
                f"{self.replay.updates}; only wire_fitting knows what an action of another robot "
                "is worth"
            )
        if self.separation is None:
            return
        if not 0 < self.separation < math.inf:
            raise ConfigError(
                f"learning.separation: expected a number above 0, or none, got {self.separation}"
            )
        if self.rule != "wire_fitting":
            raise ConfigError(
                f"learning.separation: expected none with learning.rule {self.rule}, got "
                f"{self.separation}; only wire_fitting moves candidates"
            )

    def _check_inheritance(self) -> None:
        share = self.inherited_share
        if share is None:
            return
        if not 0 < share <= 1:
            raise ConfigError(
                f"learning.inherited_share: expected a number within (0, 1], got {share}"
            )
        if self.inheritance == "darwinian":
            raise ConfigError(
                f"learning.inherited_share: expected none with inheritance darwinian, got {share}; "
                "nothing that was learnt is inherited there"
            )

    def _check_genes(self) -> None:
        if self.genes is None:
            return
        if not 0 < self.genes < math.inf:
            raise ConfigError(f"learning.genes: expected a number above 0, got {self.genes}")
        if self.rule not in ("td", "wire_fitting"):
            raise ConfigError(
                f"learning.genes: expected none with learning.rule {self.rule}, got {self.genes}; "
                "no network learns there"
            )
        if not (self.epsilon and self.step.learning_rate and self.discount < 1):
            raise ConfigError(
                "learning.genes: expected learning.epsilon and learning.step.learning_rate above 0 "
                f"and learning.discount below 1, got {self.epsilon}, {self.step.learning_rate} and "
                f"{self.discount}; founders start from them"
            )


NO_LEARNING = LearningConfig(rule="none", epsilon=0.0, inheritance="darwinian")


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """A whole run.

    Attributes:
        task: flag, moving, wall, trap, maze, switch, or the path of a scenario file.
        arm: rtneat, committed, described, neatq or qlearning; sets the defaults of what follows.
        ticks: Length of the run; it ends with the 40 ticks (or the batch, if that is longer) in
            which they are reached.
        arenas: Independent arenas side by side; arena i is the run with seed + i.
        seed: Of arena 0.
        batch_ticks: Ticks between two updates; evolution replaces robots between batches. None:
            rtNEAT's replacement interval, but at most 40.
        checkpoint_seconds: Time between two checkpoints. Does not change the run.
        logger: Also log to TorchRL's csv or tensorboard logger.
        scenario: The world.
        network: How networks are made.
        evolution: rtNEAT.
        learning: What a robot learns.
    """

    task: str = "wall"
    arm: Arm = "neatq"
    ticks: int = 70_000
    arenas: int = 1
    seed: int = 0
    batch_ticks: int | None = None
    checkpoint_seconds: float = 30.0
    logger: LoggerName | None = None
    scenario: Scenario = TASKS["wall"]
    network: NetworkConfig = field(default_factory=NetworkConfig)
    evolution: RtNEATConfig = field(default_factory=RtNEATConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("ticks", "arenas"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}: expected at least 1, got {getattr(self, name)}")
        if self.batch_ticks is not None and self.batch_ticks < 1:
            raise ConfigError(f"batch_ticks: expected at least 1, got {self.batch_ticks}")
        weights = tuple(self.scenario.weights().tolist())
        object.__setattr__(self, "evolution", replace(self.evolution, reward_weights=weights))
        if self.seed < 0:
            raise ConfigError(f"seed: expected at least 0, got {self.seed}")
        if not self.checkpoint_seconds >= 0:
            raise ConfigError(
                f"checkpoint_seconds: expected at least 0, got {self.checkpoint_seconds}"
            )
        self._check_parts()

    def _check_parts(self) -> None:
        """Check what one part needs of another."""
        rule = self.learning.rule
        if rule != "table" and self.scenario.robots < 2:
            raise ConfigError(
                f"scenario.robots: expected at least 2, got {self.scenario.robots}; one robot "
                "is no population that could evolve (the arm qlearning can do with one)"
            )
        if rule in ("td", "wire_fitting") and self.network.candidates < 2:
            raise ConfigError(
                f"network.candidates: expected at least 2, got {self.network.candidates}; with "
                "one there is no Q-value to learn (--learning.rule none goes without)"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(arenas, robots)."""
        return self.arenas, self.scenario.robots

    @property
    def ticks_per_batch(self) -> int:
        """Ticks of one batch."""
        if self.batch_ticks is not None:
            return self.batch_ticks
        evolution = self.evolution
        interval = interval_ticks(
            evolution.minimum_life_ticks, self.scenario.robots, evolution.ineligible_fraction
        )
        return max(1, min(40, math.floor(interval)))

    @property
    def stride_ticks(self) -> int:
        """Ticks from one moment at which the run can stop and go on to the next: whole batches."""
        return self.ticks_per_batch * math.ceil(STRIDE_TICKS / self.ticks_per_batch)

    def first_arenas(self, parts: int) -> list[int]:
        """The first arena of each of so many parts, of nearly equal size."""
        return [self.arenas * part // parts for part in range(parts)]

    def split(self, parts: int) -> list[RunConfig]:
        """The run as several runs, each with a part of its arenas."""
        borders = pairwise([*self.first_arenas(parts), self.arenas])
        return [replace(self, arenas=end - first, seed=self.seed + first) for first, end in borders]

    def to_dict(self) -> dict[str, Any]:
        """JSON values from which `from_dict` makes an equal configuration."""
        return to_plain(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> RunConfig:
        """Read what `to_dict` wrote.

        Raises:
            ConfigError: Naming the field that is missing, of a wrong type or out of range.
        """
        return from_plain(RunConfig, values)


Config = TypeVar("Config")


def to_plain(value: Any) -> Any:
    """JSON values of a configuration and of all its parts."""
    if is_dataclass(value):
        return {entry.name: to_plain(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    return value


def from_plain(kind: type[Config], values: Mapping[str, Any]) -> Config:
    """Read what `to_plain` made of a configuration of this kind.

    Raises:
        ConfigError: Naming the field that is missing, of a wrong type or out of range.
    """
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(f"configuration: {error}") from error


_FAITHFUL_WORLD = {"sensors": "opennero", "reward": "published"}
_ARMS: dict[Arm, dict[str, Any]] = {
    "rtneat": {
        "world": _FAITHFUL_WORLD,
        "network": NetworkConfig(candidates=1, evaluation="synchronous"),
        "learning": NO_LEARNING,
    },
    "committed": {
        "world": _FAITHFUL_WORLD,
        "network": NetworkConfig(evaluation="synchronous", double_activation=True),
        "learning": NO_LEARNING,
    },
    "described": {
        "world": {"sensors": "arena", "reward": "published"},
        "network": NetworkConfig(),
        # 0.9 is the only learning rate in OpenNERO's history.
        "learning": LearningConfig(step=LearnerConfig(learning_rate=0.9)),
    },
    "neatq": {
        "world": {"sensors": "arena", "reward": "progress"},
        "network": NetworkConfig(candidates=5),
        "learning": LearningConfig(
            rule="wire_fitting",
            step=LearnerConfig(learning_rate=0.03, optimizer="adam"),
            discount=0.9,
            epsilon=0.01,
            replay=ReplayConfig(updates=4, newborn_updates=100, horizon=40),
        ),
    },
    "qlearning": {
        "world": _FAITHFUL_WORLD,
        "network": NetworkConfig(candidates=1),
        "learning": LearningConfig(rule="table", step=LearnerConfig(learning_rate=0.8)),
        "batch_ticks": 1,
    },
}


def preset(task: str, arm: Arm) -> RunConfig:
    """The configuration of an arm on a task.

    Args:
        task: `flag`, `moving`, `wall`, `trap`, `maze`, `switch` or the path of a scenario file.
            What the file says about sensors and reward is kept; what it leaves out is the arm's.
        arm: One of the five.

    Raises:
        ConfigError: If there is no such arm or task.
        ScenarioError: If the file cannot be used.
    """
    if arm not in _ARMS:
        raise ConfigError(f"arm: expected one of {', '.join(get_args(Arm))}; got {arm!r}")
    parts = dict(_ARMS[arm])
    scenario = _scenario(task, TASKS["flag"].replaced(**parts.pop("world")))
    evolution = RtNEATConfig(minimum_life_ticks=scenario.lifetime_ticks or 1000)
    if arm == "neatq":
        evolution = replace(evolution, ineligible_fraction=0.1)
    return RunConfig(
        task=task,
        arm=arm,
        ticks=TASK_TICKS.get(task, 70_000),
        scenario=scenario,
        evolution=evolution,
        **parts,
    )


def _scenario(task: str, defaults: Scenario) -> Scenario:
    if task in TASKS:
        return TASKS[task].replaced(sensors=defaults.sensors, reward=defaults.reward)
    if not Path(task).suffix and not Path(task).exists():
        raise ConfigError(
            f"task: expected {', '.join(TASKS)} or the path of a scenario file (.json); got "
            f"{task!r}"
        )
    return load_scenario(task, defaults)
