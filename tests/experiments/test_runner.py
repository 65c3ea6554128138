"""Experiments: every seed once, whatever interrupts it."""

from __future__ import annotations

import multiprocessing
import os
import time
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from neatq_experiments import command
from neatq_experiments.experiment import (
    FIGURE,
    TABLE,
    Experiment,
    column,
    mean_and_error,
    run_again,
)
from neatq_experiments.seeds import Result, Results, SeedTask, Spread, begun, result_path, tasks
from neatq_torch.kinds import ConfigError
from neatq_trainers.folder import RunFolderError


def squares(task: SeedTask) -> list[Result]:
    factor = 1 if task.quick else 10
    return [{"value": factor * seed**2, "process": os.getpid()} for seed in task.seeds]


def means(results: Results) -> str:
    return "".join(f"{arm} {column(one, 'value').mean():g}\n" for arm, one in results.items())


def fail_at_seed_1(task: SeedTask) -> list[Result]:
    if 1 in task.seeds:
        raise OverflowError("seed 1 does not end well")
    return squares(task)


def beat_long(task: SeedTask) -> list[Result]:
    for beat in range(2000):
        (task.folder / "heart").write_text(str(beat))
        time.sleep(0.05)
    return squares(task)


ONE, TWO = Spread(jobs=1), Spread(jobs=2)
SQUARES = Experiment(
    name="squares",
    summary="squares of seeds",
    arms=("a", "b"),
    seeds=4,
    quick_seeds=2,
    batch=2,
    run=squares,
    table=means,
    figure=lambda _: Figure(),
)


def test_the_table_holds_every_seed_of_every_arm(tmp_path: Path) -> None:
    table = run_again(SQUARES, tmp_path, seeds=4, quick=False, spread=ONE)
    assert table == "a 35\nb 35\n"  # (0 + 10 + 40 + 90) / 4
    assert (tmp_path / "full" / TABLE).read_text() == table
    assert (tmp_path / "full" / FIGURE).is_file()


def test_processes_give_the_same_table_and_do_the_work_elsewhere(tmp_path: Path) -> None:
    spread = replace(SQUARES, figure=None)
    assert run_again(spread, tmp_path, seeds=3, quick=False, spread=TWO) == "a 16.6667\nb 16.6667\n"
    assert f'"process": {os.getpid()}' not in result_path(tmp_path / "full", "a", 0).read_text()


def test_finished_seeds_are_not_run_again(tmp_path: Path) -> None:
    path = result_path(tmp_path / "full", "a", 1)
    path.parent.mkdir(parents=True)
    path.write_text('{"value": 1000}')
    assert run_again(SQUARES, tmp_path, seeds=2, quick=False, spread=ONE) == "a 500\nb 5\n"


def test_seeds_are_dealt_in_batches_and_arms_take_turns(tmp_path: Path) -> None:
    planned = tasks(SQUARES, tmp_path, seeds=3, quick=False)
    assert [(one.arm, one.seeds) for one in planned] == [
        ("a", (0, 1)),
        ("b", (0, 1)),
        ("a", (2,)),
        ("b", (2,)),
    ]


def test_quick_results_are_kept_apart(tmp_path: Path) -> None:
    assert run_again(SQUARES, tmp_path, seeds=2, quick=True, spread=ONE) == "a 0.5\nb 0.5\n"
    assert run_again(SQUARES, tmp_path, seeds=2, quick=False, spread=ONE) == "a 5\nb 5\n"


@pytest.mark.parametrize("jobs", [1, 2])
def test_after_an_error_the_others_are_finished_and_kept(tmp_path: Path, jobs: int) -> None:
    failing = replace(SQUARES, run=fail_at_seed_1, batch=1, arms=("a",))
    with pytest.raises(OverflowError, match="seed 1"):
        run_again(failing, tmp_path, seeds=3, quick=False, spread=Spread(jobs=jobs))
    kept = [result_path(tmp_path / "full", "a", seed).is_file() for seed in range(3)]
    assert kept == [True, False, True]
    assert run_again(SQUARES, tmp_path, seeds=2, quick=False, spread=ONE) == "a 5\nb 5\n"


def test_a_damaged_result_is_named(tmp_path: Path) -> None:
    run_again(SQUARES, tmp_path, seeds=1, quick=False, spread=ONE)
    path = result_path(tmp_path / "full", "b", 0)
    path.write_text("{")
    with pytest.raises(RunFolderError, match=r"seed-0\.json.*delete it"):
        run_again(SQUARES, tmp_path, seeds=1, quick=False, spread=ONE)


def test_the_bar_counts_what_is_done_of_tasks_that_have_no_result_yet(tmp_path: Path) -> None:
    half = replace(SQUARES, share=lambda task: 0.5 if task.arm == "a" else 0.0)
    planned = tasks(half, tmp_path, seeds=3, quick=False)
    assert begun(half, planned) == 1.5  # half of three seeds of a, nothing of b
    assert begun(SQUARES, planned) == 0


def test_mean_and_standard_error_by_hand() -> None:
    assert mean_and_error([1.0, 3.0]) == "2.0 ± 1.0"  # sd sqrt(2), over sqrt(2)
    assert mean_and_error([4755.0], 0) == "4,755"
    assert mean_and_error([]) == "none"


def test_every_experiment_has_a_name_of_its_own_and_fewer_quick_seeds() -> None:
    names = [one.name for one in command.EXPERIMENTS]
    assert len(set(names)) == len(names)
    assert all(1 <= one.quick_seeds <= one.seeds for one in command.EXPERIMENTS)


def test_some_arms_can_be_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "EXPERIMENTS", (SQUARES,))
    asked = {"name": "squares", "seeds": 1, "jobs": 1, "out": tmp_path}
    command.run_experiment(command.ReproduceCommand(**asked, arms=("b",)))
    assert capsys.readouterr().out == "b 0\n"
    with pytest.raises(ConfigError, match="arms: expected some of a, b; got 'c'"):
        command.run_experiment(command.ReproduceCommand(**asked, arms=("c",)))


def test_processes_end_when_who_asked_is_killed(tmp_path: Path) -> None:
    asking = multiprocessing.get_context("spawn").Process(
        target=run_again,
        args=(replace(SQUARES, run=beat_long, figure=None), tmp_path),
        kwargs={"seeds": 1, "quick": False, "spread": ONE},
    )
    asking.start()
    while not (hearts := list(tmp_path.rglob("heart"))):
        assert asking.is_alive()
        time.sleep(0.05)
    asking.kill()
    asking.join()
    beats = [hearts[0].read_text()]
    while len(beats) < 2 or beats[-1] != beats[-2]:
        assert len(beats) < 30, "a process outlived the one that asked for it"
        time.sleep(1)
        beats.append(hearts[0].read_text())
