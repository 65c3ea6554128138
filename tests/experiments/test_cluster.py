"""Studies on a Ray cluster: machines come and go, results are those of one machine."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neatq_envs.machines import ClusterError, open_machines
from neatq_envs.processes import ProcessEnded
from neatq_experiments import storage
from neatq_experiments.seeds import (
    Result,
    Runs,
    SeedTask,
    Spread,
    read_results,
    run_missing,
    storage_of,
)
from neatq_experiments.storage import Mirror, mirrored
from neatq_trainers.folder import CHECKPOINT

pytest.importorskip("ray")
pytestmark = pytest.mark.filterwarnings("ignore")  # of Ray, about itself


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody is waited for long who does not answer."""
    from neatq_envs import ray_cluster

    monkeypatch.setattr(ray_cluster, "CONNECT_SECONDS", 2.0)


def squares(task: SeedTask) -> list[Result]:
    return [{"value": seed**2} for seed in task.seeds]


def squares_when_let_go(task: SeedTask) -> list[Result]:
    """Says who has begun the task, and waits until the study has a file `go`."""
    study = task.folder.parents[1]
    with (study / f"begun-{task.arm}-{task.seeds[0]}").open("a") as file:
        file.write(f"{os.getpid()}\n")
    while not (study / "go").exists():
        time.sleep(0.05)
    return squares(task)


def fail_at_seed_1(task: SeedTask) -> list[Result]:
    if 1 in task.seeds:
        raise OverflowError("seed 1 does not end well")
    return squares(task)


def die_at_seed_1(task: SeedTask) -> list[Result]:
    if 1 in task.seeds:
        os.kill(os.getpid(), signal.SIGKILL)
    return squares(task)


def leave_a_file(task: SeedTask) -> list[Result]:
    (task.folder / "lines.csv").write_text("line\n")
    return squares(task)


SQUARES = Runs(name="squares", arms=("a", "b"), run=squares)


def results(runs: Runs, folder: Path, spread: Spread, count: int = 4) -> Any:
    run_missing(runs, folder, seeds=count, quick=False, spread=spread)
    return read_results(runs, folder, count)


def kill_in_the_middle(study: Path, nodes: Any) -> None:
    """Once three tasks have begun, kill a process and a node; then let all others go on."""
    while len(begun := sorted(study.glob("begun-*"))) < 3:
        time.sleep(0.05)
    os.kill(int(begun[0].read_text()), signal.SIGKILL)
    nodes.kill_one()
    (study / "go").touch()


def test_a_study_loses_a_process_and_a_node_and_is_the_same(
    nodes: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "there"
    folder.mkdir()
    killer = threading.Thread(target=kill_in_the_middle, args=(folder, nodes))
    killer.start()
    waiting = replace(SQUARES, run=squares_when_let_go)
    there = results(waiting, folder, Spread(cluster=nodes.address))
    killer.join()
    assert there == results(SQUARES, tmp_path / "here", Spread(jobs=1))
    begun = [len(one.read_text().split()) for one in folder.glob("begun-*")]
    assert len(begun) == 8
    assert 9 <= sum(begun) <= 10  # of the two that were lost one may have been done by the node
    told = capsys.readouterr().err.splitlines()
    assert len([line for line in told if "lost 1 times, done on" in line]) == sum(begun) - 8


def test_a_task_that_loses_its_process_again_and_again_does_not_stop_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deadly = replace(SQUARES, arms=("a",), run=die_at_seed_1)
    with pytest.raises(ProcessEnded, match="SIGKILL"):
        run_missing(deadly, tmp_path, seeds=4, quick=False, spread=Spread(jobs=2))
    assert [one["seed"] for one in read_results(deadly, tmp_path, 4)["a"]] == [0, 2, 3]
    assert "squares: a, seeds 1: lost 3 times, given up" in capsys.readouterr().err


def test_what_is_under_way_is_mirrored_and_gone_on_with_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "MIRROR_SECONDS", 0.01)
    url, there = f"file://{tmp_path}/[my] bucket*", tmp_path / "[my] bucket*/a/work-0/run/lines.csv"
    with pytest.raises(OverflowError), mirrored(tmp_path / "out/a/work-0", url) as folder:
        (folder / "run").mkdir()
        (folder / "run" / there.name).write_text("half")
        while not there.is_file():
            time.sleep(0.01)
        raise OverflowError("the machine is lost")
    assert not folder.exists()
    with mirrored(tmp_path / "out/a/work-0", url) as folder:
        assert (folder / "run" / there.name).read_text() == "half"
    assert not there.exists(), "what is over is removed"
    assert not (tmp_path / "out").exists()


def test_with_a_storage_the_folder_of_a_study_has_results_alone(tmp_path: Path) -> None:
    leaving, out = replace(SQUARES, arms=("a",), run=leave_a_file), tmp_path / "out"
    spread = Spread(jobs=1, storage=str(tmp_path / "bucket"))
    run_missing(leaving, out, seeds=2, quick=False, spread=spread)
    assert sorted(one.name for one in out.rglob("*")) == ["a", "seed-0.json", "seed-1.json"]


