"""What Ray costs beside processes of this machine, and what a driver can feed.

- a task that does nothing, in a pool of two hands (`neatq_envs.pool`): one on Ray beside one in
  processes, wall time for each of 100, hands begun before;
- a message to an object elsewhere and back;
- a minibatch of a critic from the memory of the driver, beside an empty message: what it would at
  least cost to have it from a memory elsewhere;
- a step of environments that take 100 ms each (`benchmarks.sleeping`), twenty to each of 64 actors,
  beside the two seconds that twenty of them take: what is on top is the work of driver and actors,
  about a millisecond for each message, which all share two cores here. With ten environments each
  it was 1,073 ms beside 1,000, 93 % of ideal. They sleep, so two cores are enough;
- a step of environments that cost nothing, twenty to each of 64 actors, and all work of actors in
  it;
- what the driver itself does (its CPU time) to have twenty ticks of environments that cost nothing,
  twenty to each of 16 actors: as `neatq train` does it, where networks act in the actors and a
  batch is one message (`neatq_trainers.rollouts`), beside twenty steps from here. From this the
  note says at how many cores a driver is saturated by collecting alone; what it learns and breeds
  comes on top. Actors of a run have torch, 300 MB each, so there are 16 and not 64;
- what the driver of such a run grows by over 10,000 batches, from two actors.

All on a cluster that is begun on this machine; the wall time of other work is in it. Needs the
extra `ray`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from benchmarks.measure import in_rounds
from benchmarks.memory import SAMPLES, growth
from benchmarks.result import Goal, Line, compare
from neatq_envs.gymnasium_rows import make_rows
from neatq_envs.gymnasium_task import GymnasiumTask
from neatq_envs.machines import Crew, Distant, Machines, ThisMachine, open_machines
from neatq_envs.pool import Pool
from neatq_torch import preset
from neatq_torch.learning.memory import TransitionMemory
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.config import EPISODIC_BATCH_TICKS
from neatq_trainers.loop import make_collector, strides
from neatq_trainers.run import Run
from neatq_trainers.worlds import facts_of

ACTORS, ROWS_EACH, STEP_SECONDS = 64, 20, 0.1
RUN_ACTORS, BATCHES = 16, 10_000
SLEEPING = "benchmarks.sleeping:Sleeping-v0"
TASKS, HANDS, MESSAGES = 100, 2, 200
MINIBATCH, REMEMBERED = 256, 300_000
SATURATED = (0.001, 0.01, 0.1)
"""Seconds of a step for which the note says how many cores a driver feeds."""


class Nothing:
    """Does nothing, elsewhere."""

    def __call__(self, task: int) -> int:
        return task


def run(quick: bool) -> list[Line]:
    """Measure tasks, messages and steps."""
    rounds, actors = (1, 4) if quick else (3, ACTORS)
    os.environ["PYTHONPATH"] = str(Path(__file__).resolve().parents[1])  # actors import this
    with open_machines("local") as cluster:
        both: dict[str, Machines] = {"Ray": cluster, "processes": ThisMachine()}
        tasks = in_rounds({name: _task_seconds(one) for name, one in both.items()}, rounds=rounds)
        calls = in_rounds({name: _call_seconds(one) for name, one in both.items()}, rounds=rounds)
        drawn = in_rounds({"drawn": _draw_seconds()}, rounds=rounds)["drawn"]
        crew = Crew(actors, cluster)
        with _rows(crew, STEP_SECONDS) as step:
            slow = in_rounds({"step": lambda: step(5)}, rounds=rounds)["step"]
        with _rows(crew, 0.0) as step:
            free = in_rounds({"step": lambda: step(50)}, rounds=rounds)["step"]
        few = Crew(min(actors, RUN_ACTORS), cluster)
        with _rows(few, 0.0) as step, _batches(few.beside) as batch:
            ticks = EPISODIC_BATCH_TICKS
            ways = {"rollouts": lambda: _cpu(batch), "steps": lambda: _cpu(lambda: step(ticks))}
            driver = in_rounds(ways, rounds=rounds)
        batches = BATCHES // 100 if quick else BATCHES
        resident = _resident(Crew(2, cluster).beside, batches)
    ideal = np.full(rounds, ROWS_EACH * STEP_SECONDS)
    fed = few.size * ROWS_EACH * ticks / float(np.median(driver["rollouts"]))
    cores = ", ".join(f"{fed * one:,.0f} cores at {1000 * one:g} ms" for one in SATURATED)
    near = Goal(text="at least 95 % of ideal", limit=1 / 0.95, of="ratio")
    rows = f"{actors} actors, {ROWS_EACH} environments each"
    return [
        compare("a task", tasks["Ray"] * 1e3, "processes", tasks["processes"] * 1e3, unit="ms"),
        compare("a message", calls["Ray"] * 1e6, "processes", calls["processes"] * 1e6, unit="us"),
        compare(
            f"a minibatch of {MINIBATCH} from {REMEMBERED:,} transitions of the driver",
            drawn * 1e6,
            "a message on Ray",
            calls["Ray"] * 1e6,
            unit="us",
        ),
        compare(
            f"a step of 100 ms: {rows}", slow * 1e3, "ideal", ideal * 1e3, unit="ms", goal=near
        ),
        compare(f"a step that costs nothing: {rows}", free * 1e3, unit="ms"),
        compare(
            f"the driver, {ticks} ticks: {few.size} actors, {ROWS_EACH} environments each",
            driver["rollouts"] * 1e3,
            "single steps",
            driver["steps"] * 1e3,
            unit="ms",
            note=f"{fed:,.0f} steps/s; collecting saturates a driver at {cores} a step.",
        ),
        growth(f"the driver, {batches:,} batches from 2 actors", resident, batches, "batches"),
    ]


def _task_seconds(machines: Machines) -> Callable[[], float]:
    """What measures a task of a pool whose hands have begun."""

    def measure() -> float:
        pool = Pool(machines, (Nothing,), range(1, TASKS + HANDS + 1), HANDS)
        over, began = 0, time.perf_counter()
        while over < TASKS + HANDS:
            over += len(pool.work(1.0))
            if over < HANDS:
                began = time.perf_counter()
        seconds = time.perf_counter() - began
        pool.close()
        return seconds / TASKS

    return measure


def _call_seconds(machines: Machines) -> Callable[[], float]:
    """What measures a message to an object that has begun."""

    def call(one: Distant) -> None:
        one.ask("__call__", 1)
        one.answer()

    def measure() -> float:
        (one,) = Crew(1, machines).open(Nothing)
        call(one)
        began = time.perf_counter()
        for _ in range(MESSAGES):
            call(one)
        seconds = time.perf_counter() - began
        one.close()
        return seconds / MESSAGES

    return measure


def _draw_seconds() -> Callable[[], float]:
    """What measures a minibatch of transitions of fifty robots."""
    size = (REMEMBERED,)
    memory, generator = TransitionMemory(REMEMBERED), torch.Generator().manual_seed(0)
    following = {"reward": torch.rand(*size, 1), "terminated": torch.zeros(*size, 1).bool()}
    seen = {"observation": torch.rand(*size, 15)}
    now = {"action": torch.rand(*size, 2), "genome_id": torch.zeros(*size, 1).long()}
    memory.extend(TensorDict({**seen, **now, "next": {**seen, **following}}, size))

    def measure() -> float:
        began = time.perf_counter()
        for _ in range(MESSAGES):
            memory.draw(MINIBATCH, generator)
        return (time.perf_counter() - began) / MESSAGES

    return measure


@contextmanager
def _rows(crew: Crew, seconds: float) -> Any:
    """What measures so many steps of environments that are dealt to a crew; seconds of one."""
    task = GymnasiumTask(id=SLEEPING, kwargs={"seconds": seconds})
    rows, _ = make_rows(task, crew=crew)
    count = crew.size * ROWS_EACH
    mask, actions = np.ones(count, bool), np.zeros((count, 2), np.float32)
    rows.reset(mask, np.arange(count))

    def step(steps: int) -> float:
        began = time.perf_counter()
        for _ in range(steps):
            rows.step(mask, actions)
        return (time.perf_counter() - began) / steps

    yield step
    with suppress(AttributeError):
        rows.close()


@contextmanager
def _batches(crew: Crew) -> Iterator[Callable[[], object]]:
    """The next batch of a run whose environments, which cost nothing, are dealt to a crew."""
    config = preset(f"gym:{SLEEPING}", "neat").changed({"world.slots": crew.size * ROWS_EACH})
    run = build(config, facts=facts_of(config.world, 0.99), crew=crew)
    batches = iter(make_collector(run))
    next(batches)  # all have begun
    yield lambda: next(batches)
    run.world.close()


class _Watch(Callback):
    """Notes the resident bytes of this process, without Ray's, after so many batches each."""

    def __init__(self, every: int) -> None:
        self.every, self.batches, self.samples = every, 0, list[tuple[int, int]]()

    def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
        self.batches += 1
        if self.batches % self.every == 0:
            self.samples.append((self.batches, psutil.Process().memory_info().rss))


def _resident(crew: Crew, batches: int) -> np.ndarray:
    """Batches so far and resident bytes [samples, 2] of the driver of a run."""
    config = preset(f"gym:{SLEEPING}", "neat").changed({"world.slots": 2 * crew.size})
    run = build(config, facts=facts_of(config.world, 0.99), crew=crew)
    watch = _Watch(batches // SAMPLES)
    for _ in strides(run, [watch]):
        if watch.batches >= batches:
            break
    run.world.close()
    return np.array([one for one in watch.samples if one[0] <= batches])


def _cpu(work: Callable[[], object]) -> float:
    """CPU seconds of this process for some work."""
    began = time.process_time()
    work()
    return time.process_time() - began
