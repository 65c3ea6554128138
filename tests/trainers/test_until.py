"""Runs that end when their task is solved."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neatq_experiments.compare.cells import digest
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import METRICS, RunFolder, load_run
from neatq_trainers.train import resume, start, train

Tiny = Callable[..., RunConfig]
Say = Callable[..., tuple[int, str, str]]
pytestmark = pytest.mark.usefixtures("without_pictures")
GENERATIONS = 6


@pytest.fixture(scope="module")
def whole(tiny_walk: Tiny, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Two arenas that nothing ends early; evaluated after generations 1, 2, 4 and 6."""
    config = tiny_walk("neat", arenas=2, generations=GENERATIONS)
    return start(config, tmp_path_factory.mktemp("whole") / "run")


@pytest.fixture(scope="module")
def goal(whole: RunFolder) -> float:
    """A return between those of the best champions of the first and the fourth generation."""
    rows = whole.metrics()
    first, later = (rows["champion_return"][rows["generation"] == n].max() for n in (1, 4))
    assert first < later
    return float(first + later) / 2


@pytest.fixture(scope="module")
def solved(tiny_walk: Tiny, goal: float, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """The same run until that return; do not write into it."""
    config = tiny_walk("neat", arenas=2, generations=GENERATIONS, until=goal)
    return start(config, tmp_path_factory.mktemp("solved") / "run")


def test_a_run_ends_when_the_first_champion_reaches_the_return(
    whole: RunFolder, solved: RunFolder, goal: float
) -> None:
    rows = solved.metrics()
    reached = rows["champion_return"] >= goal
    assert reached.any()
    assert rows["generation"][reached].min() == rows["generation"].max() < GENERATIONS
    text = (solved.path / METRICS).read_text()
    assert (whole.path / METRICS).read_text().startswith(text)
    result = solved.result()
    assert result is not None
    best = result["champion"]
    assert best["evaluated_return"] == max(one["evaluated_return"] for one in result["arenas"])
    assert best["evaluated_return"] >= result["until"] == goal
    crowned = (rows["arena"] == best["arena"]) & (rows["generation"] == best["generation"])
    assert [result["solved_after_steps"]] == rows["steps"][crowned].tolist()
    assert solved.notes[0].startswith(f"solved after {result['solved_after_steps']} steps: the ")
    assert best["episodes"] == 5  # the test on new episodes is made all the same
    assert "solved_after_steps" not in (whole.result() or {})


@pytest.mark.parametrize("workers", [2, 3])
def test_it_ends_there_with_any_number_of_workers(
    solved: RunFolder, tmp_path: Path, workers: int
) -> None:
    run = start(solved.config, tmp_path / "run", workers=workers)
    assert (run.path / METRICS).read_text() == (solved.path / METRICS).read_text()
    assert run.result() == solved.result()


def copy_of(run: RunFolder, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run.path, tmp_path / "copy"))


def test_a_solved_run_is_finished_and_says_so(solved: RunFolder, tmp_path: Path) -> None:
    ends: list[dict[str, Any]] = [{}, {"until": solved.config.until}]
    for end in ends:
        run = resume(copy_of(solved, tmp_path / str(len(end))), workers=1, **end)
        assert run.notes == solved.notes
        assert run.is_finished(**end)
        assert (run.path / METRICS).read_text() == (solved.path / METRICS).read_text()


@pytest.mark.parametrize("end", [{"until": 1e9}, {"generations": GENERATIONS}], ids=str)
def test_a_solved_run_goes_on_to_another_end_as_if_it_had_not_stopped(
    whole: RunFolder, solved: RunFolder, tmp_path: Path, end: dict[str, Any]
) -> None:
    folder = copy_of(solved, tmp_path)
    assert not load_run(folder).is_finished(**end)
    run = resume(folder, workers=1, **end)
    assert (run.path / METRICS).read_text() == (whole.path / METRICS).read_text()
    assert run.config.until == end.get("until")
    assert run.result() == whole.result()
    assert not run.solved()


def test_a_return_that_is_not_reached_counts_on_with_another_length(
    tiny_walk: Tiny, solved: RunFolder, goal: float, tmp_path: Path
) -> None:
    config = tiny_walk("neat", arenas=2, generations=1, until=goal)
    begun = start(config, tmp_path / "run")
    assert not begun.solved()
    run = resume(begun.path, generations=GENERATIONS, workers=1)
    assert (run.path / METRICS).read_text() == (solved.path / METRICS).read_text()


def test_a_return_that_was_reached_long_ago_ends_a_run_at_once(
    whole: RunFolder, tmp_path: Path
) -> None:
    run = resume(copy_of(whole, tmp_path), until=-1e9, generations=50, workers=1)
    assert run.metrics()["generation"].max() == GENERATIONS
    assert run.solved()


def test_the_command_says_when_a_run_was_solved(neatq: Say, toy: str) -> None:
    task = ["--task", f"{toy}Walk-v0", "--arm", "neat", "--world.slots", "6", "--workers", "1"]
    status, out, _ = neatq("train", *task, "--steps", "9000", "--until=-1e9", "--out", "run")
    assert status == 0
    line = r"after \d+ steps: the champion of arena 0 was evaluated to \S+, wanted -1e\+09"
    assert re.search(f"neatq: solved {line}\n", out)
    assert re.search(f"^solved: {line}$", neatq("info", "run")[1], re.MULTILINE)
    assert re.search(f"neatq: solved {line}\n", neatq("resume", "run", "--workers", "1")[1])
    (Path("run") / "result.json").write_text('{"solved_after_steps": 3}')
    assert "solved" not in neatq("info", "run")[1]


def test_where_nobody_is_evaluated_there_is_nothing_to_reach(
    neatq: Say, tiny: Tiny, tmp_path: Path
) -> None:
    with pytest.raises(
        ConfigError, match="until: nobody is evaluated on held-out episodes on wall"
    ):
        train("wall", until=3.0)
    status, _, error = neatq("train", "--task", "wall", "--until", "3")
    assert status == 2
    assert error.startswith("neatq: error: until: nobody is evaluated")
    run = start(tiny("rtneat", ticks=40), tmp_path / "run")
    with pytest.raises(ConfigError, match="until: nobody is evaluated"):
        resume(run.path, until=3.0)
    with pytest.raises(ConfigError, match="until: expected "):
        train("gym:CartPole-v1", "neat", until=float("nan"))


def test_the_return_that_ends_a_run_is_not_in_its_digest() -> None:
    config = preset("gym:CartPole-v1", "neat")
    assert digest(config.changed({"until": 475.0})) == digest(config)
