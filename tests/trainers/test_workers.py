"""A run dealt to several processes is the run of one."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

from neatq_envs.machines import Crew, ThisMachine
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.kinds import ConfigError
from neatq_trainers.callbacks import Callback
from neatq_trainers.cli import main
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHAMPION, CONFIG, METRICS, RESULT, load_run
from neatq_trainers.rows import Row
from neatq_trainers.run import Run
from neatq_trainers.train import Session, resume, start
from neatq_trainers.workers import fitting_workers, open_team

pytestmark = pytest.mark.usefixtures("without_pictures")
Tiny = Callable[..., RunConfig]
FILES = (CONFIG, METRICS, CHAMPION, RESULT)


@pytest.fixture(scope="module")
def config(tiny: Tiny) -> RunConfig:
    return tiny("neatq", arenas=3, ticks=320)


@pytest.fixture(scope="module")
def alone(config: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return start(config, tmp_path_factory.mktemp("alone") / "run").path


def same_files(one: Path, two: Path) -> bool:
    contents = (
        [(path / name).read_bytes() for name in FILES if (path / name).is_file()]
        for path in (one, two)
    )
    return next(contents) == next(contents)


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


@pytest.mark.parametrize(
    ("arm", "arenas", "workers", "parts"),
    [
        ("neat", 2, 2, 2),  # arenas are dealt
        ("neat+q", 2, 3, 2),
        ("neat+q", 1, 2, 1),  # environments are dealt
        ("rtneat", 1, 3, 1),
    ],
)
def test_processes_make_no_difference_on_a_gymnasium_task(
    arm: str,
    arenas: int,
    workers: int,
    parts: int,
    tiny_walk: Tiny,
    tmp_path: Path,
    state_of: Callable[[Path], Any],
    differences: Callable[..., list[str]],
) -> None:
    length = {"steps": 800, "batch_ticks": 7} if arm == "rtneat" else {"generations": 3}
    config = tiny_walk(arm, arenas=arenas, **length)
    start(config, tmp_path / "one")
    start(config, tmp_path / "several", workers=workers)
    assert same_files(tmp_path / "one", tmp_path / "several")
    one, several = state_of(tmp_path / "one"), state_of(tmp_path / "several")
    assert len(several["runs"]) == parts
    if parts == 1:
        assert differences(one, several) == []


def test_generations_in_the_arena_end_at_the_same_tick_in_two_processes(
    tiny: Tiny, tmp_path: Path
) -> None:
    config = tiny("neat", arenas=2, ticks=300)
    start(config, tmp_path / "one")
    start(config, tmp_path / "two", workers=2)
    assert same_files(tmp_path / "one", tmp_path / "two")
    assert load_run(tmp_path / "two").read()["done"]["ticks"] == 400


def test_a_run_goes_on_with_another_number_of_processes(tiny_walk: Tiny, tmp_path: Path) -> None:
    config = tiny_walk("rtneat", steps=800, batch_ticks=7)
    start(config, tmp_path / "whole")
    start(replace(config, steps=300), tmp_path / "run")
    resume(tmp_path / "run", steps=800, workers=2)
    assert same_files(tmp_path / "whole", tmp_path / "run")


def test_three_parts_go_on_in_two_processes_and_in_one(config: RunConfig, tmp_path: Path) -> None:
    islands = config.changed({"migration": {"every_ticks": 80}})
    start(islands, tmp_path / "whole")
    start(replace(islands, ticks=120), tmp_path / "run", workers=3)
    born = len(multiprocessing.active_children())
    seen = list[int]()
    for ticks, workers in ((200, 2), (280, 1), (320, None)):
        counting = Counting(seen)
        resume(tmp_path / "run", ticks=ticks, workers=workers, callbacks=[counting])
    assert [one - born for one in seen] == [2, 0, 0]  # by default one here, where one core is
    assert same_files(tmp_path / "whole", tmp_path / "run")


class Counting(Callback):
    """Counts the processes of a run."""

    def __init__(self, seen: list[int]) -> None:
        self.seen = seen

    def start(self, session: Session) -> None:
        self.seen.append(len(multiprocessing.active_children()))


def interrupt_everybody() -> None:
    """What Ctrl-C in a terminal does: every process of the run gets the signal."""
    for child in multiprocessing.active_children():
        assert child.pid is not None
        os.kill(child.pid, signal.SIGINT)
    signal.raise_signal(signal.SIGINT)


def test_a_run_in_two_processes_that_is_interrupted_goes_on_exactly(
    config: RunConfig, alone: Path, tmp_path: Path, late: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr("neatq_trainers.train.STRIDES_AHEAD", 2)
        with pytest.raises(KeyboardInterrupt):
            start(config, folder, workers=2, callbacks=[late(80, interrupt_everybody)])
    assert multiprocessing.active_children() == []
    assert 80 <= load_run(folder).read()["done"]["ticks"] < 320
    resume(folder)
    assert same_files(alone, folder)


def test_environments_in_two_processes_survive_ctrl_c(
    tiny_walk: Tiny, tmp_path: Path, late: Any
) -> None:
    config = tiny_walk("neat", generations=3)
    start(config, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        start(config, tmp_path / "run", workers=2, callbacks=[late(40, interrupt_everybody)])
    assert multiprocessing.active_children() == []
    assert load_run(tmp_path / "run").read()["done"]["generations"] < 3
    resume(tmp_path / "run")
    assert same_files(tmp_path / "whole", tmp_path / "run")


class Watch(Callback):
    """Writes down in which process what happened; of processes only their files tell."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _note(self, what: str) -> None:
        with (self.folder / str(os.getpid())).open("a") as file:
            file.write(what + "\n")

    def start(self, session: Session) -> None:
        self._note("start")

    def batch(self, run: Run, batch: Any, error: torch.Tensor) -> None:
        assert batch.shape == (*run.shape, run.config.ticks_per_batch)
        assert error.shape == run.shape
        self._note("batch")

    def advance(self, run: Run, newborn: torch.Tensor) -> None:
        assert newborn.any()
        self._note("advance")

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        self._note("rows")

    def checkpoint(self, session: Session) -> None:
        self._note("checkpoint")

    def end(self, session: Session) -> None:
        self._note("end")


