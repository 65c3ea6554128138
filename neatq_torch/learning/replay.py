"""Learning from stored transitions: from what all robots did, during life and before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from neatq_torch.kinds import check_fields
from neatq_torch.learning import compiled_wires
from neatq_torch.learning.heads import CandidateHeads
from neatq_torch.learning.learner import Saved, StepConfig, TDLearner
from neatq_torch.learning.memory import NEXT, NOW, TransitionMemory, over_horizon
from neatq_torch.learning.objectives import CandidateTDLoss, discount_of
from neatq_torch.learning.wire_fitting import WireFittingLoss
from neatq_torch.network import PopulationNetwork


@dataclass(frozen=True, kw_only=True)
class ReplayConfig(StepConfig):
    """Shared replay: every network learns from what all robots of its arena did.

    Attributes:
        updates: Minibatches on which every network is trained after each batch of ticks.
        newborn_updates: Minibatches on which a newborn is trained before its first tick.
        size: Transitions of a minibatch.
        horizon: Ticks of reward that a transition sums up before the value of what follows, as far
            as the batch reaches.
        keep_every: Of the ticks of each robot, one in so many is remembered.
        capacity: Transitions that an arena remembers.

    Example:
        >>> config = ReplayConfig(learning_rate=0.03, optimizer="adam", newborn_updates=100)
    """

    updates: int = 4
    newborn_updates: int = 0
    size: int = 64
    horizon: int = 1
    keep_every: int = 4
    capacity: int = 20_000

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fields(self, newborn_updates="[0, inf]")
        for name in ("updates", "size", "horizon", "keep_every", "capacity"):
            check_fields(self, **{name: "[1, inf]"})


class ReplayLearner:
    """Trains every network on transitions of all robots of its arena (Lin 1992), off-policy.

    A transition counts for every network of the arena, whoever made it. A discrete action is the
    candidate of that number; `WireFittingLoss` says what a network holds of a continuous one, which
    is none of its candidates. All networks of an arena see the same minibatches, and each
    bootstraps from its own values. Recurrent state counts as empty before every transition.
    Newborns can be taught before their first tick, which costs no sample (Whiteson & Stone 2006,
    "Sample-efficient evolutionary function approximation").

    Memories and chance belong to an arena, so what it learns does not depend on the arenas beside:
    one in which nobody lived during a batch does not learn from its memory either.

    Args:
        learner: Trains the networks of all robots; with `CandidateHeads` by a `WireFittingLoss`.
        make_loss: Makes such a loss over other networks: those of newborns.
        config: How much is remembered and how often it is learnt from.
        seeds: One seed for each arena.

    Raises:
        ValueError: If a loss by candidate is to learn from continuous actions.

    Example:
        >>> def make_loss(network):
        ...     loss = WireFittingLoss(CandidateValue(network, heads, propose=True))
        ...     loss.make_value_estimator(gamma=0.9)
        ...     return loss
        >>> config = ReplayConfig(learning_rate=0.03, optimizer="adam")
        >>> learner = TDLearner(network, make_loss(network), config)
        >>> learner = ReplayLearner(learner, make_loss, config, seeds=[0])
    """

    def __init__(
        self,
        learner: TDLearner,
        make_loss: Callable[[PopulationNetwork], CandidateTDLoss],
        config: ReplayConfig,
        seeds: Sequence[int],
    ) -> None:
        continuous = isinstance(learner.loss.value_network.heads, CandidateHeads)
        if continuous and not isinstance(learner.loss, WireFittingLoss):
            raise ValueError(
                "a stored continuous action is no candidate of another genome; use a "
                "WireFittingLoss"
            )
        self.learner = learner
        self.config = config
        self._make_loss = make_loss
        self.memories = [TransitionMemory(config.capacity) for _ in seeds]
        self.generators = [torch.Generator().manual_seed(seed) for seed in seeds]

    def update(self, batch: TensorDictBase) -> Tensor:
        """Remember a batch [arenas, robots, ticks] and learn from what is remembered.

        Returns:
            Mean squared TD error of each network on the last minibatch [arenas, robots].
        """
        config, gamma = self.config, discount_of(self.learner.loss)
        ahead = over_horizon(batch, config.horizon, gamma, keep_every=config.keep_every)
        for memory, own in zip(self.memories, ahead, strict=True):
            memory.extend(cast(TensorDictBase, own).reshape(-1))
        asleep = (batch.get("genome_id") < 0).flatten(1).all(1)
        if not asleep.any():
            return self._rehearse()
        states = [generator.get_state() for generator in self.generators]
        with self.learner.sparing(asleep.repeat_interleave(batch.shape[1])):
            error = self._rehearse()
        for arena in asleep.nonzero().flatten().tolist():
            self.generators[arena].set_state(states[arena])
        return torch.where(asleep.unsqueeze(1).to(error.device), 0, error)

    def _rehearse(self) -> Tensor:
        stores = self.memories, self.generators, range(len(self.memories))
        return rehearse(self.learner, *stores, steps=self.config.updates, batch=self.config.size)

    def reset(self, newborn: Tensor) -> None:
        """Teach newborns (mask [arenas, robots]) and clear what belonged to those before."""
        if self.config.newborn_updates and len(self.memories[0]) and newborn.any():
            self._teach(newborn)
        self.learner.reset(newborn)

    def _teach(self, newborn: Tensor) -> None:
        network, config = self.learner.network, self.config
        slots = newborn.flatten().nonzero().flatten().tolist()
        stores = self.memories, self.generators, [slot // network.shape[1] for slot in slots]
        if compiled_wires.can_teach(self.learner):
            pupils = compiled_wires.newborns_of(self.learner, slots)
            drawn = _draw(*stores, config.newborn_updates * config.size)
            compiled_wires.learn(pupils, self.learner, drawn, config.newborn_updates)
            network.weight.data[slots] = torch.from_numpy(pupils.weight)
            return
        genomes = [network.genome(slot) for slot in slots]
        young = PopulationNetwork(genomes, shape=(len(slots), 1), evaluation=network.evaluation)
        loss = self._make_loss(young.to(network.weight.device))
        learner = TDLearner(young, loss, self.learner.config)
        rehearse(learner, *stores, steps=config.newborn_updates, batch=config.size)
        for slot, genome in zip(slots, young.genomes(), strict=True):
            network.replace(slot, genome)

    def state_dict(self) -> Saved:
        """The learner's state, all memories and the state of all chance."""
        return {
            "learner": self.learner.state_dict(),
            "memories": [memory.state_dict() for memory in self.memories],
            "generators": [generator.get_state() for generator in self.generators],
        }

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        self.learner.load_state_dict(state["learner"])
        for memory, saved in zip(self.memories, state["memories"], strict=True):
            memory.load_state_dict(saved)
        for generator, saved in zip(self.generators, state["generators"], strict=True):
            generator.set_state(torch.as_tensor(saved))


