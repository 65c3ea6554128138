"""The compiled form of what a `SharedCritic` learns and teaches, in float32 on the CPU.

Every number is that of the torch operations up to rounding. Products of matrices are BLAS's, in
blocks of rows so small that they stay in the first-level cache and that BLAS takes one thread for a
critic of the usual width. All compiled functions stay in this one file; `kernels.py` says why.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from neatq_torch.jit import cached_njit
from neatq_torch.learning.compiled_descent import F0, F1, F2, descend
from neatq_torch.learning.critic import Minibatch, TwinCritic
from neatq_torch.learning.learner import Adams
from neatq_torch.network import PopulationNetwork, kernels
from neatq_torch.network.compiled import accepts
from neatq_torch.network.kernels import Floats
from neatq_torch.network.plan import Program

__all__ = ["accepts", "step", "teach"]
_FEW_ROWS = 64


class Perceptron(NamedTuple):
    """The layers of one perceptron, each [numbers read + 1, nodes] with the biases last."""

    first: Floats
    second: Floats
    last: Floats


@njit(error_model="numpy")
def _scratch(numbers: int) -> Floats:
    return np.empty((_FEW_ROWS, numbers), np.float32)


@njit(error_model="numpy")
def _perceptron(weight: Floats, inputs: int, width: int) -> Perceptron:
    first, second = (inputs + 1) * width, (inputs + 1 + width + 1) * width
    return Perceptron(
        weight[:first].reshape(inputs + 1, width),
        weight[first:second].reshape(width + 1, width),
        weight[second:].reshape(width + 1, -1),
    )


@njit(error_model="numpy")
def _affine(rows: Floats, layer: Floats, out: Floats, rectified: bool) -> None:
    """What a layer makes of rows."""
    np.dot(rows, layer[:-1], out)
    bias = layer[-1]
    for r in range(len(out)):
        for j in range(len(bias)):
            value = out[r, j] + bias[j]
            out[r, j] = max(value, F0) if rectified else value


@njit(error_model="numpy")
def _values(one: Perceptron, rows: Floats, near: Floats, far: Floats, out: Floats) -> None:
    """Q-values of at most a block of rows; `near` and `far` take the hidden layers."""
    _affine(rows, one.first, near, True)
    _affine(near, one.second, far, True)
    _affine(far, one.last, out, False)


@njit(error_model="numpy")
def _back(weight: Floats, slope: Floats, reached: Floats, back: Floats) -> None:
    """The gradient of a layer's ReLUs, from that of the layer after it with such weights."""
    np.dot(slope, weight.T, back)
    for r in range(len(back)):
        for j in range(back.shape[1]):
            back[r, j] = back[r, j] if reached[r, j] > F0 else F0


@njit(error_model="numpy")
def _gather(rows: Floats, slope: Floats, product: Floats, gradient: Floats) -> None:
    """Add what rows and the gradient of a layer's nodes say to the gradient of its weights."""
    np.dot(rows.T, slope, product)
    for i in range(len(product)):
        for j in range(product.shape[1]):
            gradient[i, j] += product[i, j]
    for r in range(len(slope)):
        for j in range(slope.shape[1]):
            gradient[-1, j] += slope[r, j]


@njit(error_model="numpy")
def _best(left: Floats, right: Floats) -> int:
    """The column with the greatest sum of both; the first of equals."""
    best = 0
    for k in range(1, len(left)):
        if left[k] + right[k] > left[best] + right[best]:
            best = k
    return best


@cached_njit(error_model="numpy")
def td_gradient(
    weight: Floats,
    slow: Floats,
    width: int,
    rows: Floats,
    taken: NDArray[np.int64],
    reward: Floats,
    following: Floats,
    ahead: Floats,
    gradient: Floats,
) -> float:
    """The gradient of a critic's squared TD errors for the columns of a `Minibatch`.

    By its weights [2, numbers] and those of its slow copy; goes to `gradient`, zeros so far.
    Returns the sum of both mean squared TD errors.
    """
    size, inputs = rows.shape
    outputs = (weight.shape[1] - (inputs + width + 2) * width) // (width + 1)
    near, far, back = _scratch(width), _scratch(width), _scratch(width)
    values, slope = np.empty((4, _FEW_ROWS, outputs), np.float32), _scratch(outputs)
    product, edge = np.empty((width, width), np.float32), np.empty((inputs, width), np.float32)
    last, target = np.empty((width, outputs), np.float32), np.empty(_FEW_ROWS, np.float32)
    error = 0.0
    for start in range(0, size, _FEW_ROWS):
        n = min(_FEW_ROWS, size - start)
        now, then = rows[start : start + n], following[start : start + n]
        for twin in range(2):
            one = _perceptron(slow[twin], inputs, width)
            _values(one, then, near[:n], far[:n], values[twin, :n])
            if outputs > 1:
                one = _perceptron(weight[twin], inputs, width)
                _values(one, then, near[:n], far[:n], values[2 + twin, :n])
        for r in range(n):
            best = _best(values[2, r], values[3, r]) if outputs > 1 else 0
            target[r] = reward[start + r]
            if ahead[start + r] > F0:
                target[r] += ahead[start + r] * min(values[0, r, best], values[1, r, best])
        for twin in range(2):
            one = _perceptron(weight[twin], inputs, width)
            change = _perceptron(gradient[twin], inputs, width)
            _values(one, now, near[:n], far[:n], values[0, :n])
            slope[:] = F0
            for r in range(n):
                wrong = values[0, r, taken[start + r]] - target[r]
                error += wrong * wrong / size
                slope[r, taken[start + r]] = F2 * wrong / np.float32(size)
            _gather(far[:n], slope[:n], last, change.last)
            _back(one.last[:-1], slope[:n], far[:n], back[:n])
            _gather(near[:n], back[:n], product, change.second)
            far[:n] = back[:n]
            _back(one.second[:-1], far[:n], near[:n], back[:n])
            _gather(now, back[:n], edge, change.first)
    return error


