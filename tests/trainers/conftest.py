"""Tiny runs, and what it means that two of them are equal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_torch.checkpoint import load_checkpoint
from neatq_trainers.arms import preset
from neatq_trainers.callbacks import Callback
from neatq_trainers.cli import main
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHECKPOINT
from neatq_trainers.rows import Row
from neatq_trainers.session import Session

ROBOTS, LIFE_TICKS = 9, 200
_GROWING = ("weight", "first_moment", "second_moment", "target_weight", "memory", "trace")
"""Arrays with spare columns for the next genomes, which hold zeros. How many there are depends on
how often the networks were laid out, and nothing else does."""
_OFTEN = {"add_link_prob": 0.9, "recurrent_link_prob": 0.5, "add_node_prob": 0.3}
"""Mutations, so that networks soon are recurrent."""

Tiny = Callable[..., RunConfig]
State = dict[str, Any]
Say = Callable[..., tuple[int, str, str]]


def often(config: RunConfig) -> dict[str, Any]:
    """Changes by which many are born, with new links."""
    population = config.to_dict()["population"] or {}
    changes: dict[str, Any] = {}
    if "ineligible_fraction" in population:
        changes["population.ineligible_fraction"] = 0.5
    if "reproduction" in population:
        changes |= {f"population.reproduction.mutation.{k}": v for k, v in _OFTEN.items()}
    return changes


def _tiny(arm: str, *, ticks: int = 520, **changes: Any) -> RunConfig:
    size = {"robots": ROBOTS, "lifetime_ticks": LIFE_TICKS}
    config = preset("wall", arm, env_kwargs=size, length={"ticks": ticks})
    return config.changed({"seed": 1, **often(config), **changes})


@pytest.fixture(scope="session")
def tiny() -> Tiny:
    """Make the configuration of a short run with few robots, many births and new links."""
    return _tiny


@pytest.fixture(scope="session")
def tiny_walk(toy: str) -> Tiny:
    """Make the configuration of a short run of an arm, on the walk of `toy_tasks`."""

    def make(
        arm: str = "neat",
        task: str = "Walk-v0",
        *,
        env_kwargs: dict[str, Any] | None = None,
        **changes: Any,
    ) -> RunConfig:
        length: dict[str, int | None] = {"steps": None, "generations": None}
        length |= {unit: changes.pop(unit) for unit in length if unit in changes}
        if not any(length.values()):
            length["generations"] = 4
        config = preset(toy + task, arm, env_kwargs=env_kwargs, length=length)
        evaluation = {
            "world.every": 2,
            "world.evaluated": 2,
            "world.episodes": 3,
            "world.test_episodes": 5,
        }
        lives = {"world.slots": 8, "population.episodes": 2}
        if arm == "qnetwork":
            lives = {"population.episodes": 6}
        if "minimum_life_episodes" in config.to_dict()["population"]:
            lives = {"world.slots": 8}
        return config.changed({"seed": 1, **evaluation, **lives, **often(config), **changes})

    return make


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{name}/{key}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _leaves(item, f"{name}[{index}]")
    else:
        yield name, value


def _equal(name: str, a: Any, b: Any) -> bool:
    if not isinstance(a, np.ndarray):
        return a == b
    if name.rsplit("/", 1)[-1] in _GROWING and a.shape[:-1] == b.shape[:-1]:
        columns = min(a.shape[-1], b.shape[-1])
        if a[..., columns:].any() or b[..., columns:].any():
            return False
        a, b = a[..., :columns], b[..., :columns]
    return (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())


def _differences(one: State, two: State) -> list[str]:
    a, b = dict(_leaves(one)), dict(_leaves(two))
    return sorted(
        name
        for name in a.keys() | b.keys()
        if name not in a or name not in b or not _equal(name, a[name], b[name])
    )


@pytest.fixture(scope="session")
def differences() -> Callable[[State, State], list[str]]:
    """Name what differs between two states, bit for bit, spare columns apart."""
    return _differences


@pytest.fixture(scope="session")
def state_of() -> Callable[[Path], State]:
    """Load what a run folder's checkpoint holds."""
    return lambda folder: load_checkpoint(folder / CHECKPOINT)


@pytest.fixture
def neatq(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Say:
    """Run the command in an empty folder; returns status, standard output and standard error."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")

    def run(*arguments: str) -> tuple[int, str, str]:
        try:
            status = main(arguments)
        except SystemExit as end:
            status = int(end.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


class Late(Callback):
    """Does something when a run is as long as that, once."""

    def __init__(self, ticks: int, act: Callable[[], object]) -> None:
        self.ticks, self.act = ticks, act

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        if session.lengths["ticks"] >= self.ticks:
            self.ticks = 10**9
            self.act()


@pytest.fixture(scope="session")
def late() -> type[Late]:
    """A callback that does something when a run is as long as that."""
    return Late
