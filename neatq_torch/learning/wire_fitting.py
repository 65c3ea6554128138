"""Q-values of any action, interpolated between the candidates: wire fitting."""

# TorchRL declares names of its losses as properties and overrides them with attributes.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from neatq_torch.learning.candidates import CandidateValue
from neatq_torch.learning.heads import CandidateHeads
from neatq_torch.learning.objectives import CandidateTDLoss


def wire_fit(
    action: Tensor, candidates: Tensor, values: Tensor, smoothing: float, epsilon: float
) -> Tensor:
    """The Q-value of an action between the wires (Baird & Klopf 1993; Gaskett et al. 1999).

    The mean of the candidates' values, weighted by 1 / D_k with

        D_k = |a - u_k|^2 + c (q_max - q_k) + epsilon.

    No action is worth more than q_max, and as epsilon goes to 0 the best candidate is worth it: to
    look for the greatest value is to look through the candidates.

    q_max is differentiated like everything else, so the gradient is that of this function: those of
    all values sum to 1, and that of the best value at the best candidate goes to 1, where wire
    fitting is the plain TD step. The derivatives in the papers hold q_max constant, which there
    multiplies the gradient of the best value by up to K.

    Args:
        action: a [..., A].
        candidates: u [..., K, A].
        values: q [..., K].
        smoothing: c, at least 0: how much farther away a worse candidate is taken to be.
        epsilon: Above 0, so that nothing is divided by 0.

    Returns:
        Q(s, a) [...].
    """
    best = values.amax(-1, keepdim=True)
    gap = best - values
    distance = (action.unsqueeze(-2) - candidates).square().sum(-1) + smoothing * gap + epsilon
    nearness = 1 / distance
    return best.squeeze(-1) - (nearness * gap).sum(-1) / nearness.sum(-1)


SEPARATION_WIDTH = 0.1
"""Distance between candidates, in spans, within which they hardly push each other harder."""


def closeness(candidates: Tensor) -> Tensor:
    """How close candidates are to each other: what keeps them apart when it is minimised.

    The mean over pairs of 1 / sqrt(|u_i - u_j|^2 + width^2), after the separation loss of Q3C
    (Korkmaz et al. 2025), but with a gradient that stays finite where candidates meet.

    Args:
        candidates: u [..., K, A], in spans.

    Returns:
        [...]; 0 where there is only one candidate.
    """
    apart = candidates.unsqueeze(-2) - candidates.unsqueeze(-3)
    near = (apart.square().sum(-1) + SEPARATION_WIDTH**2).rsqrt()
    count = candidates.shape[-2]
    return near.tril(-1).sum((-2, -1)) / max(count * (count - 1) / 2, 1)


class WireFittingLoss(CandidateTDLoss):
    """Half the squared TD error of the wire-fitted value of the action that was taken.

    As `CandidateTDLoss`, but the action may be any, one of the candidates or not, and gradients
    reach all values and all candidate actions: the wires move to where the value is. Targets need
    no interpolation, as the greatest value over all actions is that of the best candidate.

    Actions are measured in spans of the heads' bounds and values in spans of their `value_range`,
    so that `smoothing` and `epsilon` mean the same on every task. Candidates that the heads clip
    get no gradient beyond the bounds; sigmoid outputs never are.

    Args:
        value_network: A `CandidateValue` over `CandidateHeads` that also proposes.
        smoothing: c of `wire_fit`.
        epsilon: epsilon of `wire_fit`.
        separation: Weight of `closeness`, which is added to the loss of each transition.
        settings: See `CandidateTDLoss`.

    Input: `action` [*shape, ticks, A] instead of `candidate_index`, else as `CandidateTDLoss`.

    Raises:
        ValueError: If the value network proposes no candidates.
    """

    @dataclass
    class _AcceptedKeys(CandidateTDLoss._AcceptedKeys):
        """Names of the entries that the loss reads and writes; see `set_keys`."""

        action: NestedKey = "action"
        candidates: NestedKey = "candidates"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    unit: Tensor

    def __init__(
        self,
        value_network: CandidateValue,
        *,
        smoothing: float = 0.1,
        epsilon: float = 1e-4,
        separation: float = 0.0,
        **settings: Any,
    ) -> None:
        heads = value_network.heads
        if not (value_network.propose and isinstance(heads, CandidateHeads)):
            raise ValueError(
                "expected a value network that proposes candidates: "
                "CandidateValue(network, CandidateHeads(...), propose=True)"
            )
        super().__init__(value_network, **settings)
        low, high = heads.value_range
        self.smoothing = smoothing / (high - low)
        self.epsilon = epsilon
        self.separation = separation
        # An action of which only one value is allowed is no distance away.
        unit = torch.where(heads.span > 0, 1 / heads.span, 0)
        self.register_buffer("unit", unit, persistent=False)

    def _value(self, data: TensorDictBase) -> Tensor:
        keys = self.tensor_keys
        action, candidates = (data.get(key) * self.unit for key in (keys.action, keys.candidates))
        values = data.get(keys.action_value)
        return wire_fit(action, candidates, values, self.smoothing, self.epsilon).unsqueeze(-1)

    def _penalty(self, data: TensorDictBase) -> Tensor | float:
        if not self.separation:
            return 0.0
        return self.separation * closeness(data.get(self.tensor_keys.candidates) * self.unit)
