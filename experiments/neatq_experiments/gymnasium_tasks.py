"""NEAT and NEAT+Q on the tasks that come with Gymnasium, with the trainer's own settings.

Budgets are small: what evolution of small networks reaches in minutes. The scores beside are those
of deep reinforcement learning in public benchmark tables, and of doing nothing or anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from neatq_experiments.experiment import Experiment, column, mean_and_error
from neatq_experiments.generational import run_rows
from neatq_experiments.seeds import Result, Results, SeedTask
from neatq_trainers.arms import preset
from neatq_trainers.config import RunConfig

QUICK_CHALLENGE_GENERATIONS = 2


class Challenge(NamedTuple):
    """A task and what is known of it.

    Attributes:
        task: "gym:" and an id.
        generations: of a population of the trainer's own size.
        solved: the return that counts as solved, None if nobody has set one.
        reference: scores of others.
        env_kwargs: arguments of the environment.
    """

    task: str
    generations: int
    solved: float | None
    reference: str
    env_kwargs: Mapping[str, Any] = MappingProxyType({})


CHALLENGES = {
    "MountainCarContinuous-v0": Challenge(
        "gym:MountainCarContinuous-v0",
        20,
        90.0,
        "random -33, doing nothing 0; SAC 94.7 (50,000 steps), TD3 93.5 (300,000); at most 99.6",
    ),
    "Pendulum-v1": Challenge(
        "gym:Pendulum-v1",
        60,
        None,
        "random -1216; TD3 -152 (20,000 steps), PPO -172 (100,000)",
    ),
    "LunarLander-v3, continuous": Challenge(
        "gym:LunarLander-v3",
        30,
        200.0,
        "random -197; TQC 278, PPO 271, SAC 260, TD3 207",
        {"continuous": True},
    ),
    "CartPole-v1": Challenge("gym:CartPole-v1", 10, 475.0, "random 22; at most 500"),
    "Acrobot-v1": Challenge("gym:Acrobot-v1", 20, -100.0, "random -500"),
}
LEARNERS = ("neat", "neat+q")


def challenge_config(arm: str, *, quick: bool) -> RunConfig:
    """The configuration of an arm, which is called `task: arm of the trainer`."""
    name, learner = arm.split(": ")
    challenge = CHALLENGES[name]
    generations = QUICK_CHALLENGE_GENERATIONS if quick else challenge.generations
    made, lives = (
        preset(
            challenge.task,
            one,
            env_kwargs=challenge.env_kwargs,
            length={"generations": generations},
        )
        for one in (learner, "neat")
    )
    # As many episodes for both.
    slots = lives.world.slots * lives.population.episodes // made.population.episodes
    return made.changed({"world.slots": slots})


def run_challenge(task: SeedTask) -> list[Result]:
    """Run an arm over its seeds."""
    return run_rows(task, challenge_config(task.arm, quick=task.quick))


def challenges_table(results: Results) -> str:
    """Ours beside the scores of others, as Markdown."""
    lines = [
        "| task | arm | runs | episodes | steps | champion's return | worst run | solved | others "
        "|",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for arm, runs in results.items():
        if not runs:
            continue
        name, learner = arm.split(": ")
        challenge, value = CHALLENGES[name], column(runs, "return")
        episodes, steps = column(runs, "episodes").mean(), column(runs, "steps").mean()
        solved = ""
        if challenge.solved is not None:
            solved = f"{np.sum(value >= challenge.solved)} (>= {challenge.solved:g})"
        lines.append(
            f"| {name} | {learner} | {len(runs)} | {episodes:,.0f} | {steps:,.0f} | "
            f"{mean_and_error(value)} | {value.min():,.1f} | {solved} | {challenge.reference} |"
        )
    return "\n".join(lines) + "\n"


GYMNASIUM = Experiment(
    name="gymnasium",
    summary="NEAT and NEAT+Q on tasks that come with Gymnasium (needs the extra box2d)",
    arms=tuple(f"{name}: {learner}" for name in CHALLENGES for learner in LEARNERS),
    seeds=10,
    quick_seeds=1,
    batch=5,
    run=run_challenge,
    table=challenges_table,
)
