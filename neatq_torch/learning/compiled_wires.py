"""Wire fitting on stored transitions by compiled code: `WireFittingLoss` and `TDLearner` in one.

Every number is that of the torch operations up to rounding, and the arenas and robots beside a
network do not change a bit of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.learning import wire_kernels
from neatq_torch.learning.heads import CandidateHeads
from neatq_torch.learning.learner import TDLearner
from neatq_torch.learning.objectives import discount_of
from neatq_torch.learning.wire_fitting import SEPARATION_WIDTH, WireFittingLoss
from neatq_torch.learning.wire_kernels import Floats, Wires
from neatq_torch.network import compiled, kernels
from neatq_torch.network.plan import Program


class Lessons(NamedTuple):
    """Minibatches of transitions, which all robots of an arena share.

    Attributes:
        observation: [arenas, steps, size, inputs].
        action: [arenas, steps, size, A].
        reward: Weighed sums; where each network has a gamma of its own, `arenas` are networks here
            [arenas, steps, size].
        discount: Of the next state's value, 0 where that is terminal; likewise.
        following: The next observation [arenas, steps, size, inputs].
    """

    observation: Floats
    action: Floats
    reward: Floats
    discount: Floats
    following: Floats


@dataclass(frozen=True, kw_only=True)
class Pupils:
    """Networks that learn, and what belongs to their optimiser: see `TDLearner`.

    Attributes:
        program: Their evaluation order.
        rows: Values of the largest network.
        weight: [networks, columns], changed in place, like all that follows.
        target: Weights to bootstrap from [networks, columns]; `weight` itself without targets.
        first_moment: [networks, columns].
        second_moment: [networks, columns].
        steps: Steps so far [networks].
        learning_rate: [networks].
    """

    program: Program
    rows: int
    weight: Floats
    target: Floats
    first_moment: Floats
    second_moment: Floats
    steps: Floats
    learning_rate: Floats


def serves(learner: TDLearner) -> bool:
    """Whether compiled code can stand in for a learner's torch operations."""
    loss = learner.loss
    return (
        type(loss) is WireFittingLoss
        and loss.reduction == "sum"
        and compiled.serves(learner.network.weight)
    )


def wires_of(learner: TDLearner) -> Wires:
    """The numbers of a learner that `serves` approves of."""
    loss = cast(WireFittingLoss, learner.loss)
    heads = cast(CandidateHeads, loss.value_network.heads)
    low, high = heads.value_range
    return Wires(
        heads.candidates,
        heads.low.numpy(),
        loss.unit.numpy(),
        np.float32(loss.smoothing),
        np.float32(loss.epsilon),
        np.float32(low),
        np.float32(high - low),
        np.float32(loss.epsilon_greedy if loss.bootstrap == "expected" else 0),
        np.float32(loss.separation / max(heads.candidates * (heads.candidates - 1) / 2, 1)),
        np.float32(SEPARATION_WIDTH**2),
    )


def pupils_of(learner: TDLearner) -> Pupils:
    """All networks of a learner, in the memory where they stand."""
    plan, weight = learner.network.plan, _array(learner.network.weight)
    target = learner.target_weight
    return Pupils(
        program=plan.program,
        rows=plan.layout.rows,
        weight=weight,
        target=weight if target is None else _array(target),
        first_moment=_array(learner.first_moment),
        second_moment=_array(learner.second_moment),
        steps=_array(learner.steps),
        learning_rate=_array(learner.learning_rate),
    )


def newborns_of(learner: TDLearner, places: Sequence[int]) -> Pupils:
    """A copy of the networks in some places (flat), with nothing learnt yet."""
    plan, rows = learner.network.plan, list(places)
    weight = _array(learner.network.weight)[rows]
    return Pupils(
        program=plan.program.of(rows),
        rows=plan.layout.rows,
        weight=weight,
        target=weight if learner.target_weight is None else weight.copy(),
        first_moment=np.zeros_like(weight),
        second_moment=np.zeros_like(weight),
        steps=np.zeros(len(rows), np.float32),
        learning_rate=np.full(len(rows), learner.config.learning_rate, np.float32),
    )


