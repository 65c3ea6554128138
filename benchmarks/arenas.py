"""`neatq train` with 20 arenas of 50 robots in one run: arm `replay`, task `wall`, wall time.

As `trainer`, with a worker process for each core.
"""

from __future__ import annotations

from benchmarks.result import Line, cost_at_most
from benchmarks.training import whole_run
from neatq_torch import preset
from neatq_trainers.arms import TASK_TICKS


def run(quick: bool) -> list[Line]:
    """Measure a tick of twenty arenas."""
    return whole_run(
        "a tick of 20 arenas x 50 robots",
        preset("wall", "replay").changed({"arenas": 20}),
        ticks=(1000, 4000) if quick else (1000, TASK_TICKS["wall"]),
        rounds=1 if quick else 2,
        goal=cost_at_most(2000, "at least 500,000 robot-steps/s"),
    )
