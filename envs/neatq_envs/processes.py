"""Objects that live in processes of their own."""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import signal
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any


class Remote:
    """An object in a process of its own, which does one thing after the other.

    `make` makes it of the arguments; it must be importable. What the process needs besides, such
    as `torch.set_num_threads(1)`, is for it to do.
    """

    def __init__(self, make: Callable[..., Any], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=_serve, args=(far_end,), daemon=True)
        self._process.start()
        far_end.close()
        self._send((make, arguments))

    def ask(self, method: str, *arguments: Any) -> None:
        """Have a method called; several calls may be under way."""
        self._send((method, arguments))

    def answer(self) -> Any:
        """What the earliest call under way returns or raises; `RuntimeError` with no process."""
        try:
            answer = _receive(self._pipe)
        except (EOFError, ConnectionResetError) as error:
            self._process.join()
            raise RuntimeError(
                f"a process ended with exit code {self._process.exitcode}; what is on disk is "
                "intact (out of memory? try fewer --workers)"
            ) from error
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.terminate()
        self._process.join()

    def _send(self, request: Any) -> None:
        try:
            _send(self._pipe, request)
        except BrokenPipeError:
            self.answer()  # raises what the process ended with, if it still could say so
            raise


def usable_cores() -> int:
    """How many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not every system has it
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def _serve(pipe: Connection) -> None:
    """Do what the other end of the pipe asks for, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    try:
        make, arguments = _receive(pipe)
        served = make(*arguments)
        gc.freeze()
        while True:
            method, arguments = _receive(pipe)
            _send(pipe, getattr(served, method)(*arguments))
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
