"""Many episodes of one Gymnasium environment side by side: row i has an environment of its own."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray

from neatq_envs.gymnasium_task import GymnasiumTask, Interface


class EpisodeError(RuntimeError):
    """An environment failed in an episode; the message says in which and when."""


class _RowError(Exception):
    def __init__(self, row: int, message: str) -> None:
        super().__init__(message)
        self.row = row


Mask = NDArray[np.bool_]
Step = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Observations [rows, inputs], rewards, terminated and truncated [rows]; of rows that were not
stepped, anything."""


class Rows(Protocol):
    """Environments side by side."""

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask; observations [rows, inputs], theirs count."""
        ...

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step the rows of a mask with actions [rows, actions]."""
        ...


class SingleRows:
    """An environment for each row, made by `gymnasium.make`; only rows that are meant are called.

    Args:
        task: The environment.
        interface: How it is read.
        renewed: Make a new environment for every episode. Some (BipedalWalker-v3) keep something
            from the episode before that no seed covers.
    """

    def __init__(self, task: GymnasiumTask, interface: Interface, *, renewed: bool = False) -> None:
        self._task, self._interface, self._renewed = task, interface, renewed
        self._envs: list[gymnasium.Env[Any, Any]] = []

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask."""
        while len(self._envs) < len(mask):
            self._envs.append(self._task.make())
        observations = np.zeros((len(mask), self._interface.inputs))
        for row in np.flatnonzero(mask).tolist():
            if self._renewed:
                self._envs[row].close()
                self._envs[row] = self._task.make()
            try:
                observation, _ = self._envs[row].reset(seed=int(seeds[row]))
                observations[row] = self._interface.read(observation)
            except Exception as error:
                _raise_for(row, error)
        return observations

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step the rows of a mask."""
        rows = len(mask)
        observations, rewards = np.zeros((rows, self._interface.inputs)), np.zeros(rows)
        terminated, truncated = np.zeros(rows, bool), np.zeros(rows, bool)
        own, read, envs = self._interface.act(actions), self._interface.read, self._envs
        row = 0
        try:
            for row in np.flatnonzero(mask).tolist():
                observation, rewards[row], terminated[row], truncated[row], _ = envs[row].step(
                    own[row]
                )
                observations[row] = read(observation)
        except Exception as error:
            _raise_for(row, error)
        return observations, rewards, terminated, truncated


class VectorRows:
    """The vectorised environment that an id brings; rows that are not meant take a zero action.

    Args:
        make: Makes it for a number of rows.
        interface: How it is read.
    """

    def __init__(
        self, make: Callable[[int], VectorEnv[Any, Any, Any]], interface: Interface
    ) -> None:
        self._make, self._interface = make, interface
        self._env: VectorEnv[Any, Any, Any] | None = None

    @staticmethod
    def of(task: GymnasiumTask, interface: Interface) -> VectorRows | None:
        """The rows of a task whose vectorised environment resets rows by mask and seed.

        None if the id brings no such environment.
        """
        if task.spec().vector_entry_point is None:
            return None

        def make(rows: int) -> VectorEnv[Any, Any, Any]:
            return gymnasium.make_vec(
                task.id, rows, vectorization_mode="vector_entry_point", **task.kwargs
            )

        try:
            env = make(2)
            if env.metadata.get("autoreset_mode") != AutoresetMode.DISABLED:
                return None
            seeds: Any = [1, 2]
            env.reset(seed=seeds)
            env.reset(seed=seeds, options={"reset_mask": np.array([True, False])})
        except Exception:  # whatever it objects to, single environments will do
            return None
        return VectorRows(make, interface)

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask."""
        each: Any = seeds.tolist()  # Gymnasium's annotation forgets that there may be several
        if self._env is None or self._env.num_envs != len(mask):
            self._env = self._make(len(mask))
            observations, _ = self._env.reset(seed=each)
        else:
            observations, _ = self._env.reset(seed=each, options={"reset_mask": mask})
        return self._read(observations)

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step all rows."""
        assert self._env is not None
        own = np.asarray(self._interface.act(np.where(mask[:, None], actions, 0)))
        observations, rewards, terminated, truncated, _ = self._env.step(own)
        rewards = np.asarray(rewards, np.float64)
        return self._read(observations), rewards, np.asarray(terminated), np.asarray(truncated)

    def _read(self, observations: Any) -> np.ndarray:
        if isinstance(self._interface.observation, gymnasium.spaces.Discrete):
            place = np.asarray(observations) - int(self._interface.observation.start)
            return np.eye(self._interface.inputs)[place]
        return np.asarray(observations, np.float64).reshape(len(observations), -1)


