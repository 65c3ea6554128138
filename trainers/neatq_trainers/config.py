"""What a run is: a world, a population, a learner and how networks are made."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, make_dataclass
from itertools import pairwise
from typing import Any, Literal, TypeVar, get_args, get_type_hints

import msgspec

from neatq_torch.evolution import RtNEATConfig, interval_ticks, population_kinds
from neatq_torch.genome import ACTIVATIONS
from neatq_torch.kinds import ConfigError, check_fields
from neatq_torch.learning import (
    CriticConfig,
    NoLearningConfig,
    ReplayConfig,
    TableConfig,
    TDConfig,
    TraceConfig,
    learner_kinds,
)
from neatq_torch.network import Evaluation
from neatq_trainers.migration import MOST_ISLANDS, MigrationConfig
from neatq_trainers.worlds import EnvConfig, GymnasiumConfig, WorldConfig, world_kinds

Normalization = Literal["running"]
LoggerName = Literal["csv", "tensorboard"]
Length = Literal["ticks", "steps", "generations"]
LENGTHS: tuple[Length, ...] = get_args(Length)

BATCH_TICKS = 40
"""Most ticks of a batch in an arena: evolution replaces robots between batches."""
EPISODIC_BATCH_TICKS = 20
LIFE_TICKS = 1000
"""What counts as a life where lives have no end."""
STRIDE_TICKS = 40
"""Least ticks between two rebuilds of the physics, which cost as much as a few ticks."""


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """How a network is made, evaluated and read.

    Attributes:
        candidates: Candidate actions K in a box of actions; with 1 there is nothing to choose and
            no Q-value. Without meaning where there are a few actions to choose from.
        evaluation: settle: forward links within one tick; synchronous: one propagation a tick.
        activation: Of the outputs of the first genomes. None: sigmoid, in the arena where a critic
            teaches steep_sigmoid; but identity where outputs only say which of a few actions is
            best, so that none of them saturates.
        double_activation: Activate again with the observation before (published rtNEAT+Q).
        value_range: The Q-values that outputs of 0 and 1 stand for (Whiteson & Stone 2006). None:
            those that the world's rewards allow.
        normalization: running: networks read observations less their running mean, over their
            running standard deviation (`RunningNormalization`). None: as the world gives them.
    """

    candidates: int = 10
    evaluation: Evaluation = "settle"
    activation: str | None = None
    double_activation: bool = False
    value_range: tuple[float, float] | None = None
    normalization: Normalization | None = None

    def __post_init__(self) -> None:
        check_fields(self, candidates="[1, inf]", evaluation=Evaluation)
        check_fields(self, normalization=Normalization)
        if self.value_range is not None:
            low, high = self.value_range
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ConfigError(
                    "value_range: expected two finite numbers, the smaller first, got "
                    f"{low} and {high}"
                )
        if self.activation not in (None, *ACTIVATIONS):
            expected = f"one of {', '.join(ACTIVATIONS)} or None"
            raise ConfigError(f"activation: expected {expected}; got {self.activation!r}")


AS_IT_COMES = TDConfig | ReplayConfig | TraceConfig | TableConfig
"""Learners that read observations as they come, not normalised."""
_OF_NETWORKS = NoLearningConfig | TDConfig | ReplayConfig | CriticConfig | TraceConfig
"""Learners that need networks."""


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """A whole run.

    Attributes:
        task: What the world is called; see `neatq list`.
        arm: The preset that the other values come from; see `neatq list`.
        ticks: Length in a world of robots, each a step of every robot; the run ends with the stride
            in which they are reached.
        steps: Length on a Gymnasium task: steps of all genomes of an arena together.
        generations: Length on a Gymnasium task.
        until: On a Gymnasium task: the run also ends, as solved, when the champion of an arena has
            this mean return of its held-out episodes.
        arenas: Independent populations side by side; arena i is the run with seed + i. Rivals come
            in pairs, of which each is the run with the seed of its first arena.
        seed: Of arena 0.
        migration: How the arenas of robots exchange genomes; None: they do not.
        batch_ticks: Ticks between two updates; evolution replaces genomes between batches. None:
            as many as population and learner ask for.
        checkpoint_seconds: Time between two checkpoints. Does not change the run.
        logger: Also log to TorchRL's csv or tensorboard logger.
        world: The world.
        network: How networks are made and read.
        population: Who lives and who breeds; None without evolution.
        learner: What is learnt during a life.
    """

    task: str
    arm: str
    ticks: int | None = None
    steps: int | None = None
    generations: int | None = None
    until: float | None = None
    arenas: int = 1
    seed: int = 0
    migration: MigrationConfig | None = None
    batch_ticks: int | None = None
    checkpoint_seconds: float = 30.0
    logger: LoggerName | None = None
    world: WorldConfig
    network: NetworkConfig = field(default_factory=NetworkConfig)
    population: Any = None
    learner: Any

    def __post_init__(self) -> None:
        positive = (*LENGTHS, "batch_ticks", "arenas")
        check_fields(self, **dict.fromkeys(positive, "[1, inf]"), seed="[0, inf]")
        check_fields(self, checkpoint_seconds="[0, inf]")
        self._check_length()
        self._check_until()
        self._check_parts()

    def _check_length(self) -> None:
        allowed = self.world.lengths
        given = [name for name in LENGTHS if getattr(self, name)]
        for name in given:
            if name not in allowed:
                raise ConfigError(
                    f"{name}: the length of a run on {self.task} is given in {' or '.join(allowed)}"
                )
        if len(given) != 1:
            raise ConfigError(
                f"expected one length, {' or '.join(allowed)}; got {' and '.join(given) or 'none'}"
            )

    def _check_until(self) -> None:
        check_fields(self, until="(-inf, inf)")
        if self.until is not None and not isinstance(self.world, GymnasiumConfig):
            raise ConfigError(
                f"until: nobody is evaluated on held-out episodes on {self.task}; it is for "
                "Gymnasium tasks, such as gym:CartPole-v1"
            )

    def _check_teachers(self) -> None:
        lasting = isinstance(self.population, RtNEATConfig)
        if not (lasting and self.world.lasting):
            raise ConfigError(
                "learner.teacher_mutation: expected None, as explorers need places and models need "
                "others that live on: only robots in the arena of the population rtneat have both"
            )

    def _check_migration(self, migration: MigrationConfig) -> None:
        kinds = isinstance(self.population, RtNEATConfig) and self.world.together == 1
        if not kinds or isinstance(self.world, GymnasiumConfig | EnvConfig):
            raise ConfigError(
                "migration: expected None; genomes travel between arenas of robots that are "
                "replaced one by one (the population rtneat), and not between rivals"
            )
        if not 2 <= self.arenas <= MOST_ISLANDS:
            raise ConfigError(f"arenas: expected 2 to {MOST_ISLANDS} islands, got {self.arenas}")
        if migration.every_ticks < self.stride_ticks:
            raise ConfigError(
                f"migration.every_ticks: expected at least {self.stride_ticks}, as a run stops so "
                f"often, got {migration.every_ticks}"
            )
        sources = self.arenas - 1 if migration.topology == "all" else 1
        slots, arriving = self.world.slots or 0, sources * migration.emigrants
        if arriving >= slots:
            raise ConfigError(
                f"migration: expected fewer to arrive in an arena than there are robots ({slots}), "
                f"got {arriving}"
            )

    def _check_parts(self) -> None:
        if self.migration is not None:
            self._check_migration(self.migration)
        if self.arenas % self.world.together:
            raise ConfigError(
                f"arenas: expected an even number, got {self.arenas}: populations that are each "
                "other's rivals come in pairs"
            )
        if self.network.normalization is not None:
            self._check_normalization()
        if getattr(self.learner, "teacher_mutation", None) is not None:
            self._check_teachers()
        if self.population is None:
            if isinstance(self.learner, _OF_NETWORKS):
                raise ConfigError(
                    f"learner: the arm {self.arm} has no networks that could learn like this; "
                    "choose another arm (qnetwork learns without evolution)"
                )
            return
        if isinstance(self.learner, TableConfig):
            raise ConfigError(
                "learner: a table knows no genome, so evolution could not judge any; it goes "
                "without a population (the arm qlearning)"
            )
        slots, evolves = self.world.slots, population_kinds.name_of(self.population) != "fixed"
        if evolves and slots is not None and slots < 2:
            raise ConfigError(
                f"{self.world.slots_name}: expected at least 2, got {slots}; one genome is no "
                "population that could evolve (the arms qlearning and qnetwork can do with one)"
            )
        if not evolves and not self.learns:
            raise ConfigError("learner: a fixed population without learning would never change")
        if self.generational and self.arenas > 1 and isinstance(self.world, EnvConfig):
            raise ConfigError(
                f"arenas: expected 1, got {self.arenas}; in a world of your own nobody stands idle "
                "until the other arenas have lived their generation (run one seed after the other, "
                "or take the arm rtneat or neatq)"
            )
        endless = self.world.lasting and not self.world.lifetime_ticks
        if self.generational and endless:
            raise ConfigError(
                "lifetime_ticks: expected above 0, got 0; generations need lives that end (the "
                "arm rtneat does without generations)"
            )

    def _check_normalization(self) -> None:
        """What is normalised must be learnt from, exported and shown so."""
        if not isinstance(self.world, GymnasiumConfig):
            raise ConfigError(
                f"network.normalization: expected None on {self.task}; it is for Gymnasium tasks"
            )
        if isinstance(self.learner, AS_IT_COMES):
            raise ConfigError(
                "network.normalization: expected None; the learner "
                f"{learner_kinds.name_of(self.learner)} reads observations as they come (none and "
                "critic do not mind)"
            )

    @property
    def length(self) -> tuple[Length, int]:
        """The unit of the run's length, and how many of them."""
        return next((name, value) for name in LENGTHS if (value := getattr(self, name)))

    def solved_by(self, score: float) -> bool:
        """Whether a champion of such a return solves the task, so that the run is over."""
        return self.until is not None and score >= self.until

    @property
    def learns(self) -> bool:
        """Whether anything is learnt during a life."""
        return learner_kinds.name_of(self.learner) != "none"

    @property
    def generational(self) -> bool:
        """Whether all genomes are replaced at once, after some episodes (or lives) each."""
        return hasattr(self.population, "episodes")

    @property
    def seeds(self) -> range:
        """That of each arena."""
        return range(self.seed, self.seed + self.arenas)

    @property
    def ticks_per_batch(self) -> int:
        """Ticks of one batch."""
        if self.batch_ticks is not None:
            return self.batch_ticks
        if isinstance(self.learner, TraceConfig):
            return 1
        if isinstance(self.world, GymnasiumConfig):
            return EPISODIC_BATCH_TICKS
        own, slots = self.population, self.world.slots
        if not isinstance(own, RtNEATConfig) or own.minimum_life_episodes or not slots:
            return BATCH_TICKS
        interval = interval_ticks(own.minimum_life_ticks, slots, own.ineligible_fraction)
        return max(1, min(BATCH_TICKS, math.floor(interval)))

    @property
    def stride_ticks(self) -> int:
        """Ticks from one moment at which the run can stop and go on to the next: whole batches."""
        return self.ticks_per_batch * math.ceil(STRIDE_TICKS / self.ticks_per_batch)

    def first_arenas(self, parts: int) -> list[int]:
        """The first arena of each of so many parts, of nearly equal size; rivals stay together."""
        return [self.world.together * (self.groups * part // parts) for part in range(parts)]

    @property
    def groups(self) -> int:
        """How many arenas, or groups of rivals, do not influence each other."""
        return self.arenas // self.world.together

    def split(self, parts: int) -> list[RunConfig]:
        """The run as several runs, each with a part of its arenas."""
        borders = pairwise([*self.first_arenas(parts), self.arenas])
        return [
            self.unchecked(arenas=end - first, seed=self.seed + first) for first, end in borders
        ]

    def unchecked(self, **changes: Any) -> RunConfig:
        """A copy with other values by somebody who keeps the rules, or of a part of a run."""
        part = copy.copy(self)
        part.__dict__.update(changes)
        return part

    def changed(self, changes: Mapping[str, Any]) -> RunConfig:
        """A configuration with other values.

        Args:
            changes: New values, by dotted path in `to_dict`: {"learner.epsilon": 0.05}. Another
                "learner.kind" keeps the values of the settings that both kinds have. The age at
                which genomes are judged moves with "world.scenario.lifetime_ticks", as long as it
                is one life.

        Raises:
            ConfigError: If there is no such path, or a value is impossible.
        """
        values = self.to_dict()
        for path, value in changes.items():
            *parents, name = path.split(".")
            part: Any = values
            for parent in parents:
                part = part.get(parent) if isinstance(part, dict) else None
            if not isinstance(part, dict) or name not in part:
                raise ConfigError(
                    f"{path}: there is no such value in the arm {self.arm} on {self.task}; see "
                    f"neatq train --task {self.task} --arm {self.arm} --help for the names"
                )
            part[name] = value
            if name == "kind":
                own = msgspec.to_builtins(_KINDS[parents[0]].config(value)())
                shared = {key: one for key, one in part.items() if key in own}
                values[parents[0]] = {"kind": value, **own, **shared}
        life, judged = "world.scenario.lifetime_ticks", "population.minimum_life_ticks"
        own = values["population"] or {}
        if life in changes and judged not in changes:
            before = self.world.lifetime_ticks or LIFE_TICKS
            if own.get("minimum_life_ticks") == before:
                own["minimum_life_ticks"] = changes[life] or LIFE_TICKS
        return RunConfig.from_dict(values)

    def to_dict(self) -> dict[str, Any]:
        """JSON values from which `from_dict` makes an equal configuration."""
        values = msgspec.to_builtins(self)
        for name, kinds in _KINDS.items():
            part = getattr(self, name)
            if part is not None:
                values[name] = {"kind": kinds.address_of(part), **values[name]}
        return values

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> RunConfig:
        """Read what `to_dict` wrote.

        Raises:
            ConfigError: Naming the field that is missing, of a wrong type or out of range.
        """
        try:
            parts = {"until": None, "migration": None, **values}  # which 0.2.0 did not know
            for part, gone in (("population", "novelty"), ("learner", "genes")):
                if (parts[part] or {}).get(gone):
                    raise ConfigError(f"{part}.{gone}: is no more; take version 0.2.0 for this run")
            for name, kinds in _KINDS.items():
                if parts[name] is not None:
                    own = dict(parts[name])
                    parts[name] = _read(kinds.config(own.pop("kind")), own, name)
            parts["network"] = _read(NetworkConfig, parts["network"], "network")
            scalars = {key: parts[key] for key in parts if key not in ("network", *_KINDS)}
            unknown = scalars.keys() - {one.name for one in fields(RunConfig)}
            if unknown:
                raise ConfigError(f"configuration: unknown {', '.join(sorted(unknown))}")
            return RunConfig(**parts | _read(_Scalars, scalars, "run").__dict__)
        except ConfigError:
            raise
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise ConfigError(f"configuration: damaged, or of another version ({error})") from error


PARTS = ("network", "population", "learner", "world")
_TYPES = get_type_hints(RunConfig)
_Scalars = make_dataclass("_Scalars", [item for item in _TYPES.items() if item[0] not in PARTS])
"""The fields of `RunConfig` that are no parts; all must be given."""
_KINDS = {"world": world_kinds, "population": population_kinds, "learner": learner_kinds}

Value = TypeVar("Value")


def _read(kind: type[Value], values: Any, name: str) -> Value:
    try:
        return msgspec.convert(values, kind, strict=True)
    except ValueError as error:  # of msgspec, too, which says at the end where it was
        text, _, path = str(error).partition(" - at `$")
        below = "".join(f".{one}" for one in re.findall(r"\w+", path))
        own = text if name == "run" else named(name + below, text)
        raise ConfigError(own if name != "run" or not below else f"{below[1:]}: {text}") from error


def named(path: str, error: ValueError | str) -> str:
    """What a part of a configuration complains of, called as on the command line.

    Args:
        path: Of the part: "population.reproduction".
        error: Begins with the name of a field, or with its path, where it is about one.
    """
    text = str(error).removesuffix(".")
    if text.startswith(f"{path}."):
        return text
    return f"{path}{'.' if re.match(r'[a-z_]+: ', text) else ': '}{text}"
