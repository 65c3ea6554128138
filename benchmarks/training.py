"""The whole trainer, and under it the worlds alone: what the rows about runs share."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from torchrl.collectors import Collector

from benchmarks.measure import interleaved
from benchmarks.result import Goal, Line, compare
from neatq_envs.arena import Arena
from neatq_envs.torchrl import ArenaEnv
from neatq_trainers.config import RunConfig
from neatq_trainers.train import start
from neatq_trainers.workers import fitting_workers


def trainer_tick_seconds(config: RunConfig, ticks: tuple[int, int]) -> float:
    """Wall seconds of one tick of `neatq train`, between two ticks of a run.

    Two runs are timed, one as long as each of `ticks`, and subtracted: what it takes to begin and
    to end a run is in both. A run before them loads what is loaded once.
    """
    _run_seconds(replace(config, ticks=1))
    short, long = (_run_seconds(replace(config, ticks=length)) for length in ticks)
    return (long - short) / (ticks[1] - ticks[0])


def _run_seconds(config: RunConfig) -> float:
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        start(config, Path(folder) / "run", workers=fitting_workers(config.arenas))
        return time.perf_counter() - begin


def arena_tick(config: RunConfig) -> Callable[[], None]:
    """One tick of the bare arenas, with actions drawn beforehand."""
    arena = Arena(config.scenario, range(config.arenas))
    low, high = arena.schema.action_bounds(config.scenario)
    rng = np.random.default_rng(0)
    actions = rng.uniform(low, high, (64, *arena.shape, len(low))).astype(np.float32)
    turns = itertools.cycle(actions)
    return lambda: arena.step(next(turns))


def collector_batch(config: RunConfig) -> Callable[[], object]:
    """One batch of TorchRL's collector, its random policy in the same arenas."""
    env = ArenaEnv(config.scenario, arenas=config.arenas)
    collector = Collector(
        env,
        None,
        frames_per_batch=env.batch_size.numel() * config.ticks_per_batch,
        total_frames=-1,
        auto_register_policy_transforms=False,
        use_buffers=False,
    )
    batches = iter(collector)
    return lambda: next(batches)


def whole_run(
    what: str, config: RunConfig, *, ticks: tuple[int, int], rounds: int, goal: Goal
) -> list[Line]:
    """A tick of the whole trainer beside one of the collector and one of the arenas alone."""
    parts = {"arena": arena_tick(config), "collector": collector_batch(config)}
    trainer, worlds = [], []
    for _ in range(rounds):
        trainer.append(trainer_tick_seconds(config, ticks))
        worlds.append(interleaved(parts, rounds=1, seconds=0.5, clock=time.perf_counter))
    samples = {name: np.concatenate([one[name] for one in worlds]) for name in parts}
    samples["collector"] /= config.ticks_per_batch
    micros = np.array(trainer) * 1e6
    robots = config.arenas * config.scenario.robots
    rate = 1e6 / float(np.median(micros))
    note = f"{rate:,.0f} ticks/s, {rate * robots:,.0f} robot-steps/s."
    return [
        compare(
            what,
            micros,
            "the collector alone, random actions",
            samples["collector"] * 1e6,
            unit="us",
            goal=goal,
            note=note,
        ),
        compare(
            what, micros, "the arenas alone, random actions", samples["arena"] * 1e6, unit="us"
        ),
    ]
