"""Breeding genomes of about 60 links: whole generations of 1,000 and 10,000, and single births.

A generation is reproduction and speciation: `NEAT.tell` here, `reproduce` and `speciate` in
neat-python, divided by the genomes born, CPU time. Fitness is random. Mutation rates and the share
that may breed are the same where both have them (`benchmarks/neat_python.cfg`). NEAT here steers
towards 4 species and with random fitness finds more (the notes say how many); neat-python has a
fixed threshold, here so wide that it finds one species, which is the cheapest for it: with 17 it
takes three times as long.

rtNEAT replaces one genome of 1,000 at a time while the others live. Half of the population is
always too young to be judged, as in a run. Beside it the same generations of neat-python. Why a
birth alone is not ten times cheaper, like one among a thousand: of its time a quarter goes into the
offspring itself, where handing genes and chance to compiled code and back takes longer than the
breeding; a sixth into sorting all genomes into species again after every fifth birth, as OpenNERO
does. The rest judges the population, finds the worst and chooses parents: once for each birth here,
once for a thousand of them in a generation. Printed by

    python -c "import cProfile; from benchmarks.breeding import Living; one = Living();
    cProfile.run('one.birth_seconds(1000)', sort='cumulative')"
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks import neat_python
from benchmarks.genomes import OUTPUTS
from benchmarks.measure import Samples, in_rounds
from benchmarks.result import Line, compare, times_at_most
from neatq_torch.evolution import (
    NEAT,
    NEATConfig,
    Population,
    RtNEAT,
    RtNEATConfig,
    SpeciesConfig,
)

POPULATION = 1000
LARGE = 10_000
INPUTS = 19  # and the bias: 60 links; neat-python's nodes have a bias of their own beside 60 links
TICKS = 20  # ten replacements fall due in them


def run(quick: bool) -> list[Line]:
    """Measure births by generations and one by one."""
    rounds, births = (2, 200) if quick else (5, 1000)
    lines: list[Line] = []
    for size in (POPULATION, LARGE):
        ours, theirs = Bred(size), Generations(size)
        actions = {"ours": ours.birth_seconds, "theirs": theirs.birth_seconds}
        what = f"one of a generation of {size:,}"
        lines.append(_beside(what, in_rounds(actions, rounds=rounds), ours.population, theirs))
    living, theirs = Living(), Generations(POPULATION)
    actions = {"ours": lambda: living.birth_seconds(births), "theirs": theirs.birth_seconds}
    what = f"one birth in rtNEAT while {POPULATION:,} live"
    return [*lines, _beside(what, in_rounds(actions, rounds=rounds), living.population, theirs)]


def _beside(what: str, samples: Samples, ours: Population, theirs: Generations) -> Line:
    return compare(
        what,
        samples["ours"] * 1e6,
        "neat-python",
        samples["theirs"] * 1e6,
        unit="us",
        goal=times_at_most(0.1),
        note=f"Species at the end: {len(ours.species)} here, "
        f"{len(theirs.population.species.species)} in neat-python.",
    )


class Bred:
    """NEAT with random fitness."""

    def __init__(self, size: int) -> None:
        self.rng = np.random.default_rng(0)
        config = NEATConfig(species=SpeciesConfig(), survival_share=0.5)
        self.population = NEAT.start(config, slots=size, inputs=INPUTS, outputs=OUTPUTS, rng=0)
        self.birth_seconds()

    def birth_seconds(self) -> float:
        """CPU seconds for one genome of the next generation."""
        fitness, before = self.rng.random(len(self.population.genomes)), self.population.births
        begin = time.process_time()
        self.population.tell(fitness)
        seconds = time.process_time() - begin
        return seconds / (self.population.births - before)


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

    def __init__(self, size: int) -> None:
        self.rng = np.random.default_rng(0)
        self.population = neat_python.population(size, seed=0)
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