def make_rows(task: GymnasiumTask, *, renewed: bool = False) -> tuple[Rows, Interface]:
    """The rows of a task and their interface.

    Args:
        task: The environment.
        renewed: Make a new environment for every episode.

    Raises:
        TaskError: If the environment cannot be made or used.
    """
    env = task.make()
    interface = Interface.of(env, task.id)
    env.close()
    vector = None if renewed else VectorRows.of(task, interface)
    return vector or SingleRows(task, interface, renewed=renewed), interface


def _raise_for(row: int, error: Exception) -> NoReturn:
    where = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(where.filename).name}:{where.lineno}"
    raise _RowError(row, f"{type(error).__name__}: {error} ({place})") from error


class EpisodeRows:
    """Rows that live a given number of episodes each, and then stand idle.

    The arrays are replaced, never written into, by `begin`, `go_on` and `step`.

    Attributes:
        observation: Float64 [rows, inputs], not scaled.
        reward: Float64 [rows], of the last step; idle rows have 0.
        terminated: Bool [rows], whether the last step ended the episode for good.
        truncated: Bool [rows], whether it was cut off, by a time limit for instance.
        living: Bool [rows], false once a row has had all its episodes.
        episode: Int64 [rows], from 0; that of an idle row is its last.
        step_count: Int64 [rows], steps in the episode.
        steps: Int64 [rows], steps since `begin`.
        returns: Float64 [rows, episodes], sums of rewards so far.
    """

    def __init__(
        self, rows: Rows, name: str, label: Callable[[int], str] = "row {}".format
    ) -> None:
        """Take rows.

        Args:
            rows: The environments.
            name: What messages call the environment.
            label: What they call a row.
        """
        self._rows, self._name, self._label = rows, name, label

    def begin(self, seeds: ArrayLike) -> None:
        """Begin the first episode of every row.

        Args:
            seeds: Int64 [rows, episodes]: that of each row's episodes.
        """
        self.seeds = np.asarray(seeds, np.int64)
        rows = len(self.seeds)
        self.reward, self.returns = np.zeros(rows), np.zeros(self.seeds.shape)
        self.terminated, self.truncated = np.zeros(rows, bool), np.zeros(rows, bool)
        self.living = np.ones(rows, bool)
        self.episode, self.step_count = np.zeros(rows, np.int64), np.zeros(rows, np.int64)
        self.steps = np.zeros(rows, np.int64)
        self.observation = self._reset(self.living)

    def go_on(self, mask: Mask) -> None:
        """Let the rows of a mask begin their next episode, or stand idle if it was the last."""
        last = self.episode == self.seeds.shape[1] - 1
        self.living = self.living & ~(mask & last)
        self.episode = self.episode + (mask & ~last)
        self.terminated, self.truncated = self.terminated & ~mask, self.truncated & ~mask
        following = mask & ~last
        if following.any():
            self.step_count = np.where(following, 0, self.step_count)
            fresh = self._reset(following)
            self.observation = np.where(following[:, None], fresh, self.observation)

    def step(self, actions: np.ndarray) -> None:
        """Step the living rows with actions [rows, actions]."""
        living = self.living
        try:
            observation, reward, terminated, truncated = self._rows.step(living, actions)
        except _RowError as error:
            self._fail(error.row, str(error), error)
        self.step_count, self.steps = self.step_count + living, self.steps + living
        self._check(living, observation, reward)
        self.observation = np.where(living[:, None], observation, self.observation)
        self.reward = np.where(living, reward, 0.0)
        self.terminated, self.truncated = terminated & living, truncated & living
        self.returns[np.arange(len(living)), self.episode] += self.reward

    def _reset(self, mask: Mask) -> np.ndarray:
        seeds = self.seeds[np.arange(len(mask)), self.episode]
        try:
            observation = self._rows.reset(mask, seeds)
        except _RowError as error:
            self._fail(error.row, str(error), error)
        self._check(mask, observation, np.zeros(len(mask)))
        return observation

    def _check(self, mask: Mask, observation: np.ndarray, reward: np.ndarray) -> None:
        bad = mask & ~(np.isfinite(observation).all(1) & np.isfinite(reward))
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            values = f"observation {observation[row].tolist()}, reward {reward[row]}"
            self._fail(row, f"expected finite numbers, got {values}", None)

    def _fail(self, row: int, message: str, cause: Exception | None) -> NoReturn:
        episode, steps = int(self.episode[row]), int(self.step_count[row])
        raise EpisodeError(
            f"{self._name}: {self._label(row)} failed in episode {episode} with seed "
            f"{self.seeds[row, episode]}, after {steps} steps: {message}"
        ) from cause
