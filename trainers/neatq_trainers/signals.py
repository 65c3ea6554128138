"""Signals that end a run in order."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NoReturn

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


class Terminated(SystemExit):
    """SIGTERM or SIGHUP asked a run to end; its code is 128 and the number of the signal."""


def raise_for(number: int) -> NoReturn:
    """End what is under way as a signal asks for."""
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise Terminated(128 + number)


def _raise(number: int, _: object) -> None:
    raise_for(number)


@contextmanager
def ending_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP raise `Terminated` inside, as Ctrl-C raises KeyboardInterrupt.

    A signal that somebody handles or ignores already (nohup) is left alone. So are all where only
    others may handle them: outside of the main thread, and in a process that another one began.
    """
    numbers = _ENDING if is_main_thread() and multiprocessing.parent_process() is None else []
    ours = [one for one in numbers if signal.getsignal(one) is signal.SIG_DFL]
    with handling(ours, _raise):
        yield


@contextmanager
def noting_signals() -> Iterator[list[int]]:
    """The first of Ctrl-C, SIGTERM and SIGHUP is noted; a second one ends what is under way.

    Yields a list that is empty until then, and afterwards has the number of the signal.
    """
    came: list[int] = []

    def note(number: int, _: object) -> None:
        came.append(number)
        stack.close()

    ours = [one for one in _ENDING if signal.getsignal(one) is _raise]
    with ExitStack() as stack:
        stack.enter_context(handling([signal.SIGINT, *ours] if is_main_thread() else [], note))
        yield came


def is_main_thread() -> bool:
    """Whether this thread may handle signals."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def handling(numbers: Sequence[Any], handler: Callable[[int, object], None]) -> Iterator[None]:
    """Signals of these numbers are handled by another function inside."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