def rehearse(
    learner: TDLearner,
    memories: Sequence[TransitionMemory],
    generators: Sequence[torch.Generator],
    memory_of: Sequence[int],
    *,
    steps: int,
    batch: int,
) -> Tensor:
    """Let a learner take steps, each on a minibatch of so many stored transitions.

    Its loss has the reduction `sum`, its networks the shape (arenas, robots); `memory_of` says from
    which memory each arena learns. All chance is that of the generators, one for each memory, on
    the CPU. Compiled code takes the steps where it can (`compiled_wires.can_teach`), up to rounding
    the same. Returns the mean squared TD error of each network on the last minibatch [*shape].
    """
    drawn = _draw(memories, generators, memory_of, steps * batch)
    network = learner.network
    if compiled_wires.can_teach(learner):
        pupils = compiled_wires.pupils_of(learner)
        last = compiled_wires.learn(pupils, learner, drawn, steps)
        return torch.from_numpy(last).view(network.shape)
    error = torch.zeros_like(network.genome_id, dtype=torch.float32)
    for part in drawn.to(network.weight.device).split(batch, 1):
        error = learner.update(_for_all(learner, part))
    return error


def _draw(
    memories: Sequence[TransitionMemory],
    generators: Sequence[torch.Generator],
    memory_of: Sequence[int],
    size: int,
) -> TensorDict:
    """Transitions [arenas, size]; arenas of one memory get the same, and no other one draws."""
    drawn = {row: memories[row].sample(size, generators[row]) for row in set(memory_of)}
    return cast(TensorDict, TensorDict.stack([drawn[row] for row in memory_of]))


def _for_all(learner: TDLearner, drawn: TensorDictBase) -> TensorDict:
    """A minibatch [arenas, size] as transitions [arenas, robots, size] of every network."""
    network = learner.network
    shape = (*network.shape, drawn.shape[1])

    def spread(name: str | tuple[str, str]) -> Tensor:
        own = drawn.get(name)
        return own.unsqueeze(1).expand(*shape, own.shape[-1])

    now = {name: spread(name) for name in NOW}
    following = {name: spread(("next", name)) for name in NEXT}
    # Every transition is an episode of its own, so that no return goes on into the next row.
    following["done"] = torch.ones_like(following["terminated"])
    now["candidate_index"] = now["action"][..., 0].long()
    now["genome_id"] = network.genome_id[..., None, None].expand(*shape, 1)
    return TensorDict(now | {"next": following}, shape)
