"""Functions that numba compiles once for each machine, or for each process where it must."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from typing import Any

from numba import njit

_SAID = "NEATQ_COMPILES_IN_EACH_PROCESS"


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`njit(cache=True, ...)`, which also works where nothing can be kept on disk.

    Then each process compiles anew, and a warning says so: once, as workers and the library (see
    `neatq_torch.jit`) learn from the environment that it was said.

    Args:
        options: Further options of `numba.njit`.
    """

    def keep(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:  # numba found no folder that it can write to
            if _SAID not in os.environ:
                os.environ[_SAID] = "1"
                words = "numba finds no folder to keep what it compiles, so each process compiles "
                words += "anew, for 10 to 15 seconds; set NUMBA_CACHE_DIR to one that it may write"
                warnings.warn(words, RuntimeWarning, stacklevel=2)
            return njit(**options)(function)

    return keep
