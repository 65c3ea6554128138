"""Settings that would change nothing in a run, so that nobody waits for what they do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields

from neatq_envs.gymnasium_task import Interface
from neatq_torch.evolution import RtNEATConfig
from neatq_torch.kinds import ConfigError
from neatq_trainers.config import NetworkConfig, RunConfig
from neatq_trainers.worlds import GymnasiumConfig


def refuse_without_effect(config: RunConfig, settings: Iterable[str]) -> None:
    """Refuse what somebody chose, by dotted path ("learner.epsilon"), if it changes nothing.

    Raises:
        ConfigError: Naming the first such setting, and why it has no effect.
        TaskError: If there is no such environment.
    """
    useless = without_effect(config)
    for name in settings:
        if name in useless:
            raise ConfigError(f"{name}: it has no effect here: {useless[name]}")


def without_effect(config: RunConfig) -> dict[str, str]:
    """The settings that change nothing in a run, by dotted path, and why.

    Raises:
        TaskError: If there is no such environment.
    """
    choices = _choices(config)
    many = f"{config.task} has {choices} actions to choose from"
    useless = _of_network(config) | _of_population(config)
    if choices is not None:
        useless["network.candidates"] = f"{many}, and a network an output for each"
        useless["learner.wires"] = f"{many}, and wires need a box of actions"
    return useless


def _of_network(config: RunConfig) -> dict[str, str]:
    if config.population is None:
        words = f"the arm {config.arm} has no networks; its robots learn in tables"
        return {f"network.{one.name}": words for one in fields(NetworkConfig)}
    words = "nothing is learnt, so no output is a Q-value"
    return {} if config.learns else {"network.value_range": words}


def _of_population(config: RunConfig) -> dict[str, str]:
    own, useless = config.population, {}
    if isinstance(own, RtNEATConfig):
        if own.minimum_life_episodes is not None:
            useless["population.minimum_life_ticks"] = "population.minimum_life_episodes is set"
        if isinstance(config.world, GymnasiumConfig):
            useless["population.novelty"] = f"nobody stands at a place in {config.task}"
    if getattr(own, "start", None) == "minimal":
        useless["population.start_hidden"] = 'founders of population.start "minimal" have none'
    mutation = getattr(getattr(own, "reproduction", None), "mutation", None)
    if getattr(mutation, "weight_scheme", None) == "opennero":
        name = "population.reproduction.mutation.weight_replace_prob"
        useless[name] = 'it belongs to weight_scheme "uniform"'
    return useless


def _choices(config: RunConfig) -> int | None:
    """Actions to choose from in the world of a run; None in a box of actions."""
    if not isinstance(config.world, GymnasiumConfig):
        return None
    env = config.world.task.make()
    try:
        return Interface.of(env, config.world.id).choices
    finally:
        env.close()
