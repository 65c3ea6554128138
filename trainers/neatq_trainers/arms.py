"""Arms: named presets of population, learner and network, for every world."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import gymnasium

from neatq_envs.gymnasium_task import PREFIX, assignments
from neatq_envs.scenario import TASKS, find_scenario
from neatq_torch.evolution import (
    OPENNERO,
    FixedConfig,
    LayeredFounders,
    NEATConfig,
    RtNEATConfig,
    population_kinds,
)
from neatq_torch.genome import MutationConfig
from neatq_torch.kinds import ARMS_PAGE, WORLDS_PAGE, ConfigError
from neatq_torch.learning import (
    CriticConfig,
    NoLearningConfig,
    ReplayConfig,
    TableConfig,
    TDConfig,
    TraceConfig,
    learner_kinds,
)
from neatq_trainers.config import AS_IT_COMES, LIFE_TICKS, NetworkConfig, RunConfig
from neatq_trainers.nero.nero_world import NERO, NeroConfig, nero_config
from neatq_trainers.worlds import (
    ArenaConfig,
    EnvConfig,
    GymnasiumConfig,
    WorldConfig,
    env_kinds,
    find_env,
)

CANDIDATES = 5
"""Actions that a network proposes where it learns the values of its own."""
OWN_TICKS, OWN_GENERATIONS = 70_000, 50
"""Length on worlds of robots that were not published, and on Gymnasium tasks."""
TASK_TICKS = dict.fromkeys(TASKS, OWN_TICKS) | {"flag": 40_000, "moving": 60_000, "wall": 70_000}
"""Length of the published runs (one tick of their figures is 100 ticks)."""


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A preset.

    Attributes:
        summary: One line on what it is.
        population: Who lives and who breeds; None without evolution.
        learner: What is learnt.
        network: How networks are made.
        senses: Sensors and reward law in the arena.
        batch_ticks: Ticks between two updates; None: as population and learner ask for.
        episodic: What differs where lives are episodes (Gymnasium tasks and own environments), by
            dotted path in `RunConfig.to_dict`.
        in_nero: What differs of the population on NERO's field.
        slots: Genomes on Gymnasium tasks.
        arena_only: Why it runs nowhere else, and what does.
        on_gymnasium: What it is instead on Gymnasium tasks.
    """

    summary: str
    population: Any
    learner: Any
    network: NetworkConfig
    senses: Mapping[str, str] = field(default_factory=lambda: {"sensors": "arena"})
    batch_ticks: int | None = None
    episodic: Mapping[str, Any] = field(default_factory=dict)
    in_nero: Mapping[str, Any] = field(default_factory=dict)
    slots: int = 150
    arena_only: str | None = None
    on_gymnasium: Arm | None = None


_PUBLISHED = {"sensors": "opennero", "reward": "published"}
_PROGRESS = {"sensors": "arena", "reward": "progress"}
_GENTLE = MutationConfig(
    weight_scheme="uniform",
    weight_mutation_power=0.2,
    weight_replace_prob=0.0,
    max_link_weight=None,
    recurrent_link_prob=0.0,
    hidden_activation="tanh",
)
"""Mutations that leave a network most of what it has learnt; critics do not teach memory."""
_TAUGHT = Arm(
    summary="rtNEAT, and a critic that learns from everybody's steps teaches newborns",
    population=RtNEATConfig(
        reproduction=replace(OPENNERO, mutation=_GENTLE),
        minimum_life_episodes=1,
        ineligible_fraction=0.6,
        founders=LayeredFounders(hidden=6),
    ),
    learner=CriticConfig(),
    network=NetworkConfig(candidates=1, normalization="running"),
    slots=20,
)
_EPISODES = {"population.minimum_life_episodes": 2}

