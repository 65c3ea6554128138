"""Species: who competes with whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, compress, repeat
from operator import is_not
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.trials import Kept
from neatq_torch.genome import DistanceConfig, Genome, LinkTable, compatibility, first_compatible
from neatq_torch.kinds import ConfigError, check_fields


@dataclass(frozen=True, kw_only=True)
class SpeciesConfig:
    """How genomes are sorted into species; the defaults are those of OpenNERO.

    Attributes:
        threshold: a genome joins a species whose representative is closer than this.
        target: number of species the threshold moves towards.
        step: how far the threshold moves at a time; 0 keeps it fixed.
        floor: smallest threshold.
        adjust_every: offspring between two moves of the threshold.
    """

    threshold: float = 4.0
    target: int = 4
    step: float = 0.1
    floor: float = 0.3
    adjust_every: int = 5

    def __post_init__(self) -> None:
        check_fields(self, step="[0, inf]", target="[1, inf]", adjust_every="[1, inf]")
        if not 0.0 < self.floor <= self.threshold:
            got = f"floor {self.floor} and threshold {self.threshold}"
            raise ConfigError(f"expected 0 < floor <= threshold, got {got}.")


@dataclass
class Species:
    """Slots of compatible genomes, int64 [members]; the genome in the first represents them."""

    species_id: int
    members: NDArray[np.int64]

    def rank(self, fitness: NDArray[np.float64]) -> None:
        """Sort members by fitness [slots], the fittest first, which then represents them."""
        self.members = self.members[np.argsort(-fitness[self.members], kind="stable")]


class Speciation(Kept):
    """All species of one population, in the order they were founded."""

    kept = ("threshold", "founded", "offspring")

    def __init__(self, config: SpeciesConfig, distance: DistanceConfig) -> None:
        self.config = config
        self.distance = distance
        self.species: list[Species] = []
        self.threshold = config.threshold
        self.founded = 0
        self.offspring = 0
        self._links = LinkTable()
        self._written: list[Genome] = []

    def sizes(self, slots: int) -> NDArray[np.int64]:
        """How many members the species of each slot has, int64 [slots]."""
        sizes = np.ones(slots, dtype=np.int64)
        for species in self.species:
            sizes[species.members] = species.members.size
        return sizes

    def add(self, slot: int, genomes: Sequence[Genome]) -> Species:
        """Put a slot into the first compatible species, or found one for it."""
        for species in self.species:
            apart = compatibility(genomes[slot], genomes[species.members[0]], self.distance)
            if apart < self.threshold:
                species.members = np.append(species.members, slot)
                return species
        return self._found([slot])

    def remove(self, slot: int) -> None:
        """Take a slot out of its species; a species without members vanishes."""
        for species in self.species:
            if slot in species.members:
                species.members = species.members[species.members != slot]
                if not species.members.size:
                    self.species.remove(species)
                return
        raise KeyError(f"slot {slot} belongs to no species.")

    def count_offspring(self, genomes: Sequence[Genome], order: ArrayLike) -> None:
        """Note one offspring among the genomes [slots].

        Every `adjust_every` of them the threshold moves, and every slot, one after the other in
        the `order` [slots], to the first species that it is compatible with.
        """
        self.offspring += 1
        if self.offspring % self.config.adjust_every:
            return
        self.move_threshold()
        groups, order = [one.members for one in self.species], np.asarray(order, dtype=np.int64)
        others = map(is_not, genomes, chain(self._written, repeat(None)))
        slots = list(compress(range(len(genomes)), others))
        self._written = list(genomes)
        self._links.write(slots, [genomes[slot] for slot in slots])
        self._sort(self._links.regroup(groups, order, self.threshold, self.distance))

    def renew(self, genomes: Sequence[Genome], representatives: Sequence[Genome]) -> None:
        """Sort a whole new generation into species.

        Every genome [slots], one after the other, joins the first species whose representative,
        of the generation before, it is compatible with, or founds one. A species that nobody joins
        vanishes.
        """
        home = first_compatible(genomes, representatives, self.threshold, self.distance)
        groups = max(len(self.species), int(home.max()) + 1)
        self._sort([np.flatnonzero(home == group) for group in range(groups)])

    def move_threshold(self) -> None:
        """Move the threshold by one step, up if there are too many species, down if too few."""
        surplus = int(np.sign(len(self.species) - self.config.target))
        moved = self.threshold + surplus * self.config.step
        self.threshold = max(moved, self.config.floor)

    def _sort(self, groups: Sequence[NDArray[np.int64]]) -> None:
        """Give these members to the species and to new ones; a species without any vanishes."""
        for species, members in zip(self.species, groups, strict=False):
            species.members = members
        for members in groups[len(self.species) :]:
            self._found(members)
        self.species = [species for species in self.species if species.members.size]

    def _found(self, members: ArrayLike) -> Species:
        self.founded += 1
        self.species.append(Species(self.founded, np.array(members, dtype=np.int64)))
        return self.species[-1]

    def state_dict(self) -> dict[str, Any]:
        """See `Kept`; the species, too."""
        species = [[one.species_id, one.members.tolist()] for one in self.species]
        return {"species": species, **super().state_dict()}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """See `Kept`; the species, too."""
        super().load_state(state)
        species = state["species"]
        self.species = [Species(key, np.array(members, np.int64)) for key, members in species]
        self._written.clear()
