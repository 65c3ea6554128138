"""Q-learning as OpenNERO had it: a table for each robot, and no network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type

from neatq_torch.kinds import check_fields
from neatq_torch.learning.learner import Learner, Saved


@dataclass(frozen=True, kw_only=True)
class TableConfig:
    """A table of Q-values for each robot, without a network and without evolution.

    Attributes:
        learning_rate: Step size alpha.
        discount: Weight gamma of the next tick's reward in the return.
        epsilon: Probability of exploring, per tick.
    """

    learning_rate: float = 0.8
    discount: float = 0.8
    epsilon: float = 0.1

    def __post_init__(self) -> None:
        check_fields(self, learning_rate="[0, inf)", discount="[0, 1]", epsilon="[0, 1]")


STATE_BINS = 5
ACTION_BINS = 3
"""Sensor values are rounded to {0, 1/4, ..., 1}; each action to its low, middle and high end."""


class TableLearner(Learner):
    """Watkins' Q-learning on the tables: Q += alpha (r + gamma max Q' - Q), as OpenNERO had it.

    Its rewards were those of the place where an action began, not where it led, so the reward of
    each tick is used one tick later here. They were negative, so that entries never visited, which
    are 0, look best: the environment's rewards in [0, 1] are moved to [-1, 0]. Each robot has a
    table, which survives the end of a life; nothing follows a life that is terminated. With batches
    of one tick the update is on-line.

    Args:
        shape: (arenas, robots).
        low: Smallest action [A].
        high: Largest action [A].
        config: Learning rate and discount, and how often the policy explores.
        seeds: One seed for each arena.

    Attributes:
        policy: Acts by the tables.
        actions: Those of the tables [actions, A].
        values: Q-values of the visited entries, and room for more [entries, actions].
    """

    def __init__(
        self,
        shape: Sequence[int],
        low: Sequence[float],
        high: Sequence[float],
        config: TableConfig,
        seeds: Sequence[int],
    ) -> None:
        self.shape, self.config = tuple(shape), config
        levels = [np.linspace(a, b, ACTION_BINS) for a, b in zip(low, high, strict=True)]
        self.actions = np.stack([a.ravel() for a in np.meshgrid(*levels, indexing="ij")], 1)
        self.low, self.high = np.array(low), np.array(high)
        self.values = np.zeros((1024, len(self.actions)))
        self._entries: dict[bytes, int] = {}
        self._reward = np.zeros(self.shape)
        self.policy = TableActor(self, seeds)

    def rows(self, observation: np.ndarray) -> np.ndarray:
        """The table rows [robots of all arenas] of observations [*shape, sensors]."""
        flat = observation.reshape(-1, observation.shape[-1])
        bins = np.rint(flat * (STATE_BINS - 1)).astype(np.uint8)
        robots = np.arange(len(bins), dtype=np.uint32).view(np.uint8).reshape(-1, 4)
        keys = np.concatenate([robots, bins], 1)
        entries = self._entries
        rows = np.array([entries.setdefault(key.tobytes(), len(entries)) for key in keys])
        while len(entries) > len(self.values):
            self.values = np.pad(self.values, ((0, len(self.values)), (0, 0)))
        return rows

    def index(self, action: np.ndarray) -> np.ndarray:
        """The nearest table action [...] of actions [..., A]."""
        unit = (action - self.low) / (self.high - self.low)
        levels = np.rint(unit * (ACTION_BINS - 1)).astype(np.int64)
        return levels @ ACTION_BINS ** np.arange(levels.shape[-1])[::-1]

    def update(self, batch: TensorDictBase) -> Tensor:
        """Learn from transitions [*shape, ticks]; returns the mean squared TD error [*shape]."""
        config, errors = self.config, []
        for tick in range(batch.shape[-1]):
            now = self.rows(batch.get("observation")[:, :, tick].numpy())
            following = self.rows(batch.get(("next", "observation"))[:, :, tick].numpy())
            action = self.index(batch.get("action")[:, :, tick].numpy()).ravel()
            over = batch.get(("next", "terminated"))[:, :, tick].numpy().ravel()
            best = np.where(over, 0.0, self.values[following].max(-1))
            target = self._reward.ravel() + config.discount * best
            error = target - self.values[now, action]
            self.values[now, action] += config.learning_rate * error
            errors.append(error**2)
            self._reward = batch.get(("next", "reward"))[:, :, tick, 0].double().numpy() - 1
        return torch.from_numpy(np.mean(errors, 0).reshape(self.shape))

    def state_dict(self) -> Saved:
        """Visited entries, keys [entries, bytes] and values [entries, actions]; latest rewards."""
        size = len(next(iter(self._entries), b""))
        keys = np.frombuffer(b"".join(self._entries), np.uint8).reshape(len(self._entries), size)
        return {"keys": keys, "values": self.values[: len(keys)], "reward": self._reward}

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        self._entries = {key.tobytes(): row for row, key in enumerate(state["keys"])}
        self.values = np.pad(state["values"], ((0, 1024), (0, 0)))
        self._reward = state["reward"]


class TableActor(TensorDictModuleBase):
    """Epsilon-greedy over the tables; an exploratory action is uniform over the whole range.

    Reads `observation`, writes `action`. Equal values are told apart at random, as in OpenNERO.
    A module, as collectors call what is none once more and so draw once more.
    """

    def __init__(self, tables: TableLearner, seeds: Sequence[int]) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation"], ["action"]
        self._tables = tables
        self.generators = [np.random.default_rng([seed, 2]) for seed in seeds]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add every robot's action to `tensordict`."""
        tables = self._tables
        rows = tables.rows(tensordict.get("observation").numpy())  # may replace tables.values
        values = tables.values[rows]
        arenas, robots = tables.shape
        noise = np.stack([rng.random((robots, values.shape[-1])) for rng in self.generators])
        best = values == values.max(-1, keepdims=True)
        greedy = np.where(best, noise.reshape(values.shape), -1.0).argmax(-1)
        action = tables.actions[greedy].reshape(arenas, robots, -1)
        if exploration_type() in (None, ExplorationType.RANDOM):
            wide = 1 + action.shape[-1]
            draw = np.stack([rng.random((robots, wide)) for rng in self.generators])
            explore = draw[..., :1] < tables.config.epsilon
            anywhere = tables.low + draw[..., 1:] * (tables.high - tables.low)
            action = np.where(explore, anywhere, action)
        return tensordict.set("action", torch.from_numpy(action.astype(np.float32)))

    def reset(self, newborn: Tensor) -> None:
        """There are no newborns without evolution."""

    def state_dict(self, *args: Any, **settings: Any) -> Saved:
        """The random generators; torch's own for a module around it."""
        if args or settings:
            return super().state_dict(*args, **settings)
        return {"generators": [rng.bit_generator.state for rng in self.generators]}

    def load_state_dict(self, state: Saved) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Go on from `state`."""
        for rng, bits in zip(self.generators, state["generators"], strict=True):
            rng.bit_generator.state = bits
