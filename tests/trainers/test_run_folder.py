"""What a run leaves behind, and what is refused when it goes on."""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from neatq_torch.checkpoint import CheckpointError, load_checkpoint
from neatq_torch.genome import load_genome
from neatq_trainers.config import RunConfig
from neatq_trainers.metrics import Row
from neatq_trainers.report import read_metrics, write_report
from neatq_trainers.run_folder import (
    ANIMATION,
    ARENA,
    CHAMPION,
    CHECKPOINT,
    CONFIG,
    CURVES,
    METRICS,
    RunFolder,
    RunFolderError,
)
from neatq_trainers.train import resume, start, train
from neatq_trainers.workers import open_workers

Tiny = Callable[..., RunConfig]


@pytest.fixture(scope="module")
def config(tiny: Tiny) -> RunConfig:
    return tiny("neatq", ticks=300, arenas=2, logger="csv")


@pytest.fixture(scope="module")
def done(config: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("done") / "run"
    write_report(start(config, folder))
    return folder


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(done, tmp_path / "run"))


def test_the_folder_holds_the_results_and_no_temporary_file(done: Path) -> None:
    wanted = {CONFIG, METRICS, CHECKPOINT, CHAMPION, CURVES, ARENA, ANIMATION, "logs"}
    assert set(os.listdir(done)) == wanted


def test_the_files_can_be_read_by_those_who_can_read_other_new_files(
    done: Path, tmp_path: Path
) -> None:
    (tmp_path / "new").touch()
    usual = (tmp_path / "new").stat().st_mode
    modes = {path.name: path.stat().st_mode for path in done.iterdir() if path.is_file()}
    assert modes == dict.fromkeys(modes, usual)


def test_the_configuration_comes_back(done: Path, config: RunConfig) -> None:
    assert RunConfig.from_dict(json.loads((done / CONFIG).read_text())) == config


def test_the_metrics_have_a_row_for_each_arena_and_100_ticks(done: Path) -> None:
    with (done / METRICS).open(newline="") as file:
        header, *rows = csv.reader(file)
    assert tuple(header) == Row._fields
    wanted = [(arena, tick) for tick in (100, 200, 300) for arena in (0, 1)]
    assert [(int(row[0]), int(row[1])) for row in rows] == wanted
    columns = read_metrics(done)
    assert (columns["min_distance"] <= columns["mean_distance"]).all()
    assert (columns["mean_distance"] <= columns["max_distance"]).all()
    # Nobody is eligible before the end of the first life.
    assert np.isnan(columns["champion_distance"]).tolist() == [True] * 2 + [False] * 4


def test_the_pictures_can_be_opened(done: Path) -> None:
    for name in (CURVES, ARENA):
        with Image.open(done / name) as picture:
            assert picture.format == "PNG"
            assert min(picture.size) >= 300
    with Image.open(done / ANIMATION) as picture:
        assert picture.format == "GIF"
        assert picture.n_frames == 200 // 8  # type: ignore[attr-defined]


def test_the_champion_is_the_fittest_robot_with_the_weights_it_learnt(done: Path) -> None:
    run = RunFolder.open(done).read()
    champion = run.populations[0].champion
    assert champion is not None
    assert run.network is not None
    saved, learnt = load_genome(done / CHAMPION), run.network.genome(champion)
    assert saved.to_dict() == learnt.to_dict()


def test_the_csv_logger_writes_the_means_over_arenas(done: Path) -> None:
    (path,) = (done / "logs").rglob("mean_distance.csv")
    logged = [line.split(",") for line in path.read_text().splitlines()]
    columns = read_metrics(done)
    means = columns["mean_distance"].reshape(3, 2).mean(1)
    assert [int(float(tick)) for tick, _ in logged] == [100, 200, 300]
    assert np.allclose([float(value) for _, value in logged], means, rtol=1e-4)


def test_the_tensorboard_logger_writes_events(tiny: Tiny, tmp_path: Path) -> None:
    start(tiny("rtneat", ticks=100, logger="tensorboard"), tmp_path / "run")
    (events,) = (tmp_path / "run" / "logs").rglob("events.out.tfevents.*")
    assert b"train/mean_distance" in events.read_bytes()


def test_a_run_shorter_than_a_row_still_has_a_report(tiny: Tiny, tmp_path: Path) -> None:
    write_report(start(tiny("qlearning", ticks=1), tmp_path / "run"))
    wanted = {CONFIG, METRICS, CHECKPOINT, ARENA, ANIMATION}
    assert set(os.listdir(tmp_path / "run")) == wanted


def test_the_track_is_the_latest_life(done: Path) -> None:
    state = load_checkpoint(done / CHECKPOINT)
    assert state["track"].shape == (9, 200, 3)
    assert state["track"].dtype == np.float32
    # Poses are seen at the beginning of a tick: one tick of at most 1 unit before the world's.
    # The newborn stands at the spawn already.
    moved = state["track"][:, -1, :2] - state["runs"][0]["world"]["place"][0, :, :2]
    assert (np.hypot(*moved.T) < 1.01).sum() == 9 - 1