def _array(tensor: Tensor) -> Floats:
    return tensor.detach().numpy()


def learn(pupils: Pupils, learner: TDLearner, lessons: Lessons) -> Floats:
    """Take one step on each minibatch.

    Args:
        pupils: Networks [arenas * robots], by arena.
        learner: Says how; its own networks are not touched unless they are the pupils.
        lessons: What is learnt from.

    Returns:
        Mean squared TD error of each network on the last minibatch [networks].
    """
    wires, config = wires_of(learner), learner.config
    networks, (arenas, steps, size, _) = len(pupils.weight), lessons.observation.shape
    robots = networks // arenas
    outputs = learner.network.outputs
    output, following, chosen, slope = np.empty((4, networks, size, outputs), np.float32)
    state = np.zeros((networks, size, learner.network.state_size), np.float32)
    kept, gradient = np.empty_like(state), np.empty_like(pupils.weight)
    no_slope = np.zeros_like(state)
    error = np.zeros(networks, np.float32)
    order = pupils.program, pupils.rows
    for step in range(steps):
        now, then = (
            np.repeat(part[:, step], robots, 0) for part in (lessons.observation, lessons.following)
        )
        kernels.forward(*order, pupils.target, then, state, following, kept)
        kernels.forward(*order, pupils.weight, now, state, output, kept)
        chooser = following
        if learner.loss.bootstrap == "double":
            kernels.forward(*order, pupils.weight, then, state, chosen, kept)
            chooser = chosen
        target = wire_kernels.targets(
            following, chooser, lessons.reward[:, step], lessons.discount[:, step], wires
        )
        wire_kernels.slopes(output, lessons.action[:, step], target, wires, slope, error)
        gradient[:] = 0
        kernels.backward(
            *order,
            pupils.weight,
            kernels.Batch(now, state, output, state),
            gradient,
            kernels.Batch(now, state, slope, no_slope),
            False,
        )
        wire_kernels.step(
            pupils.weight,
            gradient,
            (pupils.first_moment, pupils.second_moment),
            pupils.steps,
            pupils.learning_rate,
            learner.adam,
        )
        if config.target_tau is not None:
            wire_kernels.follow(pupils.target, pupils.weight, np.float32(config.target_tau))
    return error


def lessons_of(
    learner: TDLearner,
    drawn: Sequence[TensorDictBase],
    steps: int,
    discount: Tensor | None,
) -> Lessons:
    """Transitions [steps * size] that were drawn for each arena, as minibatches.

    Args:
        learner: Says how they are to be weighed.
        drawn: The transitions; with one gamma for all, rewards are summed up already.
        steps: Minibatches.
        discount: gamma of each network that is to learn from them [networks]; None: the loss's.
    """

    def part(*name: str) -> Floats:
        rows = torch.stack([each.get(name) for each in drawn]).float().numpy()
        return rows.reshape(len(drawn), steps, -1, rows.shape[-1])

    reward, ahead = part("next", "reward"), part("steps_to_next_obs")[..., 0]
    going_on = 1 - part("next", "terminated")[..., 0]
    if discount is None:
        gamma = np.array([discount_of(learner.loss)])
    else:
        gamma = _array(discount).astype(np.float64)
        sharing = len(gamma) // len(drawn)
        reward, ahead, going_on = (np.repeat(one, sharing, 0) for one in (reward, ahead, going_on))
    weight = gamma[:, None] ** np.arange(reward.shape[-1])
    if learner.loss.normalize_return:
        weight *= 1 - gamma[:, None]
    each = gamma.astype(np.float32)[:, None, None]
    return Lessons(
        part("observation"),
        part("action"),
        (reward @ weight.astype(np.float32)[:, None, :, None])[..., 0],
        going_on * np.power(each, ahead, dtype=np.float32),
        part("next", "observation"),
    )
