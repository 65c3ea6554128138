"""Selection: who makes room and who breeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.reproduction import ReproductionConfig
from neatq_torch.evolution.species import Species


def roulette(shares: ArrayLike, rng: np.random.Generator) -> int:
    """Return an index with probability proportional to its share, uniform if all are 0."""
    bounds = np.add.accumulate(shares, dtype=np.float64)
    if not bounds[-1] > 0.0:
        return int(rng.integers(bounds.size))
    index = bounds.searchsorted(rng.random() * bounds[-1], side="right")
    # Rounding can lift the ball to the very end: the last share above 0 catches it there.
    return int(min(index, bounds.searchsorted(bounds[-1])))


def worst(adjusted_fitness: NDArray[np.float64], slots: NDArray[np.integer]) -> int:
    """Return the one of `slots` with the lowest fitness [robots], the first of equals."""
    return int(slots[adjusted_fitness[slots].argmin()])


def choose_parents(
    species: Sequence[Species],
    fitness: NDArray[np.float64],
    eligible: NDArray[np.bool_],
    config: ReproductionConfig,
    rng: np.random.Generator,
) -> tuple[tuple[int, ...], bool]:
    """Return the slots of one or two parents, and whether these are of different species.

    A species is drawn by the mean fitness of its eligible members, parents by fitness among
    them; among all members, uniformly, where none is eligible. The only candidate of a species
    breeds alone. The species is ranked, so that its fittest member represents it from now on,
    as in OpenNERO. A mate from outside is the fittest of another species.

    Args:
        species: those that have members.
        fitness: [robots], 0 for robots that are not eligible.
        eligible: [robots] who is old enough to breed.
        config: probabilities of the kinds of parents.
        rng: draws species and parents.
    """
    able = [one.members[eligible[one.members]] for one in species]
    chosen = roulette([_mean(fitness[slots]) for slots in able], rng)
    home = species[chosen]
    home.rank(fitness)
    pool = able[chosen] if able[chosen].size else home.members
    shares = fitness[pool]
    first = int(pool[roulette(shares, rng)])
    if rng.random() < config.mutate_only_prob or pool.size == 1:
        return (first,), False
    others = [one for one in species if one is not home]
    if rng.random() < config.interspecies_mate_prob and others:
        mates = others[int(rng.integers(len(others)))].members
        return (first, int(mates[fitness[mates].argmax()])), True
    return (first, int(pool[roulette(shares, rng)])), False


def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean as `values.mean()` does, at a third of its cost; 0 if there are none."""
    return float(np.add.reduce(values) / values.size) if values.size else 0.0
