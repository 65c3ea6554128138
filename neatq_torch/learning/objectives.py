"""The temporal-difference error of the candidate that was taken."""

# TorchRL declares names of its losses as properties and overrides them with attributes.
# pyright: reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Self, cast

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModuleBase, dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.objectives import LossModule
from torchrl.objectives.utils import ValueEstimators, dispatch_value_estimator

Bootstrap = Literal["expected", "double"]
_ESTIMATOR_KEYS = ("advantage", "value_target", "value", "reward", "done", "terminated")


class CandidateTDLoss(LossModule):
    """Half the squared TD error of the chosen candidate's Q-value, and of no other output.

    The target is that of Q-learning over the candidates of the next state, r + gamma max_k Q_k,
    or its lambda-return (Robertson & Wu 2014; Whiteson & Stone 2006). A robot has a network of its
    own, so the default reduction is the sum: each network's gradient is then its own, whatever
    stands beside it. Gradients reach the chosen value output and what feeds it; action outputs get
    none.

    Args:
        value_network: Writes `action_value` [..., K] and `chosen_action_value` [..., 1], as
            `CandidateValue` does.
        delay_value: Bootstrap from target parameters, which a `SoftUpdate` moves.
        normalize_return: Weigh rewards by 1 - gamma. The return of rewards in [0, 1] then lies in
            [0, 1], within the reach of a sigmoid; without it a sigmoid can never meet the target
            r + gamma max Q of rewards near 1.
        bootstrap: What the next state is worth. None: its greatest value. "expected": that of
            epsilon-greedy, (1 - epsilon) max + epsilon mean (van Seijen et al. 2009). "double": the
            target parameters' value of the candidate that is best by the networks' own (van
            Hasselt, Guez & Silver 2016); the errors of a maximum do not add up.
        epsilon_greedy: epsilon of "expected".
        discount: gamma of each robot [*shape]; None for the estimator's own.
        reduction: `sum`, `mean` or `none`.

    Input: `candidate_index` [*shape, ticks], the value network's inputs now and next, and
    `("next", reward / done / terminated)` [*shape, ticks, 1]. A mask (`loss_mask_key`) leaves
    transitions out. Writes `td_error`, its absolute value [*shape, ticks, 1].
    """

    @dataclass
    class _AcceptedKeys:
        """Names of the entries that the loss reads and writes; see `set_keys`."""

        advantage: NestedKey = "advantage"
        value_target: NestedKey = "value_target"
        value: NestedKey = "chosen_action_value"
        action: NestedKey = "candidate_index"
        action_value: NestedKey = "action_value"
        priority: NestedKey = "td_error"
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        terminated: NestedKey = "terminated"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    default_value_estimator = ValueEstimators.TD0
    value_network: TensorDictModuleBase
    value_network_params: TensorDictParams
    target_value_network: TensorDictModuleBase
    target_value_network_params: TensorDictParams
    discount: Tensor | None

    def __init__(
        self,
        value_network: TensorDictModuleBase,
        *,
        delay_value: bool = False,
        normalize_return: bool = False,
        bootstrap: Bootstrap | None = None,
        epsilon_greedy: float = 0.0,
        discount: Tensor | None = None,
        reduction: str = "sum",
    ) -> None:
        super().__init__()
        self._in_keys = None
        self.out_keys = ["loss"]
        self.delay_value = delay_value
        self.normalize_return = normalize_return
        self.bootstrap: Bootstrap | None = bootstrap
        self.epsilon_greedy = epsilon_greedy
        self.reduction = reduction
        self.convert_to_functional(
            value_network,  # pyright: ignore[reportArgumentType]
            "value_network",
            create_target_params=delay_value,
        )
        self.register_buffer("discount", discount, persistent=False)

    @property
    def in_keys(self) -> list[NestedKey]:
        """The entries that `forward` reads."""
        keys, network = self.tensor_keys, list(self.value_network.in_keys)
        following = [keys.reward, keys.done, keys.terminated, *network]
        return [keys.action, *network, *(("next", key) for key in following)]

    @in_keys.setter
    def in_keys(self, value: Any) -> None:
        self._in_keys = value

    def _forward_value_estimator_keys(self, **_: Any) -> None:
        if self._value_estimator is not None:
            self._value_estimator.set_keys(**self._estimator_keys())

    def _estimator_keys(self) -> dict[str, NestedKey]:
        return {name: getattr(self.tensor_keys, name) for name in _ESTIMATOR_KEYS}

    def make_value_estimator(
        self,
        value_type: ValueEstimators | None = None,
        **hyperparams: Any,
    ) -> Self:
        """Choose how targets are made: TD0 (default), TD1 or TDLambda, with `gamma`, `lmbda`."""
        dispatch_value_estimator(
            self,
            self.default_value_estimator if value_type is None else value_type,
            supported=(ValueEstimators.TD0, ValueEstimators.TD1, ValueEstimators.TDLambda),
            tensor_keys=self._estimator_keys(),
            **hyperparams,
        )
        return self

    @dispatch  # pyright: ignore[reportArgumentType]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The loss of a batch of transitions, as `TensorDict(loss=...)`."""
        data = tensordict.clone(False)
        with self.value_network_params.to_module(self.value_network):
            self.value_network(data)
        error = self._target(data) - self._value(data)
        tensordict.set(self.tensor_keys.priority, error.detach().abs())
        each = 0.5 * error.squeeze(-1).square() + self._penalty(data)
        loss = self._reduce_loss(each, tensordict=tensordict)
        self._clear_weakrefs(tensordict, "value_network_params", "target_value_network_params")
        return TensorDict({"loss": loss})

    def _value(self, data: TensorDictBase) -> Tensor:
        """The Q-value of the action that was taken [*shape, ticks, 1]."""
        chosen = data.get(self.tensor_keys.action).unsqueeze(-1)
        return data.get(self.tensor_keys.action_value).gather(-1, chosen)

    def _penalty(self, data: TensorDictBase) -> Tensor | float:
        """What is added to the loss of each transition [*shape, ticks]."""
        del data
        return 0.0

    @torch.no_grad()
    def _target(self, data: TensorDictBase) -> Tensor:
        estimator = self.value_estimator
        reward = data.get(("next", self.tensor_keys.reward))
        if self.discount is not None:
            missing = reward.ndim - self.discount.ndim
            estimator.gamma = self.discount[(...,) + (None,) * missing].expand_as(reward)
        if self.normalize_return:
            gamma = estimator.gamma
            assert isinstance(gamma, Tensor)
            # `data` is a shallow copy; its nested tensordict is not, and must be left alone.
            following = data.get("next").clone(False)
            following.set(self.tensor_keys.reward, reward * (1 - gamma))
            data = data.copy().set("next", following)
        return estimator.value_estimate(
            data,
            target_params=self.target_value_network_params,
            next_value=None if self.bootstrap is None else self._next_value(data),
        )

    def _next_value(self, data: TensorDictBase) -> Tensor:
        """What the next state is worth [*shape, ticks, 1], where that is not its greatest value."""
        values = self._next_values(data, self.target_value_network_params)
        best = values.amax(-1, keepdim=True)
        if self.bootstrap == "double":
            own = self._next_values(data, self.value_network_params)
            return values.gather(-1, own.argmax(-1, keepdim=True))
        return best + self.epsilon_greedy * (values.mean(-1, keepdim=True) - best)

    def _next_values(self, data: TensorDictBase, params: TensorDictParams) -> Tensor:
        following = data.get("next").clone(False)
        with params.to_module(self.value_network):
            return self.value_network(following).get(self.tensor_keys.action_value)


def discount_of(loss: CandidateTDLoss) -> float:
    """Gamma of a loss whose robots all have the same."""
    return float(cast(Tensor, loss.value_estimator.gamma))
