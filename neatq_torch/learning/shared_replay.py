"""Learning from what all robots of an arena went through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.learning import compiled_wires
from neatq_torch.learning.learner import State, TDLearner
from neatq_torch.learning.memory import TransitionMemory, over_horizon
from neatq_torch.learning.objectives import discount_of
from neatq_torch.learning.replay import draw, pretrain, rehearse
from neatq_torch.learning.wire_fitting import WireFittingLoss
from neatq_torch.network import PopulationNetwork


@dataclass(frozen=True, kw_only=True)
class ReplayConfig:
    """What robots learn from each other's past.

    Attributes:
        updates: Minibatches on which every network is trained after each batch of ticks, instead of
            on its own ticks; 0 goes without replay.
        newborn_updates: Minibatches on which a newborn is trained before its first tick.
        size: Transitions of a minibatch.
        horizon: Ticks of reward that a transition sums up before the value of what follows, as far
            as the batch reaches.
        keep_every: Of the ticks of each robot, one in so many is remembered.
        capacity: Transitions that an arena remembers.
    """

    updates: int = 0
    newborn_updates: int = 0
    size: int = 64
    horizon: int = 1
    keep_every: int = 4
    capacity: int = 20_000

    def __post_init__(self) -> None:
        """Check ranges."""
        least = {
            "updates": 0,
            "newborn_updates": 0,
            "size": 1,
            "horizon": 1,
            "keep_every": 1,
            "capacity": 1,
        }
        for name, smallest in least.items():
            if getattr(self, name) < smallest:
                raise ValueError(f"{name}: expected at least {smallest}, got {getattr(self, name)}")
        if self.newborn_updates and not self.updates:
            raise ValueError("newborn_updates: expected 0 with updates 0: nothing is remembered")


class ReplayLearner:
    """Trains every network on transitions of all robots of its arena (Lin 1992), off-policy.

    A transition counts for every network of the arena, whoever made it; `WireFittingLoss` says what
    a network holds of an action that is none of its candidates. All networks of an arena see the
    same minibatches. Newborns can be taught before their first tick (Whiteson & Stone 2006,
    "Sample-efficient evolutionary function approximation").

    Memories and chance belong to an arena, so what it learns does not depend on the arenas beside.

    Args:
        learner: Trains the networks of all robots; its loss must be a `WireFittingLoss`.
        make_loss: Makes such a loss over other networks: those of newborns.
        config: How much is remembered and how often it is learnt from.
        seeds: One seed for each arena.
    """

    def __init__(
        self,
        learner: TDLearner,
        make_loss: Callable[[PopulationNetwork], WireFittingLoss],
        config: ReplayConfig,
        seeds: Sequence[int],
    ) -> None:
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
        loss = self.learner.loss
        gamma = discount_of(loss) if loss.discount is None else None
        keep_every = self.config.keep_every
        ahead = over_horizon(batch, self.config.horizon, gamma, keep_every=keep_every)
        for memory, own in zip(self.memories, ahead, strict=True):
            memory.extend(cast(TensorDictBase, own).reshape(-1))
        return rehearse(
            self.learner,
            self.memories,
            self.generators,
            range(len(self.memories)),
            steps=self.config.updates,
            batch=self.config.size,
        )

    def reset(self, newborn: Tensor) -> None:
        """Teach newborns (mask [arenas, robots]) and clear what belonged to those before."""
        if self.config.newborn_updates and len(self.memories[0]) and newborn.any():
            self._teach(newborn)
        self.learner.reset(newborn)

    def _teach(self, newborn: Tensor) -> None:
        network, steps, batch = self.learner.network, self.config.newborn_updates, self.config.size
        places = newborn.flatten().nonzero().flatten().tolist()
        arena_of = [place // network.shape[1] for place in places]
        arenas = sorted(set(arena_of))  # no other arena may draw
        memories = [self.memories[arena] for arena in arenas]
        generators = [self.generators[arena] for arena in arenas]
        memory_of = [arenas.index(arena) for arena in arena_of]
        discount = self.learner.loss.discount
        own = None if discount is None else discount.flatten()[places]
        if compiled_wires.serves(self.learner):
            drawn = draw(memories, generators, steps * batch)
            shared = [drawn[row] for row in memory_of]
            lessons = compiled_wires.lessons_of(self.learner, shared, steps, own)
            taught = compiled_wires.newborns_of(self.learner, places)
            compiled_wires.learn(taught, self.learner, lessons)
            network.weight.data[places] = torch.from_numpy(taught.weight)
            return
        young = PopulationNetwork(
            [network.genome(place) for place in places],
            shape=(len(places), 1),
            evaluation=network.evaluation,
        ).to(network.weight.device)
        loss = self._make_loss(young)
        loss.discount = None if own is None else own.unsqueeze(1)
        pretrain(
            young,
            loss,
            memories,
            self.learner.config,
            steps=steps,
            batch=batch,
            generators=generators,
            memory_of=memory_of,
        )
        for place, genome in zip(places, young.genomes(), strict=True):
            network.replace(place, genome)

    def state(self) -> State:
        """The learner's state, all memories and the state of all chance."""
        return {
            "learner": self.learner.state(),
            "memories": [memory.state() for memory in self.memories],
            "generators": [generator.get_state() for generator in self.generators],
        }

    def load_state(self, state: State) -> None:
        """Go on from `state`."""
        self.learner.load_state(state["learner"])
        for memory, saved in zip(self.memories, state["memories"], strict=True):
            memory.load_state(saved)
        for generator, saved in zip(self.generators, state["generators"], strict=True):
            generator.set_state(torch.as_tensor(saved))