def test_callbacks_are_called_in_order(tiny_walk: Tiny, tmp_path: Path) -> None:
    """A generation of two episodes of 20 steps is two batches; a checkpoint after each."""
    start(
        tiny_walk("neat", generations=2, checkpoint_seconds=0.0, **{"population.episodes": 2}),
        tmp_path / "run",
        callbacks=[Watch(tmp_path)],
    )
    generation = ["batch", "batch", "advance", "rows", "checkpoint"]
    noted = (tmp_path / str(os.getpid())).read_text().split()
    assert noted == ["start", *generation, *generation, "end"]


def test_with_two_processes_batches_are_seen_where_they_are_made(
    config: RunConfig, alone: Path, tmp_path: Path
) -> None:
    (tmp_path / "notes").mkdir()
    start(config, tmp_path / "run", workers=2, callbacks=[Watch(tmp_path / "notes")])
    noted = {int(file.name): file.read_text().split() for file in (tmp_path / "notes").iterdir()}
    ours = noted.pop(os.getpid())
    assert set(ours) == {"start", "rows", "checkpoint", "end"}
    assert [set(theirs) for theirs in noted.values()] == [{"batch", "advance"}] * 2
    batches = 320 // config.ticks_per_batch
    assert [theirs.count("batch") for theirs in noted.values()] == [batches] * 2
    assert same_files(alone, tmp_path / "run"), "watching changes nothing"


def test_checkpoints_between_do_not_change_the_run(
    config: RunConfig, alone: Path, tmp_path: Path
) -> None:
    start(replace(config, checkpoint_seconds=0.0), tmp_path / "run", workers=2)
    assert (alone / METRICS).read_text() == (tmp_path / "run" / METRICS).read_text()


