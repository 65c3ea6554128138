"""The training loop."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from torch import Tensor
from torchrl.collectors import Collector

from neatq_torch.learning import write_back
from neatq_trainers.build import Run, build
from neatq_trainers.config import RunConfig
from neatq_trainers.metrics import rows
from neatq_trainers.progress import Progress
from neatq_trainers.run_folder import RunFolder


def start(config: RunConfig, out: Path) -> RunFolder:
    """Make the folder `out` and train in it from the beginning."""
    run = build(config)  # first: what cannot be built leaves no folder
    folder = RunFolder.create(out, config)
    folder.checkpoint(run)
    train(run, folder)
    return folder


def resume(out: Path, ticks: int | None = None) -> RunFolder:
    """Go on with the run in folder `out`, to `ticks` ticks if given, else as long as planned."""
    folder = RunFolder.open(out)
    run = folder.load(ticks=ticks)
    train(run, folder)
    return folder


def train(run: Run, folder: RunFolder) -> None:
    """Train until the run has the ticks of its configuration, or until Ctrl-C.

    Everything that a batch [arenas, robots, ticks] leads to happens here, in order.
    """
    config = run.config
    collector = make_collector(run)
    last_checkpoint = time.monotonic()
    with Progress(config.ticks, run.tick) as progress, stop_on_interrupt() as stop:
        for batch in collector if run.tick < config.ticks else ():  # act
            run.tick += batch.shape[-1]
            error = run.learner.update(batch)  # learn
            rewards = batch.get(("next", "reward_vector")).numpy()
            for population, reward in zip(run.populations, rewards, strict=False):
                population.record(reward)  # fitness, age
            new_rows = list(rows(run, batch, error))
            newborn = breed(run)  # write back, replace
            if newborn.any():
                collector.reset(index=newborn)  # a new life for a new genome
            folder.record(run, batch, new_rows)
            progress.show(run.tick, new_rows)
            if run.tick % config.stride_ticks:
                continue
            run.env.rebuild()  # only from here on does a checkpoint go on exactly
            done = run.tick >= config.ticks or stop.requested
            if done or time.monotonic() - last_checkpoint >= config.checkpoint_seconds:
                folder.checkpoint(run)
                last_checkpoint = time.monotonic()
            if done:
                break
    collector.shutdown(close_env=False)
    if run.tick < config.ticks:
        raise KeyboardInterrupt


def make_collector(run: Run) -> Collector:
    """A collector of batches [arenas, robots, ticks], without end."""
    arenas, robots = run.config.shape
    return Collector(
        run.env,
        run.policy,
        frames_per_batch=arenas * robots * run.config.ticks_per_batch,
        total_frames=-1,
        auto_register_policy_transforms=False,
        use_buffers=False,  # a network's state may grow from batch to batch
    )


def breed(run: Run) -> Tensor:
    """Let rtNEAT replace robots where it is due; returns the newborn [arenas, robots]."""
    newborn = torch.zeros(run.config.shape, dtype=torch.bool)
    network = run.network
    if network is None or not any(population.due() for population in run.populations):
        return newborn
    if run.config.learning.inheritance == "lamarckian":
        write_back(network, run.populations)
    for arena, population in enumerate(run.populations):
        for replacement in population.replace():
            newborn[arena, replacement.slot] = True
            place = arena * len(population.genomes) + replacement.slot
            network.replace(place, replacement.genome)
    if newborn.any():
        run.learner.reset(newborn)
        run.policy.reset(newborn)
    return newborn


class _Stop:
    requested = False


@contextmanager
def stop_on_interrupt() -> Iterator[_Stop]:
    """Turn the first Ctrl-C into a request to stop after the batch; a second one interrupts."""
    stop = _Stop()

    def request(*_: object) -> None:
        stop.requested = True
        signal.signal(signal.SIGINT, previous)

    try:
        previous = signal.signal(signal.SIGINT, request)
    except ValueError:  # only the main thread may handle signals
        yield stop
        return
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, previous)
