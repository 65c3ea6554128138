"""What learning adds to acting: 50 robots whose networks have 18 inputs and 50 outputs.

The arm `described` with the sensors of the published code: ten candidates of four actions and a
value for each, 950 links at the start. Batches of 40 ticks, as in a run.

"shared replay" is what the arm `replay` learns in the time of one replacement: from memory after
each batch, and the teaching of one newborn, beside acting in these batches. "shared critic" is the
same of the arm `neatq`, also beside itself by torch operations. CPU time.

Both fall short of a quarter on top of acting. Of shared replay every minibatch takes three passes
through all networks and the gradient of wire fitting; of the critic most are the five hundred
minibatches by which a newborn is taught.

"update" is forward, TD error, backward and update of all networks (`CandidateTDLoss`, `TDLearner`)
for recorded batches, beside a tick of the collector that recorded them: acting, the arena, TorchRL.
CPU time. "whole trainer" compares `neatq train` with learning and without it, all else equal, in
wall time: it has the writing back of weights in it, and all the noise of two runs.

Runs of "whole trainer" (the arm `described`) lie between 1.2 and 1.35. Half of what learning adds
there is the update; writing 950 weights back into each of 50 genomes before a birth is a sixth (2 %
of a run in the profile below, where the update has 11 %); the rest is spread over acting, with
other networks than without learning, and was not traced further. The update does not overlap with
acting: a thread would share the interpreter, which is what acting waits for.

    python -c "import cProfile; from benchmarks.training import trainer_tick_seconds;
    from benchmarks.learning import described_with_950_links as config;
    cProfile.run('trainer_tick_seconds(config(), (1000, 6000))', sort='cumulative')"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import ModuleType
from unittest.mock import patch

import torch

from benchmarks.measure import in_rounds, interleaved
from benchmarks.result import Goal, Line, compare
from benchmarks.training import trainer_tick_seconds
from neatq_torch import preset
from neatq_torch.evolution import interval_ticks
from neatq_torch.learning import compiled_critic
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.loop import make_collector

SHARE = 0.25
PAPER = "The paper reported 40 % on top."


def run(quick: bool) -> list[Line]:
    """Measure the update alone and the whole trainer."""
    learning = described_with_950_links()
    without = learning.changed({"learner.kind": "none"})
    rounds = 3 if quick else 9
    return [
        _update(learning, rounds),
        *_shared("shared replay", "replay", rounds),
        *_shared("shared critic", "neatq", rounds, also=compiled_critic),
        _whole(learning, without, quick),
    ]


def described_with_950_links() -> RunConfig:
    """The arm `described` with the sensors and actions of the published code."""
    return preset("wall", "described", env_kwargs={"sensors": "opennero"})


def _update(config: RunConfig, rounds: int) -> Line:
    collect, update = _acting_and_learning(config)
    samples = interleaved({"act": collect, "learn": update}, rounds=rounds, seconds=0.5)
    micros = {name: seconds / config.ticks_per_batch * 1e6 for name, seconds in samples.items()}
    return compare(
        "update, a tick",
        micros["learn"],
        "collecting it",
        micros["act"],
        unit="us",
        goal=Goal(text="at most 25 % on top", limit=SHARE, of="ratio"),
        note=PAPER,
    )


def _shared(name: str, arm: str, rounds: int, also: ModuleType | None = None) -> Iterator[Line]:
    """What an arm learns between two replacements beside acting until then.

    And beside the same by torch operations, if there is a module `also` that takes their place.
    """
    config = preset("wall", arm)
    run = build(config)
    batches = iter(make_collector(run))
    evolution = config.population
    ticks = round(
        interval_ticks(evolution.minimum_life_ticks, run.shape[1], evolution.ineligible_fraction)
    )
    count = ticks // config.ticks_per_batch
    for _ in range(4):  # something to remember
        run.learner.update(next(batches))
    recorded = [next(batches).clone() for _ in range(count)]
    newborn = torch.zeros(run.shape, dtype=torch.bool)
    newborn[0, 0] = True

    def act() -> None:
        for _ in range(count):
            next(batches)

    def learn() -> None:
        for batch in recorded:
            run.learner.update(batch)
        run.learner.reset(newborn)

    def slow() -> None:
        assert also is not None
        with patch.object(also, "accepts", lambda *_: False):
            learn()

    kinds = {"act": act, "learn": learn} | ({"slow": slow} if also else {})
    samples = interleaved(kinds, rounds=rounds, seconds=0.5)
    micros = {kind: seconds / ticks * 1e6 for kind, seconds in samples.items()}
    what = f"{name} (`{arm}`), a tick"
    goal = Goal(text="at most 25 % on top", limit=SHARE, of="ratio")
    yield compare(what, micros["learn"], "collecting it", micros["act"], unit="us", goal=goal)
    if also:
        yield compare(what, micros["learn"], "by torch operations", micros["slow"], unit="us")


def _acting_and_learning(
    config: RunConfig,
) -> tuple[Callable[[], object], Callable[[], object]]:
    run = build(config)
    batches = iter(make_collector(run))
    recorded = next(batches).clone()
    return lambda: next(batches), lambda: run.learner.update(recorded.clone(False))


def _whole(learning: RunConfig, without: RunConfig, quick: bool) -> Line:
    ticks, rounds = ((1000, 4000), 1) if quick else ((1000, 21_000), 3)
    samples = in_rounds(
        {
            "with": lambda: trainer_tick_seconds(learning, ticks),
            "without": lambda: trainer_tick_seconds(without, ticks),
        },
        rounds=rounds,
    )
    return compare(
        "whole trainer, a tick",
        samples["with"] * 1e6,
        "the same without learning",
        samples["without"] * 1e6,
        unit="us",
        goal=Goal(text="at most 25 % on top", limit=1 + SHARE, of="ratio"),
        note=PAPER,
    )
