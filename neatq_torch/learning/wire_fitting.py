"""Q-values of any action, interpolated between the candidates: wire fitting.

Here stands what is learnt; `compiled_wires.py` is the compiled form of it.
"""

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
    multiplies the gradient of the best value by up to K. With n = 1 / D, the gaps g = q_max - q and
    their mean M by n,

        Q = q_max - M,
        dM/dg_k = n_k / sum n - c n_k^2 (g_k - M) / sum n,
        dQ/du_k = -2 (a - u_k) n_k^2 (g_k - M) / sum n.

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
        settings: See `CandidateTDLoss`.

    Input: `action` [*shape, ticks, A] instead of `candidate_index`, else as `CandidateTDLoss`.

    Raises:
        ValueError: If the value network proposes no candidates.

    Example:
        >>> loss = WireFittingLoss(CandidateValue(network, heads, propose=True))
        >>> loss.make_value_estimator(gamma=0.9)
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
        # An action of which only one value is allowed is no distance away.
        unit = torch.where(heads.span > 0, 1 / heads.span, 0)
        self.register_buffer("unit", unit, persistent=False)

    def _value(self, data: TensorDictBase) -> Tensor:
        keys = self.tensor_keys
        action, candidates = (data.get(key) * self.unit for key in (keys.action, keys.candidates))
        values = data.get(keys.action_value)
        return wire_fit(action, candidates, values, self.smoothing, self.epsilon).unsqueeze(-1)