def test_checkpoints_are_mirrored_after_what_lies_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As they were before: rows that came meanwhile are cut off when a run goes on."""
    work, order = tmp_path / "work/run", []
    mirror = Mirror(tmp_path / "work", f"file://{tmp_path}/there")
    work.mkdir(parents=True)
    for name in ("a.csv", CHECKPOINT, "z.csv"):
        (work / name).write_text(f"old {name}")
    move = mirror._there.mv

    def noted(one: str, two: str) -> None:
        order.append(Path(two).name)
        (work / CHECKPOINT).write_text("new")
        move(one, two)

    monkeypatch.setattr(mirror._there, "mv", noted)
    mirror.push()
    assert (sorted(order[:2]), order[2]) == (["a.csv", "z.csv"], CHECKPOINT)
    again = Mirror(tmp_path / "again", f"file://{tmp_path}/there")
    again.folder.mkdir()
    again.fetch()
    assert (tmp_path / "again/run" / CHECKPOINT).read_text() == f"old {CHECKPOINT}"
    assert not list((tmp_path / "there").rglob("*.part"))
    order.clear()
    mirror.push()
    assert order == [CHECKPOINT], "nothing else has changed"


def test_a_storage_that_fails_is_tried_again_and_never_costs_what_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "MIRROR_SECONDS", 0.01)
    push, fails = Mirror.push, [RuntimeError("no network"), RuntimeError("no network")]

    def sometimes(mirror: Mirror) -> None:
        if fails:
            raise fails.pop()
        push(mirror)

    monkeypatch.setattr(Mirror, "push", sometimes)
    monkeypatch.setattr(Mirror, "remove", lambda _: 1 / 0)
    there = tmp_path / "bucket/a/work-0/lines.csv"
    with mirrored(tmp_path / "out/a/work-0", str(tmp_path / "bucket")) as folder:
        (folder / there.name).write_text("line")
        while not there.is_file():
            time.sleep(0.01)


def test_a_storage_keeps_experiments_and_quick_ones_apart(tmp_path: Path) -> None:
    task, spread = SeedTask("a", (0,), True, tmp_path / "a/work-0"), Spread(storage="s3://bucket/")
    assert storage_of(SQUARES, task, spread) == "s3://bucket/squares-quick"
    full = task._replace(quick=False)
    assert storage_of(SQUARES, full, replace(spread, storage="b")) == f"{Path.cwd()}/b/squares-full"
    assert storage_of(SQUARES, full, Spread()) is None


class NeedsTwo(Exception):
    """Its arguments are not those of `Exception`, so it cannot be read back."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def fail_strangely(task: SeedTask) -> list[Result]:
    if 1 in task.seeds:
        raise NeedsTwo(1, 2)
    return squares(task)


def test_an_error_that_cannot_be_sent_is_told_and_stops_nobody(tmp_path: Path) -> None:
    strange = replace(SQUARES, arms=("a",), run=fail_strangely)
    with pytest.raises(RuntimeError, match="NeedsTwo: 1 and 2"):
        run_missing(strange, tmp_path, seeds=3, quick=False, spread=Spread(jobs=1))
    assert [one["seed"] for one in read_results(strange, tmp_path, 3)["a"]] == [0, 2]


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("localhost:1", "no Ray answers at localhost:1; ray start --head begins"),
        ("ray://localhost:1", "no Ray answers at localhost:1"),
        ("http://somewhere", "expected auto, local, ray://HOST:10001 or HOST:6379, got http"),
    ],
)
def test_a_wrong_address_is_said_in_a_sentence_at_once(address: str, words: str) -> None:
    with pytest.raises(ClusterError, match=words), open_machines(address):
        pass


def test_without_a_cluster_nothing_of_it_is_imported() -> None:
    """TorchRL imports Ray itself where there is one."""
    code = (
        "import sys, neatq_trainers.train, neatq_experiments.compare.command\n"
        "from neatq_envs.machines import open_machines\n"
        "with open_machines(None): print('neatq_envs.ray_cluster' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_who_listens_and_is_not_ray_is_not_waited_for() -> None:
    with socket.create_server(("localhost", 0)) as server:
        address = f"localhost:{server.getsockname()[1]}"
        with (
            pytest.raises(ClusterError, match=f"no Ray answers at {address}"),
            open_machines(address),
        ):
            pass


def test_a_cluster_that_is_gone_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray/ray_current_cluster").write_text("localhost:1")
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with pytest.raises(ClusterError, match="no Ray answers at localhost:1"), open_machines("auto"):
        pass


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "neatq_envs.ray_cluster", raising=False)
    with (
        pytest.raises(ClusterError, match=r'pip install "neatq_torch\[ray\]"'),
        open_machines("auto"),
    ):
        pass
