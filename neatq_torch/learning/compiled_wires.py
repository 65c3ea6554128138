"""The compiled form of `wire_fitting.py`, for the steps of a `TDLearner` on stored transitions.

Every number is that of the torch operations up to rounding. Networks do not mix, and every sum is
in one fixed order: the arenas and robots beside a network do not change a bit of its results. All
compiled functions stay in this one file; `kernels.py` says why.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np
from numba import njit
from tensordict import TensorDictBase

from neatq_torch.jit import cached_njit
from neatq_torch.learning.compiled_descent import F0, F1, F2, descend
from neatq_torch.learning.heads import CandidateHeads
from neatq_torch.learning.learner import TDLearner
from neatq_torch.learning.objectives import discount_of
from neatq_torch.learning.wire_fitting import WireFittingLoss
from neatq_torch.network import compiled, kernels
from neatq_torch.network.kernels import Floats
from neatq_torch.network.plan import Program

Fit = tuple[Floats, Floats, Floats, Floats]
"""Of each candidate its nearness 1 / D and what its value lacks to the best [K, size]; the mean of
the latter by the former, and the sum of the former [size]."""


class Pupils(NamedTuple):
    """Networks that learn: their evaluation order, and what belongs to their optimiser.

    All but that and the learning rate is changed in place. `rows` are the values of the largest
    network, `target` the weights to bootstrap from: `weight` itself without targets.
    """

    program: Program
    rows: int
    weight: Floats  # [networks, columns], as all down to the second moment
    target: Floats
    first_moment: Floats
    second_moment: Floats
    steps: Floats  # taken so far [networks]
    learning_rate: Floats  # [networks]


class Wires(NamedTuple):
    """The numbers of a `WireFittingLoss` over `CandidateHeads`."""

    candidates: int
    low: Floats  # smallest action [A]
    unit: Floats  # 1 / span of each action, 0 where there is none [A]
    smoothing: np.float32  # in spans of the values
    epsilon: np.float32
    value_low: np.float32  # the value of an output of 0
    value_span: np.float32  # from there to that of an output of 1


def can_teach(learner: TDLearner) -> bool:
    """Whether compiled code can stand in for a learner's torch operations."""
    loss = learner.loss
    wires = type(loss) is WireFittingLoss and loss.reduction == "sum"
    return wires and compiled.accepts(learner.network.weight)


def pupils_of(learner: TDLearner) -> Pupils:
    """All networks of a learner, in the memory where they stand."""
    plan, weight, target = learner.network.plan, learner.network.weight, learner.target_weight
    own = weight, weight if target is None else target, learner.first_moment, learner.second_moment
    tensors = (*own, learner.steps, learner.learning_rate)
    return Pupils(plan.program, plan.layout.rows, *(one.detach().numpy() for one in tensors))


def newborns_of(learner: TDLearner, slots: Sequence[int]) -> Pupils:
    """A copy of the networks in some slots (flat), with nothing learnt yet."""
    plan = learner.network.plan
    weight = learner.network.weight.detach().numpy()[slots]
    target = weight if learner.target_weight is None else weight.copy()
    moments = np.zeros_like(weight), np.zeros_like(weight)
    rate = np.full(len(slots), learner.config.learning_rate / learner.square, np.float32)
    program = Program._make(part[slots] for part in plan.program)
    own = weight, target, *moments, np.zeros_like(rate), rate
    return Pupils(program, plan.layout.rows, *own)


