"""Worlds: what a run must know of where its robots live.

Four kinds: the arena, NERO's field (`nero.nero_world`), any Gymnasium environment, and a user's own
TorchRL environment.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
import tyro
from torchrl.data import Bounded
from torchrl.envs import EnvBase

from neatq_envs.episodes import EpisodeError, EpisodeRows, Starts
from neatq_envs.gymnasium_rows import DealtRows, make_rows
from neatq_envs.gymnasium_task import PREFIX, GymnasiumTask, TaskError
from neatq_envs.machines import Crew, Machines
from neatq_envs.random_play import EnvFacts, ObservationScaling, WideScaling, look_around
from neatq_envs.scenario import TASKS, Scenario
from neatq_envs.sensors import schema_of
from neatq_envs.torchrl_env import ArenaEnv
from neatq_envs.torchrl_rows import GymnasiumRows
from neatq_torch.genome import Genome
from neatq_torch.kinds import ConfigError, Kinds, check_fields, import_own
from neatq_torch.learning import CandidateHeads, DiscreteHeads, Heads
from neatq_torch.learning.heads import ValueRange
from neatq_torch.network import Evaluation, PopulationNetwork
from neatq_trainers.collecting import RolloutWorker
from neatq_trainers.nero.nero_world import NeroConfig, NeroWorld
from neatq_trainers.world import RobotsConfig, World, return_range


@dataclass(frozen=True, kw_only=True)
class ArenaConfig(RobotsConfig):
    """Robots, walls and a flag.

    Attributes:
        scenario: The world; `--env-kwargs` changes its keys, such as robots=30.
    """

    scenario: Scenario = TASKS["wall"]

    @property
    def schema(self) -> str:
        """Name of the observations."""
        return schema_of(self.scenario).name


@dataclass(frozen=True, kw_only=True)
class GymnasiumConfig:
    """Any Gymnasium environment.

    Attributes:
        id: What `gymnasium.make` takes.
        kwargs: Keyword arguments of `gymnasium.make`.
        slots: Genomes alive in each arena.
        every: Generations from one evaluation of the fittest to the next; the first has one, too.
        evaluated: How many of the fittest are evaluated, without exploration and learning; the best
            of all is the champion.
        episodes: Held-out episodes of an evaluation, always the same.
        test_episodes: Episodes, others again, in which the champion is tested after the run.
    """

    lengths: ClassVar = ("steps", "generations")
    slots_name: ClassVar = "world.slots"
    lasting: ClassVar = False
    together: ClassVar = 1
    lifetime_ticks: ClassVar = 0
    id: tyro.conf.Suppress[str] = "CartPole-v1"
    kwargs: tyro.conf.Suppress[Mapping[str, Any]] = field(default_factory=dict)
    slots: int = 150
    every: int = 5
    evaluated: int = 3
    episodes: int = 20
    test_episodes: int = 100

    def __post_init__(self) -> None:
        positive = ("slots", "every", "evaluated", "episodes", "test_episodes")
        check_fields(self, **dict.fromkeys(positive, "[1, inf]"))
        if not self.id:
            raise ConfigError("task: expected gym: and an id, such as gym:CartPole-v1")

    @property
    def task(self) -> GymnasiumTask:
        """The environment, not made yet."""
        return GymnasiumTask(id=self.id, kwargs=self.kwargs)

    @property
    def label(self) -> str:
        """What it is called in names of files."""
        return self.id

    @property
    def schema(self) -> str:
        """Name of the observations."""
        return PREFIX + self.id


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """A user's own TorchRL environment, see `register_world`.

    Attributes:
        name: As it was registered.
        kwargs: Further arguments of what makes it.
    """

    lengths: ClassVar = ("ticks",)
    slots_name: ClassVar = "slots"
    lasting: ClassVar = False
    together: ClassVar = 1
    lifetime_ticks: ClassVar = 0
    slots: ClassVar[int | None] = None
    name: str = ""
    kwargs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """What it is called in names of files."""
        return self.name

    @property
    def schema(self) -> str:
        """Name of the observations."""
        return f"env:{self.name}"


WorldConfig = ArenaConfig | NeroConfig | GymnasiumConfig | EnvConfig
MakeEnv = Callable[..., EnvBase]
world_kinds = Kinds("world")
env_kinds: dict[str, MakeEnv] = {}


def register_world(name: str, make: MakeEnv) -> None:
    """Add a world under a name, by which `train` and the command line then know it.

    Args:
        name: What the task is called.
        make: Called with `arenas` and `seed` (and the `env_kwargs` of a run), gives an environment
            of batch size [arenas, slots] with a `done` for each row; `observation` [.., inputs],
            bounded `action` [.., A] and `reward` [.., 1]. Must be importable where several
            processes train. If it has `world_state`, `load_world_state` and `rebuild`, as
            `ArenaEnv`, a run in it is resumed exactly; else it goes on with new lives.

    Raises:
        ConfigError: If the name is taken.

    Example:
        >>> register_world("corridor", CorridorEnv)
        >>> train("corridor", arm="rtneat", ticks=2_000)
    """
    if name in TASKS or env_kinds.get(name, make) is not make:
        raise ConfigError(f"world: the name {name!r} is taken; choose another")
    env_kinds[name] = make


class ArenaWorld(World):
    """The arena; its rewards are numbers within [0, 1], see `neatq_envs.rewards`."""

    def __init__(self, config: ArenaConfig, seeds: range) -> None:
        scenario = config.scenario
        self.env = ArenaEnv(scenario, arenas=len(seeds), seed=seeds[0])
        self.inputs = len(self.env.arena.schema.observations)
        self.reward_weights = tuple(scenario.weights().tolist())

    @property
    def present_weights(self) -> tuple[float, ...]:
        """Those of the scenario, which may have become another one."""
        return tuple(self.env.scenario.weights().tolist())

    def heads(self, candidates: int, value_range: ValueRange = (0.0, 1.0)) -> Heads:
        """Speed and turn, and in OpenNERO's world two more."""
        low, high = self.env.arena.schema.action_bounds(self.env.scenario)
        return CandidateHeads(candidates, low.tolist(), high.tolist(), value_range=value_range)

    def default_range(self, discount: float, *, normalized: bool) -> ValueRange:
        """Returns of rewards within [0, 1]."""
        return return_range(discount, normalized=normalized)


