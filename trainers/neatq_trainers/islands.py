"""Genomes that leave the arenas of a run, and arrive there; see `migration`."""

from __future__ import annotations

import numpy as np

from neatq_torch.evolution import RtNEAT
from neatq_trainers.changes import field_of
from neatq_trainers.loop import introduce, learnt
from neatq_trainers.migration import CHOICE_STREAM, MigrationConfig, Travellers
from neatq_trainers.run import Run


def emigrants(run: Run, migration: MigrationConfig, times: int) -> Travellers:
    """Copies of those who go, of each arena, with the weights that are inherited.

    Args:
        run: Its state is not changed but for weights that were learnt and are written back.
        migration: How many go, and who.
        times: How many times genomes have gone before.
    """
    learnt(run, [True] * len(run.populations))
    leaving = []
    for seed, population in zip(run.config.seeds, run.populations, strict=True):
        assert isinstance(population, RtNEAT)
        judged = np.flatnonzero(population.eligible)
        if migration.chosen == "best":
            order = judged[np.argsort(-population.score[judged], kind="stable")]
        else:
            order = np.random.default_rng([seed, CHOICE_STREAM, times]).permutation(judged)
        leaving.append([population.genomes[slot] for slot in order[: migration.emigrants]])
    return leaving


def immigrate(run: Run, arriving: Travellers) -> None:
    """Let genomes take the slots of the worst of each arena, and begin a life there.

    They know what they know, and are not taught as newborns are.
    """
    replacements = []
    for population, genomes in zip(run.populations, arriving, strict=True):
        assert isinstance(population, RtNEAT)
        protected = population.slots_of(population.protected).all()  # nobody makes room
        replacements.append([population.adopt(one) for one in genomes if not protected])
    newborn = introduce(run, replacements)
    field_of(run).begin_lives(newborn.numpy())
    assert run.network is not None
    for arena, own in enumerate(replacements):
        for one in own:
            run.network.replace(arena * run.shape[1] + one.slot, one.genome)
    run.disturbed = True
    run.migrations += 1
