"""A run dealt to several processes is the run of one."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neatq_trainers.cli import main
from neatq_trainers.config import ConfigError, RunConfig
from neatq_trainers.metrics import Row
from neatq_trainers.progress import Progress
from neatq_trainers.run_folder import CHAMPION, CONFIG, METRICS, RunFolder
from neatq_trainers.train import resume, start
from neatq_trainers.workers import fitting_workers, open_workers

Tiny = Callable[..., RunConfig]
FILES = (CONFIG, METRICS, CHAMPION)


@pytest.fixture(scope="module")
def config(tiny: Tiny) -> RunConfig:
    return tiny("neatq", arenas=3, ticks=320)


@pytest.fixture(scope="module")
def alone(config: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return start(config, tmp_path_factory.mktemp("alone") / "run").path


def same_files(one: Path, two: Path) -> bool:
    return all((one / name).read_bytes() == (two / name).read_bytes() for name in FILES)


def test_a_run_is_the_same_in_one_process_and_in_two(
    config: RunConfig,
    alone: Path,
    tmp_path: Path,
    state_of: Callable[[Path], Any],
    differences: Callable[..., list[str]],
) -> None:
    start(config, tmp_path / "run", workers=2)
    assert same_files(alone, tmp_path / "run")
    whole, parts = state_of(alone), state_of(tmp_path / "run")
    assert [len(run["populations"]) for run in parts["runs"]] == [1, 2]
    populations = [one for run in parts["runs"] for one in run["populations"]]
    expected = {"populations": whole["runs"][0]["populations"], "track": whole["track"]}
    assert differences(expected, {"populations": populations, "track": parts["track"]}) == []


def interrupt_everybody() -> None:
    """What Ctrl-C in a terminal does: every process of the run gets the signal."""
    for child in multiprocessing.active_children():
        assert child.pid is not None
        os.kill(child.pid, signal.SIGINT)
    signal.raise_signal(signal.SIGINT)


def test_a_run_in_two_processes_that_is_interrupted_goes_on_exactly(
    config: RunConfig, alone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def press(_: Progress, tick: int, rows: Sequence[Row]) -> None:
        if tick == 80:
            interrupt_everybody()

    folder = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "show", press)
        patch.setattr("neatq_trainers.train.STRIDES_AHEAD", 2)
        with pytest.raises(KeyboardInterrupt):
            start(config, folder, workers=2)
    assert multiprocessing.active_children() == []
    assert 80 <= RunFolder.open(folder).read().tick < 320
    resume(folder)
    assert same_files(alone, folder)


def test_checkpoints_between_do_not_change_the_run(
    config: RunConfig, alone: Path, tmp_path: Path
) -> None:
    start(replace(config, checkpoint_seconds=0.0), tmp_path / "run", workers=2)
    assert (alone / METRICS).read_text() == (tmp_path / "run" / METRICS).read_text()


def test_a_worker_that_dies_leaves_a_checkpoint_and_says_what_to_do(
    config: RunConfig, alone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kill(_: Progress, tick: int, rows: Sequence[Row]) -> None:
        for child in multiprocessing.active_children():
            child.kill()

    with monkeypatch.context() as patch:
        patch.setattr(Progress, "show", kill)
        with pytest.raises(RuntimeError, match="exit code -9; the last checkpoint is intact"):
            start(replace(config, ticks=10_000), tmp_path / "run", workers=2)
    assert multiprocessing.active_children() == []
    resume(tmp_path / "run", ticks=320)
    assert (alone / METRICS).read_text() == (tmp_path / "run" / METRICS).read_text()


def test_an_error_in_a_worker_is_raised_here_with_its_traceback(config: RunConfig) -> None:
    broken = {"tick": 40}
    with (
        open_workers(config.split(2), [None, broken]) as workers,
        pytest.raises(KeyError, match="populations") as caught,
    ):
        workers[1].snapshot()
    assert "_network_run" in caught.value.__notes__[0]
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize(("cores", "arenas", "workers"), [(2, 20, 2), (16, 20, 5), (8, 1, 1)])
def test_workers_fill_the_cores_with_at_least_four_arenas_each(
    cores: int, arenas: int, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    assert fitting_workers(arenas) == workers


def test_a_run_without_workers_is_refused(
    config: RunConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError, match="workers: expected at least 1, got 0"):
        start(config, tmp_path / "run", workers=0)
    assert main(["train", "--workers", "0", "--out", str(tmp_path / "run")]) == 2
    assert "workers: expected at least 1, got 0" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
