"""Social learning, as in Tansey, Feasley & Miikkulainen 2012: do the rewarded make good teachers?

A hundred agents look for plants, see `neatq_experiments.foraging_world`. In egalitarian social
learning whoever is rewarded teaches the others of its subculture what it just did: each takes one
step of backpropagation. What was learnt goes back into the genomes before they breed (Lamarckian),
or does not (Darwinian). Evolution is NEAT with the settings of its paper, without recurrent links,
but with plain sigmoids: which the authors took is not known, and where they are as steep as NEAT's
(arms that end in "-steep") the gradient of a lesson is five times as large.

The same seed has the same founders and the same layouts of plants in all arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from neatq_experiments.compare.statistics import bootstrap_interval
from neatq_experiments.experiment import Experiment, mean_and_error
from neatq_experiments.foraging_world import (
    ALONE,
    EGALITARIAN,
    MOTIONS,
    SECTORS,
    STUDENT_TEACHER,
    Meadow,
    brains_of,
    live,
    standing_walkers,
    weights_of,
)
from neatq_experiments.seeds import Result, Results, SeedTask
from neatq_torch.evolution import NEAT, NEAT_2002, NEATConfig

AGENTS, SUBCULTURES = 100, 10
LIFE_STEPS = 1_000
QUICK_FORAGING_GENERATIONS = 3

Grouping = Literal["one", "random", "species"]


class Terrain(NamedTuple):
    """A world in which plants are scattered anew for each generation.

    Attributes:
        size: of its sides, in units.
        worth: reward for a plant of each kind.
        each: plants of each kind.
        generations: of a run.
        shown: generations that the table has, as far as they were reached.
    """

    size: float
    worth: tuple[float, ...]
    each: int
    generations: int
    shown: tuple[int, ...]


COMPLEX = Terrain(500.0, (-100.0, -50.0, 0.0, 50.0, 100.0), 20, 101, (0, 10, 50, 100, 500))
SIMPLE = Terrain(2_000.0, (100.0,), 100, 201, (0, 5, 20, 200))


@dataclass(frozen=True, kw_only=True)
class Society:
    """Who learns from whom.

    Attributes:
        teaching: ALONE, EGALITARIAN or STUDENT_TEACHER.
        grouping: how groups come about, anew in each generation: "one" of all, ten "random" ones
            of equal size, or the "species".
        lamarckian: whether what was learnt is inherited.
        activation: of hidden nodes and outputs.
    """

    teaching: int = EGALITARIAN
    grouping: Grouping = "random"
    lamarckian: bool = True
    activation: str = "sigmoid"

    @property
    def evolution(self) -> NEATConfig:
        """NEAT's own settings but for the activation."""
        mutation = replace(NEAT_2002.mutation, hidden_activation=self.activation)
        return NEATConfig(reproduction=replace(NEAT_2002, mutation=mutation))


SOCIETIES = {
    "neat": Society(teaching=ALONE),
    "esl": Society(),
    "esl-species": Society(grouping="species"),
    "esl-darwinian": Society(lamarckian=False),
    "esl-species-darwinian": Society(grouping="species", lamarckian=False),
    "esl-one-culture": Society(grouping="one"),
    "student-teacher": Society(teaching=STUDENT_TEACHER),
    "neat-steep": Society(teaching=ALONE, activation="steep_sigmoid"),
    "esl-steep": Society(activation="steep_sigmoid"),
}

ALL_WORLDS = ("neat", "esl", "esl-darwinian", "esl-one-culture", "student-teacher")

PUBLISHED_COMPLEX = {
    "neat": {0: 910, 10: 1_713, 50: 2_120, 500: 2_000},
    "esl-species": {0: 1_417, 10: 2_755, 50: 2_750, 500: 2_850},
    "esl-species-darwinian": {0: 1_497, 10: 1_917, 50: 2_087, 500: 2_633},
    "student-teacher": {0: 847, 10: 1_877, 50: 2_228, 500: 2_800},
}
PUBLISHED_SIMPLE = {
    "neat": {0: 1_503, 5: 2_605, 20: 3_148, 200: 3_814},
    "esl": {0: 1_733, 5: 3_203, 20: 3_697, 200: 3_760},
    "esl-one-culture": {0: 2_257, 5: 3_123, 20: 3_328, 200: 3_580},
}
"""Population best by generation, means over 30 runs, read from the authors' result files; which
files belong to which figure is inferred."""


def run_foraging(terrain: Terrain, task: SeedTask) -> list[Result]:
    """Evolve once for each seed."""
    if task.quick:
        terrain = terrain._replace(generations=QUICK_FORAGING_GENERATIONS)
    return [forage(terrain, SOCIETIES[task.arm], seed) for seed in task.seeds]


def forage(terrain: Terrain, society: Society, seed: int) -> Result:
    """Evolve for all generations: `best` and `mean` fitness and mean `lessons` of each of them."""
    chance, nature, fate = (np.random.default_rng([seed, part]) for part in range(3))
    inputs = len(terrain.worth) * SECTORS + 1
    population = NEAT.start(
        society.evolution, slots=AGENTS, inputs=inputs, outputs=MOTIONS, rng=chance
    )
    rows: list[tuple[float, float, float]] = []
    for generation in range(terrain.generations):
        group = subcultures(society, population, fate)
        fitness, lessons = raise_all(population, society, sow(terrain, nature), group)
        rows.append((fitness.max(), fitness.mean(), lessons.mean()))
        if generation < terrain.generations - 1:
            population.tell(fitness)
    best, mean, taken = np.array(rows).T.tolist()
    return {"best": best, "mean": mean, "lessons": taken}


