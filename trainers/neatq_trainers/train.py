"""Training from the first tick to the last: workers, run folder, progress, Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from neatq_trainers.config import ConfigError, RunConfig
from neatq_trainers.interrupt import stop_on_interrupt
from neatq_trainers.loop import Stride
from neatq_trainers.metrics import Row
from neatq_trainers.progress import Progress
from neatq_trainers.run_folder import RunFolder
from neatq_trainers.workers import Worker, open_workers

STRIDES_AHEAD = 8
"""Strides that a worker may have under way, so that none waits for a slower one."""


def start(config: RunConfig, out: Path, *, workers: int = 1) -> RunFolder:
    """Make the folder `out` and train in it from the beginning.

    Args:
        config: The run.
        out: A new or empty folder.
        workers: Processes among which the arenas are dealt, at most one for each arena; 1 trains
            in this process. The results do not depend on it.

    Raises:
        ConfigError: If the run cannot be built, there are no workers, or the folder is in use.
        KeyboardInterrupt: After Ctrl-C; `resume` goes on.
    """
    if workers < 1:
        raise ConfigError(f"workers: expected at least 1, got {workers}")
    parts = config.split(min(workers, config.arenas))
    with open_workers(parts, [None] * len(parts)) as team:
        begun = [worker.snapshot() for worker in team]  # what cannot be built leaves no folder
        folder = RunFolder.create(out, config)
        folder.checkpoint(config, begun)
        train(config, 0, team, folder)
    return folder


def resume(out: Path, ticks: int | None = None) -> RunFolder:
    """Go on with the run in folder `out`, to `ticks` ticks if given, else as long as planned.

    It goes on with as many workers as it was begun with.
    """
    folder = RunFolder.open(out)
    config, states = folder.load(ticks=ticks)
    with open_workers(config.split(len(states)), states) as team:
        train(config, states[0]["tick"], team, folder)
    return folder


def train(config: RunConfig, tick: int, workers: Sequence[Worker], folder: RunFolder) -> None:
    """Train until the run has the ticks of its configuration, or until Ctrl-C.

    Args:
        config: The whole run.
        tick: Ticks that it has already.
        workers: Train its arenas.
        folder: Where the results go.

    Raises:
        KeyboardInterrupt: If it was stopped; what it has so far is in the folder.
    """
    stride, first_arenas = config.stride_ticks, config.first_arenas(len(workers))
    ahead = stride * (STRIDES_AHEAD if len(workers) > 1 else 1)
    asked = saved = tick
    due, done = time.monotonic() + config.checkpoint_seconds, tick >= config.ticks
    with Progress(config.ticks, tick) as progress, stop_on_interrupt() as stop:
        while not done:
            pausing = stop.requested or (tick > saved and time.monotonic() >= due)
            while not pausing and asked < min(config.ticks, tick + ahead):
                for worker in workers:
                    worker.begin()
                asked += stride
            if tick < asked:
                came = [worker.finish() for worker in workers]
                tick += stride
                rows = in_order(came, first_arenas)
                folder.record(config, came[0].poses, rows)
                progress.show(tick, rows)
            else:  # nobody is at work
                folder.checkpoint(config, [worker.snapshot() for worker in workers])
                saved, due = tick, time.monotonic() + config.checkpoint_seconds
                done = stop.requested or tick >= config.ticks
    if tick < config.ticks:
        raise KeyboardInterrupt


def in_order(came: Sequence[Stride], first_arenas: Sequence[int]) -> list[Row]:
    """The rows of all arenas by tick and arena, from those of each worker's arenas."""
    numbered = [
        row._replace(arena=first + row.arena)
        for first, stride in zip(first_arenas, came, strict=True)
        for row in stride.rows
    ]
    return sorted(numbered, key=lambda row: (row.tick, row.arena))
