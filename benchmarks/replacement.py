"""A newborn takes a place among 1,000 networks of 60 to 90 links.

Offspring of the networks themselves, one mutation away, take random places one after the other
(1,000 of them in a round), so the layout must be made anew now and then; the mean has its cost in
it. What the next forward pass costs more than the one after it is added: work that is put off is
work. CPU time. The reference is what a library without replacement does: build everything again.
"""

from __future__ import annotations

import time

import numpy as np
import torch

from benchmarks.genomes import INPUTS, evolved
from benchmarks.measure import in_rounds
from benchmarks.result import Line, compare, cost_at_most
from neatq_torch.genome import Genome, InnovationLedger, MutationConfig, mutate
from neatq_torch.network import PopulationNetwork

NETWORKS = 1000
RARE_GROWTH = MutationConfig(recurrent_link_prob=0.0)
"""rtNEAT's own rates: 3 % new nodes, 5 % new links."""


def run(quick: bool) -> list[Line]:
    """Measure mean and median of many replacements."""
    births, rounds = (200, 2) if quick else (1000, 3)
    genomes = evolved(NETWORKS, seed=3)
    costs: list[np.ndarray] = []

    def replaced() -> float:
        costs.append(_replacement_seconds(genomes, births, seed=len(costs)))
        return float(costs[-1].mean())

    samples = in_rounds(
        {"ours": replaced, "all": lambda: _building_seconds(genomes)}, rounds=rounds
    )
    medians = np.array([np.median(one) for one in costs])
    reference = "building all networks"
    return [
        compare(
            f"one of {NETWORKS:,} replaced, {name}",
            ours * 1e3,
            reference,
            samples["all"] * 1e3,
            unit="ms",
            goal=cost_at_most(1.0, "at most 1 ms"),
        )
        for name, ours in (("mean", samples["ours"]), ("median", medians))
    ]


def _replacement_seconds(genomes: list[Genome], births: int, seed: int) -> np.ndarray:
    """CPU seconds of each replacement, with what the next forward costs for it [births]."""
    network = PopulationNetwork(genomes)
    observation = torch.rand(NETWORKS, INPUTS, generator=torch.Generator().manual_seed(seed))
    seconds = []
    with torch.no_grad():
        network(observation)
        for place, child in _births(genomes, births, seed):
            clock = [time.process_time()]
            network.replace(place, child)
            clock.append(time.process_time())
            for _ in range(2):
                network(observation)
                clock.append(time.process_time())
            replaced, first, second = np.diff(clock)
            seconds.append(replaced + first - second)
    return np.array(seconds)


def _births(genomes: list[Genome], births: int, seed: int) -> list[tuple[int, Genome]]:
    rng = np.random.default_rng(seed)
    alive, ledger = list(genomes), InnovationLedger.for_genomes(genomes)
    born = []
    for number in range(births):
        parent, place = rng.integers(len(alive), size=2).tolist()
        child = mutate(alive[parent], RARE_GROWTH, ledger, rng)
        alive[place] = child.replaced(genome_id=len(genomes) + 1 + number)
        born.append((place, alive[place]))
    return born


def _building_seconds(genomes: list[Genome]) -> float:
    begin = time.process_time()
    PopulationNetwork(genomes)
    return time.process_time() - begin
