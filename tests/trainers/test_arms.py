"""What the arms are: no setting of one changes unnoticed.

A digest is that of `neatq compare`, of all settings but seed and length. One that changes means
that the results of the arm change: say so in the changelog, and run its studies again. To make them
anew:

    python -c "import neatq_torch as nq; from neatq_experiments.compare.cells import digest;
    print(digest(nq.preset('wall', 'neatq')))"
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import gymnasium
import msgspec
import pytest

from neatq_experiments.compare.cells import digest
from neatq_torch.evolution import population_kinds
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import TDConfig, learner_kinds
from neatq_trainers.arms import ARMS, preset

DIGESTS = {
    ("wall", "rtneat"): "dcf7a4bc7fda",
    ("wall", "neat"): "1c4b42ddee67",
    ("wall", "committed"): "3e1d2b4f8971",
    ("wall", "described"): "05f3194df93a",
    ("wall", "neatq"): "96fc053fcd95",
    ("wall", "replay"): "2bdacba4bfdb",
    ("wall", "neat+q"): "3721695ccbba",
    ("wall", "qnetwork"): "eddee2552f9f",
    ("wall", "qlearning"): "62f479a7b08b",
    ("gym:Pendulum-v1", "rtneat"): "282a5ca4f401",
    ("gym:Pendulum-v1", "neat"): "01af2cd64efa",
    ("gym:Pendulum-v1", "committed"): "be7f32a6651b",
    ("gym:Pendulum-v1", "described"): "cbe2c6443f79",
    ("gym:Pendulum-v1", "neatq"): "137ad433f839",
    ("gym:Pendulum-v1", "replay"): "a072c265b9d6",
    ("gym:Pendulum-v1", "neat+q"): "b67c774956fd",
    ("gym:Pendulum-v1", "qnetwork"): "f0f76f2d9620",
}
DEFAULTS = {
    ("learner", "none"): "44136fa355b3",
    ("learner", "td"): "ffd4807a3e9b",
    ("learner", "replay"): "3d8c9a9b500b",
    ("learner", "critic"): "59f8bee7d22b",
    ("learner", "traces"): "27a1f8b7d1a8",
    ("learner", "table"): "473a57fb72fd",
    ("population", "rtneat"): "c1ff314eff2f",
    ("population", "neat"): "ae8a85d7e691",
    ("population", "fixed"): "6ebd5daf6c3f",
}
"""Of the settings of a kind of part, as JSON."""
TICKS = {
    "flag": 40_000,
    "moving": 60_000,
    "wall": 70_000,
    "trap": 70_000,
    "maze": 70_000,
    "switch": 70_000,
    "behind": 70_000,
}


@pytest.mark.parametrize(("task", "arm"), DIGESTS)
def test_an_arm_has_the_settings_that_its_studies_were_made_with(task: str, arm: str) -> None:
    assert digest(preset(task, arm)) == DIGESTS[task, arm]


def test_every_arm_is_guarded_in_the_arena_and_on_gymnasium_tasks() -> None:
    everywhere = [arm for arm in ARMS if ARMS[arm].arena_only is None]
    assert [arm for task, arm in DIGESTS if task == "wall"] == list(ARMS)
    assert [arm for task, arm in DIGESTS if task != "wall"] == everywhere


@pytest.mark.parametrize("task", TICKS)
def test_a_run_is_as_long_as_the_published_one(task: str) -> None:
    assert preset(task, "rtneat").length == ("ticks", TICKS[task])


def test_an_environment_in_place_of_its_name_is_refused() -> None:
    given: Any = gymnasium.make("CartPole-v1")
    with pytest.raises(ConfigError, match=r"expected a name, such as gym:CartPole-v1, got TimeL"):
        preset(given, "neat")


def test_other_worlds_have_lengths_of_their_own() -> None:
    assert preset("gym:CartPole-v1", "neat").length == ("generations", 50)


def test_a_scenario_file_has_the_length_of_the_longest_task(tmp_path: Path) -> None:
    (tmp_path / "mine.json").write_text('{"name": "mine"}')
    assert preset(str(tmp_path / "mine.json"), "rtneat").length == ("ticks", 70_000)


def test_where_lives_have_no_end_a_genome_is_judged_after_a_thousand_ticks() -> None:
    endless = {"lifetime_ticks": 0}
    own = preset("wall", "rtneat", env_kwargs=endless)
    other = preset("wall", "described", env_kwargs=endless, population="rtneat")
    assert own.population.minimum_life_ticks == other.population.minimum_life_ticks == 1000


def test_lives_are_judged_by_where_they_lead_in_the_arena_alone() -> None:
    judged = {
        task: (own.trial_weight, own.trial_average)
        for task in ("maze", "nero")
        for own in [preset(task, "neatq").population]
    }
    assert judged == {"maze": ("growing", "recent"), "nero": (None, None)}


def test_where_lives_end_a_genome_is_judged_after_one() -> None:
    short = {"lifetime_ticks": 300}
    own = preset("wall", "rtneat", env_kwargs=short)
    other = preset("wall", "described", env_kwargs=short, population="rtneat")
    assert own.population.minimum_life_ticks == other.population.minimum_life_ticks == 300
    assert preset("wall", "neat", env_kwargs=short).population.episodes == 1


def test_another_learner_and_population_suit_a_gymnasium_task() -> None:
    config = preset("gym:Pendulum-v1", "neat", population="rtneat", learner="td")
    assert (config.learner.normalize_return, config.learner.discount) == (False, 0.99)
    assert config.population.minimum_life_episodes == 2


def test_another_learner_keeps_its_own_discount_in_the_arena() -> None:
    assert preset("wall", "neat", learner="td").learner == TDConfig()


@pytest.mark.parametrize(("noun", "name"), DEFAULTS)
def test_a_kind_has_the_defaults_that_were_studied(noun: str, name: str) -> None:
    kinds = {"learner": learner_kinds, "population": population_kinds}[noun]
    values = json.dumps(msgspec.to_builtins(kinds.config(name)()), sort_keys=True)
    assert hashlib.sha256(values.encode()).hexdigest()[:12] == DEFAULTS[noun, name]
