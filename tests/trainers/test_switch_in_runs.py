"""Runs with two flags: every arm senses both, and an interrupted run goes on exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neatq_envs.scenario import TASKS
from neatq_trainers.build import build
from neatq_trainers.config import TASK_TICKS, RunConfig, preset
from neatq_trainers.genome_layout import node_names
from neatq_trainers.run_folder import METRICS
from neatq_trainers.train import resume, start

State = dict[str, Any]
ARMS = ("rtneat", "committed", "described", "neatq", "qlearning")
FLAG = replace(TASKS["switch"].flag, switch_ticks=70)


@pytest.mark.parametrize("arm", ["rtneat", "neatq", "qlearning"])
def test_a_run_that_is_interrupted_between_switches_goes_on_exactly(
    arm: str,
    tiny: Callable[..., RunConfig],
    differences: Callable[[State, State], list[str]],
    state_of: Callable[[Path], State],
    tmp_path: Path,
) -> None:
    config = tiny(arm, ticks=320)
    config = replace(config, scenario=config.scenario.replaced(flag=FLAG, walls=()))
    start(config, tmp_path / "whole")
    start(replace(config, ticks=130), tmp_path / "run")
    resume(tmp_path / "run", ticks=320)
    assert differences(state_of(tmp_path / "whole"), state_of(tmp_path / "run")) == []
    whole, run = ((tmp_path / name / METRICS).read_text() for name in ("whole", "run"))
    assert whole == run


@pytest.mark.parametrize("arm", ARMS)
def test_every_arm_senses_both_flags(arm: Any) -> None:
    config = preset("switch", arm)
    run = build(replace(config, scenario=config.scenario.replaced(robots=2)))
    assert "second_flag_left" in run.env.arena.schema.observations
    if run.populations:
        genome = run.populations[0].genomes[0]
        assert genome.observation_schema.endswith("-two-flags")
        assert "second flag left" in node_names(genome, None, None)


def test_every_task_has_a_length() -> None:
    assert TASK_TICKS.keys() == TASKS.keys()
