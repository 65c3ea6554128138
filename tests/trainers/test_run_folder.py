"""What a run leaves behind, and what is refused when it goes on."""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from neatq_torch.checkpoint import CheckpointError
from neatq_torch.genome import load_genome
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import (
    CHAMPION,
    CHECKPOINT,
    CONFIG,
    CURVES,
    METRICS,
    PATHS,
    PICTURE,
    TEAM,
    RunFolder,
    RunFolderError,
    load_run,
)
from neatq_trainers.report import write_report
from neatq_trainers.rows import DistanceRow, Row
from neatq_trainers.train import Session, resume, start

pytestmark = pytest.mark.usefixtures("without_pictures")
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


def test_a_run_is_shown_with_its_folder_arm_and_task(done: Path) -> None:
    assert repr(load_run(done)) == f"RunFolder({str(done)!r}, neatq on wall)"


def test_the_folder_holds_the_results_and_no_temporary_file(done: Path) -> None:
    wanted = {CONFIG, METRICS, CHECKPOINT, CHAMPION, CURVES, PATHS, TEAM, PICTURE, "logs"}
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
    assert tuple(header) == DistanceRow._fields
    wanted = [(arena, tick) for tick in (100, 200, 300) for arena in (0, 1)]
    assert [(int(row[0]), int(row[1])) for row in rows] == wanted
    columns = load_run(done).metrics()
    assert (columns["min_distance"] <= columns["mean_distance"]).all()
    assert (columns["mean_distance"] <= columns["max_distance"]).all()
    # Nobody is eligible before the end of the first life.
    assert np.isnan(columns["champion_distance"]).tolist() == [True] * 2 + [False] * 4


def test_the_pictures_can_be_opened(done: Path) -> None:
    for name in (CURVES, PATHS):
        with Image.open(done / name) as picture:
            assert picture.format == "PNG"
            assert min(picture.size) >= 300
    with Image.open(done / TEAM) as picture:
        assert picture.format == "GIF"
        assert picture.n_frames == 200 // 8  # type: ignore[attr-defined]


def test_the_champion_is_the_fittest_robot_with_the_weights_it_learnt(done: Path) -> None:
    folder = load_run(done)
    run = build(folder.config, folder.read()["runs"][0])
    champion = run.populations[0].champion
    assert champion is not None
    assert run.network is not None
    learnt = run.network.genome(champion)
    assert load_genome(done / CHAMPION).to_dict() == learnt.to_dict()
    assert load_run(done).champion().to_json() == learnt.to_json()


def test_the_csv_logger_writes_the_means_over_arenas(done: Path) -> None:
    (path,) = (done / "logs").rglob("mean_distance.csv")
    logged = [line.split(",") for line in path.read_text().splitlines()]
    columns = load_run(done).metrics()
    means = columns["mean_distance"].reshape(3, 2).mean(1)
    assert [int(float(tick)) for tick, _ in logged] == [100, 200, 300]
    assert np.allclose([float(value) for _, value in logged], means, rtol=1e-4)


def test_the_tensorboard_logger_writes_events(tiny: Tiny, tmp_path: Path) -> None:
    start(tiny("rtneat", ticks=100, logger="tensorboard"), tmp_path / "run")
    (events,) = (tmp_path / "run" / "logs").rglob("events.out.tfevents.*")
    assert b"train/mean_distance" in events.read_bytes()


def test_a_run_shorter_than_a_row_still_has_a_report(tiny: Tiny, tmp_path: Path) -> None:
    write_report(start(tiny("qlearning", ticks=1), tmp_path / "run"))
    wanted = {CONFIG, METRICS, CHECKPOINT, PATHS, TEAM}
    assert set(os.listdir(tmp_path / "run")) == wanted


def test_the_track_is_the_latest_life(done: Path) -> None:
    state = load_run(done).read()
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
        lambda values: values["world"]["scenario"].update(max_speed=0.5),
        lambda values: values["learner"].pop("discount"),
        lambda values: values["learner"].update(discount=7),
        lambda values: values.update(ticks="many"),
        lambda values: values["world"].update(scenario=[]),
        lambda values: values["population"].update(kind="neat"),
        lambda values: values.update(colour="red"),
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
    monkeypatch.setattr("neatq_trainers.folder.header", lambda _: "arena,tick,something_new\n")
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
    tick = load_run(copy).read()["done"]["ticks"]
    with pytest.raises(RunFolderError, match=f"has {tick} already, got 100"):
        resume(copy, ticks=100)
    assert (copy / CONFIG).read_bytes() == before


