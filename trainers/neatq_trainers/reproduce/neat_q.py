"""NEAT+Q beside its parts, as Whiteson & Stone (2006) compared them.

Mountain car from starts all over the state space, and server job scheduling with utility rates of
our own (see `neatq_envs.server_jobs`). All arms have as many episodes: `neat` and `neatq` share
them among the genomes of their generations, `qnetwork` among ten networks of fixed topology that
learn on, of which the best counts. The paper's budgets are larger; its figures are no numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from neatq_envs.server_jobs import (
    best_returns,
    greedy_policy,
    oldest_policy,
    ordered_policy,
    play,
    random_policy,
    urgent_policy,
)
from neatq_trainers.generational.config import EvaluationConfig, GenerationalConfig, preset
from neatq_trainers.reproduce.experiment import (
    Experiment,
    Result,
    Results,
    Task,
    bootstrap_interval,
    column,
    mean_and_error,
)
from neatq_trainers.reproduce.generational import champion_at, episodes_to, run_seeds

ARMS = ("neatq", "neat", "qnetwork")
PRETRAINING_ARMS = {"pretrained": 200, "neatq": 0}
"""Minibatches before the first step of a life."""
THRESHOLD = -60.0
POPULATION, NETWORKS = 50, 10
GENERATIONS, QUICK_GENERATIONS = 40, 5


class Budget(NamedTuple):
    """How a task is run.

    Attributes:
        task: "gym:" and an id.
        episodes: of a life in a population of 50.
        held_out: episodes of an evaluation.
        tested: episodes of the final test.
        env_kwargs: arguments of the environment.
    """

    task: str
    episodes: int
    held_out: int
    tested: int
    env_kwargs: tuple[str, ...] = ()


MOUNTAIN_CAR = Budget("gym:neatq/MountainCar-v0", 10, 100, 1000, ("max_episode_steps=500",))
FEW_EPISODES = MOUNTAIN_CAR._replace(episodes=2)
SERVER_JOBS = Budget("gym:neatq/ServerJobs-v0", 4, 50, 300)


def config(budget: Budget, arm: str, *, quick: bool) -> GenerationalConfig:
    """The configuration of an arm: the trainer's own, at this budget."""
    population = NETWORKS if arm == "qnetwork" else POPULATION
    return replace(
        preset(budget.task, arm),
        population=population,
        episodes=budget.episodes * POPULATION // population,
        generations=QUICK_GENERATIONS if quick else GENERATIONS,
        env_kwargs=budget.env_kwargs,
        evaluation=EvaluationConfig(
            every=5, genomes=3, episodes=budget.held_out, test_episodes=budget.tested
        ),
    )


def drive(task: Task) -> list[Result]:
    """Run an arm on the mountain car."""
    return run_seeds(task, config(MOUNTAIN_CAR, task.arm, quick=task.quick))


def schedule(task: Task) -> list[Result]:
    """Run an arm on server job scheduling."""
    return run_seeds(task, config(SERVER_JOBS, task.arm, quick=task.quick))


def pretrain(task: Task) -> list[Result]:
    """Run NEAT+Q on the mountain car with or without pre-training; each generation is evaluated."""
    steps = PRETRAINING_ARMS[task.arm]
    made = config(FEW_EPISODES, "neatq", quick=task.quick)
    return run_seeds(
        task,
        replace(
            made,
            pretraining=replace(made.pretraining, steps=steps),
            evaluation=replace(made.evaluation, every=1),
        ),
    )


