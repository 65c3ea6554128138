"""The temporal-difference error of the candidate that was taken."""

# TorchRL declares names of its losses as properties and overrides them with attributes.
# pyright: reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.objectives import DQNLoss


class CandidateTDLoss(DQNLoss):
    """Half the squared TD error of the chosen candidate's Q-value, and of no other output.

    The target is that of Q-learning over the candidates of the next state, r + gamma max_k Q_k,
    or its lambda-return (Robertson & Wu 2014; Whiteson & Stone 2006). A robot has a network of its
    own, so the default reduction is the sum: each network's gradient is then its own, whatever
    stands beside it. Gradients reach the chosen value output and what feeds it; action outputs get
    none. `make_value_estimator` takes TD0 (default), TD1 or TDLambda.

    Args:
        value_network: Writes `action_value` [..., K] and `chosen_action_value` [..., 1], as
            `CandidateValue` does.
        delay_value: Bootstrap from target parameters, which a `SoftUpdate` moves.
        normalize_return: Weigh rewards by 1 - gamma. The return of rewards in [0, 1] then lies in
            [0, 1], within the reach of a sigmoid; without it a sigmoid can never meet the target
            r + gamma max Q of rewards near 1.
        reduction: `sum`, `mean` or `none`.

    Input: `candidate_index` [*shape, ticks], the value network's inputs now and next, and
    `("next", reward / done / terminated)` [*shape, ticks, 1]. A mask (`loss_mask_key`) leaves
    transitions out. Writes `td_error`, its absolute value [*shape, ticks, 1].

    Example:
        >>> loss = CandidateTDLoss(CandidateValue(network, heads))
        >>> loss.make_value_estimator(gamma=0.9)
    """

    @dataclass
    class _AcceptedKeys(DQNLoss._AcceptedKeys):
        """Names of the entries that the loss reads and writes; see `set_keys`."""

        action: NestedKey = "candidate_index"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys

    def __init__(
        self,
        value_network: TensorDictModuleBase,
        *,
        delay_value: bool = False,
        normalize_return: bool = False,
        reduction: str = "sum",
    ) -> None:
        super().__init__(
            value_network,  # pyright: ignore[reportArgumentType]
            action_space="categorical",
            delay_value=delay_value,
            reduction=reduction,
        )
        self.normalize_return = normalize_return

    @dispatch  # pyright: ignore[reportArgumentType]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The loss of a batch of transitions, as `TensorDict(loss=...)`."""
        data = tensordict.clone(False)
        with self.value_network_params.to_module(self.value_network):
            self.value_network(data)
        error = self._target(data) - self._value(data)
        tensordict.set(self.tensor_keys.priority, error.detach().abs())
        loss = self._reduce_loss(0.5 * error.squeeze(-1).square(), tensordict=tensordict)
        self._clear_weakrefs(tensordict, "value_network_params", "target_value_network_params")
        return TensorDict({"loss": loss})

    def _value(self, data: TensorDictBase) -> Tensor:
        """The Q-value of the action that was taken [*shape, ticks, 1]."""
        chosen = data.get(self.tensor_keys.action).unsqueeze(-1)
        return data.get(self.tensor_keys.action_value).gather(-1, chosen)

    @torch.no_grad()
    def _target(self, data: TensorDictBase) -> Tensor:
        estimator = self.value_estimator
        if self.normalize_return:
            gamma = estimator.gamma
            assert isinstance(gamma, Tensor)
            # `data` is a shallow copy; its nested tensordict is not, and must be left alone.
            following = data.get("next").clone(False)
            reward = following.get(self.tensor_keys.reward)
            following.set(self.tensor_keys.reward, reward * (1 - gamma))
            data = data.copy().set("next", following)
        return estimator.value_estimate(data, target_params=self.target_value_network_params)


def discount_of(loss: CandidateTDLoss) -> float:
    """Gamma of a loss."""
    return float(cast(Tensor, loss.value_estimator.gamma))
