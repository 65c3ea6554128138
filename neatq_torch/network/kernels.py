"""Compiled evaluation of a whole population on the CPU, and its adjoint, in float32.

Values of one network are rows of a small scratch array, and one row holds the same value for up to
`_BLOCK` observations, so inner loops run over observations. Every sum is in one fixed order, and
products and sums are rounded one by one: results of an observation have the same bits whatever its
batch, its slot and its neighbours. Therefore there is no `fastmath` here, which would reorder
sums and contract them. `_dot` alone, which adds up observations for the gradient of a weight, is
free to keep partial sums: their order is fixed by the number of observations.

All functions stay in this one file: numba's cache on disk does not notice when a function that is
called from another file has changed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_torch.genome.rules import ACTIVATIONS
from neatq_torch.jit import cached_njit
from neatq_torch.network.plan import Program

Floats = NDArray[np.float32]
LiveLinks = NDArray[np.bool_]


class Batch(NamedTuple):
    """What one call reads and writes, or the gradients of it.

    Attributes:
        observation: [networks, batch, inputs].
        state: State from the call before [networks, batch, state].
        output: [networks, batch, outputs].
        kept: State for the next call [networks, batch, state].
    """

    observation: Floats
    state: Floats
    output: Floats
    kept: Floats


_BLOCK = 128  # observations: the rows of one network stay within the first-level cache
_FEW = 8  # outputs: fewer are summed one by one, more as a vector

_SIGMOID, _STEEP_SIGMOID = ACTIVATIONS.index("sigmoid"), ACTIVATIONS.index("steep_sigmoid")
_TANH, _RELU = ACTIVATIONS.index("tanh"), ACTIVATIONS.index("relu")

ZERO, _HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
_STEEP, _HALF_STEEP = np.float32(4.9), np.float32(2.45)

# tanh(x) = x P(x^2) / Q(x^2): the minimax approximation of Eigen (MathFunctionsImpl.h,
# generic_fast_tanh_float; also in XNNPACK). Beyond the bound the quotient is 1 in float32.
_BOUND = np.float32(7.90531110763549805)
_P1, _P3 = np.float32(4.89352455891786e-03), np.float32(6.37261928875436e-04)
_P5, _P7 = np.float32(1.48572235717979e-05), np.float32(5.12229709037114e-08)
_P9, _P11 = np.float32(-8.60467152213735e-11), np.float32(2.00018790482477e-13)
_P13 = np.float32(-2.76076847742355e-16)
_Q0, _Q2 = np.float32(4.89352518554385e-03), np.float32(2.26843463243900e-03)
_Q4, _Q6 = np.float32(1.18534705686654e-04), np.float32(1.19825839466702e-06)


@njit(error_model="numpy")
def _tanh(x: np.float32) -> np.float32:
    """Hyperbolic tangent within a few units in the last place; NaN stays NaN."""
    x = _BOUND if x > _BOUND else x
    x = -_BOUND if x < -_BOUND else x
    y = x * x
    y2 = y * y  # in pairs (Estrin): a chain of all terms would wait for each of them
    p = (_P1 + _P3 * y) + y2 * ((_P5 + _P7 * y) + y2 * ((_P9 + _P11 * y) + y2 * _P13))
    return x * p / ((_Q0 + _Q2 * y) + y2 * (_Q4 + _Q6 * y))


@njit(error_model="numpy")
def _scalar(x: np.float32, activation: int) -> np.float32:
    """One activation of one value."""
    if activation == _SIGMOID:
        return _tanh(_HALF * x) * _HALF + _HALF
    if activation == _STEEP_SIGMOID:
        return _tanh(_HALF_STEEP * x) * _HALF + _HALF
    if activation == _TANH:
        return _tanh(x)
    if activation == _RELU:
        return ZERO if x <= ZERO else x
    return x


@njit(error_model="numpy")
def _activate(values: Floats, activation: int) -> None:
    """Apply one activation to values [n]."""
    for i in range(len(values)):
        values[i] = _scalar(values[i], activation)


@njit(error_model="numpy")
def _derive(gradient: Floats, values: Floats, activation: int) -> None:
    """Multiply gradients [n] by the derivative of the activation that gave `values` [n]."""
    for i in range(len(values)):
        y = values[i]
        if activation == _SIGMOID:
            gradient[i] *= y * (ONE - y)
        elif activation == _STEEP_SIGMOID:
            gradient[i] *= _STEEP * (y * (ONE - y))
        elif activation == _TANH:
            gradient[i] *= ONE - y * y
        elif activation == _RELU:
            gradient[i] *= ZERO if y <= ZERO else ONE


@njit(error_model="numpy")
def _dense_one(
    weight: Floats, live: LiveLinks, network: int, values: Floats, sensors: int, outputs: int
) -> None:
    """Add up a network's dense links for one observation: values [rows], sensors to outputs."""
    if outputs < _FEW:
        for o in range(outputs):
            total = ZERO
            for s in range(sensors):
                c = s * outputs + o
                total += values[s] * (weight[network, c] if live[network, c] else ZERO)
            values[sensors + o] = total
        return
    for o in range(outputs):
        values[sensors + o] = ZERO
    for s in range(sensors):
        value = values[s]
        for o in range(outputs):
            c = s * outputs + o
            w = weight[network, c]
            values[sensors + o] += value * (w if live[network, c] else ZERO)


