"""Episodes side by side: with which seeds they begin, how far they are, what they have come to."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_envs.gymnasium_rows import EnvRows, Mask, RowError
from neatq_envs.observations import input_name

TRAINING, EVALUATION, TEST, RANDOM_PLAY = 0, 1, 2, 3
"""What episodes are for: each purpose has seeds of its own."""
_EPISODE_ARRAYS = ("observation", "reward", "returns", "terminated", "truncated")
_EPISODE_ARRAYS += ("living", "episode", "step_count", "steps", "seed")


LARGEST_INPUT = float(np.finfo(np.float32).max)
LARGEST_REWARD = 1e12
"""Networks learn in single precision, with the squares of sums of rewards."""


class EpisodeError(RuntimeError):
    """An environment failed in an episode; the message says in which and when."""


def episode_seed(seed: int, generation: int, episode: int, *, purpose: int = TRAINING) -> int:
    """The seed of an episode, within 32 bits.

    It is the first word of `numpy.random.SeedSequence([seed, purpose, generation, episode])` with
    the seed of the arena (where there are no generations the slot stands in their place), and
    depends on nothing else: a run can go on anywhere.
    """
    return int(np.random.SeedSequence([seed, purpose, generation, episode]).generate_state(1)[0])


def episode_seeds(
    seed: int, generation: int, episodes: int, *, purpose: int = TRAINING
) -> NDArray[np.int64]:
    """The seeds of the first episodes of a generation, int64 [episodes]; see `episode_seed`."""
    seeds = [episode_seed(seed, generation, each, purpose=purpose) for each in range(episodes)]
    return np.array(seeds, np.int64)


@dataclass(frozen=True)
class Starts:
    """With which seeds the episodes of so many rows begin: `seed(row, episode)`.

    Each row has a number of episodes, or with None one after the other, without end.
    """

    rows: int
    episodes: int | None
    seed: Callable[[int, int], int]

    @staticmethod
    def given(seeds: ArrayLike) -> Starts:
        """Those of an array, int64 [rows, episodes]."""
        table = np.asarray(seeds, np.int64)
        rows, episodes = table.shape
        return Starts(rows, episodes, lambda row, episode: int(table[row, episode]))


def rows_of(state: Mapping[str, Any], rows: slice) -> dict[str, np.ndarray]:
    """The part of a state of `EpisodeRows` that is of some rows."""
    own = {name: np.asarray(state[name])[rows] for name in _EPISODE_ARRAYS}
    actions = np.asarray(state["actions"])
    return own | {"actions": actions[:, rows] if len(actions) else actions}


def side_by_side(states: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The opposite of `rows_of`: the state of all rows."""
    own = {name: np.concatenate([one[name] for one in states]) for name in _EPISODE_ARRAYS}
    longest = max(len(one["actions"]) for one in states)
    if not longest:
        return own | {"actions": np.zeros(0, np.float32)}
    width = max(one["actions"].shape[-1] for one in states if len(one["actions"]))
    actions = []
    for one in states:
        steps, rows = len(one["actions"]), len(one["reward"])
        taken = one["actions"] if steps else np.zeros((0, rows, width), np.float32)
        none = np.zeros((longest - steps, rows, width), np.float32)
        actions.append(np.concatenate([none, taken]))
    return own | {"actions": np.concatenate(actions, axis=1)}


