"""A world of one's own, a script to copy: `python examples/own_world.py`.

Sledges on ice: each must come to its target and stay there. The world is an ordinary environment
of TorchRL with rows [arenas, slots]; the trainer knows it by its name.
"""

from typing import Any

import numpy as np
import torch
import tyro
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

import neatq_torch as nq


class Sledges(EnvBase):
    """Observed: offset to the target, speed. Action: push. Reward: 1 at the target, else less."""

    def __init__(self, *, arenas: int = 1, seed: int = 0, slots: int = 30, life: int = 50) -> None:
        size, one = torch.Size([arenas, slots]), torch.Size([arenas, slots, 1])
        super().__init__(batch_size=size)
        seen = Unbounded(torch.Size([*size, 2]))
        self.observation_spec = Composite({"observation": seen}, shape=size)
        self.action_spec = Bounded(-1.0, 1.0, shape=one)
        self.reward_spec = Bounded(0.0, 1.0, shape=one)
        ends = ("done", "terminated", "truncated")
        flag = Binary(1, shape=one, dtype=torch.bool)
        self.full_done_spec = Composite({end: flag.clone() for end in ends}, shape=size)
        self._chance = [np.random.default_rng(seed + arena) for arena in range(arenas)]
        self._life, self._age = life, torch.zeros(one, dtype=torch.int64)
        self._offset, self._speed = torch.zeros(one), torch.zeros(one)

    def _reset(self, tensordict: TensorDict | None = None, **_: Any) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        new = torch.tensor(True) if mask is None else mask.view_as(self._age)
        drawn = np.stack([one.uniform(-1, 1, self._age.shape[1:]) for one in self._chance])
        self._offset = torch.where(new, torch.from_numpy(drawn).float(), self._offset)
        self._speed = torch.where(new, 0.0, self._speed)
        self._age = torch.where(new, 0, self._age)
        return self._made()

    def _step(self, tensordict: TensorDict) -> TensorDict:
        self._speed = 0.9 * self._speed + 0.05 * tensordict["action"].clamp(-1, 1)
        self._offset, self._age = self._offset + self._speed, self._age + 1
        return self._made(reward=1 / (1 + 10 * self._offset.abs()))

    def _made(self, **more: Tensor) -> TensorDict:
        over = self._age >= self._life
        ends = {"done": over, "truncated": over.clone(), "terminated": torch.zeros_like(over)}
        seen = torch.cat([self._offset, 10 * self._speed], -1)
        return TensorDict({"observation": seen, **ends, **more}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self._chance = [np.random.default_rng((seed or 0) + i) for i in range(len(self._chance))]


nq.register_world("sledges", Sledges)


def main(ticks: int = 5_000, seed: int = 0, out: str = "runs/sledges") -> dict[str, float]:
    """Train two arms; returns the mean return of a life, of at most 50, in the last generation."""
    runs = {
        arm: nq.train("sledges", arm, ticks=ticks, seed=seed, out=f"{out}-{arm}")
        for arm in ("rtneat", "neatq")
    }
    return {arm: float(run.metrics()["mean_fitness"][-1]) for arm, run in runs.items()}


if __name__ == "__main__":
    print(tyro.cli(main))
