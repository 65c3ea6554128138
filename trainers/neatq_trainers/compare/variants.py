"""Which arms can be compared: the five of the project, and variants of them, which are data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

from neatq_trainers.config import Arm, ConfigError, RunConfig, preset

ARMS: tuple[Arm, ...] = get_args(Arm)


@dataclass(frozen=True, kw_only=True)
class Variant:
    """An arm with changes.

    Attributes:
        base: The arm.
        summary: One line on what the change is for.
        changes: New values, by dotted path in `RunConfig.to_dict`.
    """

    base: Arm
    summary: str
    changes: Mapping[str, Any]


VARIANTS: dict[str, Variant] = {
    "rtneat+neatq-world": Variant(
        base="rtneat",
        summary="evolution alone, with the sensors, actions and reward of neatq",
        changes={"scenario.sensors": "arena", "scenario.reward": "progress"},
    ),
    "neatq-frozen": Variant(
        base="neatq",
        summary="neatq whose networks choose among candidates but learn nothing",
        changes={"learning.rule": "none"},
    ),
    "neatq-darwinian": Variant(
        base="neatq",
        summary="neatq whose offspring inherit what their parents were born with",
        changes={"learning.inheritance": "darwinian"},
    ),
}


def config_of(task: str, name: str) -> RunConfig:
    """The configuration of an arm or a variant on a task, with the task's whole length.

    Raises:
        ConfigError: If there is no such arm or task, or a change of the variant is impossible.
        ScenarioError: If the scenario file cannot be used.
    """
    if name in ARMS:
        return preset(task, name)
    if name not in VARIANTS:
        raise ConfigError(
            f"arms: expected some of {', '.join((*ARMS, *VARIANTS))}; got {name!r} (neatq compare "
            "--list says what they are)"
        )
    variant = VARIANTS[name]
    try:
        return changed(preset(task, variant.base), variant.changes)
    except ConfigError as error:
        raise ConfigError(f"variant {name}: {error}") from error


def changed(config: RunConfig, changes: Mapping[str, Any]) -> RunConfig:
    """A configuration with other values.

    Args:
        config: The configuration.
        changes: New values, by dotted path in `RunConfig.to_dict`.

    Raises:
        ConfigError: If there is no such path, or a value is impossible.
    """
    values = config.to_dict()
    for path, value in changes.items():
        *parents, name = path.split(".")
        part: Any = values
        for parent in parents:
            part = part.get(parent) if isinstance(part, dict) else None
        if not isinstance(part, dict) or name not in part:
            raise ConfigError(
                f"{path}: there is no such value in a configuration; see neatq train --help for "
                "the names, with _ in place of -"
            )
        part[name] = value
    return RunConfig.from_dict(values)


def overview() -> str:
    """The arms and variants, a line each."""
    width = max(map(len, (*ARMS, *VARIANTS)))
    lines = [f"  {name:{width}}  {ARM_SUMMARIES[name]}" for name in ARMS]
    for name, variant in VARIANTS.items():
        changes = ", ".join(f"{path}={value}" for path, value in variant.changes.items())
        lines.append(f"  {name:{width}}  {variant.summary} ({variant.base} with {changes})")
    return "".join(f"{line}\n" for line in lines)


def summary_of(name: str) -> str:
    """What an arm or a variant is; nothing if this version does not know it."""
    if name in VARIANTS:
        return VARIANTS[name].summary
    return ARM_SUMMARIES.get(name, "")


ARM_SUMMARIES: dict[str, str] = {
    "rtneat": "evolution alone; the network's outputs are the action",
    "committed": "what the published code did: candidates, nothing is learnt",
    "described": "what the paper says: epsilon-greedy, TD on the chosen value, Lamarckian",
    "neatq": "this project's own choice of candidates, reward and learning",
    "qlearning": "the paper's table of Q-values, without evolution",
}
