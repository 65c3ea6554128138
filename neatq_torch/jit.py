"""Functions that numba compiles once for each machine, or for each process where it must."""

from __future__ import annotations

import itertools
import os
import time
import warnings
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.bytecode import FunctionIdentity

_TOLD = "NEATQ_COMPILES_IN_EACH_PROCESS"

# numba numbers what a process compiles from 1 on. Of what is kept on disk it takes functions with
# the same name and number for the same, so that one that was compiled by itself crashed beside
# another process's that calls it. With numbers of each process's own none are the same.
FunctionIdentity._unique_ids = itertools.count(time.time_ns())


def cached_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`njit(cache=True, ...)`, which also works where nothing can be kept on disk.

    Then each process compiles anew, and a warning says so: once, as workers learn from the
    environment that it was said.

    Args:
        options: Further options of `numba.njit`.
    """

    def compile_(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:  # numba found no folder that it can write to
            if _TOLD not in os.environ:
                os.environ[_TOLD] = "1"
                words = "numba finds no folder to keep what it compiles, so each process compiles "
                words += "anew, for 10 to 15 seconds; set NUMBA_CACHE_DIR to one that it may write"
                warnings.warn(words, RuntimeWarning, stacklevel=2)
            return njit(**options)(function)

    return compile_
