"""Learning during life: one update of every robot's own network from a batch of its ticks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, Protocol, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import SoftUpdate

from neatq_torch.evolution import Population
from neatq_torch.kinds import check_fields
from neatq_torch.learning.heads import Heads
from neatq_torch.learning.objectives import CandidateTDLoss
from neatq_torch.network import PopulationNetwork, fitted

ADAM_BETAS, ADAM_EPSILON = (0.9, 0.999), 1e-8
Adams = tuple[Tensor, Tensor, Tensor]
"""What Adam keeps of some networks: steps taken [networks], two moments [networks, columns]."""
Saved = dict[str, Any]
"""What a checkpoint keeps: JSON values, tensors and numpy arrays by name."""

Optimizer = Literal["sgd", "adam"]
Inheritance = Literal["lamarckian", "darwinian"]
"""`lamarckian`: learnt weights are written into the genome before it breeds. `darwinian`: learning
changes the robot's life and fitness, its genes never."""


def write_back(
    network: PopulationNetwork,
    populations: Sequence[Population],
    breeding: Sequence[bool] | None = None,
) -> None:
    """Copy every network's weights, bit for bit, into the genome that it was compiled from.

    Args:
        network: Networks of all robots, arena after arena.
        populations: The population of each arena.
        breeding: Whether a population is about to breed; all others are left alone. None: all are.

    Example:
        >>> write_back(network, [population])
    """
    weights = network.link_weights()
    for arena, population in enumerate(populations):
        for slot in range(len(population.genomes)):
            learnt = next(weights)
            if breeding is None or breeding[arena]:
                population.write_back(slot, learnt)


class Learner(Protocol):
    """What the training loop asks of learning; whoever derives from it keeps nothing at first."""

    def update(self, batch: TensorDictBase) -> Tensor:
        """Learn from a batch; returns the mean squared TD error of each robot [*shape]."""
        ...

    def reset(self, newborn: Tensor) -> None:
        """The one door through which newborns (mask [*shape]) come in, with nothing learnt."""

    def state_dict(self) -> Saved:
        """Everything that a checkpoint must keep."""
        return {}

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""


@dataclass(frozen=True, kw_only=True)
class NoLearningConfig:
    """Evolution alone: no exploration, and nothing that genes could inherit."""


class NoLearning(Learner):
    """Evolution alone: robots act, and nothing is learnt."""

    def __init__(self, network: PopulationNetwork) -> None:
        self._error = torch.full(network.shape, torch.nan, device=network.weight.device)

    def update(self, batch: TensorDictBase) -> Tensor:
        """No update, so no error: NaN for every robot."""
        return self._error


@dataclass(frozen=True, kw_only=True)
class StepConfig:
    """How networks follow the gradient of a TD error, by whichever learner.

    Attributes:
        learning_rate: Step size; applied to the gradient summed over the ticks of a batch. With
            plain steps (sgd) in units of the network outputs, see `TDLearner`.
        optimizer: Plain steps, or Adam's (Kingma & Ba 2015; moments per robot).
        target_tau: Share of the weights that target parameters take over at each update; None
            bootstraps from the networks themselves.
        discount: Weight gamma of the next tick's reward in the return.
        normalize_return: Weigh rewards by 1 - gamma, so that a sigmoid can reach the target.
        epsilon: Probability of starting to explore, per tick.
        max_hold_ticks: Longest run of an explored candidate; 1 is plain epsilon-greedy.
        inheritance: lamarckian: children inherit the weights that were learnt; darwinian: those
            of birth.

    Example:
        >>> @dataclass(frozen=True, kw_only=True)
        ... class SlowConfig(StepConfig):  # of a learner of your own
        ...     slowness: float = 2.0
    """

    learning_rate: float = 0.1
    optimizer: Optimizer = "sgd"
    target_tau: float | None = None
    discount: float = 0.8
    normalize_return: bool = True
    epsilon: float = 0.1
    max_hold_ticks: int = 1
    inheritance: Inheritance = "lamarckian"

    def __post_init__(self) -> None:
        check_fields(self, learning_rate="[0, inf)", optimizer=Optimizer, target_tau="(0, 1]")
        check_fields(self, discount="[0, 1]", epsilon="[0, 1]", max_hold_ticks="[1, inf]")
        check_fields(self, inheritance=Inheritance)


@dataclass(frozen=True, kw_only=True)
class TDConfig(StepConfig):
    """Every network learns the TD error of its own robot's ticks.

    Attributes:
        trace_decay: lambda of the return; 0 is one-step Q-learning, 1 the whole batch.
        wires: With `CandidateHeads`, learn the value interpolated between all candidates, which
            moves them too (`WireFittingLoss`); else that of the candidate that was taken alone.

    Example:
        >>> config = TDConfig(learning_rate=0.01, optimizer="adam", trace_decay=0.8)
    """

    trace_decay: float = 0.0
    wires: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fields(self, trace_decay="[0, 1]")


