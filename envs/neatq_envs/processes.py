"""Objects that live in processes of their own."""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

_FOR_THE_ONE_THAT_ASKS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
"""Signals that a terminal or a scheduler sends to all processes of a run at once."""
_END_SECONDS = 2.0
"""Time in which a process that has nothing to do ends by itself."""
_CAUSES = {
    "SIGSEGV": "a segmentation fault, of an environment or a library that it uses",
    "SIGBUS": "a bus error, of an environment or for want of memory",
    "SIGABRT": "a library gave up",
    "SIGKILL": "killed by somebody, or by the system for want of memory: try fewer --workers",
}


class ProcessEnded(RuntimeError):
    """A process ended that had work to do; the message says how."""


class MachinesLeft(ProcessEnded):
    """A process can no longer begin, as there are fewer machines than when it was asked for."""


class Remote:
    """An object in a process of its own, which does one thing after the other.

    `make` makes it of the arguments; it must be importable. What the process needs besides, such
    as `torch.set_num_threads(1)`, is for it to do.
    """

    def __init__(self, make: Callable[..., Any], *arguments: Any) -> None:
        refuse_unguarded_script()
        context = multiprocessing.get_context("spawn")
        self.pipe, far_end = context.Pipe()
        self._process = context.Process(target=_serve, args=(far_end,), daemon=True)
        with _signals_blocked():
            self._process.start()
        far_end.close()
        self._begun, self._under_way = False, 0
        self._send((make, arguments))

    def ask(self, method: str, *arguments: Any) -> None:
        """Have a method called; several calls may be under way."""
        self._send((method, arguments))
        self._under_way += 1

    def answer(self) -> Any:
        """What the earliest call under way returns or raises; `ProcessEnded` with no process."""
        try:
            answer = _receive(self.pipe)
        except (EOFError, ConnectionResetError) as error:
            self._process.join()
            raise ProcessEnded(
                f"{_end(self._process.exitcode)}; what is on disk is intact"
            ) from error
        self._begun = True
        self._under_way -= 1
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the process, at once if it is at work."""
        self.pipe.close()
        if self._begun and not self._under_way:
            self._process.join(_END_SECONDS)
        self._process.kill()  # it has nothing to tidy up, and an environment may ignore SIGTERM
        self._process.join()

    def _send(self, request: Any) -> None:
        try:
            _send(self.pipe, request)
        except BrokenPipeError:
            self.answer()  # raises what the process ended with, if it still could say so
            raise


def wait_for(remotes: Sequence[Remote], seconds: float) -> list[Remote]:
    """Those that have an answer, or whose process is gone; none of them after a time."""
    pipes = {remote.pipe: remote for remote in remotes}
    return [pipes[one] for one in wait(list(pipes), seconds) if isinstance(one, Connection)]


def usable_cores() -> int:
    """How many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not every system has it
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def unguarded_script() -> Path | None:
    """The script that runs here, if it would begin anew in each process that it starts."""
    main = sys.modules["__main__"]
    path = getattr(main, "__file__", None)  # a notebook has none
    if path is None or getattr(getattr(main, "__spec__", None), "name", "").endswith("__main__"):
        return None  # other processes do not import it
    try:
        return None if b"__main__" in Path(path).read_bytes() else Path(path)
    except OSError:  # no file, such as a part of an archive
        return None


def refuse_unguarded_script() -> None:
    """Raise a sentence before processes start that could not.

    Raises:
        RuntimeError: If the script has no guard.
    """
    if (script := unguarded_script()) is not None:
        raise RuntimeError(
            f"{script.name}: other processes import this script, so what starts them must stand "
            'below `if __name__ == "__main__":`; training goes without them with workers=1'
        )


def end_with_parent() -> None:
    """End this process at once when the one that began it is gone, however it went."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _end(code: int | None) -> str:
    """How a process ended, in words."""
    try:
        name = signal.Signals(-(code or 0)).name
    except ValueError:  # no signal
        return f"a process ended with exit code {code}"
    return f"a process ended with exit code {code} ({name}: {_CAUSES.get(name, 'a signal')})"


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """A process that begins inside gets no signals before it has said what it does with them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows has none
        yield
        return
    from multiprocessing import resource_tracker  # not everywhere, either

    resource_tracker.ensure_running()  # it would let signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _FOR_THE_ONE_THAT_ASKS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _leave_signals_to_parent() -> None:
    # Not SIG_IGN but for Ctrl-C: programs that an environment begins would inherit it.
    for number in _FOR_THE_ONE_THAT_ASKS:
        ignored = number == signal.SIGINT
        signal.signal(number, signal.SIG_IGN if ignored else lambda *_: None)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _FOR_THE_ONE_THAT_ASKS)


def _serve(pipe: Connection) -> None:
    """Do what the other end of the pipe asks for, until it closes."""
    _leave_signals_to_parent()
    end_with_parent()
    try:
        make, arguments = _receive(pipe)
        served = make(*arguments)
        gc.freeze()
        while True:
            method, arguments = _receive(pipe)
            _send(pipe, _answer(served, method, arguments))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:
        error.add_note(traceback.format_exc())
        _send(pipe, error)


def _answer(served: Any, method: str, arguments: Any) -> Any:
    """What a method returns, or what it raises."""
    try:
        return getattr(served, method)(*arguments)
    except Exception as error:
        error.add_note(traceback.format_exc())
        return error


def _send(pipe: Connection, message: Any) -> None:
    # Not `pipe.send`: torch would send tensors as handles of shared memory.
    pipe.send_bytes(pickle.dumps(message))


def _receive(pipe: Connection) -> Any:
    return pickle.loads(pipe.recv_bytes())
