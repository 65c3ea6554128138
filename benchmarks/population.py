"""100,000 genomes in one arena, one generation of `neat` on CartPole-v1, in one process.

What `neatq train` takes to make the founders, to let each live two episodes and to write a
checkpoint: wall time for each genome beside the same with 1,000, less what a run of ten takes,
which is mostly pictures; and the resident set at its peak. Each in a fresh process.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.measure import in_fresh_process
from benchmarks.result import Line, compare, times_at_most
from benchmarks.training import timed_run
from neatq_torch import preset

TINY, FEW, MANY = 10, 1_000, 100_000
PEAK_UNIT = 1 if sys.platform == "darwin" else 1024
"""Bytes of the unit in which the system tells it."""


def run(quick: bool) -> list[Line]:
    """Measure a large and a small population."""
    sizes, rounds = ((100, 1_000), 1) if quick else ((FEW, MANY), 2)
    samples = {size: np.array([_in_fresh_process(size) for _ in range(rounds)]) for size in sizes}
    few, many = sizes
    seconds, peak = np.median(samples[many], 0)
    return [
        compare(
            f"one of {many:,} genomes, a generation on CartPole-v1",
            samples[many][:, 0] / many * 1e3,
            f"one of {few:,}",
            samples[few][:, 0] / few * 1e3,
            unit="ms",
            goal=times_at_most(2),
            note=f"{seconds:,.0f} s in all, at most {peak / 2**30:.2f} GiB.",
        )
    ]


def _in_fresh_process(size: int) -> tuple[float, int]:
    return in_fresh_process(generation, size)


def generation(size: int) -> tuple[float, int]:
    """Wall seconds of a run of one generation, and bytes of this process at its peak."""
    import resource  # which Windows does not have

    config = preset("gym:CartPole-v1", "neat").changed({"generations": 1})
    _, tiny, seconds = (  # the first one loads what is loaded once
        timed_run(config.changed({"world.slots": slots}), workers=1).seconds
        for slots in (TINY, TINY, size)
    )
    return seconds - tiny, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * PEAK_UNIT
