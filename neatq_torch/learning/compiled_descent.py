"""The compiled form of a step of gradient descent, for networks that do not mix."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from neatq_torch.jit import cached_njit
from neatq_torch.learning.learner import ADAM_BETAS, ADAM_EPSILON
from neatq_torch.network.kernels import Floats

F0, F1, F2 = np.float32(0), np.float32(1), np.float32(2)
_BETA1, _BETA2 = ADAM_BETAS
_MOVE1, _MOVE2 = np.float32(1 - _BETA1), np.float32(1 - _BETA2)
_SMALL = np.float32(ADAM_EPSILON)
_TINY = np.finfo(np.float32).tiny


@cached_njit(error_model="numpy")
def descend(
    weight: Floats,
    gradient: Floats,
    moments: tuple[Floats, Floats],
    steps: Floats,
    learning_rate: Floats,
    adam: bool,
) -> None:
    """One step of every network that stays finite, by Adam or by the gradient itself."""
    changed = np.empty(weight.shape[1], np.float32)
    for n in range(len(weight)):
        if adam:
            steps[n] += F1
            _adam(gradient[n], moments[0][n], moments[1][n], steps[n])
        finite = True
        for c in range(len(changed)):
            changed[c] = weight[n, c] - learning_rate[n] * gradient[n, c]
            finite &= math.isfinite(changed[c])
        if finite:
            weight[n] = changed


@njit(error_model="numpy")
def _adam(gradient: Floats, first: Floats, second: Floats, steps: np.float32) -> None:
    """Replace the gradient of one network [columns] by Adam's direction."""
    unbiased1 = -math.expm1(steps * math.log(_BETA1))
    unbiased2 = -math.expm1(steps * math.log(_BETA2))
    scale = np.float32(math.sqrt(unbiased2) / unbiased1)
    for c in range(len(gradient)):
        first[c] = _normal(first[c] + _MOVE1 * (gradient[c] - first[c]))
        second[c] = _normal(second[c] + _MOVE2 * (gradient[c] * gradient[c] - second[c]))
        gradient[c] = scale * first[c] / (np.sqrt(second[c]) + _SMALL)


@njit(error_model="numpy")
def _normal(moment: np.float32) -> np.float32:
    """The same, or 0 in place of a subnormal number, which makes a step ten times as slow.

    Where a gradient is 0 for long a moment fades to one, and stays there: a tenth of it is nothing.
    """
    return moment if abs(moment) >= _TINY else F0
