"""Any Gymnasium environment as a TorchRL environment of [arenas, rows]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded

from neatq_envs.gymnasium_rows import EpisodeRows, Rows, make_rows
from neatq_envs.gymnasium_task import GymnasiumTask, Interface
from neatq_envs.observation_scaling import LARGEST, ObservationScaling
from neatq_envs.torchrl_steps import ACTION, DONE, REWARD, RowsEnv, single

OBSERVATION = "observation"
LIVING = "living"
EPISODE = "episode"
STEP_COUNT = "step_count"
TERMINATED = "terminated"
TRUNCATED = "truncated"


def episode_seeds(seed: int, generation: int, episodes: int, *, purpose: int = 0) -> np.ndarray:
    """The seeds of the episodes of a generation, int64 [episodes], each within 32 bits.

    Episode e begins with `reset(seed=s)`, where s is the first word of
    `numpy.random.SeedSequence([seed, purpose, generation, e])`. It depends on nothing else, so all
    rows of an arena begin alike and a run can go on from any generation.

    Args:
        seed: Of the arena.
        generation: Number of the generation.
        episodes: How many.
        purpose: Episodes for other purposes have other seeds.
    """
    words = [
        np.random.SeedSequence([seed, purpose, generation, episode]).generate_state(1)[0]
        for episode in range(episodes)
    ]
    return np.array(words, np.int64)


class GymnasiumRows(RowsEnv):
    """Rows that live some episodes each of a Gymnasium environment, then stand idle.

    ## Description
    Every row [arena, row] has an environment of its own. `begin` says with which seeds the
    episodes of an arena start; they are the same for all its rows. When an episode ends, resetting
    the row begins its next one. A row that had its last one is idle: `living` is false, it is not
    stepped, its reward is 0, its observation stays, and it is not done.

    ## Observation space
    `observation`, float32 [arenas, rows, inputs], scaled; `living`, bool [.., 1]; `episode`
    and `step_count`, int64 [.., 1].

    ## Action space
    `action`, float32 [arenas, rows, actions]: a point in the environment's box, or the number of
    one of its choices, counted from 0.

    ## Rewards
    `reward`, float32 [arenas, rows, 1], as the environment gives it. `episodes.returns`, float64
    [arenas x rows, episodes], sums it up.

    ## Episode end
    `terminated` and `truncated` are the environment's own: a value may be bootstrapped over the
    second, and not over the first.

    Args:
        rows: The environments, as `make_rows` makes them.
        interface: What is read and done in them.
        scaling: Of the observations.
        shape: (arenas, rows).
        seeds: The episodes of each arena [arenas, episodes] of the first `begin`. Default: one
            episode, with those of arena i for the seed i.
        name: What messages call the environment.
        label: What they call a row, counted over all arenas.
    """

    seen = (OBSERVATION, LIVING, EPISODE, STEP_COUNT, DONE, TERMINATED, TRUNCATED)

    def __init__(
        self,
        rows: Rows,
        interface: Interface,
        scaling: ObservationScaling,
        *,
        shape: Sequence[int],
        seeds: ArrayLike | None = None,
        name: str = "the environment",
        label: Callable[[int], str] = "row {}".format,
    ) -> None:
        super().__init__(device=None, batch_size=torch.Size(shape))
        self.interface = interface
        self.scaling = scaling
        self.episodes = EpisodeRows(rows, name, label)
        self._make_specs()
        if seeds is None:
            self._set_seed(0)
        else:
            self.begin(seeds)

    @classmethod
    def make(
        cls, task: GymnasiumTask, scaling: ObservationScaling, *, shape: Sequence[int]
    ) -> GymnasiumRows:
        """Make the environments of a task, and this environment of them."""
        rows, interface = make_rows(task)
        return cls(rows, interface, scaling, shape=shape, name=task.id)

    def begin(self, seeds: ArrayLike) -> None:
        """Say what the rows live through; the next `reset` without a mask begins it.

        Args:
            seeds: Int64 [arenas, episodes], as `episode_seeds` makes them.
        """
        seeds = np.asarray(seeds, np.int64)
        arenas, rows = self.batch_size
        if seeds.ndim != 2 or len(seeds) != arenas or not seeds.shape[1]:
            raise ValueError(
                f"seeds: expected those of the episodes of {arenas} arenas, got the shape "
                f"{list(seeds.shape)}"
            )
        self._seeds = np.repeat(seeds, rows, axis=0)

    def _make_specs(self) -> None:
        low, high = (torch.tensor(bound) for bound in self.interface.bounds)
        size, one = self._size(len(low)), self._size(1)
        self.action_spec = Bounded(low.expand(size), high.expand(size), dtype=torch.float32)
        seen = self._size(self.interface.inputs)
        truth = Categorical(2, shape=one, dtype=torch.bool)
        count = Unbounded(shape=one, dtype=torch.int64)
        self.observation_spec = Composite(
            {
                OBSERVATION: Bounded(-LARGEST, LARGEST, shape=seen, dtype=torch.float32),
                LIVING: truth,
                EPISODE: count,
                STEP_COUNT: count.clone(),
            },
            shape=self.batch_size,
        )
        self.reward_spec = Unbounded(shape=one)
        ends = {name: truth.clone() for name in (DONE, TERMINATED, TRUNCATED)}
        self.full_done_spec = Composite(ends, shape=self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None:
            self.episodes.begin(self._seeds)
        else:
            self.episodes.go_on(mask.reshape(-1).numpy())
        return self._tensordict(self._observe())

    def _advance(self, tensordict: TensorDictBase) -> dict[str, torch.Tensor]:
        self.episodes.step(tensordict.get(ACTION).detach().flatten(0, 1).numpy())
        values = self._observe()
        values[REWARD] = single(self.episodes.reward).view(self._size(1))
        return values

    def _observe(self) -> dict[str, torch.Tensor]:
        now, one = self.episodes, self._size(1)
        terminated, truncated = (torch.from_numpy(a) for a in (now.terminated, now.truncated))
        return {
            OBSERVATION: torch.from_numpy(self.scaling(now.observation)).unflatten(
                0, self.batch_size
            ),
            LIVING: torch.from_numpy(now.living).view(one),
            EPISODE: torch.from_numpy(now.episode).view(one),
            STEP_COUNT: torch.from_numpy(now.step_count).view(one),
            DONE: (terminated | truncated).view(one),
            TERMINATED: terminated.view(one),
            TRUNCATED: truncated.view(one),
        }

    def _set_seed(self, seed: int | None) -> None:
        first = 0 if seed is None else seed
        arenas = range(first, first + self.batch_size[0])
        self.begin(np.stack([episode_seeds(arena, 0, 1) for arena in arenas]))
