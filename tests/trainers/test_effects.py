"""What is refused as without effect has none, and says why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import ARMS, preset
from neatq_trainers.config import RunConfig
from neatq_trainers.effects import refuse_without_effect, without_effect
from neatq_trainers.folder import METRICS
from neatq_trainers.train import start

Tiny = Callable[..., RunConfig]
BOX, CHOICES = "gym:Pendulum-v1", "gym:CartPole-v1"
OF_MUTATION = "population.reproduction.mutation."

# Of each: arm, task, settings that others depend on, the setting without effect, and why.
CASES: list[tuple[str, str, dict[str, Any], str, str]] = [
    ("neat", "wall", {}, "network.value_range", "no output is a Q-value"),
    ("neat", BOX, {}, "network.double_activation", "without recurrent links"),
    ("qnetwork", BOX, {}, "network.double_activation", "without recurrent links"),
    ("neatq", CHOICES, {}, "network.candidates", "2 actions to choose from"),
    ("neat", "wall", {}, "population.start_hidden", "minimal"),
    ("neat", BOX, {}, "population.species.target", "species.step is 0"),
    ("neat", BOX, {}, "population.species.floor", "species.step is 0"),
    ("neat", BOX, {}, "population.species.adjust_every", "once a generation"),
    (
        "neat",
        BOX,
        {"population.speciate": False},
        "population.species.threshold",
        "speciate is off",
    ),
    (
        "neat",
        BOX,
        {"population.speciate": False},
        "population.reproduction.interspecies_mate_prob",
        "speciate is off",
    ),
    ("rtneat", "wall", {"population.species.step": 0.0}, "population.species.target", "step is 0"),
    ("neat", BOX, {}, OF_MUTATION + "recurrent_loop_prob", "recurrent_link_prob is 0"),
    ("rtneat", "wall", {}, OF_MUTATION + "weight_replace_prob", "weight_scheme is opennero"),
    (
        "rtneat",
        "wall",
        {OF_MUTATION + "link_weights_prob": 0.0},
        OF_MUTATION + "weight_mutation_power",
        "link_weights_prob is 0",
    ),
    (
        "rtneat",
        "wall",
        {OF_MUTATION + "add_link_prob": 0.0},
        OF_MUTATION + "new_link_weight_power",
        "add_link_prob is 0",
    ),
    (
        "rtneat",
        "wall",
        {OF_MUTATION + "add_node_prob": 0.0},
        OF_MUTATION + "split_weight_scale",
        "add_node_prob is 0",
    ),
    (
        "rtneat",
        "wall",
        {"population.reproduction.mutate_only_prob": 1.0},
        "population.reproduction.crossover.keep_all_genes",
        "mutate_only_prob is 1",
    ),
    (
        "rtneat",
        "wall",
        {"population.reproduction.multipoint_prob": 0.0},
        "population.reproduction.crossover.copy_disabled",
        "multipoint_prob is 0",
    ),
    ("rtneat", BOX, {}, "population.minimum_life_ticks", "minimum_life_episodes is set"),
    ("replay", "wall", {"learner.epsilon": 0.0}, "learner.max_hold_ticks", "epsilon is 0"),
    ("replay", "wall", {"learner.discount": 0.0}, "learner.horizon", "discount is 0"),
    ("described", "wall", {"learner.discount": 0.0}, "learner.normalize_return", "discount is 0"),
    ("neat+q", BOX, {"learner.discount": 0.0}, "learner.trace_decay", "discount is 0"),
    ("described", "wall", {"batch_ticks": 1}, "learner.trace_decay", "a batch has one tick"),
    ("replay", "wall", {"batch_ticks": 1}, "learner.keep_every", "a batch has one tick"),
    ("neat+q", "wall", {}, "learner.anneal", "a life has one"),
    ("neat+q", BOX, {"population.episodes": 1}, "learner.anneal", "a life has one"),
    ("qlearning", "wall", {}, "network.evaluation", "no networks"),
]


@pytest.mark.parametrize(("arm", "task", "others", "name", "why"), CASES)
def test_a_setting_that_others_leave_without_effect_is_refused_with_the_reason(
    arm: str, task: str, others: dict[str, Any], name: str, why: str
) -> None:
    config = preset(task, arm).changed(others)
    with pytest.raises(ConfigError, match=f"^{name}: it has no effect here: .*{why}"):
        refuse_without_effect(config, [*others, name])


def test_what_is_said_to_have_no_effect_is_a_setting_of_the_run() -> None:
    for task in ("wall", BOX, CHOICES):
        for arm in ARMS:
            if task != "wall" and arm == "qlearning":
                continue
            config = preset(task, arm)
            known = _paths(config)
            unknown = {name for name in without_effect(config) if name not in known}
            # Those of other kinds of learners are refused before, as unknown here.
            assert {name for name in unknown if not name.startswith("learner.")} == set()


def _paths(part: Any, path: str = "") -> set[str]:
    paths = set()
    for one in fields(part):
        value, name = getattr(part, one.name), f"{path}{one.name}"
        paths |= {name} | (_paths(value, f"{name}.") if is_dataclass(value) else set())
    return paths


# Of each: arm, task, settings that others depend on, the setting without effect, another value.
EQUAL: list[tuple[str, str, dict[str, Any], str, Any]] = [
    (
        "neat",
        "walk",
        {OF_MUTATION + "recurrent_link_prob": 0.0},
        "network.double_activation",
        True,
    ),
    ("neat", "walk", {}, "population.species.target", 9),
    ("neat", "walk", {}, "population.species.adjust_every", 1),
    ("neat", "walk", {"population.speciate": False}, "population.species.threshold", 0.4),
    ("rtneat", "wall", {"population.species.step": 0.0}, "population.species.target", 9),
    (
        "rtneat",
        "wall",
        {OF_MUTATION + "link_weights_prob": 0.0},
        OF_MUTATION + "max_link_weight",
        0.1,
    ),
    (
        "rtneat",
        "wall",
        {OF_MUTATION + "add_link_prob": 0.0},
        OF_MUTATION + "recurrent_link_prob",
        0.9,
    ),
    ("rtneat", "wall", {OF_MUTATION + "add_node_prob": 0.0}, OF_MUTATION + "split_tries", 1),
    (
        "rtneat",
        "wall",
        {"population.reproduction.mutate_only_prob": 1.0},
        "population.reproduction.multipoint_prob",
        0.0,
    ),
    ("replay", "wall", {"learner.epsilon": 0.0}, "learner.max_hold_ticks", 9),
    ("replay", "wall", {"learner.discount": 0.0}, "learner.horizon", 3),
    ("described", "wall", {"learner.discount": 0.0}, "learner.normalize_return", False),
    ("neat+q", "walk", {"learner.discount": 0.0}, "learner.trace_decay", 0.1),
    ("replay", "wall", {"batch_ticks": 1}, "learner.keep_every", 2),
    ("neat+q", "walk", {"population.episodes": 1}, "learner.anneal", False),
]


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(("arm", "task", "others", "name", "value"), EQUAL)
def test_what_is_said_to_have_no_effect_has_none(
    tiny: Tiny,
    tiny_walk: Tiny,
    tmp_path: Path,
    arm: str,
    task: str,
    others: dict[str, Any],
    name: str,
    value: Any,
) -> None:
    config = tiny_walk(arm, generations=3) if task == "walk" else tiny(arm, ticks=240)
    config = config.changed(others)
    assert name in without_effect(config)
    other = config.changed({name: value})
    assert other != config
    one, two = (start(run, tmp_path / at) for run, at in ((config, "one"), (other, "two")))
    assert (one.path / METRICS).read_bytes() == (two.path / METRICS).read_bytes()
    assert one.champion().to_dict() == two.champion().to_dict()