class TDLearner:
    """Trains every network of a population on its own robot's transitions.

    With plain steps a learning rate is in units of the network outputs, so that it means the same
    at any `value_range` of the heads: the gradient of a squared error of Q-values is larger by the
    square of the range. Adam's steps have no such unit.

    The optimiser's state, the learning rate and the number of steps belong to a robot's slot and
    are cleared when a newborn takes it. Whoever has no transition of its own in a batch keeps all
    of it as it is. An update that would make a weight infinite or NaN is not applied to that robot.

    Args:
        network: The networks.
        loss: A loss over that network, with reduction `sum`.
        config: Learning rate, optimiser and target parameters; the rest is the loss's.

    Attributes:
        learning_rate: Per robot [networks], in units of Q; may be changed in place.
        square: What a learning rate of the configuration is divided by for that.

    Example:
        >>> loss = CandidateTDLoss(CandidateValue(network, heads))
        >>> loss.make_value_estimator(gamma=0.9)
        >>> learner = TDLearner(network, loss, TDConfig(learning_rate=0.01, optimizer="adam"))
    """

    def __init__(
        self, network: PopulationNetwork, loss: CandidateTDLoss, config: StepConfig
    ) -> None:
        self.network = network
        self.loss = loss
        self.config = config
        self.adam = config.optimizer == "adam"
        heads = cast(Heads | None, getattr(loss.value_network, "heads", None))
        low, high = (0.0, 1.0) if heads is None else heads.value_range
        self.square = 1.0 if self.adam else (high - low) ** 2
        weight = network.weight
        self.learning_rate = weight.new_full((len(weight),), config.learning_rate / self.square)
        self.steps = weight.new_zeros(len(weight))
        self.first_moment = torch.zeros_like(weight, requires_grad=False)
        self.second_moment = torch.zeros_like(weight, requires_grad=False)
        tau = config.target_tau
        self.target_update = None if tau is None else SoftUpdate(loss, tau=tau)

    def update(self, batch: TensorDictBase) -> Tensor:
        """One step of every network.

        Args:
            batch: Transitions [*shape, ticks]. Those whose `genome_id` is not that of the network
                in the robot's slot now are left out.

        Returns:
            Mean squared TD error of each robot before the step [*shape].
        """
        own = batch.get("genome_id").squeeze(-1) == self.network.genome_id.unsqueeze(-1)
        batch.set("own_transition", own)
        self.loss.loss_mask_key = "own_transition"
        self.network.weight.grad = None
        self.loss(batch).get("loss").backward()
        with self.sparing(~own.flatten(0, -2).any(-1)):
            self._step()
            if self.target_update is not None:
                self.target_update.step()
        error = batch.get(self.loss.tensor_keys.priority).squeeze(-1).square()
        return torch.where(own, error, 0).sum(-1) / own.sum(-1).clamp_min(1)

    @contextmanager
    def sparing(self, spared: Tensor) -> Iterator[None]:
        """Leave some networks [networks] and their optimiser alone, whatever happens meanwhile."""
        parts = [self.network.weight.detach(), *self.state_dict().values()]
        before = [part.clone() for part in parts]
        yield
        for part, old in zip(parts, before, strict=True):
            part.copy_(torch.where(spared.view(-1, *(1,) * (part.ndim - 1)), old, part))

    @torch.no_grad()
    def _step(self) -> None:
        weight, gradient = self.network.weight, self.network.weight.grad
        assert gradient is not None
        if self.adam:
            gradient = adam(gradient, self.steps, self.first_moment, self.second_moment)
        take_over(weight, weight - self.learning_rate.unsqueeze(1) * gradient)

    @torch.no_grad()
    def reset(self, newborn: Tensor) -> None:
        """Clear moments, steps and targets of the genomes before, once newborns stand there."""
        weight, born = self.network.weight, newborn.reshape(-1, 1)
        self.steps.masked_fill_(born.squeeze(1), 0)
        self.first_moment = fitted(self.first_moment, weight).masked_fill(born, 0)
        self.second_moment = fitted(self.second_moment, weight).masked_fill(born, 0)
        if (target := self.target_weight) is not None:
            target.data = torch.where(born, weight, fitted(target.data, weight))

    @property
    def target_weight(self) -> Tensor | None:
        """The weights to bootstrap from [networks, columns]; None: the networks' own."""
        if self.target_update is None:
            return None
        return self.loss.target_value_network_params["network", "weight"]

    def state_dict(self) -> Saved:
        """Learning rates, moments, steps and target parameters."""
        names = ("learning_rate", "steps", "first_moment", "second_moment")
        state = {name: getattr(self, name) for name in names}
        if self.target_weight is not None:
            state["target_weight"] = self.target_weight.detach()
        return state

    @torch.no_grad()
    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        for name, own in self.state_dict().items():
            own.copy_(fitted(state[name], own))


def adam(gradient: Tensor, steps: Tensor, first_moment: Tensor, second_moment: Tensor) -> Tensor:
    """What Adam would subtract, at rate 1, for gradients [networks, columns].

    Steps [networks] and moments [networks, columns] of the networks are brought up to date.
    """
    first, second = ADAM_BETAS
    steps += 1
    first_moment.lerp_(gradient, 1 - first)
    second_moment.lerp_(gradient.square(), 1 - second)
    # Not 1 - beta**steps: torch's pow differs in the last bit with the place in the tensor.
    unbiased = [-torch.expm1(steps * math.log(beta)) for beta in ADAM_BETAS]
    scale = unbiased[1].sqrt() / unbiased[0]
    return scale.unsqueeze(1) * first_moment / (second_moment.sqrt() + ADAM_EPSILON)


def take_over(weight: Tensor, changed: Tensor, wanted: Tensor | None = None) -> Tensor:
    """Put changed weights [networks, columns] in place, but no network's with one not finite.

    Only those `wanted` [networks, 1] change, all if None; returns which did [networks, 1].
    """
    finite = torch.isfinite(changed).all(1, keepdim=True)
    if wanted is not None:
        finite &= wanted
    weight.copy_(torch.where(finite, changed, weight))
    return finite