def test_a_full_disk_during_training_leaves_a_run_that_goes_on_exactly(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    again = Path(shutil.copytree(copy, tmp_path / "again"))
    resume(copy, ticks=500)
    tick = load_run(again).read()["done"]["ticks"]

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    class Fill(Callback):
        def rows(self, session: Session, rows: Sequence[Row]) -> None:
            patch.setattr(os, "fsync", full)

    with (
        monkeypatch.context() as patch,
        pytest.raises(OSError, match="No space left") as caught,
    ):
        resume(again, ticks=500, callbacks=[Fill()])
    assert caught.value.filename == str(again / CHECKPOINT)
    assert load_run(again).read()["done"]["ticks"] == tick
    resume(again)
    assert (again / METRICS).read_bytes() == (copy / METRICS).read_bytes()


class Stop(Callback):
    """Stops a run at a tick, and remembers what was called."""

    def __init__(self, ticks: int) -> None:
        self.ticks = ticks
        self.called: list[str] = []

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        session.stop |= session.lengths["ticks"] >= self.ticks

    def checkpoint(self, session: Session) -> None:
        self.called.append("checkpoint")

    def end(self, session: Session) -> None:
        self.called.append("end")


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_a_callback_stops_ends_in_order_and_can_go_on(
    workers: int, tiny: Tiny, tmp_path: Path
) -> None:
    config, stop = tiny("rtneat", ticks=400, arenas=2), Stop(80)
    folder = start(config, tmp_path / "run", workers=workers, callbacks=[stop])
    assert stop.called == ["checkpoint", "end"]
    assert 80 <= folder.read()["done"]["ticks"] < 400 + 40 * (workers > 1)
    resume(tmp_path / "run")
    start(config, tmp_path / "whole")
    ours, whole = ((tmp_path / name / METRICS).read_bytes() for name in ("run", "whole"))
    assert ours == whole


def test_the_champion_of_a_run_that_a_callback_stops_is_tested(
    tiny_walk: Tiny, tmp_path: Path
) -> None:
    folder = start(tiny_walk("neat"), tmp_path / "run", callbacks=[Stop(1)])
    result = folder.result()
    assert result is not None
    assert result["generations"] == 1
    assert result["champion"]["episodes"] == 5


@pytest.mark.parametrize(
    ("seconds", "checkpoints"), [(0.0, [40, 80, 120, 160, 200]), (25.0, [160, 200]), (1e9, [200])]
)
def test_a_checkpoint_is_written_when_its_seconds_are_over_and_at_the_end(
    seconds: float,
    checkpoints: list[int],
    tiny: Tiny,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A stride of 40 ticks takes 10 seconds of the clock of this test."""
    saved: list[int] = []

    class Note(Callback):
        def rows(self, session: Session, rows: Sequence[Row]) -> None:
            clock[0] += 10

        def checkpoint(self, session: Session) -> None:
            saved.append(session.lengths["ticks"])

    clock = [0.0]
    monkeypatch.setattr(
        "neatq_trainers.callbacks.time", SimpleNamespace(monotonic=lambda: clock[0])
    )
    config = replace(tiny("qlearning", ticks=200), checkpoint_seconds=seconds)
    start(config, tmp_path / "run", callbacks=[Note()])
    assert saved == checkpoints


def test_a_champion_is_remembered_between_generations_in_the_arena(
    tiny: Tiny, tmp_path: Path
) -> None:
    """A generation of one life of 200 ticks is over at the end: nobody is judged yet."""
    folder = start(tiny("neat", ticks=200), tmp_path / "run")
    state = folder.read()
    run = build(folder.config, state["runs"][0])
    assert run.populations[0].champion is None
    remembered = run.metrics.champions[0]
    assert remembered is not None
    assert remembered.generation == 1
    assert folder.champion().to_json() == remembered.genome.to_json()
    assert remembered.genome.genome_id <= 9, "one of the founders"
    (_, cell) = folder.metrics()["champion_distance"]
    assert not np.isnan(cell), "the row of tick 200 is made before the next generation"
