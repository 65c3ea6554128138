"""SAC of TorchRL (Haarnoja et al. 2018), in the arena: the whole team is one actor.

Twin values, their slow copies and a temperature that is learnt; all robots' transitions go into one
memory. A life is truncated, never terminated: values are bootstrapped over its end.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate, ValueEstimators

from neatq_experiments.anchors.anchor import AnchorConfig
from neatq_experiments.anchors.team import HIDDEN, Bounds, train_team
from neatq_torch.learning.memory import over_horizon
from neatq_trainers.folder import Columns

_MADE = "Initialized LazyTensorStorage"
logging.getLogger("torchrl").addFilter(lambda record: not record.getMessage().startswith(_MADE))


class ActionValue(nn.Module):
    """What an action is worth; actions are read as shares of their range, -1 to 1."""

    def __init__(self, inputs: int, low: Tensor, high: Tensor) -> None:
        super().__init__()
        self._middle, self._half = (high + low) / 2, (high - low) / 2
        self.network = _rectified(inputs + len(low), 1)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Values [.., 1] of observations [.., inputs] and actions [.., actions]."""
        return self.network(torch.cat([observation, (action - self._middle) / self._half], -1))


def _rectified(inputs: int, outputs: int) -> MLP:
    """A network with rectified units."""
    return MLP(in_features=inputs, out_features=outputs, num_cells=HIDDEN, activation_class=nn.ReLU)


class SACTrainer:
    """Actor, twin values, temperature, memory and their updates.

    Args:
        settings: As `sac_settings` gives them.
        inputs: Numbers in an observation.
        bounds: Of actions.

    Attributes:
        actor: Draws actions.
        loss: TorchRL's, with all weights.
        memory: Transitions of all robots.
    """

    def __init__(self, settings: Mapping[str, Any], inputs: int, bounds: Bounds) -> None:
        self._settings, self._due = settings, 0.0
        low, high = (torch.from_numpy(np.array(bound, np.float32)) for bound in bounds)
        policy = nn.Sequential(_rectified(inputs, 2 * len(low)), NormalParamExtractor())
        self.actor = ProbabilisticActor(
            TensorDictModule(policy, ["observation"], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=TanhNormal,
            distribution_kwargs={"low": low, "high": high},
        )
        twins: list[TensorDictModule] = [
            ValueOperator(ActionValue(inputs, low, high), in_keys=["observation", "action"])
            for _ in range(2)
        ]
        # An entropy of -1 for each action (Haarnoja et al. 2018), had it the range -1 to 1.
        entropy = ((high - low) / 2).log().sum().item() - len(low)
        self.loss = SACLoss(
            self.actor,
            twins,
            loss_function="l2",
            alpha_init=settings["alpha"],
            target_entropy=entropy,
        )
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=settings["discount"])
        self._targets = SoftUpdate(self.loss, tau=settings["tau"])
        self._optimizer = torch.optim.Adam(self.loss.parameters(), lr=settings["learning_rate"])
        self.memory = TensorDictReplayBuffer(storage=LazyTensorStorage(settings["capacity"]))

    def update(self, batch: TensorDictBase) -> None:
        """Remember a batch [arenas, slots, ticks], and learn from what is remembered."""
        own = self._settings
        ahead = over_horizon(batch, own["horizon"], own["discount"]).reshape(-1)
        ahead["next", "done"] = ahead["next", "terminated"]
        self.memory.extend(ahead)
        if len(self.memory) < own["warmup"]:
            return
        self._due += own["updates_per_tick"] * batch.shape[-1]
        updates = int(self._due)
        self._due -= updates
        for _ in range(updates):
            self._learn(self.memory.sample(own["minibatch"]))

    def _learn(self, drawn: TensorDictBase) -> None:
        """Take one step by transitions [minibatch]."""
        parts = self.loss(drawn)
        # Each loss has gradients for weights of its own only.
        total = parts["loss_actor"] + parts["loss_qvalue"] + parts["loss_alpha"]
        self._optimizer.zero_grad()
        total.backward()
        self._optimizer.step()
        self._targets.step()


def train_sac(config: AnchorConfig, seed: int) -> Columns:
    """Train in the arena; see `train_team`."""
    return train_team(config, seed, lambda own, inputs, bounds, _: SACTrainer(own, inputs, bounds))
