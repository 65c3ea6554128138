"""The training loop."""

from __future__ import annotations

from collections.abc import Generator
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector

from neatq_torch.genome import ScalesOf
from neatq_torch.learning import write_back
from neatq_torch.network import perturbation_scales
from neatq_trainers.build import Run
from neatq_trainers.metrics import Row, rows


class Stride(NamedTuple):
    """What came of the ticks from one moment at which a run can stop to the next.

    Attributes:
        rows: New rows of metrics, by tick and arena.
        poses: Poses of the robots of the first arena [robots, ticks, 3].
    """

    rows: list[Row]
    poses: np.ndarray


def strides(run: Run) -> Generator[Stride]:
    """Train without end; yields after every `stride_ticks` ticks.

    Everything that a batch [arenas, robots, ticks] leads to happens here, in order.
    """
    collector = make_collector(run)
    new_rows: list[Row] = []
    poses: list[np.ndarray] = []
    try:
        for batch in collector:  # act
            run.tick += batch.shape[-1]
            error = run.learner.update(batch)  # learn
            record(run, batch)  # fitness, age
            new_rows += rows(run, batch, error)
            poses.append(batch.get("pose")[0].numpy())
            newborn = breed(run, batch.get("observation"))  # write back, replace
            if newborn.any():
                collector.reset(index=newborn)  # a new life for a new genome
            if run.tick % run.config.stride_ticks == 0:
                run.env.rebuild()  # only from here on can a run go on exactly
                yield Stride(new_rows, np.concatenate(poses, 1))
                new_rows, poses = [], []
    finally:
        collector.shutdown(close_env=False)


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
        track_traj_ids=False,  # the age of a life tells more
    )


def record(run: Run, batch: TensorDictBase) -> None:
    """Tell rtNEAT what all robots went through in a batch [arenas, robots, ticks]."""
    rewards = batch.get(("next", "reward_vector")).numpy()
    places = batch.get(("next", "pose"))[..., :2].numpy()  # for novelty
    for arena, population in enumerate(run.populations):
        counts = None
        if run.genes is not None:  # what a robot explored is not its fault
            best = batch.get("action_value")[arena].argmax(-1)
            counts = (batch.get("candidate_index")[arena] == best).numpy()
        population.record(rewards[arena], places[arena], counts)


def breed(run: Run, observation: Tensor | None = None) -> Tensor:
    """Let rtNEAT replace robots where it is due.

    Args:
        run: The run.
        observation: What robots saw last [arenas, robots, ticks, inputs], for safe mutation.

    Returns:
        The newborn [arenas, robots].
    """
    newborn = torch.zeros(run.config.shape, dtype=torch.bool)
    network = run.network
    if network is None or not any(population.due() for population in run.populations):
        return newborn
    if run.config.learning.inheritance == "lamarckian":
        inherit = write_back if run.heritage is None else run.heritage.write_back
        inherit(network, run.populations)
    for arena, population in enumerate(run.populations):
        for replacement in population.replace(_scales_of(run, arena, observation)):
            newborn[arena, replacement.slot] = True
            place = arena * len(population.genomes) + replacement.slot
            network.replace(place, replacement.genome)
            if run.heritage is not None:
                run.heritage.reset(place, replacement.genome)
            if run.genes is not None:
                run.genes.inherit(arena, replacement)
    if newborn.any():
        if run.genes is not None:
            run.genes.express()
        run.learner.reset(newborn)
        run.policy.reset(newborn)
    return newborn


def _scales_of(run: Run, arena: int, observation: Tensor | None) -> ScalesOf | None:
    """How far mutation moves weights in an arena; None if all alike."""
    count = run.config.learning.safe_mutation
    if count is None or observation is None:
        return None
    seen = observation[arena].flatten(0, 1)
    seen = seen[torch.arange(count) * len(seen) // count]
    return partial(perturbation_scales, observation=seen, evaluation=run.config.network.evaluation)
