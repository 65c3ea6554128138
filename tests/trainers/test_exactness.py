"""A run is a function of its configuration: not of interruptions, processes or company."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_trainers.build import build
from neatq_trainers.cli import main
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHAMPION, CHECKPOINT, CONFIG, METRICS, RESULT, SCALING, load_run
from neatq_trainers.train import resume, start
from neatq_trainers.worlds import facts_of

pytestmark = pytest.mark.usefixtures("without_pictures")

State = dict[str, Any]
Tiny = Callable[..., RunConfig]
Differences = Callable[[State, State], list[str]]
StateOf = Callable[[Path], State]

WALL: dict[str, tuple[str, dict[str, Any]]] = {
    "rtneat": ("rtneat", {}),
    "neat": ("neat", {}),
    "committed": ("committed", {}),
    "described": ("described", {}),
    "neatq": ("neatq", {"learner.newborn_updates": 20, "learner.warmup": 100}),
    "replay": ("replay", {}),
    "neat+q": ("neat+q", {}),
    "qlearning": ("qlearning", {}),
    "own ticks": ("replay", {"learner.kind": "td"}),
    "wires": ("replay", {"learner.kind": "td", "learner.wires": True, "learner.trace_decay": 0.5}),
    "little memory": (
        "replay",
        {
            "learner.updates": 2,
            "learner.newborn_updates": 3,
            "learner.size": 16,
            "learner.capacity": 300,
        },
    ),
    "target weights": ("replay", {"learner.target_tau": 0.1}),
    "parsimony": ("replay", {"population.parsimony": 0.05}),
    "teachers": ("neatq", {"learner.teacher_mutation": 0.7, "learner.warmup": 50}),
    "generations of replay": ("neat", {"learner.kind": "replay", "network.candidates": 3}),
}
"""Arms and variants of them in the arena."""
WALK: dict[str, tuple[str, dict[str, Any]]] = {
    "neat": ("neat", {}),
    "neat+q": ("neat+q", {}),
    "qnetwork": ("qnetwork", {}),
    "generations of replay": ("neat+q", {"learner.kind": "replay"}),
    "parsimony": ("neat", {"population.parsimony": 0.05}),
    "rtneat": ("rtneat", {}),
    "neatq": ("neatq", {"learner.newborn_updates": 20, "learner.warmup": 100}),
    "replay": ("replay", {}),
    "described": ("described", {}),
}
"""The same on a Gymnasium task."""
CASES = (*(f"wall {name}" for name in WALL), *(f"walk {name}" for name in WALK))
ENDLESS = ("walk rtneat", "walk neatq", "walk described")
"""Where genomes are replaced one at a time on a Gymnasium task: episodes begin at all times."""
BATCH_TICKS = 7
"""Their batches: no episode of the walk, of 20 steps, ends with a stride but by chance."""


@pytest.fixture(scope="module")
def config_of(tiny: Tiny, tiny_walk: Tiny) -> Callable[[str], RunConfig]:
    def make(case: str) -> RunConfig:
        world, _, name = case.partition(" ")
        arm, changes = (WALL if world == "wall" else WALK)[name]
        if case in ENDLESS:
            changes = {"steps": 1600, "batch_ticks": BATCH_TICKS, **changes}
        return (tiny if world == "wall" else tiny_walk)(arm, **changes)

    return make


ConfigOf = Callable[[str], RunConfig]


@pytest.fixture(scope="module")
def whole(config_of: ConfigOf, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
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
        for name in (METRICS, CONFIG, CHAMPION, SCALING, RESULT):
            assert content(one / name) == content(two / name), name

    return check


def content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None


Same = Callable[[Path, Path], None]
Whole = Callable[[str], Path]


def done(folder: Path, unit: str = "ticks") -> int:
    """How long the run in a folder is."""
    return load_run(folder).read()["done"][unit]


def power_cut() -> None:
    raise RuntimeError("power cut")


@pytest.mark.parametrize(
    "case", [one for one in CASES if one not in ("wall qlearning", "walk qnetwork")]
)
def test_the_runs_of_this_file_have_births_and_become_recurrent(
    case: str, whole: Whole, config_of: ConfigOf, state_of: StateOf
) -> None:
    config = config_of(case)
    run = build(config, facts=facts_of(config.world, 0.9))
    run.world.close()
    assert run.network is not None
    assert run.network.state_size == 0
    state = state_of(whole(case))["runs"][0]
    assert state["populations"][0]["births"] > 5
    assert state["policy"]["memory"].shape[-1] > 0


@pytest.mark.parametrize("case", ENDLESS)
def test_where_lives_have_no_end_runs_stop_in_the_middle_of_episodes(
    case: str, whole: Whole, state_of: StateOf
) -> None:
    rows = state_of(whole(case))["runs"][0]["world"]["rows"]
    assert np.unique(rows["step_count"]).size > 2
    assert rows["living"].all()


@pytest.mark.parametrize("case", ["wall neatq", "wall qlearning", "walk neat+q", "walk neatq"])
def test_the_same_seed_is_the_same_run(
    case: str, whole: Whole, config_of: ConfigOf, same_run: Same, tmp_path: Path
) -> None:
    start(config_of(case), tmp_path / "again")
    same_run(whole(case), tmp_path / "again")


@pytest.mark.parametrize("case", ["wall rtneat", "walk neat", "walk qnetwork"])
def test_another_seed_is_another_run(
    case: str, whole: Whole, config_of: ConfigOf, tmp_path: Path
) -> None:
    start(replace(config_of(case), seed=2), tmp_path / "other")
    assert content(whole(case) / METRICS) != content(tmp_path / "other" / METRICS)


def parts_of(config: RunConfig) -> list[dict[str, Any]]:
    """Three lengths, the last of them that of the run."""
    unit, total = config.length
    first = {"ticks": (130, 340), "generations": (1, 3), "steps": (300, 900)}[unit]
    return [{unit: length} for length in (*first, total)]


@pytest.mark.parametrize("case", CASES)
def test_a_run_that_is_lengthened_is_the_longer_run(
    case: str, whole: Whole, config_of: ConfigOf, same_run: Same, tmp_path: Path
) -> None:
    config = config_of(case)
    first, second, third = parts_of(config)
    start(replace(config, **first), tmp_path / "run")
    resume(tmp_path / "run", **second)
    resume(tmp_path / "run", **third)
    same_run(whole(case), tmp_path / "run")


@pytest.mark.parametrize(
    "case", ["wall described", "wall neat+q", "wall qlearning", "walk neat", "walk neatq"]
)
def test_a_run_that_is_interrupted_by_ctrl_c_goes_on_exactly(
    case: str, whole: Whole, config_of: ConfigOf, same_run: Same, tmp_path: Path, late: Any
) -> None:
    press = late(90, lambda: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        start(config_of(case), tmp_path / "run", callbacks=[press])
    assert 90 <= done(tmp_path / "run") < done(whole(case))
    assert not (tmp_path / "run" / RESULT).exists()
    resume(tmp_path / "run")
    same_run(whole(case), tmp_path / "run")


@pytest.mark.parametrize("case", ["wall neatq", "wall qlearning", "walk neat+q", "walk rtneat"])
def test_a_run_that_dies_before_its_first_stride_is_over_goes_on_exactly(
    case: str, whole: Whole, config_of: ConfigOf, same_run: Same, tmp_path: Path, late: Any
) -> None:
    with pytest.raises(RuntimeError, match="power cut"):
        start(config_of(case), tmp_path / "run", callbacks=[late(0, power_cut)])
    assert done(tmp_path / "run") == 0
    resume(tmp_path / "run")
    same_run(whole(case), tmp_path / "run")


@pytest.mark.parametrize(
    ("case", "row"), [("wall rtneat", "0,300,1.0,2.0\n0,400,3"), ("walk neat", "0,3,7")]
)
def test_rows_written_after_the_checkpoint_and_half_a_row_are_cut_off(
    case: str, row: str, whole: Whole, config_of: ConfigOf, tmp_path: Path, late: Any
) -> None:
    folder, often = tmp_path / "run", replace(config_of(case), checkpoint_seconds=0.0)
    with pytest.raises(RuntimeError, match="power cut"):
        start(often, folder, callbacks=[late(200 if "wall" in case else 80, power_cut)])
    before = len((folder / METRICS).read_bytes())
    assert before > load_run(folder).read()["metrics_bytes"]
    with (folder / METRICS).open("a") as file:
        file.write(row)
    resume(folder)
    for name in (METRICS, CHAMPION, RESULT):
        assert content(folder / name) == content(whole(case) / name), name


@pytest.mark.parametrize("case", ["wall rtneat", "walk neat"])
def test_a_resume_of_a_finished_run_changes_nothing(
    case: str, whole: Whole, state_of: StateOf, differences: Differences
) -> None:
    files = (METRICS, CHAMPION, RESULT)
    before = [content(whole(case) / name) for name in files]
    state = state_of(whole(case))
    resume(whole(case))
    assert differences(state, state_of(whole(case))) == []
    assert [content(whole(case) / name) for name in files] == before


LONG = {"ticks": 1200, "steps": 5000}
"""Runs that take seconds, so that a signal meets them on their way."""


def begin(folder: Path, config: RunConfig) -> subprocess.Popen[str]:
    """Resume the run in `folder` in another process, which writes a checkpoint after each batch."""
    unit, total = config.length
    start(replace(config, checkpoint_seconds=0.0, **{unit: total // 80}), folder)
    code = "import sys; from neatq_trainers.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "resume", str(folder), f"--{unit}", str(total)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    first, deadline = checkpoint_time(folder), time.monotonic() + 120
    while checkpoint_time(folder) == first and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.005)
    return process


def checkpoint_time(folder: Path) -> int:
    return (folder / CHECKPOINT).stat().st_mtime_ns


def long_run(config: RunConfig) -> RunConfig:
    unit, _ = config.length
    return replace(config, **{unit: LONG[unit]})


@pytest.mark.parametrize(("case", "seed"), [("wall neatq", 0), ("walk rtneat", 1)])
def test_a_run_that_is_killed_at_any_moment_goes_on_exactly(
    case: str,
    seed: int,
    config_of: ConfigOf,
    state_of: StateOf,
    differences: Differences,
    tmp_path: Path,
) -> None:
    config = long_run(config_of(case))
    unit, total = config.length
    with begin(tmp_path / "run", config) as process:
        time.sleep(np.random.default_rng(seed).uniform(0, 0.3))
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert total // 80 < done(tmp_path / "run", unit) < total
    resume(tmp_path / "run")
    start(config, tmp_path / "whole")
    ours, killed = state_of(tmp_path / "whole"), state_of(tmp_path / "run")
    assert differences(ours, killed) == ["/config/checkpoint_seconds"]
    assert content(tmp_path / "whole" / METRICS) == content(tmp_path / "run" / METRICS)


def test_ctrl_c_in_a_terminal_ends_with_130_and_says_how_to_go_on(
    config_of: ConfigOf,
    state_of: StateOf,
    differences: Differences,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, config = tmp_path / "my run", long_run(config_of("wall rtneat"))
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
    alone, beside = state_of(whole(case))["runs"][0], state_of(tmp_path / "run")["runs"][0]
    ours, theirs = rows_of(whole(case), 0), rows_of(tmp_path / "run", 1)
    assert len(ours) > 2
    # In steps a run lasts until every arena has had them.
    assert theirs[: len(ours)] == ours
    if case in ENDLESS and alone["tick"] != beside["tick"]:
        return
    assert theirs == ours
    for one, two in zip(alone["populations"], beside["populations"][1:], strict=True):
        assert differences({"population": one}, {"population": two}) == []
    champions = (state["metrics"]["champions"] for state in (alone, beside))
    assert differences({"_": next(champions)}, {"_": next(champions)[1:]}) == []
    if alone["weight"] is not None:
        half = len(alone["weight"])
        assert differences({"weight": alone["weight"]}, {"weight": beside["weight"][half:]}) == []


def test_an_environment_that_carries_something_over_is_renewed(
    tiny_walk: Tiny, same_run: Same, tmp_path: Path
) -> None:
    config = tiny_walk(task="Carrying-v0", generations=3)
    assert start(config, tmp_path / "1").read()["facts"]["renewed"]
    start(replace(config, generations=2), tmp_path / "2")
    resume(tmp_path / "2", generations=3)
    same_run(tmp_path / "1", tmp_path / "2")


def test_an_environment_that_does_not_repeat_itself_is_said_to_be_one(
    tiny_walk: Tiny, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = start(tiny_walk(task="Dicing-v0", generations=1), tmp_path / "run")
    assert "does not repeat itself with the same seed" in capsys.readouterr().err
    assert not folder.read()["facts"]["repeatable"]


def test_a_walk_repeats_itself(whole: Whole, state_of: StateOf) -> None:
    facts = state_of(whole("walk neat"))["facts"]
    assert facts["repeatable"]
    assert not facts["renewed"]
