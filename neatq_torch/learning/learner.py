"""Learning during life: one update of every robot's own network from a batch of its ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import SoftUpdate

from neatq_torch.learning.objectives import CandidateTDLoss
from neatq_torch.learning.steps import fitted, take_over, widened
from neatq_torch.network import PopulationNetwork

ADAM_BETAS, ADAM_EPSILON = (0.9, 0.999), 1e-8
State = dict[str, Any]
"""What a checkpoint keeps: JSON values, tensors and numpy arrays by name."""


class Learner(Protocol):
    """What the training loop asks of learning."""

    def update(self, batch: TensorDictBase) -> Tensor:
        """Learn from a batch; returns the mean squared TD error of each robot [*shape]."""
        ...

    def reset(self, newborn: Tensor) -> None:
        """The one door through which newborns (mask [*shape]) come in, with nothing learnt."""
        ...

    def state(self) -> State:
        """Everything that a checkpoint must keep."""
        ...

    def load_state(self, state: State) -> None:
        """Go on from `state`."""
        ...


class NoLearning:
    """Evolution alone: robots act, and nothing is learnt."""

    def __init__(self, network: PopulationNetwork) -> None:
        self._error = torch.full(network.shape, torch.nan, device=network.weight.device)

    def update(self, batch: TensorDictBase) -> Tensor:
        """No update, so no error: NaN for every robot."""
        return self._error

    def reset(self, newborn: Tensor) -> None:
        """Nothing to forget."""

    def state(self) -> State:
        """Nothing to keep."""
        return {}

    def load_state(self, state: State) -> None:
        """Nothing to restore."""


@dataclass(frozen=True, kw_only=True)
class LearnerConfig:
    """How networks learn.

    Attributes:
        learning_rate: Step size; applied to the gradient summed over the ticks of a batch.
        optimizer: `sgd` or `adam` (Kingma & Ba 2015; moments per robot).
        target_tau: Share of the weights that target parameters take over at each update; None
            bootstraps from the networks themselves.
    """

    learning_rate: float = 0.1
    optimizer: Literal["sgd", "adam"] = "sgd"
    target_tau: float | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        if not 0 <= self.learning_rate < math.inf:
            raise ValueError(
                f"learning_rate: expected a finite number of at least 0, got {self.learning_rate}"
            )
        if self.optimizer not in ("sgd", "adam"):
            raise ValueError(f"optimizer: expected 'sgd' or 'adam', got {self.optimizer!r}")
        if self.target_tau is not None and not 0 < self.target_tau <= 1:
            raise ValueError(f"target_tau: expected within (0, 1], got {self.target_tau}")


class TDLearner:
    """Trains every network of a population on its own robot's transitions.

    The optimiser's state, the learning rate and the number of steps belong to a robot's place and
    are cleared when a newborn takes it. An update that would make a weight infinite or NaN is not
    applied to that robot.

    Args:
        network: The networks.
        loss: A loss over that network, with reduction `sum`.
        config: Learning rate and optimiser.

    Attributes:
        learning_rate: Per robot [networks]; may be changed in place.
    """

    def __init__(
        self, network: PopulationNetwork, loss: CandidateTDLoss, config: LearnerConfig
    ) -> None:
        self.network = network
        self.loss = loss
        self.config = config
        self.adam = config.optimizer == "adam"
        weight = network.weight
        self.learning_rate = weight.new_full((len(weight),), config.learning_rate)
        self.steps = weight.new_zeros(len(weight))
        self.first_moment = torch.zeros_like(weight, requires_grad=False)
        self.second_moment = torch.zeros_like(weight, requires_grad=False)
        self.target_update = (
            SoftUpdate(loss, tau=config.target_tau) if config.target_tau is not None else None
        )

    def update(self, batch: TensorDictBase) -> Tensor:
        """One step of every network.

        Args:
            batch: Transitions [*shape, ticks]. Those whose `genome_id` is not that of the network
                standing in the robot's place now are left out.

        Returns:
            Mean squared TD error of each robot before the step [*shape].
        """
        own = batch.get("genome_id").squeeze(-1) == self.network.genome_id.unsqueeze(-1)
        batch.set("own_transition", own)
        self.loss.loss_mask_key = "own_transition"
        self.network.weight.grad = None
        self.loss(batch).get("loss").backward()
        self._step()
        if self.target_update is not None:
            self.target_update.step()
        error = batch.get(self.loss.tensor_keys.priority).squeeze(-1).square()
        return torch.where(own, error, 0).sum(-1) / own.sum(-1).clamp_min(1)

    @torch.no_grad()
    def _step(self) -> None:
        weight, gradient = self.network.weight, self.network.weight.grad
        assert gradient is not None
        if self.adam:
            gradient = self._adam(gradient)
        take_over(weight, weight - self.learning_rate.unsqueeze(1) * gradient)

    def _adam(self, gradient: Tensor) -> Tensor:
        first, second = ADAM_BETAS
        self.steps += 1
        self.first_moment.lerp_(gradient, 1 - first)
        self.second_moment.lerp_(gradient.square(), 1 - second)
        # Not 1 - beta**steps: torch's pow differs in the last bit with the place in the tensor.
        unbiased = [-torch.expm1(self.steps * math.log(beta)) for beta in ADAM_BETAS]
        scale = unbiased[1].sqrt() / unbiased[0]
        root = self.second_moment.sqrt() + ADAM_EPSILON
        return scale.unsqueeze(1) * self.first_moment / root

    @torch.no_grad()
    def reset(self, newborn: Tensor) -> None:
        """Clear what belongs to the genomes before: moments, steps, target parameters.

        Call it after the newborns' genomes stand in the network.
        """
        weight = self.network.weight
        self.first_moment = widened(self.first_moment, weight)
        self.second_moment = widened(self.second_moment, weight)
        rows = newborn.reshape(-1, 1)
        self.steps.masked_fill_(rows.squeeze(1), 0)
        self.first_moment.masked_fill_(rows, 0)
        self.second_moment.masked_fill_(rows, 0)
        target = self.target_weight
        if target is not None:
            target.data = widened(target.data, weight)
            target.copy_(torch.where(rows, weight, target))

    @property
    def target_weight(self) -> Tensor | None:
        """The weights to bootstrap from [networks, columns]; None: the networks' own."""
        if self.target_update is None:
            return None
        return self.loss.target_value_network_params["network", "weight"]

    def state(self) -> State:
        """Learning rates, moments, steps and target parameters."""
        state = {
            "learning_rate": self.learning_rate,
            "steps": self.steps,
            "first_moment": self.first_moment,
            "second_moment": self.second_moment,
        }
        if self.target_weight is not None:
            state["target_weight"] = self.target_weight.detach()
        return state

    @torch.no_grad()
    def load_state(self, state: State) -> None:
        """Go on from `state`."""
        for name in ("learning_rate", "steps", "first_moment", "second_moment"):
            own = getattr(self, name)
            own.copy_(fitted(state[name], own))
        target = self.target_weight
        if target is not None:
            target.copy_(fitted(state["target_weight"], target))
