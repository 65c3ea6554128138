"""Which arms can be compared: those of the trainer, variants of them (data), and anchors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import ANCHORS, ARMS, preset
from neatq_trainers.config import RunConfig
from neatq_trainers.names import file_name
from neatq_trainers.nero.nero_world import NERO
from neatq_trainers.worlds import ArenaConfig

PAPER_ARMS = ("rtneat", "committed", "described", "neatq", "qlearning")
"""Those that are compared in the arena unless others are asked for."""
RETURN_ARMS = ("rtneat", "neat", "neatq", "neat+q")
"""The same in other worlds."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """An arm with changes.

    Attributes:
        base: The arm.
        summary: One line on what the change is for.
        changes: New values, by dotted path in `RunConfig.to_dict`.
    """

    base: str
    summary: str
    changes: Mapping[str, Any]


GROUPS: dict[str, dict[str, Variant]] = {}
"""Variants by what they are for; the name of a group stands for all of it."""


def register_variants(group: str, variants: Mapping[str, Variant]) -> None:
    """Make variants known by name to `neatq compare`, and all of them by the name of their group.

    Raises:
        ConfigError: If a name already stands for something else, or is no name for a folder.
    """
    taken = {**ARMS, **ANCHORS, **GROUPS, **known_variants()}
    for name, one in {group: dict(variants), **variants}.items():
        if name != file_name(name):
            raise ConfigError(
                f"variants: results go into folders of these names, got {name!r}; call it "
                f"{file_name(name)}"
            )
        if taken.get(name, one) != one:
            raise ConfigError(f"variants: {name!r} is taken by something else; choose another name")
    GROUPS[group] = dict(variants)


def known_variants() -> dict[str, Variant]:
    """All registered variants by name."""
    return {name: variant for group in GROUPS.values() for name, variant in group.items()}


def expanded(names: Sequence[str]) -> tuple[str, ...]:
    """Arms and variants, with those of a group in place of its name."""
    return tuple(one for name in names for one in GROUPS.get(name, (name,)))


def default_arms(task: str) -> tuple[str, ...]:
    """The arms that are compared on a task unless others are asked for."""
    in_arena = isinstance(config_of(task, PAPER_ARMS[0]).world, ArenaConfig)
    return PAPER_ARMS if in_arena else RETURN_ARMS


def config_of(task: str, name: str, env_kwargs: Mapping[str, Any] | None = None) -> RunConfig:
    """The configuration of an arm or a variant on a task, with the task's whole length.

    Args:
        task: As `preset` takes it.
        name: The arm or variant.
        env_kwargs: Keys of the scenario, or arguments of the environment, with other values.

    Raises:
        ConfigError: If there is no such arm or task, or a change of the variant is impossible.
        ScenarioError: If the scenario file cannot be used.
    """
    if task == NERO:
        advice = "let the teams of its runs fight: neatq tournament runs/*/"
        raise ConfigError(f"tasks: {NERO} has no distance or return to compare; {advice}")
    if name in ARMS:
        return preset(task, name, env_kwargs=env_kwargs)
    variant = known_variants().get(name)
    if variant is None:
        raise ConfigError(
            f"arms: expected some of {', '.join((*ARMS, *ANCHORS, *GROUPS))}; got {name!r} (neatq "
            "compare --list says what they are and which variants there are)"
        )
    try:
        return preset(task, variant.base, env_kwargs=env_kwargs).changed(variant.changes)
    except ConfigError as error:
        raise ConfigError(f"variant {name}: {error}") from error


def arms_overview() -> str:
    """The arms, anchors and variants, a line each."""
    width = max(map(len, (*ARMS, *ANCHORS, *known_variants())))
    lines = [f"  {name:{width}}  {arm.summary}" for name, arm in ARMS.items()]
    lines.append("anchors, which one would otherwise take:")
    lines += [f"  {name:{width}}  {summary}" for name, summary in ANCHORS.items()]
    for group, members in GROUPS.items():
        lines.append(f"{group}: {len(members)} variants")
        lines += [f"  {name:{width}}  {variant.summary}" for name, variant in members.items()]
    return "".join(f"{line}\n" for line in lines)


def summary_of(name: str) -> str:
    """What an arm, variant or anchor is; nothing if this version does not know it."""
    if name in ANCHORS:
        return ANCHORS[name]
    known = (ARMS | known_variants()).get(name)
    return "" if known is None else known.summary
