"""The study's variants of arms: `replay` and the paper's arms with one thing changed each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from neatq_experiments.compare.variants import Variant, register_variants


class StudyPart(NamedTuple):
    """One thing in which `replay` differs from `described`.

    Attributes:
        summary: What it is.
        added: Its values in `replay`.
        removed: What stands in their place without it.
    """

    summary: str
    added: Mapping[str, Any]
    removed: Mapping[str, Any]


STUDY_PARTS: dict[str, StudyPart] = {
    "progress": StudyPart(
        "a reward for coming nearer",
        {"world.scenario.reward": "progress"},
        {"world.scenario.reward": "published"},
    ),
    "adam": StudyPart(
        "Adam's steps",
        {"learner.optimizer": "adam", "learner.learning_rate": 0.03},
        {"learner.optimizer": "sgd", "learner.learning_rate": 0.9},
    ),
    "exploration": StudyPart(
        "one exploratory tick in a hundred instead of ten",
        {"learner.epsilon": 0.01},
        {"learner.epsilon": 0.1},
    ),
    "candidates": StudyPart(
        "5 instead of 10 candidates", {"network.candidates": 5}, {"network.candidates": 10}
    ),
    "discount": StudyPart(
        "a discount of 0.9 instead of 0.8",
        {"learner.discount": 0.9},
        {"learner.discount": 0.8},
    ),
    "wires": StudyPart(
        "candidates that move: wire fitting",
        {"learner.wires": True},
        {"learner.kind": "td"},
    ),
    "replay": StudyPart(
        "learning from what all robots went through",
        {
            "learner.kind": "replay",
            "learner.updates": 4,
            "learner.newborn_updates": 0,
            "learner.horizon": 1,
        },
        {"learner.kind": "td", "learner.wires": True},
    ),
    "horizon": StudyPart(
        "rewards over 40 ticks before a value stands for the rest",
        {"learner.horizon": 40},
        {"learner.horizon": 1},
    ),
    "teaching": StudyPart(
        "newborns learn before their first tick",
        {"learner.newborn_updates": 100},
        {"learner.newborn_updates": 0},
    ),
    "sparing": StudyPart(
        "a replacement every 200 ticks instead of 40: a tenth are newborns, not half",
        {"population.ineligible_fraction": 0.1},
        {"population.ineligible_fraction": 0.5},
    ),
}
"""All of them, in the order in which the ladder from `described` to `replay` adds them."""


def _ladder() -> dict[str, Variant]:
    """From `described` to `replay`, one part at a time.

    The last two steps are in other places: `replay` without its last part, and `replay`.
    """
    steps, changes = {}, {}
    for number, (name, part) in enumerate(list(STUDY_PARTS.items())[:-2], 1):
        changes |= part.added
        summary = f"described, its first {number} steps to replay; the last: {part.summary}"
        steps[f"step-{number}-{name}"] = Variant(
            base="described", summary=summary, changes=dict(changes)
        )
    return steps


def _without() -> dict[str, Variant]:
    """`replay` without one part each."""
    return {
        f"replay-without-{name}": Variant(
            base="replay", summary=f"replay without: {part.summary}", changes=part.removed
        )
        for name, part in STUDY_PARTS.items()
    }


_WIRES = {
    "learning_rate": 0.03,
    "optimizer": "adam",
    "discount": 0.98,
    "normalize_return": False,
    "epsilon": 0.01,
    "newborn_updates": 100,
    "horizon": 10,
}
_WORLD = {"world.scenario.sensors": "arena", "world.scenario.reward": "progress"}
_SPARING = STUDY_PARTS["sparing"].added
STUDY_GROUPS: dict[str, dict[str, Variant]] = {
    "ladder": _ladder(),
    "without": _without(),
    "controls": {
        "rtneat-replay-senses": Variant(
            base="rtneat",
            summary="evolution alone, with replay's sensors, actions and reward",
            changes=_WORLD,
        ),
        "rtneat-sparing": Variant(
            base="rtneat", summary="evolution alone, as few newborns as replay", changes=_SPARING
        ),
        "rtneat-both": Variant(
            base="rtneat",
            summary="evolution alone, with replay's senses and as few newborns",
            changes={**_WORLD, **_SPARING},
        ),
        "replay-published-reward": Variant(
            base="replay",
            summary="replay with the published reward, which lies in a twentieth of the values",
            changes={"world.scenario.reward": "published", "network.value_range": (0.95, 1.0)},
        ),
        "replay-published-world": Variant(
            base="replay",
            summary="replay with the published reward, sensors and actions",
            changes={
                "world.scenario.reward": "published",
                "world.scenario.sensors": "opennero",
                "network.value_range": (0.95, 1.0),
            },
        ),
        "replay-frozen": Variant(
            base="replay",
            summary="replay whose networks choose among candidates but learn nothing",
            changes={"learner.kind": "none"},
        ),
    },
    "alternatives": {
        "replay-farsighted": Variant(
            base="replay",
            summary="replay with a discount of 0.98: what comes in 50 ticks counts",
            changes={"learner.discount": 0.98},
        ),
        "replay-lasting-exploration": Variant(
            base="replay",
            summary="replay with as many exploratory ticks, of which many come in a row",
            changes={"learner.epsilon": 0.00235, "learner.max_hold_ticks": 40},
        ),
        "replay-target-weights": Variant(
            base="replay",
            summary="replay with target weights that follow slowly",
            changes={"learner.target_tau": 0.05},
        ),
        "replay-plastic": Variant(
            base="replay",
            summary="replay that forgets and learns in tens of ticks, for worlds that change",
            changes={
                "learner.discount": 0.8,
                "learner.epsilon": 0.03,
                "learner.max_hold_ticks": 40,
                "learner.learning_rate": 0.05,
                "learner.updates": 16,
                "learner.horizon": 5,
                "learner.keep_every": 1,
                "learner.capacity": 1000,
                "batch_ticks": 20,
            },
        ),
        "replay-darwinian": Variant(
            base="replay",
            summary="replay whose offspring inherit what their parents were born with",
            changes={"learner.inheritance": "darwinian"},
        ),
    },
    "teachers": {
        "neatq-critic-alone": Variant(
            base="neatq",
            summary="in the arena: neatq whose critic teaches all",
            changes={"learner.teacher_mutation": None, "learner.novelty": None},
        ),
        "neatq-without-explorers": Variant(
            base="neatq",
            summary="in the arena: neatq that critic and fittest teach, no explorer",
            changes={"learner.novelty": None},
        ),
        "neatq-teachers-by-chance": Variant(
            base="neatq",
            summary="in the arena: neatq whose newborns draw their teachers, and inherit none",
            changes={"learner.teacher_mutation": 1.0},
        ),
        "neatq-learning-alone": Variant(
            base="neatq",
            summary="in the arena: fifty networks that follow the critic; nobody is born",
            changes={
                # With steep outputs or hidden nodes the networks soon say the same to everything.
                "population": {"kind": "fixed", "start": "minimal"},
                "world.scenario.first_lives": "spread",
                "network.activation": "sigmoid",
                "learner.every": 8,
                "learner.teacher_mutation": None,
                "learner.novelty": None,
            },
        ),
        "neatq-all-breed": Variant(
            base="neatq",
            summary="in the arena: neatq in which all who can be judged breed, by fitness",
            changes={"population.survival_share": None, "population.pioneer_share": None},
        ),
        "neatq-without-pioneers": Variant(
            base="neatq",
            summary="in the arena: neatq in which only the fittest breed",
            changes={"population.pioneer_share": None},
        ),
        "neatq-whole-lives": Variant(
            base="neatq",
            summary="in the arena: neatq that weighs all ticks of a life the same",
            changes={"population.trial_weight": None},
        ),
        "neatq-opennero-average": Variant(
            base="neatq",
            summary="in the arena: neatq that averages lives as OpenNERO does",
            changes={"population.trial_average": None},
        ),
        "neatq-short-sums": Variant(
            base="neatq",
            summary="in the arena: neatq whose critics sum rewards over 5 ticks instead of 20",
            changes={"learner.horizon": 5},
        ),
        "neatq-without-feedback": Variant(
            base="neatq",
            summary="in the arena: neatq that senses nothing of the tick before",
            changes={"world.scenario.sensors": "arena"},
        ),
        "neatq-published-reward": Variant(
            base="neatq",
            summary="in the arena: neatq that learns from the published reward",
            changes={"world.scenario.reward": "published"},
        ),
    },
    "critic": {
        "neatq-living": Variant(
            base="neatq",
            summary="on Gymnasium tasks: neatq whose networks learn from the critic in life, too",
            changes={"learner.every": 2},
        ),
        "neatq-one-step": Variant(
            base="neatq",
            summary="on Gymnasium tasks: neatq whose critic looks one step ahead, not three",
            changes={"learner.horizon": 1},
        ),
        "neatq-as-it-comes": Variant(
            base="neatq",
            summary="on Gymnasium tasks: neatq that reads observations as random play scales them",
            changes={"network.normalization": None},
        ),
        "neatq-minimal": Variant(
            base="neatq",
            summary="on Gymnasium tasks: neatq whose founders have no hidden nodes",
            changes={"population.founders": None},
        ),
        "neatq-wires": Variant(
            base="neatq",
            summary="on Gymnasium tasks: the population of neatq, wire fitting as in replay",
            changes={
                "learner": {"kind": "replay", **_WIRES},
                "network.normalization": None,
                "network.candidates": 5,
            },
        ),
        "neatq-without-births": Variant(
            base="neatq",
            summary="on Gymnasium tasks: learning alone, twenty networks that follow the critic",
            changes={
                "population": {"kind": "fixed", "founders": {"hidden": 6}},
                "learner.every": 2,
            },
        ),
    },
}
"""Variants by what they are for."""


def register() -> None:
    """Make the study's variants known to `neatq compare`."""
    for group, variants in STUDY_GROUPS.items():
        register_variants(group, variants)
