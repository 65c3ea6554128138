"""A run is a function of its configuration: not of processes, interruptions or company."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neatq_torch.checkpoint import load_checkpoint
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.folder import RESULT, SCALING, GenerationalFolder
from neatq_trainers.generational.train import resume, start
from neatq_trainers.progress import ProgressBar
from neatq_trainers.run_files import CHAMPION, CHECKPOINT, CONFIG, METRICS

ARMS = ("neat", "neatq", "qnetwork", "pretrained", "wires")
Tiny = Callable[..., GenerationalConfig]
Done = Callable[[str], Path]
Differences = Callable[[dict[str, Any], dict[str, Any]], list[str]]


@pytest.fixture(scope="module")
def same_run(differences: Differences) -> Callable[[Path, Path], None]:
    def check(one: Path, two: Path) -> None:
        states = [load_checkpoint(folder / CHECKPOINT) for folder in (one, two)]
        assert differences(*states) == []
        for name in (METRICS, CONFIG, CHAMPION, SCALING, RESULT):
            assert (one / name).read_bytes() == (two / name).read_bytes(), name

    return check


Same = Callable[[Path, Path], None]


@pytest.mark.parametrize("arm", ARMS)
def test_the_same_seed_is_the_same_run(
    arm: str, tiny: Tiny, done: Done, same_run: Same, tmp_path: Path
) -> None:
    start(tiny(arm), tmp_path / "again")
    same_run(done(arm), tmp_path / "again")


@pytest.mark.parametrize("arm", ARMS)
def test_another_seed_is_another_run(arm: str, tiny: Tiny, done: Done, tmp_path: Path) -> None:
    start(tiny(arm, seed=2), tmp_path / "other")
    ours, other = ((path / METRICS).read_text() for path in (done(arm), tmp_path / "other"))
    assert ours != other


@pytest.mark.parametrize("arm", ["neat", "neatq", "pretrained", "wires"])
def test_a_run_is_the_same_in_one_process_and_in_two(
    arm: str, tiny: Tiny, done: Done, same_run: Same, tmp_path: Path
) -> None:
    start(tiny(arm), tmp_path / "two", workers=2)
    same_run(done(arm), tmp_path / "two")


@pytest.mark.parametrize("arm", ARMS)
def test_a_run_that_is_lengthened_is_the_longer_run(
    arm: str, tiny: Tiny, done: Done, same_run: Same, tmp_path: Path
) -> None:
    start(replace(tiny(arm), generations=1), tmp_path / "run")
    resume(tmp_path / "run", generations=3)
    resume(tmp_path / "run", generations=4)
    same_run(done(arm), tmp_path / "run")


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_is_interrupted_by_ctrl_c_goes_on_exactly(
    workers: int,
    tiny: Tiny,
    done: Done,
    same_run: Same,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def press(_: ProgressBar, generation: int, text: str | None = None) -> None:
        if generation == 2:
            for child in multiprocessing.active_children():
                os.kill(child.pid or 0, signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(ProgressBar, "move", press)
        with pytest.raises(KeyboardInterrupt):
            start(tiny(), tmp_path / "run", workers=workers)
    assert multiprocessing.active_children() == []
    assert GenerationalFolder.open(tmp_path / "run").read().generation == 2
    assert not (tmp_path / "run" / RESULT).exists()
    resume(tmp_path / "run")
    same_run(done("neat"), tmp_path / "run")


def test_a_run_that_was_killed_between_two_checkpoints_goes_on_exactly(
    tiny: Tiny, done: Done, same_run: Same, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is written after a checkpoint is there when the power goes, and is cut off."""
    folder = tmp_path / "run"

    def die(self: GenerationalFolder, rows: Sequence[Any]) -> None:
        self.add_rows(rows)
        if rows[0].generation == 2:
            os.rename(folder / CHECKPOINT, folder / "kept")
            raise RuntimeError("power cut")

    with monkeypatch.context() as patch:
        patch.setattr(GenerationalFolder, "record", die)
        with pytest.raises(RuntimeError, match="power cut"):
            start(tiny(checkpoint_seconds=0.0), folder)
    os.rename(folder / "kept", folder / CHECKPOINT)
    with (folder / METRICS).open("a") as file:
        file.write("0,3,7")
    resume(folder)
    assert (folder / METRICS).read_bytes() == (done("neat") / METRICS).read_bytes()
    assert (folder / CHAMPION).read_bytes() == (done("neat") / CHAMPION).read_bytes()


@pytest.mark.parametrize("arm", ARMS)
def test_an_arena_is_the_run_with_its_seed(
    arm: str, tiny: Tiny, done: Done, differences: Differences, tmp_path: Path
) -> None:
    start(tiny(arm, arenas=2, seed=0), tmp_path / "run")
    alone, beside = (load_checkpoint(f / CHECKPOINT) for f in (done(arm), tmp_path / "run"))
    for part in ("populations", "champions", "memories"):
        assert differences({"_": alone[part][:1]}, {"_": beside[part][1:]}) == []
    lines = [line.split(",", 1) for line in (tmp_path / "run" / METRICS).read_text().splitlines()]
    ours = [rest for arena, rest in lines if arena == "1"]
    theirs = [line.split(",", 1)[1] for line in (done(arm) / METRICS).read_text().splitlines()[1:]]
    assert ours == theirs


def test_an_environment_that_carries_something_over_is_renewed(
    tiny: Tiny, same_run: Same, tmp_path: Path
) -> None:
    config = tiny(task="Carrying-v0")
    for workers in (1, 2):
        folder = start(config, tmp_path / str(workers), workers=workers)
        assert folder.read().surroundings.renewed
    same_run(tmp_path / "1", tmp_path / "2")


def test_an_environment_that_does_not_repeat_itself_is_said_to_be_one(
    tiny: Tiny, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = start(tiny(task="Dicing-v0"), tmp_path / "run")
    assert "does not repeat itself with the same seed" in capsys.readouterr().err
    assert not folder.read().surroundings.repeatable


def test_a_walk_repeats_itself(done: Done, capsys: pytest.CaptureFixture[str]) -> None:
    surroundings = GenerationalFolder.open(done("neat")).read().surroundings
    assert surroundings.repeatable
    assert not surroundings.renewed