class GymnasiumWorld(World):
    """A Gymnasium environment for every slot.

    Args:
        config: Which.
        seeds: One for each arena.
        facts: What `facts_of` has found.
        episodes: Of each slot in a generation; None: episode after episode without end.
        crew: Among whom the environments of this run are dealt; None: this process has them.
        normalized: Whether observations are normalised after they are scaled.
    """

    stream = 4

    def __init__(
        self,
        config: GymnasiumConfig,
        seeds: range,
        facts: EnvFacts,
        episodes: int | None,
        crew: Crew | None = None,
        *,
        normalized: bool = False,
    ) -> None:
        self.config, self.facts, self._crew = config, facts, crew
        self._generational = episodes is not None
        task = config.task
        dealt = {"crew": crew, "kind": RolloutWorker}
        rows, self.interface = make_rows(task, renewed=facts.renewed, **dealt)
        # One arena is evaluated when all its episodes are over; of several, others may not be.
        alone = self._generational and len(seeds) == 1
        self._rows, self._free = rows, rows if alone else None
        shape = len(seeds), config.slots
        self.env = GymnasiumRows(
            rows,
            self.interface,
            WideScaling(**vars(facts.scaling)) if normalized else facts.scaling,
            shape=shape,
            seeds=seeds,
            episodes=episodes,
            name=config.id,
        )
        self.env.replays_late = self.rollout_workers is not None
        self.inputs = self.interface.inputs

    def heads(self, candidates: int, value_range: ValueRange = (0.0, 1.0)) -> Heads:
        """Choices, or a box of actions. Where outputs only rank actions they keep their range."""
        if self.interface.choices is not None:
            return DiscreteHeads(self.interface.choices, value_range=value_range)
        return CandidateHeads(candidates, *self.interface.bounds, value_range=value_range)

    def default_range(self, discount: float, *, normalized: bool) -> ValueRange:
        """Returns that random play had or might have had."""
        return self.facts.value_range

    @property
    def rollout_workers(self) -> DealtRows | None:
        """Where environments live elsewhere: a `RolloutWorker` each."""
        return self._rows if isinstance(self._rows, DealtRows) else None

    def begin(self, generation: int) -> None:
        """Begin the episodes of a generation."""
        if self._generational:
            self.env.begin(generation)

    def close(self) -> None:
        """Close the environments."""
        for rows in {self._rows, self._free} - {None}:
            rows.close()

    @torch.no_grad()
    def returns(
        self,
        genomes: Sequence[Genome],
        seeds: np.ndarray,
        heads: Heads,
        evaluation: Evaluation,
        *,
        double_activation: bool = False,
        scalings: Sequence[ObservationScaling | None] = (),
    ) -> np.ndarray:
        """Returns without exploration and learning, in environments of their own.

        Each genome acts in its episodes, which start by `seeds`, int64 [genomes, episodes], and
        reads observations by its own of the `scalings`, if it has one. They run side by side; none
        depends on another. Returns float64 [genomes, episodes].
        """
        scaling = self._side_by_side(scalings, seeds) if any(scalings) else self.facts.scaling
        flat = [genome for genome in genomes for _ in range(seeds.shape[1])]
        if self._free is None:  # those of the run are in the middle of episodes
            task, renewed = self.config.task, self.facts.renewed
            crew = None if self._crew is None else self._crew.beside
            self._free, _ = make_rows(task, renewed=renewed, crew=crew)
        episodes = EpisodeRows(self._free, self.config.id, lambda i: f"genome {flat[i].genome_id}")
        episodes.begin(Starts.given(seeds.reshape(-1, 1)))
        network = PopulationNetwork(flat, evaluation=evaluation)
        state, previous = network.initial_state(), torch.zeros(len(flat), network.inputs)
        while episodes.living.any():
            seen = torch.from_numpy(scaling(episodes.observation))
            output, state = network.step(seen, state)
            if double_activation:
                state, previous = network.step(previous, state)[1], seen
            episodes.step(heads.best(output).numpy())
            episodes.go_on(episodes.terminated | episodes.truncated)
        return episodes.returns.reshape(seeds.shape)

    def _side_by_side(
        self, scalings: Sequence[ObservationScaling | None], seeds: np.ndarray
    ) -> ObservationScaling:
        """Of the episodes of all genomes [genomes x episodes, inputs]."""
        own = [one or self.facts.scaling for one in scalings]
        columns = (np.stack([getattr(one, name) for one in own]) for name in ("offset", "scale"))
        return ObservationScaling(*(np.repeat(one, seeds.shape[1], axis=0) for one in columns))


