"""Breeding in a population of 1,000 genomes of about 60 links.

rtNEAT replaces one genome at a time while the others live: choosing who goes, choosing parents,
crossover, mutation, species. Half of the population is always too young to be judged, as in a run.
neat-python makes a whole generation: `reproduce` and `speciate`. Both divided by the genomes born,
CPU time. Mutation rates are the same where both have them (`benchmarks/neat_python.cfg`). rtNEAT
steers towards 4 species; neat-python has a fixed threshold, here so wide that it finds one species,
which is the cheapest for it: with 17 it takes three times as long.

Why ours is not cheaper: of the time of a birth, a third goes into the offspring themselves and a
sixth into sorting all genomes into species again after every fifth birth, as OpenNERO does. The
rest judges the population, finds the worst and chooses parents: once for each birth here, once for
a thousand of them in a generation. Printed by

    python -c "import cProfile; from benchmarks.breeding import Living; one = Living();
    cProfile.run('one.birth_seconds(1000)', sort='cumulative')"
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks import neat_python
from benchmarks.genomes import OUTPUTS
from benchmarks.measure import in_rounds
from benchmarks.result import Line, compare, times_at_most
from neatq_torch.evolution import RtNEAT, RtNEATConfig

POPULATION = 1000
INPUTS = 19  # and the bias: 60 links; neat-python's nodes have a bias of their own beside 60 links
TICKS = 20  # ten replacements fall due in them


def run(quick: bool) -> list[Line]:
    """Measure births one by one and by generations."""
    rounds, births = (2, 200) if quick else (5, 1000)
    ours, theirs = Living(), Generations()
    samples = in_rounds(
        {"ours": lambda: ours.birth_seconds(births), "theirs": theirs.birth_seconds}, rounds=rounds
    )
    return [
        compare(
            "one offspring",
            samples["ours"] * 1e6,
            "neat-python",
            samples["theirs"] * 1e6,
            unit="us",
            goal=times_at_most(0.1),
            note=f"Species at the end: {len(ours.population.species)} here, "
            f"{len(theirs.population.species.species)} in neat-python.",
        )
    ]


class Living:
    """rtNEAT with random rewards, warmed up until half of the population is too young."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)
        config = RtNEATConfig(minimum_life_ticks=1000)
        self.population = RtNEAT.start(
            config, slots=POPULATION, inputs=INPUTS, outputs=OUTPUTS, rng=0
        )
        self.population.record(np.zeros((POPULATION, 1000, 1)))
        self.birth_seconds(POPULATION)

    def birth_seconds(self, births: int) -> float:
        """CPU seconds of one replacement, over at least `births` of them."""
        seconds, born = 0.0, 0
        while born < births:
            self.population.record(self.rng.random((POPULATION, TICKS, 1)))
            begin = time.process_time()
            born += len(self.population.advance())
            seconds += time.process_time() - begin
        return seconds / born


class Generations:
    """neat-python with random fitness."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.population = neat_python.population(seed=0)
        self.birth_seconds()

    def birth_seconds(self) -> float:
        """CPU seconds for one genome of the next generation."""
        whole = self.population
        fitness = self.rng.random(len(whole.population)).tolist()
        for genome, value in zip(whole.population.values(), fitness, strict=True):
            genome.fitness = value
        begin = time.process_time()
        config = whole.config
        whole.population = whole.reproduction.reproduce(
            config, whole.species, config.pop_size, whole.generation
        )
        whole.species.speciate(config, whole.population, whole.generation)
        seconds = time.process_time() - begin
        whole.generation += 1
        return seconds / len(whole.population)
