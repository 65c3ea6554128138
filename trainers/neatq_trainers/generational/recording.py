"""The transitions that the lives of a generation leave to the next one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from tensordict import TensorDictBase

from neatq_envs.torchrl_rows import LIVING

Transitions = dict[str, np.ndarray]
"""What `TransitionMemory.state` writes: `observation`, `action`, `next_observation`, `next_reward`
and `next_terminated` [transitions, ...]."""

_KEYS = {
    "observation": "observation",
    "action": "action",
    "next_observation": ("next", "observation"),
    "next_reward": ("next", "reward"),
    "next_terminated": ("next", "terminated"),
}
_DRAWN_STEPS = 256


class Lessons(NamedTuple):
    """What newborns learn from before their first step.

    Attributes:
        memories: The transitions that each arena remembers.
        seeds: Of the minibatches that are drawn from each memory, int64 [memories].
        memory_of: From which memory each life learns, int64 [lives].
    """

    memories: list[Transitions]
    seeds: np.ndarray
    memory_of: np.ndarray

    def of(self, lives: slice) -> Lessons:
        """Those of some of the lives."""
        return self._replace(memory_of=self.memory_of[lives])


class Recorder:
    """A fair sample of the transitions of each life: each of them is kept with the same chance.

    Its ends of episodes are in it, too, however long the life is. This is reservoir sampling
    (Vitter 1985, algorithm R) for every life on its own, so that what it leaves does not depend on
    what lives beside it.

    Args:
        size: Transitions kept of each life; those of a shorter one are kept all, in their order.
        generators: That of each life.
    """

    def __init__(self, size: int, generators: Sequence[np.random.Generator]) -> None:
        self._size, self._generators = size, generators
        self._step = 0
        self._kept: Transitions = {}
        self._count = np.zeros(len(generators), np.int64)

    def add(self, lived: TensorDictBase) -> None:
        """Take note of one step of all lives [lives, 1]; idle ones have none."""
        living = lived.get(LIVING)[:, 0, 0].numpy()
        place = self._places()
        lives = np.flatnonzero(living & (place < self._size))
        if len(lives):
            for name, key in _KEYS.items():
                values = lived.get(key)[:, 0].detach().numpy()
                if name not in self._kept:
                    shape = (len(place), self._size, values.shape[1])
                    self._kept[name] = np.zeros(shape, values.dtype)
                self._kept[name][lives, place[lives]] = values[lives]
        self._count += living
        self._step += 1

    def _places(self) -> np.ndarray:
        """Where each life keeps this step's transition; from `size` on it does not."""
        if self._step < self._size:
            return np.full(len(self._generators), self._step)
        column = self._step % _DRAWN_STEPS
        if column == 0 or self._step == self._size:
            self._chance = np.stack([rng.random(_DRAWN_STEPS) for rng in self._generators])
        return (self._chance[:, column] * (self._step + 1)).astype(np.int64)

    def transitions(self) -> list[Transitions]:
        """Those of each life."""
        counts = np.minimum(self._count, self._size).tolist()
        return [
            {name: rows[life, :count] for name, rows in self._kept.items()}
            for life, count in enumerate(counts)
        ]


def merged(lives: Sequence[Transitions]) -> Transitions:
    """The transitions of lives, one life after the other."""
    return {name: np.concatenate([life[name] for life in lives]) for name in _KEYS}
