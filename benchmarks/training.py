"""The whole trainer, and under it the worlds alone: what the rows about runs share."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from torchrl.collectors import Collector

from benchmarks.measure import interleaved
from benchmarks.result import Goal, Line, compare
from neatq_envs.arena import Arena
from neatq_envs.scenario import Scenario
from neatq_envs.torchrl_env import ArenaEnv
from neatq_trainers.config import RunConfig
from neatq_trainers.train import start
from neatq_trainers.worlds import ArenaConfig


class Timed(NamedTuple):
    """A run of `neatq train`: its wall seconds, and its steps of all genomes if it counts them."""

    seconds: float
    steps: int


def trainer_tick_seconds(config: RunConfig, ticks: tuple[int, int]) -> float:
    """Wall seconds of one tick of `neatq train`, between two ticks of a run."""
    short, long = timed_runs(config, "ticks", ticks)
    return (long.seconds - short.seconds) / (ticks[1] - ticks[0])


def timed_runs(
    config: RunConfig, unit: str, lengths: tuple[int, int], *, workers: int | None = None
) -> list[Timed]:
    """A run as long as each of `lengths`.

    Subtract them: what it takes to begin and to end a run is in both. A run before them loads what
    is loaded once.
    """
    timed_run(config.changed({unit: 1}), workers)
    return [timed_run(config.changed({unit: length}), workers) for length in lengths]


def timed_run(config: RunConfig, workers: int | None = None) -> Timed:
    """A run of `neatq train`, in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        run = start(config, Path(folder) / "run", workers=workers)
        seconds = time.perf_counter() - begin
        steps = run.metrics().get("steps", np.zeros(1))
        return Timed(seconds, int(steps[-1]) if steps.size else 0)


def scenario_of(config: RunConfig) -> Scenario:
    """The world of a run in the arena."""
    assert isinstance(config.world, ArenaConfig)
    return config.world.scenario


def arena_tick(config: RunConfig) -> Callable[[], None]:
    """One tick of the bare arenas, with actions drawn beforehand."""
    scenario = scenario_of(config)
    arena = Arena(scenario, range(config.arenas))
    low, high = arena.schema.action_bounds(scenario)
    rng = np.random.default_rng(0)
    actions = rng.uniform(low, high, (64, *arena.shape, len(low))).astype(np.float32)
    turns = itertools.cycle(actions)
    return lambda: arena.step(next(turns))


def collector_batch(config: RunConfig) -> Callable[[], object]:
    """One batch of TorchRL's collector, its random policy in the same arenas."""
    env = ArenaEnv(scenario_of(config), arenas=config.arenas)
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
    robots = config.arenas * scenario_of(config).robots
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