def test_a_folder_with_something_in_it_is_refused_and_left_alone(
    tiny: Tiny, tmp_path: Path
) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(RunFolderError, match=r"not empty; choose another --out$"):
        RunFolder.create(tmp_path, tiny("rtneat"))
    assert os.listdir(tmp_path) == ["thesis.tex"]
    with pytest.raises(RunFolderError, match="not empty"):
        RunFolder.create(tmp_path / "thesis.tex", tiny("rtneat"))


def test_a_folder_with_a_run_is_refused_and_resume_is_offered(done: Path, tiny: Tiny) -> None:
    with pytest.raises(RunFolderError, match="neatq resume"):
        RunFolder.create(done, tiny("rtneat"))


def test_a_run_that_failed_before_its_first_checkpoint_can_be_begun_again(
    tiny: Tiny, tmp_path: Path
) -> None:
    RunFolder.create(tmp_path / "run", tiny("rtneat"))
    RunFolder.create(tmp_path / "run", tiny("rtneat", seed=5))
    assert json.loads((tmp_path / "run" / CONFIG).read_text())["seed"] == 5
    with (tmp_path / "run" / METRICS).open("a") as file:
        file.write("0,100,1.0\n")
    with pytest.raises(RunFolderError, match="not empty"):
        RunFolder.create(tmp_path / "run", tiny("rtneat"))


def rewrite(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


@pytest.mark.parametrize(
    "change",
    [
        lambda values: values.update(seed=3),
        lambda values: values["scenario"].update(max_speed=0.5),
        lambda values: values["learning"].pop("discount"),
        lambda values: values["learning"].update(discount=7),
        lambda values: values.update(ticks="many"),
        lambda values: values.update(scenario=[]),
    ],
)
def test_an_altered_configuration_is_refused(
    copy: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    before = (copy / METRICS).read_bytes(), (copy / CHECKPOINT).read_bytes()
    rewrite(copy / CONFIG, change)
    with pytest.raises(CheckpointError, match=r"config\.json"):
        resume(copy)
    assert ((copy / METRICS).read_bytes(), (copy / CHECKPOINT).read_bytes()) == before


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b"null"])
def test_a_broken_configuration_is_refused(copy: Path, content: bytes) -> None:
    (copy / CONFIG).write_bytes(content)
    with pytest.raises(CheckpointError, match=r"config\.json: altered or damaged"):
        resume(copy)


def test_altered_metrics_are_refused(copy: Path) -> None:
    good = (copy / METRICS).read_bytes()
    for content in (good[:-1], b"", good.replace(b"100", b"999", 1), b"x" * len(good)):
        (copy / METRICS).write_bytes(content)
        with pytest.raises(CheckpointError, match=r"metrics\.csv: altered"):
            resume(copy)
        assert (copy / METRICS).read_bytes() == content
    (copy / METRICS).unlink()
    with pytest.raises(CheckpointError, match=r"metrics\.csv: altered"):
        resume(copy)


def test_metrics_with_other_columns_are_refused_and_left_alone(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (copy / METRICS).read_bytes()
    monkeypatch.setattr(RunFolder, "header", "arena,tick,something_new\n")
    with pytest.raises(CheckpointError, match="not of this version of neatq"):
        resume(copy)
    assert (copy / METRICS).read_bytes() == before


@pytest.mark.parametrize("name", [CONFIG, CHECKPOINT])
def test_a_missing_file_is_named(copy: Path, name: str) -> None:
    (copy / name).unlink()
    with pytest.raises((CheckpointError, RunFolderError), match=name.replace(".", r"\.")):
        resume(copy)


def test_a_run_cannot_be_made_shorter_than_it_is(copy: Path) -> None:
    before = (copy / CONFIG).read_bytes()
    tick = RunFolder.open(copy).read().tick
    with pytest.raises(RunFolderError, match=f"has {tick} already, got 100"):
        resume(copy, ticks=100)
    assert (copy / CONFIG).read_bytes() == before


def test_a_full_disk_during_training_leaves_a_run_that_goes_on_exactly(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    again = Path(shutil.copytree(copy, tmp_path / "again"))
    resume(copy, ticks=500)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = RunFolder.open(again)
    config, states = folder.load(ticks=500)
    tick = states[0]["tick"]
    with monkeypatch.context() as patch, open_workers([config], states) as workers:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left") as caught:
            train(config, tick, workers, folder)
    assert caught.value.filename == str(again / CHECKPOINT)
    assert RunFolder.open(again).read().tick == tick
    resume(again)
    assert (again / METRICS).read_bytes() == (copy / METRICS).read_bytes()
