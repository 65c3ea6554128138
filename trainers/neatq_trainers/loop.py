"""The training loop: seven steps, for every world.

1 compile: the genomes of all slots become one network.
2 act: each network chooses an action.
3 the world moves: all slots by one tick; a batch of ticks is collected.
4 learn: each network is updated.
5 judge: the rewards of the batch count towards fitness and age.
6 write back: what was learnt goes into the genomes, if it is to be inherited.
7 replace: newborns take the slots that the population frees.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector

from neatq_torch.evolution import Replacement
from neatq_torch.learning import write_back
from neatq_torch.learning.candidates import NOBODY
from neatq_trainers.callbacks import Callback
from neatq_trainers.collecting import RowsCollector, collector_of
from neatq_trainers.rollouts import Rollouts, rollouts_of
from neatq_trainers.rows import Row
from neatq_trainers.run import Run


class Stride(NamedTuple):
    """What came of the ticks from one moment at which a run can stop to the next.

    Attributes:
        rows: New rows of metrics.
        poses: Poses of the robots of the first arena [slots, ticks, 3]; None in other worlds.
        tick: Ticks of the run so far.
        steps: Steps so far of the arena that has fewest.
        generation: Generations that all arenas have lived through.
    """

    rows: list[Row]
    poses: np.ndarray | None
    tick: int
    steps: int
    generation: int

    def done(self, unit: str) -> int:
        """How long the run is in a unit of length."""
        return {"ticks": self.tick, "steps": self.steps, "generations": self.generation}[unit]


def strides(run: Run, callbacks: Sequence[Callback] = ()) -> Generator[Stride]:
    """Train without end; yields at every moment at which the run can stop and go on exactly.

    That is after every `stride_ticks` ticks, or between two generations.
    """
    rows: list[Row] = []
    poses: list[np.ndarray] = []
    _settled(run)
    collector = make_collector(run)
    try:
        for batch in collector:  # 2 act, 3 the world moves: [arenas, slots, ticks]
            run.tick += batch.shape[-1]
            if run.normalization is not None:
                living = batch.get("genome_id").squeeze(-1) != NOBODY
                run.normalization.add(batch.get("observation"), living)
            error = run.learner.update(batch)  # 4 learn
            judge(run, batch)  # 5 judge: fitness and age
            rows += run.metrics.add(run, batch, error)
            for callback in callbacks:
                callback.batch(run, batch, error)
            if (pose := batch.get("pose", None)) is not None:
                poses.append(pose[0].numpy())
            newborn = breed(run)  # 6 write back, 7 replace, and 1 compile again
            if newborn.any():
                collector.reset(index=newborn)  # a new life for a new genome
                for callback in callbacks:
                    callback.advance(run, newborn)
            if (
                newborn.all()
                if run.config.generational
                else run.tick % run.config.stride_ticks == 0
            ):
                if hasattr(run.world.env, "rebuild"):
                    run.world.env.rebuild()  # only from here on can a run go on exactly
                track = np.concatenate(poses, 1) if poses else None
                yield Stride(rows, track, run.tick, run.metrics.steps(run), run.generation)
                rows, poses = [], []
                if _settled(run):
                    assert isinstance(collector, RowsCollector)
                    collector.look_again()
    finally:
        collector.shutdown(close_env=False)


def _settled(run: Run) -> bool:
    """Whether somebody has changed the world, which is built then as a resumed run builds it."""
    changed, run.disturbed = run.disturbed, False
    if changed:
        run.world.env.rebuild()
    return changed


def make_collector(run: Run) -> Collector | Rollouts:
    """A collector of batches [arenas, slots, ticks], without end."""
    if (rollouts := rollouts_of(run)) is not None:
        return rollouts
    return collector_of(run.world.env, run.policy, run.config.ticks_per_batch)


def judge(run: Run, batch: TensorDictBase) -> None:
    """Tell evolution what all slots went through in a batch [arenas, slots, ticks]."""
    following = batch.get("next")
    vector, pose = following.get("reward_vector", None), following.get("pose", None)
    rewards = (following.get("reward") if vector is None else vector).numpy()
    done = following.get("done").squeeze(-1).numpy()
    for arena, population in enumerate(run.populations):
        population.weigh(run.world.present_weights)
        where = None if pose is None else pose[arena, ..., :2].numpy()  # how it behaved
        population.record(rewards[arena], done[arena], behaviour=where)


def breed(run: Run) -> Tensor:
    """Let evolution replace genomes where it is due; returns the newborn [arenas, slots]."""
    due = [population.due() > 0 for population in run.populations]
    if run.network is None or not (all(due) if run.config.generational else any(due)):
        return torch.zeros(run.shape, dtype=torch.bool)
    learnt(run, due)
    return introduce(run, [population.advance() for population in run.populations])


def learnt(run: Run, arenas: Sequence[bool]) -> None:
    """Write what was learnt into the genomes of arenas that are about to breed."""
    assert run.network is not None
    if getattr(run.config.learner, "inheritance", "darwinian") == "lamarckian":
        write_back(run.network, run.populations, arenas)


def introduce(run: Run, replacements: list[list[Replacement]]) -> Tensor:
    """Let networks, learner and policy begin anew where populations, the first ones, replaced."""
    assert run.network is not None
    newborn = torch.zeros(run.shape, dtype=torch.bool)
    run.replacements = replacements
    for arena, own in enumerate(replacements):
        for replacement in own:
            newborn[arena, replacement.slot] = True
            run.network.replace(arena * run.shape[1] + replacement.slot, replacement.genome)
        if run.teachers is not None:
            run.teachers.inherit(arena, own)
    if newborn.any():
        run.begin_generation()
        if run.teachers is not None:
            run.teachers.express()
        run.learner.reset(newborn)
        run.policy.reset(newborn)
    return newborn
