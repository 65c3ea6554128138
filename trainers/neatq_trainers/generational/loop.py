"""The training loop: one generation after the other."""

from __future__ import annotations

import numpy as np

from neatq_envs.torchrl_rows import episode_seeds
from neatq_torch.genome import Genome
from neatq_trainers.generational.lives import Outcome
from neatq_trainers.generational.metrics import Row
from neatq_trainers.generational.purposes import (
    EVALUATION,
    EXPLORATION,
    PRETRAINING,
    TEST,
    TRAINING,
)
from neatq_trainers.generational.recording import Lessons, merged
from neatq_trainers.generational.run import Champion, Run
from neatq_trainers.generational.team import Team


def train_generation(run: Run, team: Team) -> list[Row]:
    """One generation of all arenas: live, evaluate, breed; returns a row for each arena.

    If something fails before breeding, the run is as it was.
    """
    config = run.config
    shape = (config.arenas, config.population)
    genomes = [genome for population in run.populations for genome in population.genomes]
    starts = _seeds(run, TRAINING, run.generation, config.episodes, config.population)

    lived = team.live(genomes, starts, _exploration(run), _lessons(run))  # compile, act, learn

    fitness = lived.returns.mean(1).reshape(shape)
    learnt = [one.with_weights(own) for one, own in zip(genomes, lived.weights, strict=True)]
    scores = _evaluate(run, team, learnt, fitness) if _evaluates(run) else None
    if scores is not None:
        run.champions = _best(run, scores)
    run.steps = run.steps + lived.steps.reshape(shape).sum(1)
    rows = _rows(run, lived, fitness, scores)
    if lived.transitions:
        arenas = range(0, len(genomes), config.population)
        run.memories = [merged(lived.transitions[i : i + config.population]) for i in arenas]
    for arena, population in enumerate(run.populations):
        if config.learning.inheritance == "lamarckian":
            for slot in range(config.population):
                place = arena * config.population + slot
                population.write_back(slot, lived.weights[place])
        population.advance(fitness[arena])  # breed
    run.generation += 1
    return rows


def try_champions(run: Run, team: Team) -> np.ndarray:
    """Returns of each arena's champion on episodes of their own, float64 [arenas, episodes]."""
    episodes = run.config.evaluation.test_episodes
    return _play(run, team, [[one.genome] for one in run.champions], TEST, episodes)[:, 0]


def _evaluates(run: Run) -> bool:
    return not run.generation or not (run.generation + 1) % run.config.evaluation.every


def _evaluate(
    run: Run, team: Team, genomes: list[Genome], fitness: np.ndarray
) -> list[list[Champion]]:
    """The fittest of each arena, with their mean returns without exploration and learning."""
    evaluation = run.config.evaluation
    fittest = np.argsort(-fitness, axis=1, kind="stable")[:, : evaluation.genomes]
    places = fittest + np.arange(len(fitness))[:, None] * fitness.shape[1]
    chosen = [[genomes[place] for place in own] for own in places]
    scores = _play(run, team, chosen, EVALUATION, evaluation.episodes).mean(2)
    number = run.generation + 1
    return [
        [Champion(one, float(score), number) for one, score in zip(own, each, strict=True)]
        for own, each in zip(chosen, scores, strict=True)
    ]


def _play(
    run: Run, team: Team, genomes: list[list[Genome]], purpose: int, episodes: int
) -> np.ndarray:
    """Returns of genomes [arenas][genomes], without exploration and learning.

    Returns:
        Float64 [arenas, genomes, episodes].
    """
    each = len(genomes[0])
    starts = _seeds(run, purpose, 0, episodes, each)
    flat = [genome for own in genomes for genome in own]
    return team.live(flat, starts, None).returns.reshape(len(genomes), each, episodes)


def _best(run: Run, evaluated: list[list[Champion]]) -> list[Champion]:
    """The champion of each arena; of equal ones the newer, and of these the fitter."""
    newest = [max(own, key=lambda one: one.score) for own in evaluated]
    before = run.champions or newest
    return [a if a.score > b.score else b for a, b in zip(before, newest, strict=True)]


def _seeds(run: Run, purpose: int, generation: int, episodes: int, lives: int) -> np.ndarray:
    """Of the starts of episodes [arenas x lives, episodes]: the same for all lives of an arena."""
    arenas = [
        episode_seeds(seed, generation, episodes, purpose=purpose) for seed in run.config.seeds
    ]
    return np.repeat(np.stack(arenas), lives, axis=0)


def _exploration(run: Run) -> np.ndarray:
    """The seed of each life's exploration: of (seed of the arena, generation, slot)."""
    return np.array(
        [
            np.random.SeedSequence([seed, EXPLORATION, run.generation, slot]).generate_state(1)[0]
            for seed in run.config.seeds
            for slot in range(run.config.population)
        ],
        np.int64,
    )


def _lessons(run: Run) -> Lessons | None:
    """What the generation before has left; the first has none."""
    if not run.memories:
        return None
    seeds = [
        np.random.SeedSequence([seed, PRETRAINING, run.generation]).generate_state(1)[0]
        for seed in run.config.seeds
    ]
    memory_of = np.repeat(np.arange(run.config.arenas), run.config.population)
    return Lessons(run.memories, np.array(seeds, np.int64), memory_of)


def _rows(
    run: Run, lived: Outcome, fitness: np.ndarray, scores: list[list[Champion]] | None
) -> list[Row]:
    error = lived.td_error.reshape(fitness.shape).mean(1)
    rows = []
    for arena, population in enumerate(run.populations):
        genomes = population.genomes
        rows.append(
            Row(
                arena=arena,
                generation=run.generation + 1,
                episodes=(run.generation + 1) * fitness.shape[1] * lived.returns.shape[1],
                steps=int(run.steps[arena]),
                best_fitness=float(fitness[arena].max()),
                mean_fitness=float(fitness[arena].mean()),
                evaluated_return=max(one.score for one in scores[arena]) if scores else None,
                champion_return=run.champions[arena].score,
                species=len(population.species),
                mean_nodes=float(np.mean([one.node_id.size for one in genomes])),
                mean_links=float(np.mean([one.link_enabled.sum() for one in genomes])),
                td_error=None if np.isnan(error[arena]) else float(error[arena]),
            )
        )
    return rows
