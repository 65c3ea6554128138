"""A run whose workers live on a Ray cluster is the run of one process, whatever is lost."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neatq_envs.machines import ThisMachine, open_machines
from neatq_envs.processes import ProcessEnded
from neatq_trainers.callbacks import Callback
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHAMPION, METRICS, load_run
from neatq_trainers.run import Run
from neatq_trainers.train import resume, start

ray = pytest.importorskip("ray")
pytestmark = [
    pytest.mark.usefixtures("without_pictures"),
    pytest.mark.filterwarnings("ignore"),  # of Ray, about itself
]
Tiny = Callable[..., RunConfig]


def same(one: Path, two: Path) -> bool:
    names = METRICS, CHAMPION
    return [(one / name).read_bytes() for name in names] == [
        (two / name).read_bytes() for name in names
    ]


def test_signals_stay_who_ends_a_run(nodes: Any) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with open_machines(nodes.address) as machines:
        assert machines.cores() >= 2
        assert signal.getsignal(signal.SIGTERM) is before


class WhoTrains(Callback):
    """Writes down which process trains."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def batch(self, run: Run, batch: Any, error: Any) -> None:
        (self.folder / str(os.getpid())).touch()


@pytest.fixture(scope="module")
def config(tiny: Tiny) -> RunConfig:
    return tiny("neatq", arenas=3, ticks=320, checkpoint_seconds=0.0)


def test_islands_on_three_nodes_survive_a_process_and_a_node(
    nodes: Any,
    config: RunConfig,
    tmp_path: Path,
    late: Any,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("neatq_trainers.train.STRIDES_AHEAD", 1)
    who = tmp_path / "who"
    who.mkdir()

    def kill_worker() -> None:
        os.kill(int(next(who.iterdir()).name), signal.SIGKILL)

    islands = config.changed({"migration": {"every_ticks": 80}})
    start(islands, tmp_path / "alone")
    callbacks = [WhoTrains(who), late(80, kill_worker), late(200, nodes.kill_one)]
    start(islands, tmp_path / "run", workers=None, cluster=nodes.address, callbacks=callbacks)
    assert str(os.getpid()) not in {one.name for one in who.iterdir()}
    assert same(tmp_path / "alone", tmp_path / "run")
    assert [len(run["populations"]) for run in load_run(tmp_path / "run").read()["runs"]] == [1] * 3
    told = re.findall("the run goes on from tick ([0-9]+)", capsys.readouterr().err)
    assert int(told[0]) < 80 <= int(told[-1])


def test_a_run_goes_on_on_another_cluster_or_without_one(
    nodes: Any, config: RunConfig, tmp_path: Path
) -> None:
    config = replace(config, arenas=2)
    start(config, tmp_path / "alone")
    start(replace(config, ticks=120), tmp_path / "run", workers=2)
    resume(tmp_path / "run", ticks=200, cluster=nodes.address)
    resume(tmp_path / "run", ticks=320)
    assert same(tmp_path / "alone", tmp_path / "run")


def test_environments_on_three_nodes_survive_the_loss_of_one(
    nodes: Any, tiny_walk: Tiny, tmp_path: Path, late: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two sets of them are needed, and the first has taken all cores."""
    config = tiny_walk("rtneat", steps=400, batch_ticks=7, checkpoint_seconds=0.0)
    start(config, tmp_path / "one")
    own = {"workers": 3, "cluster": nodes.address, "callbacks": [late(28, nodes.kill_one)]}
    start(config, tmp_path / "two", **own)
    assert "the run goes on from tick" in capsys.readouterr().err
    assert same(tmp_path / "one", tmp_path / "two")


def test_a_signal_ends_a_run_that_loses_a_worker_meanwhile(
    config: RunConfig, tmp_path: Path, late: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lose(*_: object) -> None:
        raise ProcessEnded("gone")

    def interrupt() -> None:
        signal.raise_signal(signal.SIGINT)
        monkeypatch.setattr("neatq_trainers.workers.Worker.snapshot", lose)

    monkeypatch.setattr(ThisMachine, "elastic", True)
    with pytest.raises(KeyboardInterrupt):
        start(config, tmp_path / "run", workers=1, callbacks=[late(80, interrupt)])


def test_who_is_lost_again_and_again_ends_the_run(
    config: RunConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    losses = []

    def lose(*_: object) -> None:
        losses.append(1)
        raise ProcessEnded("gone")

    monkeypatch.setattr(ThisMachine, "elastic", True)
    monkeypatch.setattr("neatq_trainers.train._train", lose)
    with pytest.raises(ProcessEnded, match="gone"):
        start(config, tmp_path / "run", workers=1)
    assert len(losses) == 3


@pytest.mark.parametrize(
    ("cores", "objects", "share"),
    [
        ([1, 1, 1], 3, 1.0),
        ([4, 2], 3, 1.0),
        ([1, 1], 3, 0.5),  # not 2 / 3: two of them need a core each
        ([3, 1], 5, 0.75),  # four on the first, one on the second
        ([2], 64, 0.0312),
        ([], 2, 1.0),  # whoever is asked for now waits for a machine
        ([1, 1], 0, 0.0),
    ],
)
def test_all_objects_find_room(cores: list[float], objects: int, share: float) -> None:
    from neatq_envs.ray_cluster import fitting_share

    assert fitting_share(cores, objects) == share
