"""How networks without velocities are judged at double pole balancing (Gruau et al. 1996)."""

from __future__ import annotations

import numpy as np

PROGRAM_START_RAD = 0.07
"""Where the long pole starts in Stanley's program; the paper says one degree."""
WOBBLE_STEPS = 100
_TRIAL_STEPS = 1000
_WOBBLE_SCALE = 0.75

# The generalisation test of Gruau, Whitley & Pyeatt (1996): shares of the ranges of the cart's
# place and velocity and of the long pole's angle (3.6 degrees) and rate (8.6 degrees/s).
_GRID = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
_GRID_REACH = np.array([2.16, 1.35, 0.06283152, 0.15009752])


def generalisation_starts() -> np.ndarray:
    """The 625 starts of the generalisation test, float64 [625, 6].

    A network's generalisation is the number of starts from which it balances for 1,000 actions.
    The last variable, the long pole's rate, turns fastest.
    """
    shares = np.stack(np.meshgrid(*[_GRID] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    state = np.zeros((len(shares), 6))
    state[:, :4] = (2 * shares - 1) * _GRID_REACH
    return state


def damping_fitness(steps: np.ndarray, wobble: np.ndarray) -> np.ndarray:
    """The fitness of Gruau, Whitley & Pyeatt (1996) for networks without velocities.

    F = 0.1 f1 + 0.9 f2 with f1 = t / 1000 and f2 = 0 if t < 100, else 0.75 / (sum of
    |x| + |x'| + |angle| + |angle'| over the last 100 balanced actions, long pole only). It keeps
    networks from surviving by shaking the cart.

    Args:
        steps: t, how many actions of at most 1,000 each row stayed alive, [rows].
        wobble: that sum after each of the last 100 balanced actions, float64 [rows, 100].
    """
    total = np.maximum(wobble.sum(axis=1), np.finfo(float).tiny)
    calm = np.where(steps < WOBBLE_STEPS, 0.0, _WOBBLE_SCALE / total)
    return 0.1 * steps / _TRIAL_STEPS + 0.9 * calm
