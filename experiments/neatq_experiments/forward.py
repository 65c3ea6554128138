"""How long a network takes for one observation."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import torch

PASSES, WARM_UP = 300, 30


@torch.no_grad()
def forward_us(forward: Callable[[], Any]) -> float:
    """Median time of a forward pass in microseconds, on as many threads as torch has."""
    times = []
    for _ in range(WARM_UP + PASSES):
        began = time.perf_counter()
        forward()
        times.append(time.perf_counter() - began)
    return 1e6 * median(times[WARM_UP:])