@cached_njit(error_model="numpy")
def lesson_in_a_box(
    weight: Floats, width: int, observation: Floats, output: Floats, lesson: Floats
) -> None:
    """`SharedCritic.lesson` on actions in a box: goes to `lesson` [networks, rows, actions].

    By the critic's weights [2, numbers], for observations [rows, inputs] and outputs, as `lesson`.
    """
    networks, size, actions = output.shape
    inputs, share = observation.shape[1], -F2 / np.float32(size)
    one = _perceptron(weight[0], inputs + actions, width)
    near, far, back = _scratch(width), _scratch(width), _scratch(width)
    rows, slope = _scratch(inputs + actions), _scratch(actions)
    by_node, by_action = one.last[:-1, 0].copy(), one.first[inputs:-1]
    for network in range(networks):
        for start in range(0, size, _FEW_ROWS):
            n = min(_FEW_ROWS, size - start)
            put_out, told = output[network, start : start + n], lesson[network, start : start + n]
            rows[:n, :inputs] = observation[start : start + n]
            for r in range(n):
                for a in range(actions):
                    rows[r, inputs + a] = F2 * min(max(put_out[r, a], F0), F1) - F1
            _affine(rows[:n], one.first, near[:n], True)
            _affine(near[:n], one.second, far[:n], True)
            for r in range(n):
                for j in range(width):
                    far[r, j] = by_node[j] if far[r, j] > F0 else F0
            _back(one.second[:-1], far[:n], near[:n], back[:n])
            np.dot(back[:n], by_action.T, slope[:n])
            for r in range(n):
                for a in range(actions):
                    inside = F0 <= put_out[r, a] <= F1
                    told[r, a] = share * slope[r, a] if inside else F0


@cached_njit(error_model="numpy")
def lesson_by_choice(
    weight: Floats, width: int, observation: Floats, output: Floats, lesson: Floats
) -> None:
    """As `lesson_in_a_box`, where there are a few actions to choose from."""
    networks, size, choices = output.shape
    near, far = _scratch(width), _scratch(width)
    values, inclined = np.empty((2, _FEW_ROWS, choices), np.float32), np.empty(choices, np.float32)
    for start in range(0, size, _FEW_ROWS):
        n = min(_FEW_ROWS, size - start)
        for twin in range(2):
            one = _perceptron(weight[twin], observation.shape[1], width)
            _values(one, observation[start : start + n], near[:n], far[:n], values[twin, :n])
        for network in range(networks):
            for r in range(n):
                put_out, mean, total = output[network, start + r], F0, F0
                greatest = put_out.max()
                for k in range(choices):
                    inclined[k] = np.exp(put_out[k] - greatest)
                    total += inclined[k]
                for k in range(choices):
                    inclined[k] /= total
                    mean += inclined[k] * (values[0, r, k] + values[1, r, k]) / F2
                for k in range(choices):
                    lacks = mean - (values[0, r, k] + values[1, r, k]) / F2
                    lesson[network, start + r, k] = inclined[k] * lacks / np.float32(size)


def step(
    weight: Tensor, slow: Tensor, width: int, adams: Adams, given: Minibatch, rate: float
) -> Tensor:
    """A step of a critic's weights [2, numbers]; returns the sum of both mean squared TD errors."""
    own, (steps, *moments) = weight.detach().numpy(), (one.numpy() for one in adams)
    gradient, columns = np.zeros_like(own), (one.numpy() for one in given)
    error = td_gradient(own, slow.numpy(), width, *columns, gradient)
    descend(own, gradient, tuple(moments), steps, np.full_like(steps, rate), True)
    return torch.tensor(error)


def teach(
    network: PopulationNetwork,
    own: slice,
    adams: Adams,
    seen: Tensor,
    critic: TwinCritic,
    rate: float,
    wanted: Tensor | None = None,
) -> None:
    """Let networks follow a critic, a step on each minibatch [minibatches, size, inputs].

    Or come nearer to outputs that are wanted [minibatches, size, outputs]; see `toward`.
    """
    _, size, inputs = seen.shape
    plan, width, judge = network.plan, critic.sizes[1], critic.weight.detach().numpy()
    boxed = critic.sizes[0] > inputs  # it reads actions, too
    lesson_of = lesson_in_a_box if boxed else lesson_by_choice
    weight = network.weight.detach().numpy()[own]
    program = Program._make(part[own] for part in plan.program)
    steps, *moments = (one.numpy() for one in adams)
    rates, gradient = np.full_like(steps, rate), np.empty_like(weight)
    output, lesson = np.empty((2, len(weight), size, network.outputs), np.float32)
    state = np.zeros((len(weight), size, network.state_size), np.float32)
    kept, nothing = np.empty_like(state), np.zeros_like(state)
    toward = None if wanted is None else wanted.numpy()
    for number, minibatch in enumerate(seen.numpy()):
        observation = np.repeat(minibatch[None], len(weight), 0)
        kernels.forward(program, plan.layout.rows, weight, observation, state, output, kept)
        if toward is None:
            lesson_of(judge, width, minibatch, output, lesson)
        else:
            np.multiply(output - toward[number], F2 / np.float32(size), lesson)
        gradient[:] = 0
        went = kernels.Batch(observation, state, output, state)
        told = kernels.Batch(observation, state, lesson, nothing)
        kernels.backward(program, plan.layout.rows, weight, went, gradient, told, False)
        descend(weight, gradient, tuple(moments), steps, rates, True)
