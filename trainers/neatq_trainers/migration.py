"""Islands: arenas that send each other genomes now and then, and evolve by themselves between.

Whitley, Rana & Heckendorn 1999 compare such models; with the defaults a copy of each island's
fittest goes to the next one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from neatq_torch.genome import Genome
from neatq_torch.kinds import check_fields

Topology = Literal["ring", "random", "all"]
Chosen = Literal["best", "random"]
MOST_ISLANDS = 1024
"""Arenas whose genes are numbered apart."""
ROUTES_STREAM, CHOICE_STREAM = 11, 12
"""Of random numbers: [seed, stream, how many times genomes have gone before]."""


@dataclass(frozen=True, kw_only=True)
class MigrationConfig:
    """How arenas exchange genomes.

    Attributes:
        every_ticks: Ticks from one time to the next; they go when the stride is over that reaches
            them.
        topology: Where they go: "ring", from each arena to the next; "random", each time along
            another ring; "all", from each to all others.
        emigrants: How many of an arena go on each of its ways.
        chosen: "best", the fittest of those who can be judged; "random", any of these.

    Example:
        >>> run = train("maze", arenas=8, settings={"migration": {"every_ticks": 2000}})
    """

    every_ticks: int = 2000
    topology: Topology = "ring"
    emigrants: int = 1
    chosen: Chosen = "best"

    def __post_init__(self) -> None:
        check_fields(self, every_ticks="[1, inf]", emigrants="[1, inf]")
        check_fields(self, topology=Topology, chosen=Chosen)


Travellers = list[list[Genome]]
"""Genomes that leave each of some arenas, or arrive there."""


def routes(migration: MigrationConfig, arenas: int, seed: int, times: int) -> list[list[int]]:
    """From which arenas genomes arrive in each arena, in this order."""
    if migration.topology == "all":
        return [[one for one in range(arenas) if one != arena] for arena in range(arenas)]
    ring = np.arange(arenas)
    if migration.topology == "random":
        ring = np.random.default_rng([seed, ROUTES_STREAM, times]).permutation(arenas)
    before = dict(zip(ring.tolist(), np.roll(ring, 1).tolist(), strict=True))
    return [[before[arena]] for arena in range(arenas)]


def arrivals(leaving: Sequence[Sequence[Genome]], ways: Sequence[Sequence[int]]) -> Travellers:
    """Who arrives in each arena."""
    return [[genome for arena in sources for genome in leaving[arena]] for sources in ways]