ARMS: dict[str, Arm] = {
    "rtneat": Arm(
        summary="evolution alone, one genome at a time (Stanley, Bryant & Miikkulainen 2005)",
        population=RtNEATConfig(),
        learner=NoLearningConfig(),
        network=NetworkConfig(candidates=1, evaluation="synchronous"),
        senses=_PUBLISHED,
        episodic={"network.evaluation": "settle", **_EPISODES},
    ),
    "neat": Arm(
        summary="evolution alone, by generations (Stanley & Miikkulainen 2002)",
        population=NEATConfig(episodes=2),
        learner=NoLearningConfig(),
        network=NetworkConfig(candidates=1),
        senses=_PUBLISHED,
    ),
    "committed": Arm(
        summary="what the published code did: candidates, always the best one, nothing is learnt",
        population=RtNEATConfig(),
        learner=NoLearningConfig(),
        network=NetworkConfig(evaluation="synchronous", double_activation=True),
        senses=_PUBLISHED,
        episodic=_EPISODES,
    ),
    "described": Arm(
        summary="what the paper says: epsilon-greedy, TD on the chosen value alone, Lamarckian",
        population=RtNEATConfig(),
        # 0.9 is the only learning rate in OpenNERO's history.
        learner=TDConfig(learning_rate=0.9, discount=0.8),
        network=NetworkConfig(),
        senses={"sensors": "arena", "reward": "published"},
        episodic={"learner.discount": 0.99, "learner.normalize_return": False, **_EPISODES},
    ),
    "neatq": Arm(
        summary=_TAUGHT.summary,
        population=RtNEATConfig(
            trial_average="recent",
            trial_weight="growing",
            ineligible_fraction=0.125,
            survival_share=0.2,
            pioneer_share=0.35,
        ),
        learner=CriticConfig(
            updates_per_step=0.01,
            newborn_updates=500,
            horizon=20,
            discount=0.97,
            noise=0.05,
            teacher_mutation=0.05,
            novelty=0.5,
        ),
        network=NetworkConfig(candidates=1),
        senses={"sensors": "arena-feedback", "reward": "progress"},
        episodic={
            "learner.updates_per_step": 0.5,
            "learner.newborn_updates": 1_000,
            "learner.horizon": 3,
            "learner.discount": 0.99,
            "learner.noise": 0.1,
            "population.trial_weight": None,
            "population.ineligible_fraction": 0.5,
            "population.survival_share": None,
            "population.pioneer_share": None,
            **_EPISODES,
        },
        # Robots die there: a trial is no life, and leads nowhere. It is judged as published.
        in_nero={"trial_weight": None, "trial_average": None, "ineligible_fraction": 0.25},
        on_gymnasium=_TAUGHT,
    ),
    "replay": Arm(
        summary="rtNEAT, and every network learns from what all went through (shared replay)",
        population=RtNEATConfig(ineligible_fraction=0.1),
        learner=ReplayConfig(
            learning_rate=0.03,
            optimizer="adam",
            discount=0.9,
            epsilon=0.01,
            updates=4,
            newborn_updates=100,
            horizon=40,
        ),
        network=NetworkConfig(candidates=CANDIDATES),
        senses=_PROGRESS,
        episodic={
            "learner.discount": 0.98,
            "learner.normalize_return": False,
            "learner.horizon": 10,
            **_EPISODES,
        },
    ),
    "neat+q": Arm(
        summary="NEAT+Q (Whiteson & Stone 2006): generations whose networks learn by Q(lambda)",
        population=NEATConfig(episodes=10),
        learner=TraceConfig(discount=0.99, epsilon=0.05, inheritance="darwinian"),
        network=NetworkConfig(candidates=5),
        senses=_PROGRESS,
        episodic={"learner.anneal": True},
    ),
    "qnetwork": Arm(
        summary="Q(lambda) in networks of fixed topology that do not evolve",
        population=FixedConfig(episodes=50),
        learner=TraceConfig(discount=0.99, epsilon=0.05, inheritance="lamarckian"),
        network=NetworkConfig(candidates=5),
        senses=_PROGRESS,
        episodic={"world.evaluated": 1},
        slots=1,
    ),
    "qlearning": Arm(
        summary="the paper's table of Q-values for each robot, without evolution",
        population=None,
        learner=TableConfig(learning_rate=0.8, discount=0.8, epsilon=0.1),
        network=NetworkConfig(candidates=1),
        senses=_PUBLISHED,
        batch_ticks=1,
        arena_only="its table rounds observations within [0, 1], as the arena has them, to five "
        "values each; qnetwork learns without evolution on every world",
    ),
}

