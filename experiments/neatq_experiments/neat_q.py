"""NEAT+Q beside its parts, as Whiteson & Stone (2006) compared them.

Mountain car from starts all over the state space, and server job scheduling with utility rates of
our own (see `neatq_envs.server_jobs`). All arms have as many episodes: `neat` and `neat+q` share
them among the genomes of their generations, `qnetwork` among ten networks of fixed topology that
learn on, of which the best counts. The paper's budgets are larger; its figures are no numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from neatq_experiments.compare.statistics import bootstrap_interval
from neatq_experiments.experiment import Experiment, column, mean_and_error
from neatq_experiments.generational import champion_at, run_rows
from neatq_experiments.seeds import Result, Results, SeedTask
from neatq_experiments.server_jobs_reference import (
    best_returns,
    greedy_policy,
    oldest_policy,
    ordered_policy,
    play_jobs,
    random_policy,
    urgent_policy,
)
from neatq_trainers.arms import preset
from neatq_trainers.config import RunConfig

NEAT_Q_ARMS = ("neat+q", "neat", "qnetwork")
EVOLVING, NETWORKS = 50, 10
FULL_GENERATIONS, QUICK_GENERATIONS = 40, 5


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
    env_kwargs: Mapping[str, Any] = MappingProxyType({})


MOUNTAIN_CAR = Budget("gym:neatq/MountainCar-v0", 10, 100, 1000, {"max_episode_steps": 500})
SERVER_JOBS = Budget("gym:neatq/ServerJobs-v0", 4, 50, 300)


def budget_config(budget: Budget, arm: str, *, quick: bool) -> RunConfig:
    """The configuration of an arm: the trainer's own, at this budget."""
    slots = NETWORKS if arm == "qnetwork" else EVOLVING
    length = {"generations": QUICK_GENERATIONS if quick else FULL_GENERATIONS}
    config = preset(budget.task, arm, env_kwargs=budget.env_kwargs, length=length)
    return config.changed(
        {
            "world.slots": slots,
            "world.evaluated": 3,
            "world.episodes": budget.held_out,
            "world.test_episodes": budget.tested,
            "population.episodes": budget.episodes * EVOLVING // slots,
        }
    )


def drive_car(task: SeedTask) -> list[Result]:
    """Run an arm on the mountain car."""
    return run_rows(task, budget_config(MOUNTAIN_CAR, task.arm, quick=task.quick))


def schedule_jobs(task: SeedTask) -> list[Result]:
    """Run an arm on server job scheduling."""
    return run_rows(task, budget_config(SERVER_JOBS, task.arm, quick=task.quick))


def mountain_car_table(results: Results) -> str:
    """Ours beside the optimum, as Markdown."""
    return _budget_table(results, digits=1) + "\nThe best possible return is -49.2 on average.\n"


def server_jobs_table(results: Results) -> str:
    """Ours beside policies that do not learn, as Markdown."""
    seeds = range(300)
    known = {
        "oldest first": play_jobs(oldest_policy, seeds),
        "random": play_jobs(random_policy(np.random.default_rng(0)), seeds),
        "greedy": play_jobs(greedy_policy, seeds),
        "most urgent first": play_jobs(urgent_policy, seeds),
        "best fixed order": play_jobs(ordered_policy, seeds),
        "oracle that knows all arrivals": best_returns(seeds),
    }
    lines = ["", "| policy | mean return of 300 episodes |", "| --- | --- |"]
    lines += [f"| {name} | {mean_and_error(value, 0)} |" for name, value in known.items()]
    return _budget_table(results, digits=0) + "\n".join(lines) + "\n"


def _budget_table(results: Results, digits: int) -> str:
    lines = [
        "| arm | runs | episodes | steps | champion's return | worst run | a quarter of the "
        "episodes | neat+q is better by |",
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
        cells.append(_advantage(results.get("neat+q", []), runs, digits) if arm != "neat+q" else "")
        lines.append(f"| {arm} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _advantage(ours: Sequence[Result], others: Sequence[Result], digits: int) -> str:
    """Mean difference of paired seeds, with its bootstrap interval."""
    theirs = {one["seed"]: one["return"] for one in others}
    apart = [one["return"] - theirs[one["seed"]] for one in ours if one["seed"] in theirs]
    if not apart:
        return ""
    low, high = bootstrap_interval(apart)
    return f"{np.mean(apart):,.{digits}f} ({low:,.{digits}f} to {high:,.{digits}f})"


def draw_champions(results: Results) -> Figure:
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


def _neat_q_experiment(name: str, summary: str, arms: tuple[str, ...], **parts: Any) -> Experiment:
    return Experiment(
        name=name,
        summary=summary,
        arms=arms,
        seeds=10,
        quick_seeds=2,
        batch=5,
        figure=draw_champions,
        **parts,
    )


NEAT_Q = (
    _neat_q_experiment(
        "mountain-car",
        "NEAT+Q, NEAT and Q-learning on the mountain car (Whiteson & Stone 2006)",
        NEAT_Q_ARMS,
        run=drive_car,
        table=mountain_car_table,
    ),
    _neat_q_experiment(
        "server-jobs",
        "NEAT+Q, NEAT and Q-learning on server job scheduling (Whiteson & Stone 2006)",
        NEAT_Q_ARMS,
        run=schedule_jobs,
        table=server_jobs_table,
    ),
)
