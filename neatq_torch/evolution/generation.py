"""Arithmetic of a generation: who may breed, and how many offspring each species has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.species import Species


def judged(fitness: ArrayLike, population: int) -> NDArray[np.float64]:
    """Return fitness as float64 [population].

    Raises:
        ValueError: the shape is wrong, or a value is not finite; the message names its slot.
    """
    fitness = np.array(fitness, dtype=np.float64)
    if fitness.shape != (population,):
        raise ValueError(
            f"expected one fitness for each of the {population} genomes, got an array of shape "
            f"{list(fitness.shape)}."
        )
    wrong = np.flatnonzero(~np.isfinite(fitness))
    if wrong.size:
        raise ValueError(
            f"the fitness of slot {wrong[0]} is {fitness[wrong[0]]}; it must be finite. Give a "
            "genome that could not be judged the lowest fitness of the task."
        )
    return fitness


def shared_fitness(fitness: NDArray[np.float64], species: Sequence[Species]) -> NDArray[np.float64]:
    """Return for each of [species] the sum of fitness / species size over its members.

    That is the mean of its members. Where a fitness is negative, all are first lifted by so much
    that the lowest is 0; where nobody is fit, all count the same.
    """
    lifted = fitness - min(0.0, float(fitness.min()))
    shared = np.array([lifted[one.members].mean() for one in species])
    return shared if shared.any() else np.ones(len(species))


def offspring_counts(shares: ArrayLike, offspring: int) -> NDArray[np.int64]:
    """Return int64 [species] that add up to `offspring`, in proportion to `shares` [species].

    Everybody gets the whole part of what is due; those with the largest remainders get one more,
    the first of equals first.
    """
    shares = np.asarray(shares, dtype=np.float64)
    due = shares / shares.sum() * offspring
    counts = np.floor(due).astype(np.int64)
    order = np.argsort(counts - due, kind="stable")
    counts[order[: offspring - counts.sum()]] += 1
    return counts


def breeders(ranked: NDArray[np.int64], survival_share: float) -> NDArray[np.int64]:
    """Return those of a species' members, the fittest first, that may breed: at least one."""
    return ranked[: int(survival_share * ranked.size) + 1]
