"""What a robot learnt, and what of it its children inherit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.genome import Genome
from neatq_torch.learning.learner import State
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
    for population, slot in _places(populations):
        population.write_back(slot, next(weights))


def _places(populations: Sequence[Heirs]) -> Iterator[tuple[Heirs, int]]:
    for population in populations:
        for slot in range(len(population.genomes)):
            yield population, slot


class PartialInheritance:
    """Writes a share of what was learnt since birth into the genes.

    A middle way between Lamarck and Darwin; the partial Lamarckianism of Houck et al. (1997), where
    a share of the individuals write back everything, is another.

    The gene of a link becomes (1 - share) * the weight it was born with + share * the weight
    learnt. The weights at birth are kept here, because a life is written back many times: a share
    of the difference to the gene of the last time would come to nearly all of it in the end.

    Args:
        share: Within (0, 1]; 1 is the whole of it, bit for bit.
        populations: The population of each arena, with genes as they were born.

    Attributes:
        born: Weights at birth of each place, float32 [links], arena after arena.

    Raises:
        ValueError: If the share is out of range.
    """

    def __init__(self, share: float, populations: Sequence[Heirs]) -> None:
        if not 0 < share <= 1:
            raise ValueError(f"share: expected within (0, 1], got {share}")
        self.share = share
        self.born: list[NDArray[np.float32]] = [
            population.genomes[slot].link_weight for population, slot in _places(populations)
        ]

    def write_back(self, network: PopulationNetwork, populations: Sequence[Heirs]) -> None:
        """Write the share of what every network learnt into its genome."""
        pairs = zip(_places(populations), self.born, network.link_weights(), strict=True)
        for (population, slot), born, learnt in pairs:
            # In double precision a weight that did not change comes out bit for bit.
            gene = (1 - self.share) * born.astype(np.float64) + self.share * learnt
            population.write_back(slot, gene.astype(np.float32))

    def reset(self, place: int, newborn: Genome) -> None:
        """Note what the newborn in a place (flat) is born with."""
        self.born[place] = newborn.link_weight

    def state(self) -> State:
        """The weights at birth."""
        return {"born": list(self.born)}

    def load_state(self, state: State) -> None:
        """Go on from `state`."""
        self.born = [np.asarray(weights, dtype=np.float32) for weights in state["born"]]
