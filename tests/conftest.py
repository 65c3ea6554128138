"""Every test runs on one thread and one core, without a display, with the same examples."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Iterator
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

os.environ.setdefault("MPLBACKEND", "Agg")  # before anything imports matplotlib

import pytest
import torch
from hypothesis import settings

torch.set_num_threads(1)

# The same examples in every run: a red test stays red. To hunt for new examples:
#   HYPOTHESIS_PROFILE=search make test
settings.register_profile("ci", derandomize=True, deadline=None, database=None, print_blob=True)
settings.register_profile("search", max_examples=1000, deadline=None, database=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

OTHERS = ["gymnasium", "matplotlib.pyplot", "numba", "pymunk", "scipy.stats"]
OTHERS += [f"torchrl.{name}" for name in ("collectors", "envs", "modules", "objectives", "record")]
"""Packages of others that processes need; to import them takes each four seconds of work."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: Any, log: Any) -> Any:
    """The tests of a file run in one process: what they share is made once."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log)


@pytest.fixture(scope="session")
def toy() -> str:
    """What the ids of the toy environments begin with, once they can be imported."""
    folder = str(Path(__file__).parent / "toy")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    return "gym:toy_tasks:toy/"


@pytest.fixture(scope="session", autouse=True)
def one_core() -> Iterator[None]:
    """Nobody starts processes unless a test asks for some; results do not depend on them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
        yield


@pytest.fixture(scope="session", autouse=True)
def quick_processes() -> Iterator[None]:
    """Processes begin as copies of one that has imported torch, where the system can do that.

    They share nothing with the test and import this project anew. With `spawned` nothing is copied.
    """
    with pytest.MonkeyPatch.context() as patch:
        if "forkserver" in multiprocessing.get_all_start_methods():
            patch.setattr(multiprocessing, "get_context", _context)
        yield


@pytest.fixture(scope="module")
def without_pictures() -> Iterator[None]:
    """Runs draw nothing at their end, which takes longer than a tiny run."""
    from neatq_trainers import train  # which genomes and worlds are tested without
    from neatq_trainers.callbacks import Report

    with pytest.MonkeyPatch.context() as patch:
        callbacks = tuple(one for one in train.BUILT_IN if one is not Report)
        patch.setattr(train, "BUILT_IN", callbacks)
        yield


@pytest.fixture
def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of runs that write more than pictures at their end: nothing is drawn."""
    from neatq_trainers import report

    monkeypatch.setattr(report, "save_figure", lambda *_: None)
    monkeypatch.setattr(report, "life_frames", lambda *_: [])
    monkeypatch.setattr(report, "film", lambda *_: [])
    monkeypatch.setattr(report, "animation", lambda _: b"")


@pytest.fixture
def spawned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes begin as they do for users: each imports what it needs, which takes seconds."""
    monkeypatch.setattr(multiprocessing, "get_context", _GET_CONTEXT)


class Nodes:
    """A Ray cluster of a head and two more nodes, of one core each, on this machine."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster

        self.cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        self.address = self.cluster.address
        self.others = [self.cluster.add_node(num_cpus=1) for _ in range(2)]

    def kill_one(self) -> None:
        self.cluster.remove_node(self.others.pop(), allow_graceful=False)


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
    """A cluster whose workers import the tests, and the toy tasks."""
    tests = Path(__file__).parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(map(str, (tests.parent, tests / "toy"))))
        nodes = Nodes()
        yield nodes
        nodes.cluster.shutdown()


_GET_CONTEXT = multiprocessing.get_context


def _context(method: str | None = None) -> BaseContext:
    """The context of a method, but for that of `spawn`."""
    if method != "spawn":
        return _GET_CONTEXT(method)
    from multiprocessing import forkserver  # not everywhere

    forkserver.set_forkserver_preload(OTHERS)
    forkserver.ensure_running()  # now, as it hands on the signals that are blocked where it begins
    return _GET_CONTEXT("forkserver")
