"""`neatq train` on a Gymnasium task: arm `neat`, LunarLander-v3, one process, wall time.

From the first generation to the last: two runs, subtracted, so start, the only evaluation and the
test do not count. The bare environment takes random actions in a loop and is reset where an episode
ends: what the trainer adds to it is the price of 150 networks, TorchRL and breeding.

Where the time goes, as the profiler sees it: stepping environments 66 %, resetting them 8 %, acting
8 %, the rest tensors of rows and TorchRL. A generation is as long as its longest
life: most slots are idle towards its end, and cost little but not nothing.
"""

from __future__ import annotations

import time

import gymnasium
import numpy as np

from benchmarks.measure import in_rounds
from benchmarks.result import Line, compare
from benchmarks.training import timed_runs
from neatq_torch import preset

ID = "LunarLander-v3"


def run(quick: bool) -> list[Line]:
    """Measure a step of the trainer and one of the environment."""
    generations, steps, rounds = ((1, 4), 10_000, 1) if quick else ((1, 21), 50_000, 3)
    samples = in_rounds(
        {
            "trainer": lambda: trainer_step_seconds(generations),
            "environment": lambda: environment_step_seconds(steps),
        },
        rounds=rounds,
    )
    rates = {name: 1 / float(np.median(seconds)) for name, seconds in samples.items()}
    return [
        compare(
            f"a step of {ID}",
            samples["trainer"] * 1e6,
            "the environment alone, random actions",
            samples["environment"] * 1e6,
            unit="us",
            note=f"{rates['trainer']:,.0f} steps/s; the environment alone "
            f"{rates['environment']:,.0f}.",
        )
    ]


def trainer_step_seconds(generations: tuple[int, int]) -> float:
    """Wall seconds of a step of `neatq train` between two generations of a run."""
    config = preset(f"gym:{ID}", "neat").changed({"world.every": 1000, "world.test_episodes": 1})
    short, long = timed_runs(config, "generations", generations, workers=1)
    return (long.seconds - short.seconds) / (long.steps - short.steps)


def environment_step_seconds(steps: int) -> float:
    """Wall seconds of a step of the environment in a loop, its resets among them."""
    env = gymnasium.make(ID)
    env.action_space.seed(0)
    env.reset(seed=0)
    begin = time.perf_counter()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
    seconds = time.perf_counter() - begin
    env.close()
    return seconds / steps
