"""Who trains the arenas of a run: this process, or several at once.

Arenas do not influence each other, so they can be dealt to processes in any way: the results are
the same, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple, Protocol

from neatq_torch.genome import Genome
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.loop import Stride, strides
from neatq_trainers.processes import Remote, usable_cores

ARENAS_PER_WORKER = 4
"""A tick of one arena costs nearly as much as a tick of four."""

State = dict[str, Any]


class Snapshot(NamedTuple):
    """A run as it stands between two strides.

    Attributes:
        state: What `Run.state` gives.
        champion: The fittest genome of the first arena, with the weights its robot has learnt.
    """

    state: State
    champion: Genome | None


class Worker(Protocol):
    """Trains some arenas of a run."""

    def begin(self) -> None:
        """Let it train one stride more; several may be under way."""
        ...

    def finish(self) -> Stride:
        """What came of the earliest stride under way."""
        ...

    def snapshot(self) -> Snapshot:
        """The run as it stands; no stride may be under way."""
        ...


class LocalWorker:
    """Trains in this process."""

    def __init__(self, config: RunConfig, state: State | None) -> None:
        self._run = build(config, state)
        self._strides = strides(self._run)

    def begin(self) -> None:
        """Nothing: `finish` does the work."""

    def finish(self) -> Stride:
        """Train one stride."""
        return next(self._strides)

    def snapshot(self) -> Snapshot:
        """The run as it stands."""
        run = self._run
        champion = run.populations[0].champion if run.populations else None
        if champion is None or run.network is None:
            return Snapshot(run.state(), None)
        return Snapshot(run.state(), run.network.genome(champion))

    def close(self) -> None:
        """Close what training has opened."""
        self._strides.close()


class ProcessWorker:
    """Trains in a process of its own."""

    def __init__(self, config: RunConfig, state: State | None) -> None:
        self._far = Remote(LocalWorker, config, state)

    def begin(self) -> None:
        """Ask for a stride."""
        self._far.ask("finish")

    def finish(self) -> Stride:
        """Wait for a stride."""
        return self._far.answer()

    def snapshot(self) -> Snapshot:
        """Ask for the state, and wait for it."""
        self._far.ask("snapshot")
        return self._far.answer()

    def close(self) -> None:
        """End the process."""
        self._far.close()


@contextmanager
def open_workers(
    parts: Sequence[RunConfig], states: Sequence[State | None]
) -> Iterator[Sequence[Worker]]:
    """A worker for each part of a run: this process if there is one part, else a process each."""
    kind = LocalWorker if len(parts) == 1 else ProcessWorker
    with ExitStack() as stack:
        workers = []
        for config, state in zip(parts, states, strict=True):
            workers.append(kind(config, state))
            stack.callback(workers[-1].close)
        yield workers


def fitting_workers(arenas: int) -> int:
    """How many processes make the most of this machine for so many arenas."""
    return max(1, min(usable_cores(), arenas // ARENAS_PER_WORKER))
