"""Batches of ticks: slots act and the world moves, in this process or where environments live."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_envs.gymnasium_rows import Mask, SingleRows, Step
from neatq_envs.random_play import ObservationScaling
from neatq_envs.torchrl_env import RowsEnv
from neatq_envs.torchrl_rows import GymnasiumRows
from neatq_torch.genome import Genome
from neatq_torch.learning import CandidatePolicy, RunningNormalization

Arrays = dict[str, Any]
"""A batch as nested dicts of arrays [arenas, slots, ticks, ...]."""


def collector_of(env: EnvBase, policy: Callable[..., Any], ticks: int) -> Collector:
    """A collector of batches [arenas, slots, ticks], without end."""
    explores = getattr(policy, "explores", True)  # else nothing is drawn for it
    chance: Any = ExplorationType.RANDOM if explores else ExplorationType.DETERMINISTIC
    kind = RowsCollector if isinstance(env, RowsEnv) else Collector
    return kind(
        env,
        policy,
        frames_per_batch=env.batch_size.numel() * ticks,
        total_frames=-1,
        auto_register_policy_transforms=False,
        use_buffers=False,  # a network's state may grow from batch to batch
        track_traj_ids=False,  # the age of a life tells more
        exploration_type=chance,
    )


class RowsCollector(Collector):
    """The same batches for environments of rows, at less cost.

    All is on the CPU, and the ticks of a batch have the same entries, so they need not be looked
    through for what differs, and a batch that was just made need not be copied.
    """

    def iterator(self) -> Iterator[TensorDictBase]:
        """Batch after batch."""
        while True:
            yield self.rollout()

    def look_again(self) -> None:
        """Go on from what the environment's `reset` returns, as a collector that has just begun."""
        self._carrier = self.env.reset()

    @torch.no_grad()
    def rollout(self) -> TensorDict:
        """The next batch."""
        ticks = []
        with set_exploration_type(self.exploration_type):
            for _ in range(self.frames_per_batch):
                acted = self._wrapped_policy(self._carrier)
                tick, self._carrier = self.env.step_and_maybe_reset(acted)
                ticks.append(tick)
        return _stacked(ticks)


def _stacked(ticks: Sequence[TensorDictBase]) -> TensorDict:
    """Ticks of batch size [arenas, slots] as one batch [arenas, slots, ticks]."""
    size, dim = torch.Size([*ticks[0].batch_size, len(ticks)]), ticks[0].batch_dims
    columns: list[Arrays] = [dict(tick.items()) for tick in ticks]
    values: Arrays = {}
    for key, first in columns[0].items():
        column = [one[key] for one in columns]
        nested = isinstance(first, TensorDict)
        if nested:
            values[key] = _stacked(column)
        else:
            values[key] = torch.stack(column, dim) if len(ticks) > 1 else first.unsqueeze(dim)
    return TensorDict._new_unsafe(values, size)


class Share(NamedTuple):
    """Some slots of an arena that begin, or go on, elsewhere.

    Attributes:
        policy: Acts for them.
        scaling: Of their observations.
        seeds: Of the arena.
        generation: Whose episodes they have.
        episodes: Of each slot in a generation; None: without end.
        first_slot: The number of the first.
        ticks: Of a batch.
        name: What messages call the environment.
        rows: The state in which they go on, see `EpisodeRows`; None: they begin.
    """

    policy: CandidatePolicy
    scaling: ObservationScaling
    seeds: Sequence[int]
    generation: int
    episodes: int | None
    first_slot: int
    ticks: int
    name: str
    rows: Mapping[str, Any] | None


class News(NamedTuple):
    """What has come to some slots since the batch before.

    Attributes:
        born: New genomes by slot, counted from the first of these.
        policy: State of the policy.
        weight: Of the networks [slots, columns]; None: as it was.
        normalization: Of what they read; None where it is read as it comes.
    """

    born: dict[int, Genome]
    policy: dict[str, Any]
    weight: Tensor | None
    normalization: RunningNormalization | None


class Collected(NamedTuple):
    """What some slots went through.

    Attributes:
        batch: [1, slots, ticks].
        policy: State of the policy after it.
        seconds: What the steps took in their environments.
        steps: How many there were.
    """

    batch: Arrays
    policy: dict[str, Any]
    seconds: float
    steps: int


class RolloutWorker(SingleRows):
    """Environments of some slots, and the networks that act in them.

    What a slot does depends on its genome, its seeds and what is told of it alone, so it does not
    matter who else is here.
    """

    _seconds, _steps = 0.0, 0
    _env: GymnasiumRows
    _policy: CandidatePolicy
    _collector: RowsCollector

    def take(self, share: Share) -> None:
        """Have these slots from now on."""
        torch.set_num_threads(1)
        self._policy = share.policy
        self._env = GymnasiumRows(
            self,
            self.interface,
            share.scaling,
            shape=share.policy.network.shape,
            seeds=share.seeds,
            episodes=share.episodes,
            name=share.name,
            first_slot=share.first_slot,
        )
        own = {"seeds": share.seeds, "generation": share.generation, "starts": None}
        self._env.load_world_state({**own, "rows": share.rows})
        collector = collector_of(self._env, self._policy, share.ticks)
        assert isinstance(collector, RowsCollector)
        self._collector = collector

    def collect(self, news: News) -> Collected:
        """The next batch."""
        self._hear(news)
        self._seconds, self._steps = 0.0, 0
        batch = _sendable_batch(self._collector.rollout())
        return Collected(batch, self._policy.state_dict(), self._seconds, self._steps)

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """See `SingleRows`."""
        begun = time.perf_counter()
        came = super().step(mask, actions)
        self._seconds += time.perf_counter() - begun
        self._steps += int(mask.sum())
        return came

    def rows(self, news: News) -> dict[str, Any]:
        """The state of the slots, see `EpisodeRows`."""
        self._hear(news)
        return self._env.episodes.state()

    def _hear(self, news: News) -> None:
        network = self._policy.network
        for slot, genome in news.born.items():
            network.replace(slot, genome)
        if news.weight is not None:
            network.load_weights(news.weight)
        self._policy.normalization = news.normalization
        self._policy.load_state_dict(news.policy)
        if news.born:
            mask = torch.zeros(network.shape, dtype=torch.bool)
            mask[0, list(news.born)] = True
            self._collector.reset(index=mask)


def _sendable_batch(batch: TensorDictBase) -> Arrays:
    """Plain arrays, which travel faster."""
    return {
        key: value.numpy() if isinstance(value, Tensor) else _sendable_batch(value)
        for key, value in batch.items()
    }
