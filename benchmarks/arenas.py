"""`neatq train` with 20 arenas of 50 robots in one run: arm `replay`, task `wall`, wall time.

As `trainer`, with a worker process for each core. Where a tick of ten arenas in one process
goes, as the profiler sees it: learning from shared memory 32 %, the arenas and their tensors 28 %
(the arenas alone 22 %), acting 20 % (the networks 13 %), new Spaces for the physics 7 %, breeding
with write-back and teaching 7 %, judging and metrics 3 %, stacking ticks to batches 2 %. Learning
and networks are compiled loops already; twice as fast is not in sight on two cores.
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
        goal=cost_at_most(1000, "at least 1,000,000 robot-steps/s"),
    )
