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

from neatq_envs.machines import Crew, Distant, Here, Machines
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


class Worker:
    """Trains some arenas of a run in its process; see `build`.

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

    def stride(self) -> Stride:
        """Train one stride more."""
        stride = next(self._strides)
        self._hearing.close()
        return stride

    def check(self, change: AnyChange) -> None:
        """Refuse a change that cannot be made, see `Change`."""
        change.check(self._run)

    def make(self, change: AnyChange) -> None:
        """Make a change that was checked."""
        change.make(self._run)

    def emigrants(self, times: int) -> Travellers:
        """Who goes of each arena, see `islands`."""
        assert self._run.config.migration is not None
        return emigrants(self._run, self._run.config.migration, times)

    def immigrate(self, arriving: Travellers) -> None:
        """Let them arrive."""
        immigrate(self._run, arriving)

    def snapshot(self) -> Snapshot:
        """The run as it stands."""
        run = self._run
        return Snapshot(run.state_dict(), run.champion(0), run.metrics.champions)

    def close(self) -> None:
        """Close what training has opened."""
        self._hearing.close()
        self._strides.close()
        self._run.world.close()


def _in_process(tells: bool, *arguments: Any) -> Worker:
    torch.set_num_threads(1)
    return Worker(*arguments, tells=tells)


@contextmanager
def open_workers(
    parts: Sequence[RunConfig],
    states: Sequence[State | None],
    facts: EnvFacts | None,
    callbacks: Sequence[Callback],
    crew: Crew,
) -> Iterator[Sequence[Distant]]:
    """A `Worker` for each part of a run: in this process if there is one part, else elsewhere."""
    own = [one for one in callbacks if _is_called_there(one)]
    with ExitStack() as stack:
        opened: list[Distant] = []
        for config, state in zip(parts, states, strict=True):
            arguments = config, state, facts, own
            if len(parts) == 1:
                opened.append(Here(Worker(*arguments, crew)))
            else:
                tells = not opened  # one of them tells what all of them do
                everything = _in_process, tells, *arguments
                opened.append(crew.machines.open(*everything, together=len(parts)))
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
