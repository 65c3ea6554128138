"""What it costs eight islands in two processes to wait for each other.

A tick of `neatq train --task maze --islands 8 --migrate-every 1000 --workers 2`, of arms `rtneat`
and `neatq`, between two ticks of a run, beside islands that nobody leaves and that wait for nobody.
Wall time; needs two cores with nothing else to do.
"""

from __future__ import annotations

from benchmarks.measure import in_rounds
from benchmarks.result import Line, compare
from benchmarks.training import timed_runs
from neatq_torch import preset
from neatq_trainers.config import RunConfig

ISLANDS, WORKERS, EVERY_TICKS = 8, 2, 1000
TICKS = 2 * EVERY_TICKS, 8 * EVERY_TICKS


def run(quick: bool) -> list[Line]:
    """Measure islands that meet and islands apart."""
    return [_line(arm, rounds=1 if quick else 3) for arm in ("rtneat", "neatq")]


def _line(arm: str, rounds: int) -> Line:
    apart = preset("maze", arm).changed({"arenas": ISLANDS})
    meet = apart.changed({"migration": {"every_ticks": EVERY_TICKS}})
    samples = in_rounds(
        {"meet": lambda: _tick_seconds(meet), "apart": lambda: _tick_seconds(apart)}, rounds=rounds
    )
    ours, theirs = samples["meet"] * 1e6, samples["apart"] * 1e6
    return compare(f"a tick of {ISLANDS} islands, {arm}", ours, "nobody leaves", theirs, unit="us")


def _tick_seconds(config: RunConfig) -> float:
    short, long = timed_runs(config, "ticks", TICKS, workers=WORKERS)
    return (long.seconds - short.seconds) / (TICKS[1] - TICKS[0])
