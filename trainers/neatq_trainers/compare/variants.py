"""Which arms can be compared: the five of the project, and variants of them, which are data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args

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


class Part(NamedTuple):
    """One thing in which `neatq` differs from `described`.

    Attributes:
        summary: What it is.
        added: Its values in `neatq`.
        removed: What stands in their place without it.
    """

    summary: str
    added: Mapping[str, Any]
    removed: Mapping[str, Any]


PARTS: dict[str, Part] = {
    "progress": Part(
        "a reward for coming nearer",
        {"scenario.reward": "progress"},
        {"scenario.reward": "published"},
    ),
    "adam": Part(
        "Adam's steps",
        {"learning.step.optimizer": "adam", "learning.step.learning_rate": 0.03},
        {"learning.step.optimizer": "sgd", "learning.step.learning_rate": 0.9},
    ),
    "exploration": Part(
        "one exploratory tick in a hundred instead of ten",
        {"learning.epsilon": 0.01},
        {"learning.epsilon": 0.1},
    ),
    "candidates": Part(
        "5 instead of 10 candidates", {"network.candidates": 5}, {"network.candidates": 10}
    ),
    "discount": Part(
        "a discount of 0.9 instead of 0.8",
        {"learning.discount": 0.9},
        {"learning.discount": 0.8},
    ),
    "wires": Part(
        "candidates that move: wire fitting",
        {"learning.rule": "wire_fitting"},
        {"learning.rule": "td", "learning.replay.updates": 0, "learning.replay.newborn_updates": 0},
    ),
    "replay": Part(
        "learning from what all robots went through",
        {"learning.replay.updates": 4},
        {"learning.replay.updates": 0, "learning.replay.newborn_updates": 0},
    ),
    "horizon": Part(
        "rewards over 40 ticks before a value stands for the rest",
        {"learning.replay.horizon": 40},
        {"learning.replay.horizon": 1},
    ),
    "teaching": Part(
        "newborns learn before their first tick",
        {"learning.replay.newborn_updates": 100},
        {"learning.replay.newborn_updates": 0},
    ),
    "sparing": Part(
        "a replacement every 200 ticks instead of 40: a tenth are newborns, not half",
        {"evolution.ineligible_fraction": 0.1},
        {"evolution.ineligible_fraction": 0.5},
    ),
}
"""All of them, in the order in which the ladder from `described` to `neatq` adds them."""


def _ladder() -> dict[str, Variant]:
    """From `described` to `neatq`, one part at a time.

    The last two steps are in other places: `neatq` without its last part, and `neatq`.
    """
    steps, changes = {}, {}
    for number, (name, part) in enumerate(list(PARTS.items())[:-2], 1):
        changes |= part.added
        summary = f"described, its first {number} steps to neatq; the last: {part.summary}"
        steps[f"step-{number}-{name}"] = Variant(
            base="described", summary=summary, changes=dict(changes)
        )
    return steps


def _without() -> dict[str, Variant]:
    """`neatq` without one part each."""
    return {
        f"neatq-without-{name}": Variant(
            base="neatq", summary=f"neatq without: {part.summary}", changes=part.removed
        )
        for name, part in PARTS.items()
    }


_WORLD = {"scenario.sensors": "arena", "scenario.reward": "progress"}
_SPARING = PARTS["sparing"].added
GROUPS: dict[str, dict[str, Variant]] = {
    "ladder": _ladder(),
    "without": _without(),
    "controls": {
        "rtneat-neatq-senses": Variant(
            base="rtneat",
            summary="evolution alone, with neatq's sensors, actions and reward",
            changes=_WORLD,
        ),
        "rtneat-sparing": Variant(
            base="rtneat", summary="evolution alone, as few newborns as neatq", changes=_SPARING
        ),
        "rtneat-both": Variant(
            base="rtneat",
            summary="evolution alone, with neatq's senses and as few newborns",
            changes={**_WORLD, **_SPARING},
        ),
        "neatq-published-reward": Variant(
            base="neatq",
            summary="neatq with the published reward, which lies in a twentieth of the values",
            changes={"scenario.reward": "published", "network.value_range": (0.95, 1.0)},
        ),
        "neatq-published-world": Variant(
            base="neatq",
            summary="neatq with the published reward, sensors and actions",
            changes={
                "scenario.reward": "published",
                "scenario.sensors": "opennero",
                "network.value_range": (0.95, 1.0),
            },
        ),
        "neatq-frozen": Variant(
            base="neatq",
            summary="neatq whose networks choose among candidates but learn nothing",
            changes={
                "learning.rule": "none",
                "learning.replay.updates": 0,
                "learning.replay.newborn_updates": 0,
                "learning.epsilon": 0.0,
            },
        ),
    },
    "alternatives": {
        "neatq-farsighted": Variant(
            base="neatq",
            summary="neatq with a discount of 0.98: what comes in 50 ticks counts",
            changes={"learning.discount": 0.98},
        ),
        "neatq-lasting-exploration": Variant(
            base="neatq",
            summary="neatq with as many exploratory ticks, of which many come in a row",
            changes={"learning.epsilon": 0.00235, "learning.max_hold_ticks": 40},
        ),
        "neatq-target-weights": Variant(
            base="neatq",
            summary="neatq with target weights that follow slowly",
            changes={"learning.step.target_tau": 0.05},
        ),
        "neatq-exponential-trials": Variant(
            base="neatq",
            summary="neatq whose fitness is an exponential average over trials",
            changes={"evolution.trial_average": "exponential"},
        ),
        "neatq-double": Variant(
            base="neatq",
            summary="neatq with double targets",
            changes={"learning.bootstrap": "double", "learning.step.target_tau": 0.05},
        ),
        "neatq-expected": Variant(
            base="neatq",
            summary="neatq with the targets of expected Sarsa",
            changes={"learning.bootstrap": "expected"},
        ),
        "neatq-plastic": Variant(
            base="neatq",
            summary="neatq that forgets and learns in tens of ticks, for worlds that change",
            changes={
                "learning.discount": 0.8,
                "learning.epsilon": 0.03,
                "learning.max_hold_ticks": 40,
                "learning.step.learning_rate": 0.05,
                "learning.replay.updates": 16,
                "learning.replay.horizon": 5,
                "learning.replay.keep_every": 1,
                "learning.replay.capacity": 1000,
                "batch_ticks": 20,
            },
        ),
        "neatq-separation": Variant(
            base="neatq",
            summary="neatq whose candidates are kept apart, as in Q3C",
            changes={"learning.separation": 0.01},
        ),
        "neatq-darwinian": Variant(
            base="neatq",
            summary="neatq whose offspring inherit what their parents were born with",
            changes={"learning.inheritance": "darwinian"},
        ),
        "neatq-half-lamarckian": Variant(
            base="neatq",
            summary="neatq whose offspring inherit half of what their parents learnt",
            changes={"learning.inherited_share": 0.5},
        ),
        "neatq-safe-mutation": Variant(
            base="neatq",
            summary="neatq whose mutations spare weights to which the outputs react strongly",
            changes={"learning.safe_mutation": 100},
        ),
        "neatq-novelty": Variant(
            base="neatq",
            summary="neatq that selects half by fitness, half by novelty of where a life ends",
            changes={"evolution.novelty": 0.5},
        ),
        "rtneat-novelty": Variant(
            base="rtneat",
            summary="evolution alone, half by fitness, half by novelty of where a life ends",
            changes={"evolution.novelty": 0.5},
        ),
        "neatq-genes": Variant(
            base="neatq",
            summary="neatq whose learning rate, epsilon and discount evolve, scored without "
            "exploration",
            changes={"learning.genes": 0.2},
        ),
    },
}
"""Variants by what they are for; the name of a group stands for all of it."""
VARIANTS: dict[str, Variant] = {
    name: variant for group in GROUPS.values() for name, variant in group.items()
}


def expanded(names: Sequence[str]) -> tuple[str, ...]:
    """Arms and variants, with those of a group in place of its name."""
    return tuple(one for name in names for one in GROUPS.get(name, (name,)))


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
            f"arms: expected some of {', '.join((*ARMS, *GROUPS))}; got {name!r} (neatq compare "
            "--list says what they are and which variants there are)"
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
    for group, members in GROUPS.items():
        lines.append(f"{group}: {len(members)} variants")
        lines += [f"  {name:{width}}  {variant.summary}" for name, variant in members.items()]
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