def test_a_worker_that_dies_leaves_a_checkpoint_and_says_what_to_do(
    config: RunConfig, alone: Path, tmp_path: Path, late: Any
) -> None:
    def kill() -> None:
        for child in multiprocessing.active_children():
            child.kill()

    long = replace(config, ticks=10_000)
    with pytest.raises(RuntimeError, match=r"exit code -9 .*what is on disk is intact"):
        start(long, tmp_path / "run", workers=2, callbacks=[late(0, kill)])
    assert multiprocessing.active_children() == []
    resume(tmp_path / "run", ticks=320)
    assert (alone / METRICS).read_text() == (tmp_path / "run" / METRICS).read_text()


def test_an_error_in_a_worker_is_raised_here_with_its_traceback(config: RunConfig) -> None:
    broken = {"tick": 40}
    with (
        open_team(config.split(2), [None, broken], None, [], Crew(2)) as team,
        pytest.raises(CheckpointError, match="populations") as caught,
    ):
        team.asked("snapshot")
    assert "_populations" in caught.value.__notes__[0]
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize(("cores", "arenas", "workers"), [(2, 20, 2), (16, 20, 5), (8, 1, 1)])
def test_workers_fill_the_cores_with_at_least_four_arenas_each(
    cores: int, arenas: int, workers: int, config: RunConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    assert fitting_workers(replace(config, arenas=arenas), ThisMachine()) == workers


def test_gymnasium_environments_are_dealt_to_all_cores(
    tiny_walk: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert fitting_workers(tiny_walk("neat"), ThisMachine()) == 8


def test_a_run_without_workers_is_refused(
    config: RunConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError, match="workers: expected at least 1, got 0"):
        start(config, tmp_path / "run", workers=0)
    assert main(["train", "--workers", "0", "--out", str(tmp_path / "run")]) == 2
    assert "workers: expected at least 1, got 0" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


SCRIPT = """
import os
os.sched_getaffinity = lambda _: {0, 1}
import neatq_torch as nq
run = nq.train("gym:CartPole-v1", "neat", steps=1, settings={"world.slots": 4})
print(run.metrics()["generation"])
"""


@pytest.fixture
def run_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Run the text of a script as Python does, but in this process."""

    def run(text: str) -> None:
        script = tmp_path / "five.py"
        script.write_text(text)
        main = ModuleType("__main__")
        main.__file__ = str(script)
        monkeypatch.setitem(sys.modules, "__main__", main)
        monkeypatch.setattr(os, "sched_getaffinity", None, raising=False)  # the script sets it
        exec(compile(text, script, "exec"), vars(main))

    monkeypatch.chdir(tmp_path)
    return run


def test_a_script_without_a_guard_trains_in_one_process_and_is_told(
    run_script: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    run_script(SCRIPT)
    out, error = capsys.readouterr()
    assert out == "[1.]\n"
    assert "trains in one process; on 2 cores where five.py has `if __name__" in error


@pytest.mark.parametrize(
    "asked",
    [
        'nq.train("gym:CartPole-v1", "neat", generations=1, workers=2)',
        'nq.compare("gym:CartPole-v1", ["neat"], seeds=1, quick=True)',
    ],
)
def test_a_script_that_no_process_can_import_is_refused_in_a_sentence(
    asked: str, run_script: Callable[[str], None]
) -> None:
    sentence = r"^five\.py: other processes import this script"
    with pytest.raises(RuntimeError, match=sentence) as refused:
        run_script(f"import neatq_torch as nq\n{asked}\n")
    assert refused.value.__context__ is None, "more than one traceback"
    assert multiprocessing.active_children() == []


def test_a_script_with_a_guard_has_its_processes(tmp_path: Path) -> None:
    guarded = SCRIPT.replace("run = nq", 'if __name__ == "__main__":\n    run = nq')
    (tmp_path / "five.py").write_text(guarded.replace("\nprint", "\n    print"))
    command = [sys.executable, "five.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "[1.]\n")
    assert "one process" not in done.stderr