class EnvWorld(World):
    """A user's own environment."""

    def __init__(self, config: EnvConfig, seeds: range) -> None:
        make = find_env(config.name)
        if make is None:
            raise ConfigError(f"world: nobody has registered {config.name!r}")
        self.env = make(arenas=len(seeds), seed=seeds[0], **config.kwargs)
        action = self.env.action_spec
        if len(self.env.batch_size) != 2 or self.env.batch_size[0] != len(seeds):
            raise ConfigError(
                f"world {config.name}: expected the batch size [{len(seeds)}, slots], got "
                f"{list(self.env.batch_size)}"
            )
        if not isinstance(action, Bounded):
            raise ConfigError(
                f"world {config.name}: expected a bounded action [.., A], got {action}; actions to "
                "choose from are known to Gymnasium tasks (gym:ID)"
            )
        self.inputs = self.env.observation_spec["observation"].shape[-1]
        space: Any = action.space
        self._low, self._high = (
            bound.flatten(0, 1)[0].tolist() for bound in (space.low, space.high)
        )

    def heads(self, candidates: int, value_range: ValueRange = (0.0, 1.0)) -> Heads:
        """A point in the box of actions."""
        return CandidateHeads(candidates, self._low, self._high, value_range=value_range)

    def default_range(self, discount: float, *, normalized: bool) -> ValueRange:
        """Returns of rewards within the bounds of the reward spec."""
        space = getattr(self.env.reward_spec, "space", None)
        low, high = (
            float(bound.flatten()[0]) if isinstance(bound, torch.Tensor) else math.nan
            for bound in (getattr(space, "low", None), getattr(space, "high", None))
        )
        if not (math.isfinite(low) and low < high < math.inf) or discount >= 1:
            raise ConfigError(
                "network.value_range: expected two numbers; the rewards of this world have no "
                "bounds, so nobody knows which Q-values the outputs 0 and 1 stand for"
            )
        span = 1.0 if normalized else 1 / (1 - discount)
        return low * span, high * span


def find_env(name: str) -> MakeEnv | None:
    """What makes a registered world; "module:name" imports the module first. None: unknown."""
    module, colon, own = name.rpartition(":")
    if colon and own not in env_kinds:
        import_own("task", name, module)
    return env_kinds.get(own)


def make_world(
    config: WorldConfig,
    seeds: range,
    *,
    episodes: int | None,
    facts: EnvFacts | None = None,
    crew: Crew | None = None,
    normalized: bool = False,
) -> World:
    """The world of a configuration; see `GymnasiumWorld`, which alone asks for the rest."""
    if isinstance(config, ArenaConfig):
        return ArenaWorld(config, seeds)
    if isinstance(config, NeroConfig):
        return NeroWorld(config, seeds)
    if isinstance(config, EnvConfig):
        return EnvWorld(config, seeds)
    assert facts is not None
    return GymnasiumWorld(config, seeds, facts, episodes, crew, normalized=normalized)


def facts_of(
    config: WorldConfig, discount: float, *, apart: Machines | None = None
) -> EnvFacts | None:
    """What must be known of a Gymnasium task before a run; None of other worlds.

    Args:
        config: The world.
        discount: Of the returns.
        apart: Play in a process of these, so that an environment which ends its process does not
            end the program; None: play here.

    Raises:
        TaskError: If the environment cannot be used, its episodes do not end, or its process does.
        EpisodeError: If it fails.
    """
    if not isinstance(config, GymnasiumConfig):
        return None
    if apart is None:
        return look_around(config.task, discount)
    remote = apart.open(look_around, config.task, discount)
    try:
        remote.ask("to_dict")
        return EnvFacts.from_dict(remote.answer())
    except TaskError as error:
        if "knows no" in str(error) and config.id in gymnasium.registry:
            raise TaskError(
                f"task: {config.id} is registered in this program, where other processes do not "
                "find it; register it in a module of yours (gym:my_module:ID), or take one worker"
            ) from error
        raise
    except EpisodeError:
        raise
    except RuntimeError as error:
        raise TaskError(f"task: random play in {config.id} did not survive: {error}") from error
    finally:
        remote.close()


world_kinds.register("arena", ArenaConfig, ArenaWorld)
world_kinds.register("nero", NeroConfig, NeroWorld)
world_kinds.register("gymnasium", GymnasiumConfig, GymnasiumWorld)
world_kinds.register("env", EnvConfig, EnvWorld)