def sow(terrain: Terrain, rng: np.random.Generator) -> Meadow:
    """Scatter plants evenly at random."""
    kinds = len(terrain.worth)
    x, y = rng.uniform(0.0, terrain.size, (2, kinds * terrain.each))
    kind = np.repeat(np.arange(kinds), terrain.each)
    return Meadow(terrain.size, x, y, kind, np.array(terrain.worth))


def subcultures(society: Society, population: NEAT, rng: np.random.Generator) -> NDArray[np.int64]:
    """The group of each agent, from 0 on, int64 [agents]."""
    agents = len(population.genomes)
    group = np.zeros(agents, np.int64)
    if society.grouping == "random":
        group[rng.permutation(agents)] = np.arange(agents) * SUBCULTURES // agents
    elif society.grouping == "species":
        for number, species in enumerate(population.species):
            group[species.members] = number
    return group


def raise_all(
    population: NEAT, society: Society, meadow: Meadow, group: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Let a generation live; its genomes then have what was learnt, if that is inherited.

    Returns:
        Fitness, float64 [agents], and lessons of each agent, int64 [agents].
    """
    brains = brains_of(population.genomes)
    walkers = standing_walkers(len(population.genomes), meadow)
    lived = live(brains, walkers, meadow, group, society.teaching, LIFE_STEPS)
    if society.lamarckian:
        for slot, weights in enumerate(weights_of(brains, population.genomes)):
            population.write_back(slot, weights)
    return lived


def foraging_table(terrain: Terrain, published: dict[str, dict[int, int]], results: Results) -> str:
    """Population best by generation, ours beside the published one, as Markdown.

    A single generation has a layout of its own, of luck; hence also means over twenty of them.
    """
    shown = terrain.shown
    names = [f"generation {one}" for one in shown] + ["1 to 20", "last 20"]
    lines = [f"| arm | runs | {' | '.join(names)} |", f"| --- | --- |{' --- |' * len(names)}"]
    for arm, runs in results.items():
        if runs:
            cells = [best_over(runs, slice(one, one + 1)) for one in shown]
            cells += [best_over(runs, slice(1, 21)), best_over(runs, slice(-20, None))]
            lines.append(f"| {arm} | {len(runs)} | {' | '.join(cells)} |")
        if arm in published:
            cells = [f"{published[arm][one]:,}" if one in published[arm] else "" for one in shown]
            lines.append(f"| {arm}, published | 30 | {' | '.join(cells)} |  |  |")
    return "\n".join(lines) + "\n"


def best_over(runs: Sequence[Result], generations: slice) -> str:
    """Mean and standard error of the mean population best; nothing beyond the end of the runs."""
    values = [np.mean(one["best"][generations]) for one in runs if one["best"][generations]]
    return mean_and_error(values, 0) if values else ""


def draw_foraging(published: dict[str, dict[int, int]], results: Results) -> Figure:
    """Population best over generations: mean over seeds, a 95 % interval, and published points."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.add_subplot()
    for arm, runs in results.items():
        if not runs:
            continue
        generations, curves = in_blocks(np.array([one["best"] for one in runs]))
        bands = np.array([bootstrap_interval(values) for values in curves.T])
        (line,) = axes.plot(generations, curves.mean(0), label=arm)
        axes.fill_between(generations, *bands.T, color=line.get_color(), alpha=0.1, lw=0)
        for generation, best in published.get(arm, {}).items():
            if generation <= len(runs[0]["best"]):
                axes.plot([generation], [best], "o", color=line.get_color(), mec="black")
    axes.set_xlabel("generation")
    axes.set_ylabel("fitness of the best of a generation")
    axes.set_xscale("symlog", linthresh=10)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, title="mean, 95 % interval; dots: published")
    return figure


def in_blocks(curves: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means over blocks of generations, which grow from the tenth on: a layout is luck.

    Returns:
        The middle of each block, and `curves` [runs, generations] as [runs, blocks].
    """
    end = curves.shape[1]
    grown = np.geomspace(10, max(end, 10), 14).astype(np.int64)
    starts = np.unique(np.concatenate([np.arange(10), grown]))
    starts = starts[starts < end]
    sizes = np.diff(starts, append=end)
    return starts + (sizes - 1) / 2, np.add.reduceat(curves, starts, axis=1) / sizes


def _foraging_experiment(
    name: str,
    summary: str,
    terrain: Terrain,
    arms: tuple[str, ...],
    published: dict[str, dict[int, int]],
) -> Experiment:
    return Experiment(
        name=name,
        summary=summary,
        arms=arms,
        seeds=6,
        quick_seeds=2,
        run=partial(run_foraging, terrain),
        table=partial(foraging_table, terrain, published),
        figure=partial(draw_foraging, published),
    )


FORAGING = (
    _foraging_experiment(
        "foraging",
        "Social learning among five kinds of plants (Tansey, Feasley & Miikkulainen 2012).",
        COMPLEX,
        (*ALL_WORLDS, "esl-species", "esl-species-darwinian"),
        PUBLISHED_COMPLEX,
    ),
    _foraging_experiment(
        "foraging-simple",
        "Social learning in a large world with plants of one kind (the same).",
        SIMPLE,
        (*ALL_WORLDS, "neat-steep", "esl-steep"),
        PUBLISHED_SIMPLE,
    ),
)
