"""How things are timed: in rounds, each thing once in each, so that all see the same noise."""

from __future__ import annotations

import gc
import multiprocessing
import subprocess
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from typing import Any, ParamSpec, TypeVar

import numpy as np
import torch

P = ParamSpec("P")
T = TypeVar("T")
Samples = dict[str, np.ndarray]


def interleaved(
    actions: Mapping[str, Callable[[], object]],
    *,
    rounds: int,
    seconds: float = 0.1,
    clock: Callable[[], float] = time.process_time,
) -> Samples:
    """Seconds of one call of each action, [rounds] for each.

    Args:
        actions: What to time. Each is called once before.
        rounds: How often.
        seconds: Least length of one sample; an action is repeated to fill it.
        clock: CPU time of the process, or `time.perf_counter` for work in several processes.
    """
    repeats = {name: _repeats(action, seconds) for name, action in actions.items()}
    samples: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(rounds):
        for name, action in actions.items():
            gc.collect()
            begin = clock()
            for _ in range(repeats[name]):
                action()
            samples[name].append((clock() - begin) / repeats[name])
    return {name: np.array(values) for name, values in samples.items()}


def _repeats(action: Callable[[], object], seconds: float) -> int:
    action()
    begin = time.perf_counter()
    action()
    return max(1, round(seconds / max(time.perf_counter() - begin, 1e-9)))


def in_rounds(actions: Mapping[str, Callable[[], float]], *, rounds: int) -> Samples:
    """The same for actions that time themselves and return what they measured."""
    samples: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(rounds):
        for name, action in actions.items():
            gc.collect()
            samples[name].append(action())
    return {name: np.array(values) for name, values in samples.items()}


def in_fresh_process(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """What `function` returns in a new process with one thread, where nothing ran before."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=one_thread) as pool:
        return pool.submit(function, *args, **kwargs).result()


def one_thread() -> None:
    """Measure as `neatq` runs: one thread, and no search for garbage in what was imported."""
    torch.set_num_threads(1)
    gc.collect()
    gc.freeze()


def resident_bytes(process: int) -> int:
    """Resident set of a process and all that it started; what they share counts more than once."""
    listing = subprocess.run(
        ["ps", "-axo", "pid=,ppid=,rss="], capture_output=True, text=True, check=True
    )
    table: dict[int, Any] = {}
    for line in listing.stdout.splitlines():
        pid, parent, kibibytes = map(int, line.split())
        table[pid] = parent, kibibytes
    family = {process}
    for _ in table:  # children may be listed before their parents
        more = {pid for pid, (parent, _) in table.items() if parent in family} | family
        if more == family:
            break
        family = more
    return 1024 * sum(table[pid][1] for pid in family if pid in table)
