"""What a robot learnt, and what of it its children inherit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Protocol

from numpy.typing import ArrayLike

from neatq_torch.genome import Genome
from neatq_torch.network import PopulationNetwork

Inheritance = Literal["lamarckian", "darwinian"]
"""`lamarckian`: learnt weights are written into the genome before it breeds. `darwinian`: learning
changes the robot's life and fitness, its genes never."""


class Heirs(Protocol):
    """What inheritance asks of a population, of whichever kind of evolution."""

    @property
    def genomes(self) -> Sequence[Genome]:
        """The genomes alive, in the order of their places."""
        ...

    def write_back(self, slot: int, weights: ArrayLike) -> None:
        """Give the genome in a place the weights, float32 [links], that were learnt there."""
        ...


def write_back(network: PopulationNetwork, populations: Sequence[Heirs]) -> None:
    """Copy every network's weights, bit for bit, into the genome that it was compiled from.

    Args:
        network: Networks of all robots, arena after arena.
        populations: The population of each arena.
    """
    weights = network.link_weights()
    for population in populations:
        for slot in range(len(population.genomes)):
            population.write_back(slot, next(weights))
