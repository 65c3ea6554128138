"""Who trains the arenas of a run: this process, or several at once.

Arenas, but for rivals, do not influence each other, so they can be dealt to processes in any way:
the results are the same, bit for bit. Where there are fewer arenas than processes, the environments
of a Gymnasium task are dealt instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import torch

from neatq_envs.machines import Crew, Distant, Machines
from neatq_envs.random_play import EnvFacts
from neatq_torch.genome import Genome
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.changes import AnyChange
from neatq_trainers.compiling import CompilingTold
from neatq_trainers.config import RunConfig
from neatq_trainers.islands import emigrants, immigrate
from neatq_trainers.loop import Stride, strides
from neatq_trainers.migration import Travellers
from neatq_trainers.run import Champion, State

ARENAS_PER_WORKER = 4
"""A tick of one arena costs nearly as much as a tick of four."""


class Snapshot(NamedTuple):
    """A run as it stands between two strides.

    Attributes:
        state: What `Run.state_dict` gives.
        champion: The fittest genome of the first arena, with the weights its robot has learnt.
        champions: Those that are remembered, one for each arena.
    """

    state: State
    champion: Genome | None
    champions: list[Champion | None]


class LocalWorker:
    """Trains some arenas of a run in this process; see `build`.

    `batch` and `advance` of the callbacks are called here.
    """

    def __init__(
        self,
        config: RunConfig,
        state: State | None,
        facts: EnvFacts | None,
        callbacks: Sequence[Callback],
        crew: Crew | None = None,
        *,
        tells: bool = True,
    ) -> None:
        self._hearing = ExitStack()
        if tells:
            self._hearing.callback(CompilingTold().close)
        try:
            self._run = build(config, state, facts=facts, crew=crew)
        except BaseException:
            self._hearing.close()
            raise
        self._strides = strides(self._run, callbacks)

    def begin(self) -> None:
        """Let it train one stride more; several may be under way. Here `finish` does the work."""

    def finish(self) -> Stride:
        """What came of the earliest stride under way."""
        stride = next(self._strides)
        self._hearing.close()
        return stride

    def check(self, change: AnyChange) -> None:
        """Refuse a change that cannot be made, see `Change`; no stride may be under way."""
        change.check(self._run)

    def make(self, change: AnyChange) -> None:
        """Make a change that was checked."""
        change.make(self._run)

    def emigrants(self, times: int) -> Travellers:
        """Who goes of each arena, see `islands`; no stride may be under way."""
        assert self._run.config.migration is not None
        return emigrants(self._run, self._run.config.migration, times)

    def immigrate(self, arriving: Travellers) -> None:
        """Let them arrive."""
        immigrate(self._run, arriving)

    def snapshot(self) -> Snapshot:
        """The run as it stands; no stride may be under way."""
        run = self._run
        return Snapshot(run.state_dict(), run.champion(0), run.metrics.champions)

    def close(self) -> None:
        """Close what training has opened."""
        self._hearing.close()
        self._strides.close()
        self._run.world.close()


def _in_process(tells: bool, *arguments: Any) -> LocalWorker:
    torch.set_num_threads(1)
    return LocalWorker(*arguments, tells=tells)


class DistantWorker:
    """Has a `LocalWorker` train elsewhere."""

    def __init__(self, worker: Distant) -> None:
        self._worker = worker

    def begin(self) -> None:
        """Ask for a stride."""
        self._worker.ask("finish")

    def finish(self) -> Stride:
        """Wait for a stride."""
        return self._worker.answer()

    def check(self, change: AnyChange) -> None:
        """Ask whether a change can be made."""
        self._worker.ask("check", change)
        self._worker.answer()

    def make(self, change: AnyChange) -> None:
        """Have a change made."""
        self._worker.ask("make", change)
        self._worker.answer()

    def emigrants(self, times: int) -> Travellers:
        """Ask who goes."""
        self._worker.ask("emigrants", times)
        return self._worker.answer()

    def immigrate(self, arriving: Travellers) -> None:
        """Have them arrive."""
        self._worker.ask("immigrate", arriving)
        self._worker.answer()

    def snapshot(self) -> Snapshot:
        """Ask for the state, and wait for it."""
        self._worker.ask("snapshot")
        return self._worker.answer()

    def close(self) -> None:
        """End it."""
        self._worker.close()


Worker = LocalWorker | DistantWorker


@contextmanager
def open_workers(
    parts: Sequence[RunConfig],
    states: Sequence[State | None],
    facts: EnvFacts | None,
    callbacks: Sequence[Callback],
    crew: Crew,
) -> Iterator[Sequence[Worker]]:
    """A worker for each part of a run: this process if there is one part, else one elsewhere."""
    own = [one for one in callbacks if _is_called_there(one)]
    with ExitStack() as stack:
        opened: list[Worker] = []
        for config, state in zip(parts, states, strict=True):
            arguments = config, state, facts, own
            if len(parts) == 1:
                opened.append(LocalWorker(*arguments, crew))
            else:
                tells = not opened  # one of them tells what all of them do
                everything = _in_process, tells, *arguments
                worker = crew.machines.open(*everything, together=len(parts))
                opened.append(DistantWorker(worker))
            stack.callback(opened[-1].close)
        yield opened


def _is_called_there(callback: Callback) -> bool:
    """Whether a callback has something to do where arenas are trained."""
    kind = type(callback)
    return kind.batch is not Callback.batch or kind.advance is not Callback.advance


def fitting_workers(config: RunConfig, machines: Machines) -> int:
    """How many processes make the most of machines for a run."""
    if config.world.lasting:
        each = 1 if machines.elastic else ARENAS_PER_WORKER  # a core more is at hand there
        return max(1, min(machines.cores(), config.arenas // each))
    return machines.cores()
