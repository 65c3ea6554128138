"""Tiny runs on toy environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from neatq_trainers.generational.config import (
    EvaluationConfig,
    GenerationalConfig,
    LifeLearningConfig,
    PretrainingConfig,
    preset,
)
from neatq_trainers.generational.train import start

Tiny = Callable[..., GenerationalConfig]

VARIANTS: dict[str, dict[str, object]] = {
    "pretrained": {"pretraining": PretrainingConfig(steps=3, batch=4, transitions=80)},
    "wires": {"learning": LifeLearningConfig(rule="wire_fitting")},
}
"""Switches of the arm neatq."""


@pytest.fixture(scope="session")
def tiny(toy: str) -> Tiny:
    """Make the configuration of a short run of an arm or variant, on the walk of `toy_tasks`."""

    def make(arm: str = "neat", task: str = "Walk-v0", **changes: object) -> GenerationalConfig:
        changes = VARIANTS.get(arm, {}) | changes
        config = preset(toy + task, "neatq" if arm in VARIANTS else arm)
        size = {"population": 8, "episodes": 2} if arm != "qnetwork" else {"episodes": 6}
        evaluation = EvaluationConfig(every=2, genomes=2, episodes=3, test_episodes=5)
        config = replace(config, generations=4, seed=1, evaluation=evaluation, **size)
        return replace(config, **changes)  # pyright: ignore[reportArgumentType]

    return make


@pytest.fixture(scope="session")
def done(tiny: Tiny, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of the finished tiny run of an arm, made once; do not write into it."""
    folder = tmp_path_factory.mktemp("generational")

    def run(arm: str) -> Path:
        if not (folder / arm).exists():
            start(tiny(arm), folder / arm)
        return folder / arm

    return run
