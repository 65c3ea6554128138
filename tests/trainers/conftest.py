"""Tiny runs, and what it means that two of them are equal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_torch.checkpoint import load_checkpoint
from neatq_trainers.config import RunConfig, preset
from neatq_trainers.run_folder import CHECKPOINT

ROBOTS, LIFE_TICKS = 9, 200
_GROWING = ("weight", "first_moment", "second_moment", "target_weight", "memory")
"""Arrays with spare columns for the next genomes, which hold zeros. How many there are depends on
how often the networks were laid out, and nothing else does."""

Tiny = Callable[..., RunConfig]
State = dict[str, Any]


def _tiny(arm: str, *, ticks: int = 520, **changes: Any) -> RunConfig:
    config = preset("wall", arm)  # type: ignore[arg-type]
    scenario = config.scenario.replaced(robots=ROBOTS, lifetime_ticks=LIFE_TICKS)
    reproduction = config.evolution.reproduction
    mutation = replace(
        reproduction.mutation, add_link_prob=0.9, recurrent_link_prob=0.5, add_node_prob=0.3
    )
    evolution = replace(
        config.evolution,
        minimum_life_ticks=LIFE_TICKS,
        ineligible_fraction=0.5,
        reproduction=replace(reproduction, mutation=mutation),
    )
    config = replace(config, scenario=scenario, evolution=evolution, ticks=ticks, seed=1)
    return replace(config, **changes)


@pytest.fixture(scope="session")
def tiny() -> Tiny:
    """Make the configuration of a short run with few robots, many births and new links."""
    return _tiny


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