class EpisodeRows:
    """Rows that live one episode after the other; after the last one, if any, they stand idle.

    All arrays but `returns` are replaced, never written into, by `begin`, `go_on` and `step`.

    Attributes:
        observation: Float64 [rows, inputs], not scaled.
        reward: Float64 [rows], of the last step; 0 where an episode begins and of idle rows.
        terminated: Bool [rows], whether the last step ended the episode for good.
        truncated: Bool [rows], whether it was cut off, by a time limit for instance.
        living: Bool [rows], false once a row has had all its episodes.
        episode: Int64 [rows], from 0; that of an idle row is its last.
        step_count: Int64 [rows], steps in the episode.
        steps: Int64 [rows], steps since `begin`.
        seed: Int64 [rows], of the episode.
        returns: Float64 [rows, episodes], sums of rewards so far; without an end of the episodes
            [rows, 1], that of the episode.
    """

    def __init__(
        self, rows: EnvRows, name: str, label: Callable[[int], str] = "row {}".format
    ) -> None:
        """Take environments; messages call them by `name` and a row by its `label`."""
        self._rows, self._name, self._label = rows, name, label
        self._actions: deque[np.ndarray] = deque()  # [rows, actions] of the last steps

    def begin(self, starts: Starts) -> None:
        """Begin the first episode of every row."""
        rows, self._starts = starts.rows, starts
        self._actions.clear()
        self.reward, self.returns = np.zeros(rows), np.zeros((rows, starts.episodes or 1))
        self.terminated, self.truncated = np.zeros(rows, bool), np.zeros(rows, bool)
        self.living, self.seed = np.ones(rows, bool), np.zeros(rows, np.int64)
        self.episode, self.step_count = np.zeros(rows, np.int64), np.zeros(rows, np.int64)
        self.steps = np.zeros(rows, np.int64)
        self.observation = self._reset(self.living)

    def go_on(self, mask: Mask) -> None:
        """Let rows begin their next episode, or stand idle after the last; it need not be over."""
        last = self.episode + 1 == (self._starts.episodes or 0)
        following = mask & ~last
        self.living = self.living & ~(mask & last)
        self.episode = self.episode + following
        self.terminated, self.truncated = self.terminated & ~mask, self.truncated & ~mask
        self.reward = np.where(mask, 0.0, self.reward)
        if following.any():
            self.step_count = np.where(following, 0, self.step_count)
            if self._starts.episodes is None:
                self.returns = np.where(following[:, None], 0.0, self.returns)
            fresh = self._reset(following)
            self.observation = np.where(following[:, None], fresh, self.observation)

    def step(self, actions: np.ndarray) -> None:
        """Step the living rows with actions [rows, actions]; if none lives, nothing is called."""
        living, rows = self.living, len(self.living)
        if not living.any():
            self.reward, self.terminated = np.zeros(rows), np.zeros(rows, bool)
            self.truncated = np.zeros(rows, bool)
            return
        with self._failures_named():
            observation, reward, terminated, truncated = self._rows.step(living, actions)
            self.step_count, self.steps = self.step_count + living, self.steps + living
            self._actions.append(np.array(actions, np.float32))
            self._forget()
            self._check(living, observation, reward)
        self.observation = np.where(living[:, None], observation, self.observation)
        self.reward = np.where(living, reward, 0.0)
        self.terminated, self.truncated = terminated & living, truncated & living
        self.returns[np.arange(rows), self.episode if self._starts.episodes else 0] += self.reward

    def state(self) -> dict[str, np.ndarray]:
        """All arrays, and the actions of the episodes under way, float32 [steps, rows, actions].

        Row i has taken the last `step_count[i]` of these actions in its episode; those before, and
        of idle rows all, are 0.
        """
        self._forget()
        arrays = {name: getattr(self, name).copy() for name in _EPISODE_ARRAYS}
        actions = np.array([*self._actions], np.float32)
        if len(actions):
            taken = np.where(self.living, self.step_count, 0)
            actions[np.arange(len(actions))[:, None] < len(actions) - taken] = 0
        return arrays | {"actions": actions}

    def load_state(self, state: Mapping[str, Any], starts: Starts) -> None:
        """Continue from a `state` of as many rows that began with these starts.

        Every environment is reset with its seed and takes its actions again; all end at the same
        step, so that no row is stepped beyond where it was.
        """
        self._starts = starts
        for name in _EPISODE_ARRAYS:
            setattr(self, name, np.array(state[name]))
        actions = np.array(state["actions"], np.float32)
        self._actions = deque(actions)
        first = np.where(self.living, len(actions) - self.step_count, len(actions) + 1)
        with self._failures_named():
            for step in range(len(actions) + 1):
                if (fresh := first == step).any():
                    self._rows.reset(fresh, self.seed)
                if step < len(actions):
                    self._rows.step(first <= step, actions[step])

    def _forget(self) -> None:
        """Keep the actions of the longest of the living episodes, and none before."""
        longest = int(self.step_count.max(where=self.living, initial=0))
        while len(self._actions) > longest:
            self._actions.popleft()

    def _reset(self, mask: Mask) -> np.ndarray:
        self.seed = self.seed.copy()
        for row in np.flatnonzero(mask).tolist():
            self.seed[row] = self._starts.seed(row, int(self.episode[row]))
        with self._failures_named():
            observation = self._rows.reset(mask, self.seed)
            self._check(mask, observation, np.zeros(len(mask)))
        return observation

    def _check(self, mask: Mask, observation: np.ndarray, reward: np.ndarray) -> None:
        """Require numbers with which scaling and learning can compute."""
        fine = (np.abs(observation) <= LARGEST_INPUT) & np.isfinite(observation)
        bad = mask & ~(fine.all(1) & (np.abs(reward) <= LARGEST_REWARD))
        if not bad.any():
            return
        row = int(bad.argmax())
        if fine[row].all():
            words = f"reward is {reward[row]}; expected a finite number of at most 1e12; scale it"
            raise RowError(row, f"{words}, for instance by gymnasium.wrappers.TransformReward")
        entry = int(fine[row].argmin())
        name = input_name(self._rows.interface.observation, entry)
        raise RowError(
            row,
            f"{name} is {observation[row, entry]}; expected a finite number within single "
            "precision (3.4e38); scale or clip it, for instance by "
            "gymnasium.wrappers.TransformObservation",
        )

    @contextmanager
    def _failures_named(self) -> Iterator[None]:
        try:
            yield
        except RowError as error:
            raise EpisodeError(
                f"{self._name}: {self._label(error.row)} failed in episode "
                f"{self.episode[error.row]} with seed {self.seed[error.row]}, after "
                f"{self.step_count[error.row]} steps: {error.message}"
            ) from error
