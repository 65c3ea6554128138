"""Networks that do not evolve: what they learn is all that changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, Self

from numpy.typing import ArrayLike

from neatq_torch.evolution import NEAT, NEATConfig, Species
from neatq_torch.genome import Genome, pack_genomes, unpack_genomes


class Population(Protocol):
    """What a run asks of the genomes of an arena."""

    genomes: list[Genome]

    @property
    def species(self) -> list[Species]:
        """Genomes that are alike."""
        ...

    def write_back(self, slot: int, weights: ArrayLike) -> None:
        """Give the genome of a slot what was learnt."""
        ...

    def advance(self, fitness: ArrayLike) -> None:
        """Go on to the next generation; fitness [population]."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Everything that a checkpoint must keep."""
        ...


class FixedPopulation:
    """Genomes that stay, with the weights that they have learnt.

    Attributes:
        genomes: [population].
        species: None; nobody breeds.
    """

    def __init__(self, genomes: list[Genome]) -> None:
        self.genomes = genomes
        self.species: list[Species] = []

    @classmethod
    def start(cls, config: NEATConfig, **founders: Any) -> Self:
        """The founders that NEAT would begin with; see `NEAT.start`."""
        return cls(NEAT.start(config, **founders).genomes)

    def write_back(self, slot: int, weights: ArrayLike) -> None:
        """Give the genome of a slot what was learnt."""
        self.genomes[slot] = self.genomes[slot].with_weights(weights)

    def advance(self, fitness: ArrayLike) -> None:
        """Stay."""

    def state_dict(self) -> dict[str, Any]:
        """The genomes."""
        return {"genomes": pack_genomes(self.genomes)}

    @classmethod
    def from_state(cls, _: NEATConfig, state: Mapping[str, Any]) -> Self:
        """Go on from `state_dict`."""
        return cls(unpack_genomes(state["genomes"]))
