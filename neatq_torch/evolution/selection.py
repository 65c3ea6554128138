"""Selection: who makes room and who breeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.reproduction import ReproductionConfig
from neatq_torch.evolution.species import Species


def roulette(shares: ArrayLike, rng: np.random.Generator) -> int:
    """Return an index with probability proportional to its share, uniform if all are 0."""
    bounds = np.cumsum(shares, dtype=np.float64)
    if not bounds[-1] > 0.0:
        return int(rng.integers(bounds.size))
    index = np.searchsorted(bounds, rng.random() * bounds[-1], side="right")
    # Rounding can lift the ball to the very end: the last share above 0 catches it there.
    return int(min(index, np.searchsorted(bounds, bounds[-1])))


def worst(adjusted_fitness: NDArray[np.float64], slots: Sequence[int]) -> int:
    """Return the one of `slots` with the lowest fitness [robots], the first of equals."""
    return min(slots, key=lambda slot: adjusted_fitness[slot])


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
    able = [[slot for slot in one.members if eligible[slot]] for one in species]
    chosen = roulette([fitness[slots].mean() if slots else 0.0 for slots in able], rng)
    home = species[chosen]
    home.rank(fitness)
    pool = able[chosen] or list(home.members)
    first = pool[roulette(fitness[pool], rng)]
    if rng.random() < config.mutate_only_prob or len(pool) == 1:
        return (first,), False
    others = [one for one in species if one is not home]
    if rng.random() < config.interspecies_mate_prob and others:
        mates = others[int(rng.integers(len(others)))].members
        return (first, max(mates, key=lambda slot: fitness[slot])), True
    return (first, pool[roulette(fitness[pool], rng)]), False
