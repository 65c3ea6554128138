"""`neatq train` with 1 arena of 50 robots: arm `replay`, task `wall`, learning on, wall time.

From tick 1,000, when evolution begins, to the end of a run as long as the published ones: two runs
of those lengths, subtracted, so start-up does not count. TorchRL's collector with a random policy
and the bare arena, in the same worlds, show where the time goes: their cost is part of ours.

Where a tick goes, as the profiler sees it: acting 38 % (the networks 5 %), the arena and its
tensors 34 % (the arena alone 18 %), learning from shared memory 14 %, breeding with write-back and
teaching 5 %, new Spaces for the physics 3 %, stacking ticks to batches 2 %, the rest the loops.
What is left to gain is the price of small tensors in Python: a tick has some sixty operations on
fifty robots, of five microseconds each, most of it to call them. One compiled call for acting and
another for the arena would save about a third (on paper), which is 2,200 ticks/s and not 4,000;
the rest is what is learnt and bred, and TorchRL's batches. Printed by

    python -c "import cProfile; from benchmarks.training import trainer_tick_seconds;
    from neatq_torch import preset; wall = preset('wall', 'replay');
    cProfile.run('trainer_tick_seconds(wall, (1000, 9000))', sort='cumulative')"

The figure moves by a tenth with whatever else the server does.
"""

from __future__ import annotations

from benchmarks.result import Line, cost_at_most
from benchmarks.training import whole_run
from neatq_torch import preset
from neatq_trainers.arms import TASK_TICKS


def run(quick: bool) -> list[Line]:
    """Measure a tick of one arena."""
    return whole_run(
        "a tick of 1 arena x 50 robots",
        preset("wall", "replay"),
        ticks=(1000, 4000) if quick else (1000, TASK_TICKS["wall"]),
        rounds=1 if quick else 3,
        goal=cost_at_most(250, "at least 4,000 ticks/s"),
    )
