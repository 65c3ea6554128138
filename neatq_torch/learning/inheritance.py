"""What a robot learnt, and what of it its children inherit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from neatq_torch.evolution import RtNEAT
from neatq_torch.network import PopulationNetwork

Inheritance = Literal["lamarckian", "darwinian"]
"""`lamarckian`: learnt weights are written into the genome before it breeds. `darwinian`: learning
changes the robot's life and fitness, its genes never."""


def write_back(network: PopulationNetwork, populations: Sequence[RtNEAT]) -> None:
    """Copy every network's weights, bit for bit, into the genome that it was compiled from.

    Args:
        network: Networks of all robots, arena after arena.
        populations: The population of each arena.
    """
    weights = network.link_weights()
    for population in populations:
        for slot in range(len(population.genomes)):
            population.write_back(slot, next(weights))
