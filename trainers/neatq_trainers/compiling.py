"""The first run on a machine compiles its inner loops, and says so."""

from __future__ import annotations

import sys
import time

from numba.core import event


class CompilingTold(event.Listener):
    """Says once that numba compiles, and afterwards for how long it did.

    Only on a terminal. Where all is in numba's cache it is never called.
    """

    def __init__(self) -> None:
        self._depth, self._began, self._seconds = 0, 0.0, 0.0
        event.register("numba:compile", self)

    def on_start(self, event: event.Event) -> None:
        """A function is being compiled, often inside of another one."""
        if not self._depth:
            self._began = time.monotonic()
            if not self._seconds:
                _tell("the first run on this machine compiles; that takes a while, once")
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """It was."""
        self._depth -= 1
        if not self._depth:
            self._seconds += time.monotonic() - self._began

    def close(self) -> None:
        """Say how long it took, and listen no more."""
        event.unregister("numba:compile", self)
        if self._seconds:
            _tell(f"compiled in {self._seconds:.0f} s; the next run need not")


def _tell(words: str) -> None:
    if sys.stderr is not None and sys.stderr.isatty():
        print(f"neatq: {words}", file=sys.stderr, flush=True)