def learn(pupils: Pupils, learner: TDLearner, drawn: TensorDictBase, steps: int) -> Floats:
    """Take one step on each minibatch, as the learner would: its networks or others, the pupils.

    These stand arena after arena and learn from `drawn` [arenas, steps * size]. Returns the mean
    squared TD error of each network on the last minibatch [networks].
    """
    networks, arenas, wires = len(pupils.weight), len(drawn), _wires_of(learner)
    observation, following, action = (
        _part(drawn, name, steps) for name in ("observation", ("next", "observation"), "action")
    )
    returns = _returns(learner, drawn, steps)
    reward, ahead = (np.repeat(one, networks // arenas, 0) for one in returns)
    each = (networks, action.shape[2])
    output, slope = np.empty((2, *each, learner.network.outputs), np.float32)
    state = np.zeros((*each, learner.network.state_size), np.float32)
    kept, gradient = np.empty_like(state), np.empty_like(pupils.weight)
    no_slope, error = np.zeros_like(state), np.zeros(networks, np.float32)
    order, tau = (pupils.program, pupils.rows), learner.config.target_tau
    for step in range(steps):
        observations = observation[:, step], following[:, step]
        now, then = (np.repeat(part, networks // arenas, 0) for part in observations)
        kernels.forward(*order, pupils.target, then, state, output, kept)
        best = wires.value_low + wires.value_span * output[..., -wires.candidates :].max(-1)
        target = reward[:, step] + ahead[:, step] * best
        kernels.forward(*order, pupils.weight, now, state, output, kept)
        _slopes(output, action[:, step], target, wires, slope, error)
        gradient[:] = 0
        went = kernels.Batch(now, state, output, state)
        wanted = kernels.Batch(now, state, slope, no_slope)
        kernels.backward(*order, pupils.weight, went, gradient, wanted, False)
        moments, rate = (pupils.first_moment, pupils.second_moment), pupils.learning_rate
        descend(pupils.weight, gradient, moments, pupils.steps, rate, learner.adam)
        if tau is not None:
            pupils.target[:] += np.float32(tau) * (pupils.weight - pupils.target)
    return error


def _wires_of(learner: TDLearner) -> Wires:
    loss = cast(WireFittingLoss, learner.loss)
    heads = cast(CandidateHeads, loss.value_network.heads)
    low, high = heads.value_range
    numbers = (np.float32(one) for one in (loss.smoothing, loss.epsilon, low, high - low))
    return Wires(heads.candidates, heads.low.numpy(), loss.unit.numpy(), *numbers)


def _part(drawn: TensorDictBase, name: str | tuple[str, str], steps: int) -> Floats:
    """An entry of each minibatch [arenas, steps, size, n]."""
    rows = drawn.get(name).float().numpy()
    return rows.reshape(len(drawn), steps, -1, rows.shape[-1])


def _returns(learner: TDLearner, drawn: TensorDictBase, steps: int) -> tuple[Floats, Floats]:
    """Weighed rewards, and discounts of the next state's value, 0 where it is terminal.

    Both are [arenas, steps, size].
    """
    names = ("next", "reward"), "steps_to_next_obs", ("next", "terminated")
    reward, ahead, over = (_part(drawn, name, steps)[..., 0] for name in names)
    gamma = discount_of(learner.loss)
    if learner.loss.normalize_return:
        reward = reward * np.float32(1 - gamma)
    return reward, (1 - over) * np.power(np.float32(gamma), ahead)


@cached_njit(error_model="numpy")
def _slopes(
    output: Floats, action: Floats, target: Floats, wires: Wires, slope: Floats, error: Floats
) -> None:
    """Gradients of half the squared TD error with regard to the outputs [networks, size, outputs].

    They go to `slope`, and the mean squared TD error [networks] to `error`, for what was done
    [arenas, size, A] and the targets [networks, size].
    """
    networks, size, outputs = output.shape
    robots, candidates = networks // len(action), wires.candidates
    # Rows over transitions, so that inner loops become vector instructions.
    out, moved = np.empty((outputs, size), np.float32), np.empty((outputs, size), np.float32)
    away = np.empty((outputs - candidates, size), np.float32)
    near, gap = np.empty((candidates, size), np.float32), np.empty((candidates, size), np.float32)
    wrong, mean, total = np.empty((3, size), np.float32)
    fit = near, gap, mean, total
    for network in range(networks):
        out[:] = output[network].T
        _distances(out, action[network // robots], wires, away)
        _weigh(out, away, wires, fit)
        best = out[outputs - candidates :]
        squares = F0
        for i in range(size):
            value = wires.value_low + wires.value_span * best[0, i] + gap[0, i] - mean[i]
            wrong[i] = target[network, i] - value
            squares += wrong[i] * wrong[i]
        error[network] = squares / np.float32(size)
        _spread(out, away, wires, fit, wrong, moved)
        slope[network] = moved.T


@njit(error_model="numpy")
def _distances(out: Floats, action: Floats, wires: Wires, away: Floats) -> None:
    """From each candidate to the action [size, A], in spans [K A, size]."""
    actions = len(wires.low)
    for row in range(len(away)):
        a = row % actions
        low, unit = wires.low[a], wires.unit[a]
        within = F1 if unit != F0 else F0
        for i in range(len(action)):
            here = min(max(out[row, i], F0), F1)
            away[row, i] = (action[i, a] - low) * unit - within * here


@njit(error_model="numpy")
def _weigh(out: Floats, away: Floats, wires: Wires, fit: Fit) -> None:
    """Weigh the candidates, by outputs [outputs, size] and their way to the actions [K A, size]."""
    near, gap, mean, total = fit
    candidates, actions, size = wires.candidates, len(wires.low), out.shape[1]
    first = candidates * actions
    mean[:], total[:] = out[first], F0
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
    mean[:] = F0
    for k in range(candidates):
        for i in range(size):
            near[k, i] = F1 / near[k, i]
            total[i] += near[k, i]
            mean[i] += near[k, i] * gap[k, i]
    for i in range(size):
        mean[i] /= total[i]


@njit(error_model="numpy")
def _spread(
    out: Floats, away: Floats, wires: Wires, fit: Fit, wrong: Floats, slope: Floats
) -> None:
    """The gradients [outputs, size] of transitions whose TD errors are `wrong` [size].

    Their derivation stands with `wire_fit`; the best candidates share what goes to q_max.
    """
    near, gap, mean, total = fit
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
            ties[i] += F1 if gap[k, i] == F0 else F0
        for row in range(k * actions, (k + 1) * actions):
            unit = wires.unit[row % actions]
            for i in range(size):
                inside = F0 <= out[row, i] <= F1 and unit != F0
                step = wrong[i] * F2 * away[row, i] * more[i]
                slope[row, i] = step if inside else F0
    for k in range(candidates):
        for i in range(size):
            part = wrong[i] * wires.value_span * rest[i] / ties[i]
            slope[first + k, i] -= part if gap[k, i] == F0 else F0
