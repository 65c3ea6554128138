"""What a checkpoint holds, checked: whatever does not fit the run is told as damage."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from neatq_envs.episodes import EpisodeError
from neatq_envs.gymnasium_task import TaskError
from neatq_envs.processes import ProcessEnded
from neatq_envs.random_play import EnvFacts
from neatq_torch.checkpoint import CheckpointError
from neatq_trainers.config import LENGTHS, RunConfig
from neatq_trainers.run import State

_SAVED_PARTS = {
    "config": dict,
    "runs": list,
    "track": np.ndarray,
    "facts": dict | None,
    "done": dict,
    "metrics_bytes": int,
    "metrics_crc": int,
}


def check_saved(path: Path, state: State, config: RunConfig) -> None:
    """Check the parts of a checkpoint of a run.

    Raises:
        CheckpointError: Naming the part that is missing or of another kind.
    """
    with restoring(path):
        for name, kind in _SAVED_PARTS.items():
            if not isinstance(state[name], kind):
                raise TypeError(f"{name} is no {kind}")
        runs, track = state["runs"], state["track"]
        counts = [state["metrics_bytes"], *(state["done"][unit] for unit in LENGTHS)]
        counts += [run["tick"] for run in runs]
        if any(type(one) is not int or one < 0 for one in counts):
            raise ValueError("a number of ticks or bytes is none")
        if track.ndim != 3 or track.dtype != np.float32 or not 1 <= len(runs) <= config.arenas:
            raise ValueError(f"{len(runs)} runs, track {track.dtype} {track.shape}")
        if state["facts"] is not None:
            EnvFacts.from_dict(state["facts"])


def best_score(state: State) -> float:
    """The best return of a champion in the checkpoint of a run; -inf before any was evaluated.

    Raises:
        CheckpointError: If the checkpoint is damaged.
    """
    with restoring():
        known = [one for run in state["runs"] for one in run["metrics"]["champions"]]
        return max((float(one["score"]) for one in known if one is not None), default=-math.inf)


def _plain(value: Any) -> Any:
    return value.detach().numpy() if isinstance(value, Tensor) else value


def check_form(saved: Any, fresh: Any, *, columns: bool, where: str = "") -> None:
    """Check that what was saved has the form of what has just begun, and may take its place.

    An array of no entries stands for one that grows, an empty list or object for any, None for all.

    Args:
        saved: What was saved.
        fresh: What `state_dict` gave before anything happened.
        columns: Whether the last dimension of arrays may differ: those of networks have as many
            entries there as the largest so far needed.
        where: The path by which messages call it.

    Raises:
        ValueError: Naming the first part that is missing, or of another type or shape.
    """
    saved, fresh = _plain(saved), _plain(fresh)
    if isinstance(fresh, np.ndarray):
        right = isinstance(saved, np.ndarray) and saved.dtype == fresh.dtype
        right = right and saved.ndim == fresh.ndim
        rows = slice(-1 if columns and fresh.ndim > 1 else None)
        right = right and (fresh.size == 0 or saved.shape[rows] == fresh.shape[rows])
    elif isinstance(fresh, dict | list):
        items = list(fresh.items()) if isinstance(fresh, dict) else list(enumerate(fresh))
        right = isinstance(saved, type(fresh)) and len(saved) >= len(items)
        for name, value in items if right else ():
            check_form(saved[name], value, columns=columns, where=f"{where}.{name}")
    elif isinstance(fresh, float):
        right = isinstance(saved, int | float)
    else:
        right = fresh is None or type(saved) is type(fresh)
    if not right:
        raise ValueError(f"{where[1:]} is missing, or of another type or shape")


@contextmanager
def restoring(path: Path | str = "checkpoint.npz") -> Iterator[None]:
    """Whatever fails in it is the fault of a checkpoint, but for environment, worker and machine.

    Raises:
        CheckpointError: In place of the error that came.
    """
    try:
        yield
    except (CheckpointError, EpisodeError, TaskError, ProcessEnded, OSError, MemoryError):
        raise
    except Exception as error:
        text = f"what it holds does not fit the run ({type(error).__name__}: {error})"
        raise CheckpointError(f"{path}: damaged, or of another version: {text}") from error
