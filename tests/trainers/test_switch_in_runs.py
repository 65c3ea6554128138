"""Runs with two flags: every arm senses both, and an interrupted run goes on exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neatq_envs.scenario import TASKS
from neatq_trainers.arms import ARMS, TASK_TICKS, preset
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import METRICS
from neatq_trainers.genome_figure import node_names
from neatq_trainers.train import resume, start
from neatq_trainers.worlds import ArenaConfig

pytestmark = pytest.mark.usefixtures("without_pictures")
State = dict[str, Any]
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
    assert isinstance(config.world, ArenaConfig)
    scenario = config.world.scenario.replaced(flag=FLAG, walls=())
    config = replace(config, world=replace(config.world, scenario=scenario))
    start(config, tmp_path / "whole")
    start(replace(config, ticks=130), tmp_path / "run")
    resume(tmp_path / "run", ticks=320)
    assert differences(state_of(tmp_path / "whole"), state_of(tmp_path / "run")) == []
    whole, run = ((tmp_path / name / METRICS).read_text() for name in ("whole", "run"))
    assert whole == run


@pytest.mark.parametrize("arm", ARMS)
def test_every_arm_senses_both_flags(arm: Any) -> None:
    run = build(preset("switch", arm, env_kwargs={"robots": 2}))
    env: Any = run.world.env
    assert "second_flag_left" in env.arena.schema.observations
    if run.populations:
        genome = run.populations[0].genomes[0]
        assert genome.observation_schema.endswith("-two-flags")
        assert "second flag left" in node_names(genome, None, None)


def test_every_task_has_a_length() -> None:
    assert TASK_TICKS.keys() == TASKS.keys()