ANCHORS: dict[str, str] = {
    "ppo": "PPO of TorchRL (Schulman et al. 2017): one network, in the arena for the whole team",
    "ppo-novelty": "ppo in the arena, half of whose reward is for being where few were",
    "sac": "SAC of TorchRL (Haarnoja et al. 2018) in the arena: one network for the whole team",
    "sac-novelty": "sac in the arena, half of whose reward is for being where few were",
    "sb3-ppo": "PPO of Stable-Baselines3 (Raffin et al. 2021), tuned by RL Zoo where it knows the "
    "task",
    "sb3-sac": "SAC of Stable-Baselines3 (Haarnoja et al. 2018), likewise; for boxes of actions",
    "sb3-td3": "TD3 of Stable-Baselines3 (Fujimoto et al. 2018), likewise; for boxes of actions",
    "sb3-dqn": "DQN of Stable-Baselines3 (Mnih et al. 2015), likewise; for actions to choose from",
}
"""What one would otherwise take, by name: `neatq compare` runs them beside arms."""


def preset(
    task: str,
    arm: str,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    population: str | None = None,
    learner: str | None = None,
    length: Mapping[str, int | None] | None = None,
) -> RunConfig:
    """The configuration of an arm on a task.

    Args:
        task: A built-in task, the path of a scenario file, gym:ID, gym:ID:name=value (an argument
            of the environment, as in `env_kwargs`) or the name of a registered world. What a file
            says about sensors and reward is kept; what it leaves out is the arm's.
        arm: One of `ARMS`.
        env_kwargs: Keys of the scenario, or arguments of the environment, with other values.
        population: Another kind of population than the arm's, with its own defaults.
        learner: Another kind of learner.
        length: `ticks`, `steps` or `generations`; those that are None are left out.

    Raises:
        ConfigError: If there is no such arm, task, population or learner, or they do not go
            together.
        ScenarioError: If the file or a key cannot be used.

    Example:
        >>> config = preset("wall", "neatq", length={"ticks": 10_000})
        >>> config = config.changed({"learner.epsilon": 0.05})
    """
    if arm in ANCHORS:
        command = f"neatq compare --tasks {task} --arms {arm}"
        raise ConfigError(f"arm: {arm} is an anchor, which only neatq compare runs: {command}")
    if arm not in ARMS:
        expected = f"arm: expected one of {', '.join(ARMS)}"
        raise ConfigError(f"{expected}; got {arm!r} (explained in {ARMS_PAGE})")
    chosen = ARMS[arm]
    if isinstance(task, str) and task.startswith(PREFIX):
        chosen = chosen.on_gymnasium or chosen
    world = _world(task, chosen, env_kwargs or {})
    if chosen.arena_only and not isinstance(world, ArenaConfig):
        raise ConfigError(f"arm: {arm} does not run on {task}: {chosen.arena_only}")
    config = RunConfig(
        task=task,
        arm=arm,
        arenas=world.together,
        world=world,
        network=chosen.network,
        population=_population(chosen, world),
        learner=_learner(chosen, world),
        batch_ticks=chosen.batch_ticks,
        **_length(task, world, length or {}),
    )
    if not world.lasting:
        known = config.to_dict()
        fitting = {path: one for path, one in chosen.episodic.items() if _has(known, path)}
        if isinstance(world, EnvConfig):  # which tells nobody the number of an episode
            fitting.pop("learner.anneal", None)
        config = config.changed(fitting)
    return _with_kinds(config, population, learner)


