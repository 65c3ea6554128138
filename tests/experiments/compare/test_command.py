"""The command: what it writes, what it refuses, what it does not do twice."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from neatq_experiments import seeds
from neatq_experiments.compare import cells, command
from neatq_experiments.compare.tables import Study, read_tables, write_tables
from neatq_trainers.cli import main

Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def compare(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Say:
    """Run `neatq compare` in an empty folder; returns status, standard output and error."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        status = main(["compare", *arguments])
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


def no_pool(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run tasks in this process; returns the list to which each adds its arm."""
    ran: list[str] = []

    def run(runs: seeds.Runs, planned: list[seeds.SeedTask], _: object) -> None:
        for task in planned:
            ran.append(task.arm.split("-")[1])
            task.folder.mkdir(parents=True, exist_ok=True)
            seeds._keep(task, runs.run(task))

    monkeypatch.setattr(seeds, "_run", run)
    return ran


def test_it_lists_arms_variants_and_tasks(compare: Say) -> None:
    status, out, _ = compare("--list")
    assert status == 0
    for wanted in ("rtneat", "qlearning", "replay-frozen", "step-1-progress", "wall, "):
        assert wanted in out.replace("wall\n", "wall, ").replace("or a file", "wall, ")


def test_a_comparison_from_processes_to_report_and_never_twice(
    compare: Say, tiny_cells: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ("--quick", "--tasks", "flag", "--arms", "qlearning", "--seeds", "2")
    status, out, error = compare(*asked, "--jobs", "2", "--out", "processes")
    assert (status, error) == (0, "")
    assert out == "neatq: processes: report.md, flag.png\n"
    ran = no_pool(monkeypatch)
    compare(*asked, "--out", "here")
    assert ran == ["qlearning"]
    tables = [Path(folder, "results.csv").read_bytes() for folder in ("here", "processes")]
    assert tables[0] == tables[1]
    ran.clear()
    compare(*asked, "--out", "processes")
    assert ran == []
    status, _, _ = compare(*asked[:-3], "qlearning", "rtneat", "--seeds", "2", "--out", "here")
    assert (status, ran) == (0, ["rtneat"])
    assert (tmp_path / "here" / "newborn.png").is_file()
    assert "| rtneat | 2 |" in Path("here/report.md").read_text()


def test_all_is_made_again_from_tables_without_a_run(
    compare: Say, study_of: Callable[..., Study], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "run_missing", None)
    study = study_of(rtneat=[[140, 100], [140, 90]], mine=[[140, 80], [140, 70]])
    write_tables(study, Path("saved"), compress=True)
    status, out, error = compare("--results", "saved")
    assert (status, error) == (0, "")
    warning, written = out.splitlines()
    assert warning == "neatq: saved: rtneat on flag has another configuration in this version"
    assert written == "neatq: saved: report.md, flag.png, differences.png"
    compare("--results", "saved", "--arms", "mine", "--out", "copy")
    assert read_tables(Path("copy")).arms() == ["mine"]
    assert Path("copy/results.csv.gz").is_file()
    assert "rtneat |" not in Path("copy/report.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["--arms", "nope"], "arms: expected some of rtneat, .*ladder.* got 'nope'"),
        (["--tasks", "nope"], "task: expected flag, .* got 'nope'"),
        (["--tasks", "nope.json"], "nope.json: cannot be read"),
        (["--seeds", "0"], "seeds: expected at least 1, got 0"),
        (["--jobs", "-1"], "jobs: expected at least 1, got -1"),
        (["--results", "x", "--seeds", "3"], "seeds: nothing is run with --results"),
        (["--results", "x", "--quick"], "quick: nothing is run with --results"),
        (["--results", "x"], r"x: expected results\.csv or results\.csv\.gz"),
    ],
)
def test_bad_input_is_answered_in_one_line(
    compare: Say, arguments: list[str], pattern: str, tmp_path: Path
) -> None:
    status, out, error = compare(*arguments)
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: .*{pattern}.*\n", error), error
    assert not list(tmp_path.iterdir())


def test_ctrl_c_says_that_nothing_is_lost(compare: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_missing", interrupt)
    status, _, error = compare("--quick")
    assert status == 130
    assert error == "neatq: stopped; what is finished is kept: the same command goes on\n"


def test_by_default_it_runs_the_five_arms_on_the_papers_tasks(
    compare: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, set[str]]] = []

    def run_missing(runs: cells.Runs, *_: object, seeds: int, **__: object) -> None:
        asked.append((seeds, {name.rsplit("-", 3)[0] for name in runs.arms}))
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_missing", run_missing)
    compare()
    arms = ("rtneat", "committed", "described", "neatq", "qlearning")
    grid = {f"{task}-{arm}" for task in ("flag", "moving", "wall") for arm in arms}
    assert asked == [(20, grid)]
