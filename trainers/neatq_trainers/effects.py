"""Settings that would change nothing in a run, so that nobody waits for what they do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

from neatq_envs.gymnasium_rows import interface_of
from neatq_torch.evolution import (
    FixedConfig,
    NEATConfig,
    ReproductionConfig,
    RtNEATConfig,
    SpeciesConfig,
)
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CriticConfig, ReplayConfig, TDConfig, TraceConfig
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
    world = config.world
    choices = interface_of(world.task).choices if isinstance(world, GymnasiumConfig) else None
    many = f"{config.task} has {choices} actions to choose from"
    useless = _of_network(config) | _of_population(config) | _of_learner(config)
    if choices is not None:
        useless["network.candidates"] = f"{many}, and a network an output for each"
        useless["learner.wires"] = f"{many}, and wires need a box of actions"
    if isinstance(config.learner, CriticConfig):
        useless |= _of_critic(config.learner, None if choices is None else many)
        if not world.lasting:
            words = "explorers and models are for robots in the arena"
            useless |= dict.fromkeys(("learner.teacher_mutation", "learner.novelty"), words)
    return useless


def _of_critic(own: CriticConfig, many: str | None) -> dict[str, str]:
    """Settings of a critic; `many` says how many actions there are, None that they are a box."""
    useless = {"network.value_range": "the critic has the Q-values, and its own range for them"}
    if many is None:
        words = "actions in a box are explored by learner.noise"
        return useless | dict.fromkeys(("learner.epsilon", "learner.max_hold_ticks"), words)
    words = f"{many}, which have no noise (learner.epsilon explores)"
    return useless | dict.fromkeys(
        ("learner.noise", "learner.persistence", "learner.smoothing"), words
    )


def _of_network(config: RunConfig) -> dict[str, str]:
    if config.population is None:
        words = f"the arm {config.arm} has no networks; its robots learn in tables"
        return {f"network.{one.name}": words for one in fields(NetworkConfig)}
    useless = {}
    if not config.learns:
        useless["network.value_range"] = "nothing is learnt, so no output is a Q-value"
    if config.network.evaluation == "settle" and not _may_recur(config.population):
        words = "networks without recurrent links remember nothing"
        useless["network.double_activation"] = words
    return useless


def _may_recur(population: Any) -> bool:
    """Whether networks of a population may have recurrent links."""
    mutation = getattr(getattr(population, "reproduction", None), "mutation", None)
    if mutation is None:
        return not isinstance(population, FixedConfig)
    return bool(mutation.add_link_prob and mutation.recurrent_link_prob)


def _of_population(config: RunConfig) -> dict[str, str]:
    own, useless = config.population, {}
    if isinstance(own, RtNEATConfig) and own.minimum_life_episodes is not None:
        of_ticks = "minimum_life_ticks", "trial_average", "trial_weight"
        words = "population.minimum_life_episodes is set"
        useless |= {f"population.{name}": words for name in of_ticks}
    if isinstance(own, RtNEATConfig) and own.survival_share is not None:
        words = "population.survival_share is set, and mates are of one species"
        useless["population.reproduction.interspecies_mate_prob"] = words
    elif isinstance(own, RtNEATConfig):
        useless["population.pioneer_share"] = "population.survival_share is not set"
    if getattr(own, "start", None) == "minimal":
        useless["population.start_hidden"] = 'founders of population.start "minimal" have none'
    return useless | _of_species(own) | _of_reproduction(getattr(own, "reproduction", None))


def _of_species(population: Any) -> dict[str, str]:
    species, useless = getattr(population, "species", None), {}
    if not isinstance(species, SpeciesConfig):
        return {}
    if not species.step:
        words = "the threshold stays where it is, as population.species.step is 0"
        useless |= dict.fromkeys(("species.target", "species.floor"), words)
    if isinstance(population, NEATConfig):
        useless["species.adjust_every"] = "the threshold moves once a generation"
        if not population.speciate:
            names = [f"species.{one.name}" for one in fields(SpeciesConfig)]
            words = "all are of one species, as population.speciate is off"
            useless |= dict.fromkeys([*names, "reproduction.interspecies_mate_prob"], words)
    return {f"population.{name}": why for name, why in useless.items()}


def _of_reproduction(reproduction: Any) -> dict[str, str]:
    if not isinstance(reproduction, ReproductionConfig):
        return {}
    useless: dict[str, str] = {}
    for (name, value), others in _DEPENDENT.items():
        part: Any = reproduction
        for step in name.split("."):
            part = getattr(part, step)
        if part == value:
            words = f"population.reproduction.{name} is {value}"
            useless |= dict.fromkeys(others.split(), words)
    return {f"population.reproduction.{name}": why for name, why in useless.items()}


_DEPENDENT: dict[tuple[str, Any], str] = {
    ("mutation.weight_scheme", "opennero"): "mutation.weight_replace_prob",
    ("mutation.link_weights_prob", 0): """mutation.weight_scheme mutation.weight_mutation_power
        mutation.weight_replace_prob mutation.max_link_weight""",
    ("mutation.add_link_prob", 0): """mutation.recurrent_link_prob mutation.recurrent_loop_prob
        mutation.forward_from_outputs mutation.new_link_tries mutation.new_link_weight_power""",
    ("mutation.recurrent_link_prob", 0): "mutation.recurrent_loop_prob",
    ("mutation.add_node_prob", 0): """mutation.split_tries mutation.split_old_below
        mutation.split_weight_scale mutation.hidden_activation""",
    ("multipoint_prob", 0): "crossover.copy_disabled",
    ("mutate_only_prob", 1): """mate_only_prob multipoint_prob interspecies_mate_prob
        crossover.keep_all_genes crossover.inherit_disabled_prob crossover.copy_disabled""",
}
"""What has no effect where a setting of `ReproductionConfig` has a value."""


def _of_learner(config: RunConfig) -> dict[str, str]:
    own, useless = config.learner, {}
    if getattr(own, "epsilon", None) == 0:
        useless["max_hold_ticks"] = "nobody explores, as learner.epsilon is 0"
    if getattr(own, "discount", None) == 0:
        words = "only the next reward counts, as learner.discount is 0"
        useless |= dict.fromkeys(("trace_decay", "horizon", "normalize_return"), words)
    if isinstance(own, CriticConfig) and own.teacher_mutation is None:
        useless["novelty"] = "nobody explores for the new, as learner.teacher_mutation is None"
    if config.ticks_per_batch == 1:
        words = "a batch has one tick, as batch_ticks says"
        if isinstance(own, ReplayConfig):
            useless |= dict.fromkeys(("horizon", "keep_every"), words)
        elif isinstance(own, TDConfig):
            useless["trace_decay"] = words
    if isinstance(own, TraceConfig) and config.generational:
        if config.world.lasting or config.population.episodes == 1:
            useless["anneal"] = "it falls from episode to episode, and a life has one"
        elif not isinstance(config.world, GymnasiumConfig):
            useless["anneal"] = "a world of your own does not tell the number of an episode"
    return {f"learner.{name}": why for name, why in useless.items()}
