"""Who trains the arenas of a run: this process, or several at once.

Arenas do not influence each other, so they can be dealt to processes in any way: the results are
the same, bit for bit.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import signal
import traceback
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Protocol

import torch

from neatq_torch.genome import Genome
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.loop import Stride, strides

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
        context = multiprocessing.get_context("spawn")
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=_serve, args=(far_end,), daemon=True)
        self._process.start()
        far_end.close()
        self._send((config, state))

    def begin(self) -> None:
        """Ask for a stride."""
        self._send("finish")

    def finish(self) -> Stride:
        """Wait for a stride."""
        return self._receive()

    def snapshot(self) -> Snapshot:
        """Ask for the state, and wait for it."""
        self._send("snapshot")
        return self._receive()

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.terminate()
        self._process.join()

    def _send(self, request: Any) -> None:
        try:
            _send(self._pipe, request)
        except BrokenPipeError:
            self._receive()  # raises what the process ended with, if it still could say so
            raise

    def _receive(self) -> Any:
        try:
            answer = _receive(self._pipe)
        except (EOFError, ConnectionResetError) as error:
            self._process.join()
            raise RuntimeError(
                f"a training process ended with exit code {self._process.exitcode}; the last "
                "checkpoint is intact (out of memory? try fewer --workers)"
            ) from error
        if isinstance(answer, Exception):
            raise answer
        return answer


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


def usable_cores() -> int:
    """How many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not every system has it
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def _serve(pipe: Connection) -> None:
    """Do what the other end of the pipe asks for, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    torch.set_num_threads(1)
    try:
        worker = LocalWorker(*_receive(pipe))
        gc.freeze()
        while True:
            _send(pipe, getattr(worker, _receive(pipe))())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:
        error.add_note(traceback.format_exc())
        _send(pipe, error)


def _send(pipe: Connection, message: Any) -> None:
    # Not `pipe.send`: torch would send tensors as handles of shared memory.
    pipe.send_bytes(pickle.dumps(message))


def _receive(pipe: Connection) -> Any:
    return pickle.loads(pipe.recv_bytes())