def _with_kinds(config: RunConfig, population: str | None, learner: str | None) -> RunConfig:
    """Other kinds than the arm's, with their own defaults, as far as these suit the world."""
    parts: dict[str, Any] = {}
    if population is not None:
        parts["population"] = population_kinds.config(population)()
        if not isinstance(parts["population"], RtNEATConfig):
            parts["learner"] = _having(config.learner, teacher_mutation=None, novelty=None)
        if config.world.lasting:
            life = config.world.lifetime_ticks or LIFE_TICKS
            parts["population"] = _having(parts["population"], minimum_life_ticks=life)
        else:
            parts["population"] = _having(parts["population"], minimum_life_episodes=2)
    if learner is not None:
        parts["learner"] = learner_kinds.config(learner)()
        if not config.world.lasting:
            parts["learner"] = _having(parts["learner"], normalize_return=False, discount=0.99)
        parts["network"] = _networks_for(config, parts["learner"])
    return replace(config, **parts)


def _networks_for(config: RunConfig, learner: Any) -> NetworkConfig:
    """Networks as a learner in place of the arm's needs them."""
    network = config.network
    if isinstance(learner, AS_IT_COMES):
        network = replace(network, normalization=None)
    if isinstance(learner, CriticConfig):
        return replace(network, candidates=1)
    chooses = not isinstance(learner, NoLearningConfig)
    if chooses and isinstance(config.learner, CriticConfig):
        return replace(network, candidates=CANDIDATES)
    return network


def _having(part: Any, **values: Any) -> Any:
    """A configuration with those of the values for which it has a field."""
    known = {one.name for one in fields(part)}
    return replace(part, **{name: value for name, value in values.items() if name in known})


def _has(values: Mapping[str, Any], path: str) -> bool:
    part, name = path.split(".")
    return name in (values[part] or {})


def _population(arm: Arm, world: WorldConfig) -> Any:
    """That of the arm; in the arena a life is a robot's, and generations have one."""
    if arm.population is None or not world.lasting:
        return arm.population
    life = world.lifetime_ticks or LIFE_TICKS
    own = arm.in_nero if isinstance(world, NeroConfig) else {}
    return _having(arm.population, minimum_life_ticks=life, episodes=1, **own)


def _learner(arm: Arm, world: WorldConfig) -> Any:
    """That of the arm; elsewhere than in the arena its critic teaches all."""
    if world.lasting:
        return arm.learner
    return _having(arm.learner, teacher_mutation=None, novelty=None)


def _length(task: str, world: WorldConfig, given: Mapping[str, int | None]) -> dict[str, Any]:
    lengths: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if lengths:
        return lengths
    if "ticks" in world.lengths:
        return {"ticks": TASK_TICKS.get(task, OWN_TICKS)}
    return {"generations": OWN_GENERATIONS}


def _world(task: str, arm: Arm, kwargs: Mapping[str, Any]) -> WorldConfig:
    if not isinstance(task, str):
        raise ConfigError(
            f"task: expected a name, such as gym:CartPole-v1, got {type(task).__name__}; each "
            f"worker makes environments of its own, by their id (explained in {WORLDS_PAGE})"
        )
    if task.startswith(PREFIX):
        # A name with "=" cannot be an id's, so that what follows the colon is an argument.
        name, *given = re.split(r":(?=[a-zA-Z_]\w*=)", task.removeprefix(PREFIX))
        own = {**assignments(given), **kwargs}
        return GymnasiumConfig(id=name, kwargs=own, slots=arm.slots)
    if task == NERO:
        return nero_config(kwargs)
    known = task in TASKS or Path(task).suffix == ".json"
    if not known and find_env(task):
        return EnvConfig(name=task, kwargs=dict(kwargs))
    if known or Path(task).exists():
        return ArenaConfig(scenario=find_scenario(task, defaults=arm.senses, changes=kwargs))
    meant = f"; did you mean {PREFIX}{task}?" if task in gymnasium.registry else ""
    raise ConfigError(
        f"task: expected {', '.join((*TASKS, NERO, *env_kinds))}, gym:ID for a Gymnasium "
        f"environment, or the path of a scenario file (.json); got {task!r}{meant} "
        f"(explained in {WORLDS_PAGE})"
    )
