"""The gradient of wire fitting and the steps of an optimiser, in float32, compiled.

Networks do not mix, and every sum is in one fixed order: the arenas and robots beside a network do
not change a bit of its results. All functions that numba compiles stay in this one file, as numba's
cache does not notice when a function of another file has changed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_torch.learning.learner import ADAM_BETAS, ADAM_EPSILON

Floats = NDArray[np.float32]

_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_BETA1, _BETA2 = ADAM_BETAS
_MOVE1, _MOVE2 = np.float32(1 - _BETA1), np.float32(1 - _BETA2)
_SMALL = np.float32(ADAM_EPSILON)


class Wires(NamedTuple):
    """The numbers of a `WireFittingLoss` over `CandidateHeads`.

    Attributes:
        candidates: K.
        low: Smallest action [A].
        unit: 1 / span of each action, 0 where there is none [A].
        smoothing: c, in spans of the values.
        epsilon: epsilon.
        value_low: The value of an output of 0.
        value_span: From there to that of an output of 1.
        explored: Probability with which the next candidate is any, not the best.
        separation: Weight of each pair of candidates in `closeness`; 0 without.
        width: Of `closeness`, squared.
    """

    candidates: int
    low: Floats
    unit: Floats
    smoothing: np.float32
    epsilon: np.float32
    value_low: np.float32
    value_span: np.float32
    explored: np.float32
    separation: np.float32
    width: np.float32


@njit(cache=True, error_model="numpy")
def targets(
    following: Floats, chooser: Floats, reward: Floats, discount: Floats, wires: Wires
) -> Floats:
    """What is learnt towards [networks, size].

    Args:
        following: Outputs for the next states, whose values count [networks, size, outputs].
        chooser: Outputs by which the best candidate is chosen, likewise.
        reward: A row for all networks of an arena, or for each network [rows, size].
        discount: Of the next state's value, likewise.
        wires: The law.
    """
    networks, size, outputs = following.shape
    sharing, first = networks // len(reward), outputs - wires.candidates
    target = np.empty((networks, size), np.float32)
    for network in range(networks):
        row = network // sharing
        for i in range(size):
            best, total = first, following[network, i, first]
            for k in range(first + 1, outputs):
                total += following[network, i, k]
                if chooser[network, i, k] > chooser[network, i, best]:
                    best = k
            mean = total / np.float32(wires.candidates)
            expected = (_ONE - wires.explored) * following[network, i, best] + wires.explored * mean
            value = wires.value_low + wires.value_span * expected
            target[network, i] = reward[row, i] + discount[row, i] * value
    return target


@njit(cache=True, error_model="numpy")
def slopes(
    output: Floats, action: Floats, target: Floats, wires: Wires, slope: Floats, error: Floats
) -> None:
    """Gradients of half the squared TD error with regard to the outputs.

    Args:
        output: [networks, size, outputs].
        action: What was done [arenas, size, A].
        target: [networks, size].
        wires: The law.
        slope: Takes the gradients, as `output`.
        error: Takes the mean squared TD error [networks].
    """
    networks, size, outputs = output.shape
    robots, candidates = networks // len(action), wires.candidates
    # Rows over transitions, so that inner loops become vector instructions.
    out, moved = np.empty((outputs, size), np.float32), np.empty((outputs, size), np.float32)
    away = np.empty((outputs - candidates, size), np.float32)
    near, gap = np.empty((candidates, size), np.float32), np.empty((candidates, size), np.float32)
    wrong, mean, total = np.empty((3, size), np.float32)
    for network in range(networks):
        for o in range(outputs):
            for i in range(size):
                out[o, i] = output[network, i, o]
        _distances(out, action[network // robots], wires, away)
        _fit(out, away, wires, near, gap, mean, total)
        best = out[outputs - candidates :]
        squares = _ZERO
        for i in range(size):
            value = wires.value_low + wires.value_span * best[0, i] + gap[0, i] - mean[i]
            wrong[i] = target[network, i] - value
            squares += wrong[i] * wrong[i]
        error[network] = squares / np.float32(size)
        _spread(out, away, wires, near, gap, mean, total, wrong, moved)
        if wires.separation > _ZERO:
            _separate(out, wires, moved)
        for o in range(outputs):
            for i in range(size):
                slope[network, i, o] = moved[o, i]


@njit(error_model="numpy")
def _distances(out: Floats, action: Floats, wires: Wires, away: Floats) -> None:
    """From each candidate to the action [size, A], in spans [K A, size]."""
    actions = len(wires.low)
    for row in range(len(away)):
        a = row % actions
        low, unit = wires.low[a], wires.unit[a]
        within = _ONE if unit != _ZERO else _ZERO
        for i in range(len(action)):
            here = min(max(out[row, i], _ZERO), _ONE)
            away[row, i] = (action[i, a] - low) * unit - within * here


@njit(error_model="numpy")
def _fit(
    out: Floats,
    away: Floats,
    wires: Wires,
    near: Floats,
    gap: Floats,
    mean: Floats,
    total: Floats,
) -> None:
    """Weigh the candidates.

    Args:
        out: Outputs [outputs, size].
        away: From candidates to actions [K A, size].
        wires: The law.
        near: Takes the nearness of each candidate [K, size].
        gap: Takes what its value lacks to the best [K, size].
        mean: Takes the mean gap by nearness [size].
        total: Takes the sum of nearnesses [size].
    """
    candidates, actions, size = wires.candidates, len(wires.low), out.shape[1]
    first = candidates * actions
    for i in range(size):
        mean[i], total[i] = out[first, i], _ZERO
    for k in range(1, candidates):
        for i in range(size):
            mean[i] = max(mean[i], out[first + k, i])  # the best output, for now
    for k in range(candidates):
        for i in range(size):
            gap[k, i] = wires.value_span * (mean[i] - out[first + k, i])
            near[k, i] = wires.smoothing * gap[k, i] + wires.epsilon
        for row in range(k * actions, (k + 1) * actions):
            for i in range(size):
                near[k, i] += away[row, i] * away[row, i]
    for i in range(size):
        mean[i] = _ZERO
    for k in range(candidates):
        for i in range(size):
            near[k, i] = _ONE / near[k, i]
            total[i] += near[k, i]
            mean[i] += near[k, i] * gap[k, i]
    for i in range(size):
        mean[i] /= total[i]


@njit(error_model="numpy")
def _spread(
    out: Floats,
    away: Floats,
    wires: Wires,
    near: Floats,
    gap: Floats,
    mean: Floats,
    total: Floats,
    wrong: Floats,
    slope: Floats,
) -> None:
    """The gradients [outputs, size] of transitions whose TD errors are `wrong` [size].

    With n = 1 / D and M the mean of the gaps by nearness, Q = q_max - M, and
    dM/dgap_k = n_k / sum n - c n_k^2 (gap_k - M) / sum n; a candidate u_k gets
    dQ/du_k = -2 (a - u_k) n_k^2 (gap_k - M) / sum n. The best candidates share dQ/dq_max.
    """
    candidates, actions, size = wires.candidates, len(wires.low), out.shape[1]
    first = candidates * actions
    rest, ties = np.ones(size, np.float32), np.zeros(size, np.float32)
    more = np.empty(size, np.float32)
    for k in range(candidates):
        for i in range(size):
            share = near[k, i] / total[i]
            more[i] = share * near[k, i] * (gap[k, i] - mean[i])
            by_gap = share - wires.smoothing * more[i]
            slope[first + k, i] = -wrong[i] * wires.value_span * by_gap
            rest[i] -= by_gap
            ties[i] += _ONE if gap[k, i] == _ZERO else _ZERO
        for row in range(k * actions, (k + 1) * actions):
            unit = wires.unit[row % actions]
            for i in range(size):
                inside = _ZERO <= out[row, i] <= _ONE and unit != _ZERO
                step = wrong[i] * _TWO * away[row, i] * more[i]
                slope[row, i] = step if inside else _ZERO
    for k in range(candidates):
        for i in range(size):
            part = wrong[i] * wires.value_span * rest[i] / ties[i]
            slope[first + k, i] -= part if gap[k, i] == _ZERO else _ZERO


@njit(error_model="numpy")
def _separate(out: Floats, wires: Wires, slope: Floats) -> None:
    """Add to the gradients [outputs, size] that of `closeness`: every pair pushes apart."""
    actions, size = len(wires.low), out.shape[1]
    push, apart = np.empty(size, np.float32), np.empty((actions, size), np.float32)
    for one in range(0, wires.candidates * actions, actions):
        for other in range(0, one, actions):
            push[:] = wires.width
            for a in range(actions):
                within = _ONE if wires.unit[a] != _ZERO else _ZERO
                for i in range(size):
                    here = min(max(out[one + a, i], _ZERO), _ONE)
                    there = min(max(out[other + a, i], _ZERO), _ONE)
                    apart[a, i] = within * (here - there)
                    push[i] += apart[a, i] * apart[a, i]
            for i in range(size):
                push[i] = wires.separation / (push[i] * np.sqrt(push[i]))
            for a in range(actions):
                for i in range(size):
                    step = push[i] * apart[a, i]
                    slope[one + a, i] -= step if _ZERO <= out[one + a, i] <= _ONE else _ZERO
                    slope[other + a, i] += step if _ZERO <= out[other + a, i] <= _ONE else _ZERO


@njit(cache=True, error_model="numpy")
def step(
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
            steps[n] += _ONE
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
        first[c] += _MOVE1 * (gradient[c] - first[c])
        second[c] += _MOVE2 * (gradient[c] * gradient[c] - second[c])
        gradient[c] = scale * first[c] / (np.sqrt(second[c]) + _SMALL)


@njit(cache=True, error_model="numpy")
def follow(target: Floats, weight: Floats, tau: np.float32) -> None:
    """Move target weights towards the weights."""
    for n in range(len(target)):
        for c in range(target.shape[1]):
            target[n, c] += tau * (weight[n, c] - target[n, c])
