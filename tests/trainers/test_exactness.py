"""A run is a function of its configuration: of the seed, not of how often it was interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_torch.learning import ReplayConfig
from neatq_trainers.build import build
from neatq_trainers.cli import main
from neatq_trainers.config import RunConfig
from neatq_trainers.metrics import Row
from neatq_trainers.progress import Progress
from neatq_trainers.run_folder import CHECKPOINT, CONFIG, METRICS, RunFolder
from neatq_trainers.train import resume, start

ARMS = ("rtneat", "committed", "described", "neatq", "qlearning")
CASES = (
    *ARMS,
    "neatq with own ticks",
    "neatq with wire fitting",
    "neatq with little memory",
    "neatq with half inheritance",
    "neatq with safe mutation",
    "neatq with novelty",
    "neatq with genes",
)
LONG_TICKS = 4000
"""A run that takes seconds, so that a signal meets it on its way."""
State = dict[str, Any]
Differences = Callable[[State, State], list[str]]
StateOf = Callable[[Path], State]


@pytest.fixture(scope="module")
def config_of(tiny: Callable[..., RunConfig]) -> Callable[[str], RunConfig]:
    def make(case: str) -> RunConfig:
        config = tiny(case.split()[0])
        learning, replay = config.learning, ReplayConfig()
        if case.endswith("own ticks"):
            config = replace(config, learning=replace(learning, rule="td", replay=replay))
        if case.endswith("wire fitting"):
            config = replace(config, learning=replace(learning, trace_decay=0.5, replay=replay))
        if case.endswith("little memory"):
            replay = ReplayConfig(updates=2, newborn_updates=3, size=16, capacity=300)
            config = replace(config, learning=replace(learning, replay=replay))
        if case.endswith("half inheritance"):
            config = replace(config, learning=replace(learning, inherited_share=0.5))
        if case.endswith("safe mutation"):
            config = replace(config, learning=replace(learning, safe_mutation=20))
        if case.endswith("genes"):
            config = replace(config, learning=replace(learning, genes=0.5))
        if case.endswith("novelty"):
            config = replace(config, evolution=replace(config.evolution, novelty=0.5))
        return config

    return make


@pytest.fixture(scope="module")
def whole(
    config_of: Callable[[str], RunConfig], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Path]:
    """The folder of the uninterrupted run of a case."""
    folder = tmp_path_factory.mktemp("whole")

    def run(case: str) -> Path:
        path = folder / case.replace(" ", "-")
        if not path.exists():
            start(config_of(case), path)
        return path

    return run


@pytest.fixture(scope="module")
def same_run(state_of: StateOf, differences: Differences) -> Callable[[Path, Path], None]:
    def check(one: Path, two: Path) -> None:
        assert differences(state_of(one), state_of(two)) == []
        assert (one / METRICS).read_text() == (two / METRICS).read_text()
        assert (one / CONFIG).read_text() == (two / CONFIG).read_text()

    return check


Same = Callable[[Path, Path], None]
Whole = Callable[[str], Path]
ConfigOf = Callable[[str], RunConfig]


@pytest.mark.parametrize("case", [case for case in CASES if case != "qlearning"])
def test_the_runs_of_this_file_have_births_and_become_recurrent(
    case: str, whole: Whole, config_of: ConfigOf, state_of: StateOf
) -> None:
    run = build(config_of(case))
    assert run.network is not None
    assert run.network.state_size == 0
    state = state_of(whole(case))["runs"][0]
    assert state["populations"][0]["births"] > 5
    assert state["policy"]["memory"].shape[-1] > 0


@pytest.mark.parametrize("case", ARMS)
def test_the_same_seed_is_the_same_run(
    case: str, whole: Whole, config_of: ConfigOf, same_run: Same, tmp_path: Path
) -> None:
    start(config_of(case), tmp_path / "again")
    same_run(whole(case), tmp_path / "again")


def test_another_seed_is_another_run(
    tiny: Callable[..., RunConfig], whole: Whole, tmp_path: Path
) -> None:
    start(tiny("rtneat", seed=2), tmp_path / "other")
    ours, other = ((path / METRICS).read_text() for path in (whole("rtneat"), tmp_path / "other"))
    assert ours != other


@pytest.mark.parametrize("case", CASES)
def test_a_run_that_is_lengthened_is_the_longer_run(
    case: str, whole: Whole, config_of: ConfigOf, same_run: Same, tmp_path: Path
) -> None:
    start(replace(config_of(case), ticks=130), tmp_path / "run")
    resume(tmp_path / "run", ticks=340)
    resume(tmp_path / "run", ticks=520)
    same_run(whole(case), tmp_path / "run")


@pytest.mark.parametrize("case", ARMS)
def test_a_run_that_is_interrupted_by_ctrl_c_goes_on_exactly(
    case: str,
    whole: Whole,
    config_of: ConfigOf,
    same_run: Same,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pressed: list[int] = []

    def press(_: Progress, tick: int, rows: Sequence[Row]) -> None:
        if tick >= 330 and not pressed:
            pressed.append(tick)
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(Progress, "show", press)
        with pytest.raises(KeyboardInterrupt):
            start(config_of(case), tmp_path / "run")
    assert 330 <= resume_tick(tmp_path / "run") < 400
    resume(tmp_path / "run")
    same_run(whole(case), tmp_path / "run")


def resume_tick(folder: Path) -> int:
    return RunFolder.open(folder).read().tick


@pytest.mark.parametrize("arm", ["neatq", "qlearning"])
def test_a_run_that_dies_before_its_first_batch_goes_on_exactly(
    arm: str,
    whole: Whole,
    config_of: ConfigOf,
    same_run: Same,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def die(*_: object) -> None:
        raise RuntimeError("power cut")

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "record", die)
        with pytest.raises(RuntimeError, match="power cut"):
            start(config_of(arm), tmp_path / "run")
    assert resume_tick(tmp_path / "run") == 0
    resume(tmp_path / "run")
    same_run(whole(arm), tmp_path / "run")


def test_rows_and_half_a_row_written_after_the_checkpoint_are_cut_off(
    whole: Whole, config_of: ConfigOf, same_run: Same, tmp_path: Path
) -> None:
    start(replace(config_of("rtneat"), ticks=400), tmp_path / "run")
    with (tmp_path / "run" / METRICS).open("a") as file:
        file.write("0,500,1.0,2.0\n0,600,3")
    resume(tmp_path / "run", ticks=520)
    same_run(whole("rtneat"), tmp_path / "run")


def test_a_resume_of_a_finished_run_changes_nothing(
    whole: Whole, state_of: StateOf, differences: Differences
) -> None:
    before = state_of(whole("rtneat")), (whole("rtneat") / METRICS).read_text()
    resume(whole("rtneat"))
    assert differences(before[0], state_of(whole("rtneat"))) == []
    assert (whole("rtneat") / METRICS).read_text() == before[1]


def begin(folder: Path, config: RunConfig) -> subprocess.Popen[str]:
    """Resume the run in `folder` in another process, which writes a checkpoint after each batch."""
    start(replace(config, ticks=30, checkpoint_seconds=0.0), folder)
    code = "import sys; from neatq_trainers.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "resume", str(folder), "--ticks", str(config.ticks)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    first, deadline = checkpoint_time(folder), time.monotonic() + 120
    while checkpoint_time(folder) == first and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.005)
    return process


def checkpoint_time(folder: Path) -> int:
    return (folder / CHECKPOINT).stat().st_mtime_ns


@pytest.mark.parametrize(("arm", "seed"), [("neatq", 0), ("qlearning", 1)])
def test_a_run_that_is_killed_at_any_moment_goes_on_exactly(
    arm: str,
    seed: int,
    config_of: ConfigOf,
    state_of: StateOf,
    differences: Differences,
    tmp_path: Path,
) -> None:
    config = replace(config_of(arm), ticks=LONG_TICKS)
    with begin(tmp_path / "run", config) as process:
        time.sleep(np.random.default_rng(seed).uniform(0, 0.3))
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert 30 < resume_tick(tmp_path / "run") < LONG_TICKS
    resume(tmp_path / "run")
    start(config, tmp_path / "whole")
    ours, killed = state_of(tmp_path / "whole"), state_of(tmp_path / "run")
    assert differences(ours, killed) == ["/config/checkpoint_seconds"]
    assert (tmp_path / "whole" / METRICS).read_text() == (tmp_path / "run" / METRICS).read_text()


def test_ctrl_c_in_a_terminal_ends_with_130_and_says_how_to_go_on(
    config_of: ConfigOf,
    state_of: StateOf,
    differences: Differences,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, config = tmp_path / "my run", replace(config_of("neatq"), ticks=LONG_TICKS)
    with begin(folder, config) as process:
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said == f"neatq: stopped; go on with: neatq resume '{folder}'\n"
    assert main(["resume", str(folder)]) == 0
    assert capsys.readouterr().err == ""
    start(config, tmp_path / "whole")
    ours, stopped = state_of(tmp_path / "whole"), state_of(folder)
    assert differences(ours, stopped) == ["/config/checkpoint_seconds"]


def rows_of(folder: Path, arena: int) -> list[str]:
    lines = (folder / METRICS).read_text().splitlines()[1:]
    cells = [line.split(",", 1) for line in lines]
    return [rest for number, rest in cells if number == str(arena)]


@pytest.mark.parametrize("case", CASES)
def test_an_arena_is_the_run_with_its_seed(
    case: str,
    whole: Whole,
    config_of: ConfigOf,
    state_of: StateOf,
    differences: Differences,
    tmp_path: Path,
) -> None:
    start(replace(config_of(case), arenas=2, seed=0), tmp_path / "run")
    assert len(rows_of(whole(case), 0)) == 5
    assert rows_of(tmp_path / "run", 1) == rows_of(whole(case), 0)
    alone, beside = state_of(whole(case))["runs"][0], state_of(tmp_path / "run")["runs"][0]
    for one, two in zip(alone["populations"], beside["populations"][1:], strict=True):
        assert differences({"population": one}, {"population": two}) == []
    if alone["weight"] is not None:
        half = len(alone["weight"])
        assert differences({"weight": alone["weight"]}, {"weight": beside["weight"][half:]}) == []