@njit(error_model="numpy")
def _evaluate_one(
    program: Program, weight: Floats, network: int, dense: int, values: Floats
) -> None:
    """Run a network's instructions for one observation: values [rows]."""
    instruction, source = program.instruction, program.source
    link = 0
    for i in range(program.size[network, 0]):
        row, rows = instruction[network, i, 0], instruction[network, i, 1]
        total = values[row]
        for k in range(link, link + instruction[network, i, 2]):
            total += values[source[network, k]] * weight[network, dense + k]
        values[row] = total
        link += instruction[network, i, 2]
        if rows < _FEW:
            for r in range(row, row + rows):
                values[r] = _scalar(values[r], instruction[network, i, 3])
        else:
            _activate(values[row : row + rows], instruction[network, i, 3])


@njit(error_model="numpy")
def _forward_one(program: Program, rows: int, weight: Floats, batch: Batch) -> None:
    """Evaluate every network on one observation: as `forward` does, same bits, faster."""
    observation, state, output, kept = batch
    networks, inputs, outputs = len(weight), observation.shape[2], output.shape[2]
    sensors, first_state = inputs + 1, inputs + 1 + outputs
    values = np.empty(rows, np.float32)
    for network in range(networks):
        states, hidden = program.size[network, 1], program.size[network, 2]
        for i in range(inputs):
            values[i] = observation[network, 0, i]
        values[inputs] = ONE
        for i in range(states):
            values[first_state + i] = state[network, 0, i]
        for i in range(hidden):
            values[first_state + states + i] = ZERO
        _dense_one(weight, program.live, network, values, sensors, outputs)
        _evaluate_one(program, weight, network, sensors * outputs, values)
        for i in range(outputs):
            output[network, 0, i] = values[sensors + i]
        for i in range(states):
            kept[network, 0, i] = values[program.kept[network, i]]
        for i in range(states, kept.shape[2]):
            kept[network, 0, i] = ZERO


@njit(error_model="numpy")
def _add(target: Floats, source: Floats, weight: np.float32, n: int) -> None:
    """Add weight * source [n] to target [n]."""
    for b in range(n):
        target[b] += source[b] * weight


@njit(error_model="numpy")
def _dense_block(
    weight: Floats,
    live: LiveLinks,
    network: int,
    values: Floats,
    sensors: int,
    outputs: int,
    n: int,
) -> None:
    """Add up a network's dense links for n observations: values [rows, block].

    Four inputs at a time save loads and stores; the order of the sum is that of one at a time.
    """
    whole = sensors - sensors % 4
    for o in range(outputs):
        total = values[sensors + o]
        total[:n] = ZERO
        for s in range(0, whole, 4):
            c0 = s * outputs + o
            c1, c2, c3 = c0 + outputs, c0 + 2 * outputs, c0 + 3 * outputs
            w0 = weight[network, c0] if live[network, c0] else ZERO
            w1 = weight[network, c1] if live[network, c1] else ZERO
            w2 = weight[network, c2] if live[network, c2] else ZERO
            w3 = weight[network, c3] if live[network, c3] else ZERO
            v0, v1, v2, v3 = values[s], values[s + 1], values[s + 2], values[s + 3]
            for b in range(n):
                two = (total[b] + v0[b] * w0) + v1[b] * w1
                total[b] = (two + v2[b] * w2) + v3[b] * w3
        for s in range(whole, sensors):
            c = s * outputs + o
            _add(total, values[s], weight[network, c] if live[network, c] else ZERO, n)


@njit(error_model="numpy")
def _evaluate_block(
    program: Program, weight: Floats, network: int, dense: int, values: Floats, lowest: int, n: int
) -> None:
    """Run a network's instructions for rows from `lowest` on and n observations."""
    instruction, source = program.instruction, program.source
    link = 0
    for i in range(program.size[network, 0]):
        row, links = instruction[network, i, 0], instruction[network, i, 2]
        if row >= lowest:
            for k in range(link, link + links):
                _add(values[row], values[source[network, k]], weight[network, dense + k], n)
            for r in range(row, row + instruction[network, i, 1]):
                _activate(values[r, :n], instruction[network, i, 3])
        link += links


@njit(error_model="numpy")
def _read_block(
    program: Program, network: int, batch: Batch, values: Floats, start: int, n: int
) -> None:
    """Write n observations and states into values [rows, block]; hidden nodes get zero."""
    inputs, outputs = batch.observation.shape[2], batch.output.shape[2]
    first_state = inputs + 1 + outputs
    states = program.size[network, 1]
    first_hidden = first_state + states
    values[:inputs, :n] = batch.observation[network, start : start + n].T
    values[inputs] = ONE
    for k in range(states):
        values[first_state + k, :n] = batch.state[network, start : start + n, k]
    values[first_hidden : first_hidden + program.size[network, 2]] = ZERO