def pretraining_table(results: Results) -> str:
    """Episodes until a champion was evaluated at the threshold, as Markdown."""
    lines = [
        f"| arm | runs | reached {THRESHOLD:g} | episodes until then | 95 % interval | "
        "return after all episodes |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for arm, runs in results.items():
        if not runs:
            continue
        reached = [episodes_to(one, THRESHOLD) for one in runs]
        # A run that never got there counts with all its episodes, which is too few.
        needed = [
            one["episodes"] if at is None else at for one, at in zip(runs, reached, strict=True)
        ]
        low, high = bootstrap_interval(needed)
        count = sum(at is not None for at in reached)
        lines.append(
            f"| {arm} | {len(runs)} | {count} | {mean_and_error(needed, 0)} | {low:,.0f} to "
            f"{high:,.0f} | {mean_and_error(column(runs, 'return'))} |"
        )
    return "\n".join(lines) + "\n"


def mountain_car_table(results: Results) -> str:
    """Ours beside the optimum, as Markdown."""
    return _table(results, digits=1) + "\nThe best possible return is -49.2 on average.\n"


def server_jobs_table(results: Results) -> str:
    """Ours beside policies that do not learn, as Markdown."""
    seeds = range(300)
    known = {
        "oldest first": play(oldest_policy, seeds),
        "random": play(random_policy(np.random.default_rng(0)), seeds),
        "greedy": play(greedy_policy, seeds),
        "most urgent first": play(urgent_policy, seeds),
        "best fixed order": play(ordered_policy, seeds),
        "oracle that knows all arrivals": best_returns(seeds),
    }
    lines = ["", "| policy | mean return of 300 episodes |", "| --- | --- |"]
    lines += [f"| {name} | {mean_and_error(value, 0)} |" for name, value in known.items()]
    return _table(results, digits=0) + "\n".join(lines) + "\n"


def _table(results: Results, digits: int) -> str:
    lines = [
        "| arm | runs | episodes | steps | champion's return | worst run | a quarter of the "
        "episodes | neatq is better by |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for arm, runs in results.items():
        if not runs:
            continue
        value, episodes = column(runs, "return"), column(runs, "episodes").mean()
        steps = column(runs, "steps").mean()
        early = mean_and_error(champion_at(runs, episodes / 4), digits)
        cells = [f"{len(runs)}", f"{episodes:,.0f}", f"{steps:,.0f}"]
        cells += [mean_and_error(value, digits), f"{value.min():,.{digits}f}", early]
        cells.append(_advantage(results.get("neatq", []), runs, digits) if arm != "neatq" else "")
        lines.append(f"| {arm} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _advantage(neatq: Sequence[Result], others: Sequence[Result], digits: int) -> str:
    """Mean difference of paired seeds, with its bootstrap interval."""
    theirs = {one["seed"]: one["return"] for one in others}
    apart = [one["return"] - theirs[one["seed"]] for one in neatq if one["seed"] in theirs]
    if not apart:
        return ""
    low, high = bootstrap_interval(apart)
    return f"{np.mean(apart):,.{digits}f} ({low:,.{digits}f} to {high:,.{digits}f})"


def draw(results: Results) -> Figure:
    """The champions' returns over the episodes: mean over seeds, and a 95 % interval."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for arm, runs in results.items():
        if not runs:
            continue
        curves = np.array([one["curve"] for one in runs])
        episodes, returns = curves[0, :, 0], curves[:, :, 1]
        bands = np.array([bootstrap_interval(values) for values in returns.T])
        (line,) = axes.plot(episodes, returns.mean(0), label=arm)
        axes.fill_between(episodes, *bands.T, color=line.get_color(), alpha=0.2, lw=0)
    axes.set_xlabel("episodes")
    axes.set_ylabel("return of the champion, held-out episodes")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, title="mean, 95 % interval")
    return figure


def _experiment(name: str, summary: str, arms: tuple[str, ...], **parts: Any) -> Experiment:
    return Experiment(
        name=name,
        summary=summary,
        arms=arms,
        seeds=10,
        quick_seeds=2,
        batch=5,
        figure=draw,
        **parts,
    )


EXPERIMENTS = (
    _experiment(
        "mountain-car",
        "NEAT+Q, NEAT and Q-learning on the mountain car (Whiteson & Stone 2006)",
        ARMS,
        run=drive,
        table=mountain_car_table,
    ),
    _experiment(
        "server-jobs",
        "NEAT+Q, NEAT and Q-learning on server job scheduling (Whiteson & Stone 2006)",
        ARMS,
        run=schedule,
        table=server_jobs_table,
    ),
    _experiment(
        "pretraining",
        "NEAT+Q with and without off-line pre-training (Whiteson & Stone 2006b)",
        tuple(PRETRAINING_ARMS),
        run=pretrain,
        table=pretraining_table,
    ),
)
