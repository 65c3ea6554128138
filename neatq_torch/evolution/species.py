"""Species: who competes with whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.genome import (
    DistanceConfig,
    Genome,
    LinkTable,
    compatibility,
    first_compatible,
)


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
        """Check every value."""
        if not 0.0 < self.floor <= self.threshold:
            raise ValueError(
                f"expected 0 < floor <= threshold, got floor {self.floor} and threshold "
                f"{self.threshold}."
            )
        if self.target < 1 or self.adjust_every < 1:
            raise ValueError(
                f"target and adjust_every must be at least 1, not {self.target} and "
                f"{self.adjust_every}."
            )
        if self.step < 0.0:
            raise ValueError(f"step must be >= 0, not {self.step}.")


@dataclass
class Species:
    """Slots of compatible genomes, int64 [members]; the genome in the first represents them."""

    species_id: int
    members: NDArray[np.int64]

    def representative(self, genomes: Sequence[Genome]) -> Genome:
        """Return the genome that newcomers are compared with."""
        return genomes[self.members[0]]

    def rank(self, fitness: NDArray[np.float64]) -> None:
        """Sort members by fitness [slots], the fittest first, which then represents them."""
        self.members = self.members[np.argsort(-fitness[self.members], kind="stable")]


class Speciation:
    """All species of one population, in the order they were founded."""

    def __init__(self, config: SpeciesConfig, distance: DistanceConfig) -> None:
        """Start without species; `add` founds them."""
        self.config = config
        self.distance = distance
        self.species: list[Species] = []
        self.threshold = config.threshold
        self._founded = 0
        self._offspring = 0
        self._links = LinkTable()
        self._changed: set[int] = set()

    def of(self, slot: int) -> Species:
        """Return the species that the slot belongs to; KeyError if it belongs to none."""
        for species in self.species:
            if slot in species.members:
                return species
        raise KeyError(f"slot {slot} belongs to no species.")

    def sizes(self, slots: int) -> NDArray[np.int64]:
        """Return for each of [slots] how many members its species has."""
        sizes = np.ones(slots, dtype=np.int64)
        for species in self.species:
            sizes[species.members] = species.members.size
        return sizes

    def add(self, slot: int, genomes: Sequence[Genome]) -> Species:
        """Put a slot into the first compatible species, or found one for it."""
        self.changed(slot)
        for species in self.species:
            apart = compatibility(genomes[slot], species.representative(genomes), self.distance)
            if apart < self.threshold:
                species.members = np.append(species.members, slot)
                return species
        return self._found([slot])

    def changed(self, slot: int) -> None:
        """Note that a slot has another genome, or its genome other weights, than before."""
        self._changed.add(slot)

    def remove(self, slot: int) -> None:
        """Take a slot out of its species; a species without members vanishes."""
        species = self.of(slot)
        species.members = species.members[species.members != slot]
        if not species.members.size:
            self.species.remove(species)

    def count_offspring(self, genomes: Sequence[Genome], order: ArrayLike) -> None:
        """Note one offspring; every `adjust_every` of them move the threshold and reassign.

        Args:
            genomes: [slots] all genomes, the offspring included.
            order: [slots] slots in the order in which they are reassigned.
        """
        self._offspring += 1
        if self._offspring % self.config.adjust_every:
            return
        self.move_threshold()
        self._reassign(genomes, np.asarray(order, dtype=np.int64))

    def renew(self, genomes: Sequence[Genome], representatives: Sequence[Genome]) -> None:
        """Sort a whole new generation into species.

        Every genome joins the first species whose representative it is compatible with, or founds
        one. A species that nobody joins vanishes.

        Args:
            genomes: [slots] the generation, sorted in the order of its slots.
            representatives: one for each species, from the generation before.
        """
        home = first_compatible(genomes, representatives, self.threshold, self.distance)
        for species in range(len(self.species), int(home.max()) + 1):
            self._found(np.flatnonzero(home == species))
        for index, species in enumerate(self.species):
            species.members = np.flatnonzero(home == index)
        self.species = [species for species in self.species if species.members.size]

    def move_threshold(self) -> None:
        """Move the threshold by one step, up if there are too many species, down if too few."""
        surplus = int(np.sign(len(self.species) - self.config.target))
        moved = self.threshold + surplus * self.config.step
        self.threshold = max(moved, self.config.floor)

    def _reassign(self, genomes: Sequence[Genome], order: NDArray[np.int64]) -> None:
        """Move every slot to the first species it is compatible with, one after the other."""
        changed = list(self._changed)
        self._links.write(changed, [genomes[slot] for slot in changed])
        self._changed.clear()
        groups = [species.members for species in self.species]
        groups = self._links.regroup(groups, order, self.threshold, self.distance)
        for species, members in zip(self.species, groups, strict=False):
            species.members = members
        for members in groups[len(self.species) :]:
            self._found(members)
        self.species = [species for species in self.species if species.members.size]

    def _found(self, members: ArrayLike) -> Species:
        self._founded += 1
        self.species.append(Species(self._founded, np.array(members, dtype=np.int64)))
        return self.species[-1]

    def state_dict(self) -> dict[str, Any]:
        """Return species, threshold and counters as JSON values."""
        return {
            "species": [[one.species_id, one.members.tolist()] for one in self.species],
            "threshold": self.threshold,
            "founded": self._founded,
            "offspring": self._offspring,
        }

    @classmethod
    def from_state(
        cls, config: SpeciesConfig, distance: DistanceConfig, state: Mapping[str, Any]
    ) -> Self:
        """Return what `state_dict` described."""
        speciation = cls(config, distance)
        speciation.species = [
            Species(key, np.array(members, dtype=np.int64)) for key, members in state["species"]
        ]
        for species in speciation.species:
            speciation._changed.update(species.members.tolist())
        speciation.threshold = state["threshold"]
        speciation._founded = state["founded"]
        speciation._offspring = state["offspring"]
        return speciation