@cached_njit(error_model="numpy")
def forward(
    program: Program,
    rows: int,
    weight: Floats,
    observation: Floats,
    state: Floats,
    output: Floats,
    kept: Floats,
) -> None:
    """Evaluate every network on its observations.

    The largest network has `rows` values, weights are [networks, columns]. The fields of `Batch`,
    of which `output` and `kept` take the results, are arguments of their own: numba looks at a
    tuple for half a microsecond.
    """
    batch = Batch(observation, state, output, kept)
    networks, size, inputs = observation.shape
    if size == 1:
        _forward_one(program, rows, weight, batch)
        return
    outputs = output.shape[2]
    sensors = inputs + 1
    values = np.empty((rows, min(size, _BLOCK)), np.float32)
    for network in range(networks):
        states = program.size[network, 1]
        kept[network, :, states:] = ZERO
        for start in range(0, size, _BLOCK):
            n = min(_BLOCK, size - start)
            _read_block(program, network, batch, values, start, n)
            _dense_block(weight, program.live, network, values, sensors, outputs, n)
            _evaluate_block(program, weight, network, sensors * outputs, values, 0, n)
            output[network, start : start + n] = values[sensors : sensors + outputs, :n].T
            for k in range(states):
                kept[network, start : start + n, k] = values[program.kept[network, k], :n]


@njit(error_model="numpy", fastmath={"reassoc"})
def _dot(left: Floats, right: Floats, n: int) -> np.float32:
    """Sum of left * right over n observations, in an order that depends on n alone."""
    total = ZERO
    for b in range(n):
        total += left[b] * right[b]
    return total


@njit(error_model="numpy")
def _adjoint(
    program: Program,
    network: int,
    weight: Floats,
    change: Floats,
    values: Floats,
    gradient: Floats,
    outputs: int,
    further: bool,
    n: int,
) -> None:
    """Run a network's links backwards: gradients [rows, block] flow from targets to sources.

    Weights and their gradients `change` are those of the network [columns]. A row without any
    gradient passes none on. `further`: on to the observations, not only to the weights.
    """
    instruction, source = program.instruction[network], program.source[network]
    live, instructions = program.live[network], program.size[network, 0]
    dense, sensors = len(live), len(live) // outputs
    link = instruction[:instructions, 2].sum()
    for i in range(instructions - 1, -1, -1):
        row, links = instruction[i, 0], instruction[i, 2]
        link -= links
        for r in range(row, row + instruction[i, 1]):
            _derive(gradient[r, :n], values[r, :n], instruction[i, 3])
        if links == 0 or not np.any(gradient[row, :n]):
            continue
        for k in range(link, link + links):
            change[dense + k] += _dot(values[source[k]], gradient[row], n)
            _add(gradient[source[k]], gradient[row], weight[dense + k], n)
    for o in range(outputs):
        if not np.any(gradient[sensors + o, :n]):
            continue
        for c in range(o, dense, outputs):
            if live[c]:
                change[c] += _dot(values[c // outputs], gradient[sensors + o], n)
                if further:
                    _add(gradient[c // outputs], gradient[sensors + o], weight[c], n)


@cached_njit(error_model="numpy")
def backward(
    program: Program,
    rows: int,
    weight: Floats,
    batch: Batch,
    weight_gradient: Floats,
    gradient: Batch,
    further: bool,
) -> None:
    """The adjoint of `forward`. Hidden nodes are evaluated again, which is cheaper than memory.

    `batch` is what `forward` read and wrote; its `kept` is not read. `weight_gradient`, zeros so
    far, takes the gradient of `weight`, summed over observations. `gradient` has those of `output`
    and `kept` and, if `further`, takes those of observation and state.
    """
    networks, size, inputs = batch.observation.shape
    outputs, sensors = batch.output.shape[2], inputs + 1
    dense, first_state = sensors * outputs, sensors + outputs
    values = np.empty((rows, min(size, _BLOCK)), np.float32)
    slope = np.empty_like(values)
    for network in range(networks):
        states, w, change = program.size[network, 1], weight[network], weight_gradient[network]
        for start in range(0, size, _BLOCK):
            n = min(_BLOCK, size - start)
            _read_block(program, network, batch, values, start, n)
            values[sensors:first_state, :n] = batch.output[network, start : start + n].T
            _evaluate_block(program, weight, network, dense, values, first_state, n)
            slope[:, :n] = ZERO
            slope[sensors:first_state, :n] = gradient.output[network, start : start + n].T
            for k in range(states):
                for b in range(n):
                    slope[program.kept[network, k], b] += gradient.kept[network, start + b, k]
            _adjoint(program, network, w, change, values, slope, outputs, further, n)
            if further:
                gradient.observation[network, start : start + n] = slope[:inputs, :n].T
                for k in range(states):
                    gradient.state[network, start : start + n, k] = slope[first_state + k, :n]
