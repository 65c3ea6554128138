"""A Gymnasium environment many times side by side: row i has an environment of its own."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Any, NoReturn, Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from neatq_envs.gymnasium_task import GymnasiumTask, Interface
from neatq_envs.processes import Remote


class RowError(Exception):
    """The environment of a row failed; the message says how."""

    def __init__(self, row: int, message: str) -> None:
        super().__init__(row, message)  # all arguments, so that it can be sent
        self.row, self.message = row, message


Mask = NDArray[np.bool_]
Step = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Observations [rows, inputs], rewards, terminated and truncated [rows]; of others, anything."""


class EnvRows(Protocol):
    """Environments side by side."""

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask; observations [rows, inputs], theirs count."""
        ...

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step the rows of a mask with actions [rows, actions]."""
        ...

    def close(self) -> None:
        """Close the environments, for good."""
        ...


class SingleRows:
    """An environment for each row, made by `gymnasium.make`; only rows that are meant are called.

    Args:
        task: The environment.
        interface: How it is read.
        renewed: Make a new environment for every episode. Some (BipedalWalker-v3) keep something
            from the episode before that no seed covers.
    """

    def __init__(self, task: GymnasiumTask, interface: Interface, renewed: bool = False) -> None:
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
                seen, rewards[row], terminated[row], truncated[row], _ = envs[row].step(own[row])
                observations[row] = read(seen)
        except Exception as error:
            _raise_for(row, error)
        return observations, rewards, terminated, truncated

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs:
            env.close()


class DealtRows:
    """Rows dealt to processes, with a `SingleRows` in each; a step is one message to and fro.

    Rows that stand together live together. Arguments are those of `SingleRows`, and the number of
    processes.
    """

    def __init__(
        self, task: GymnasiumTask, interface: Interface, *, renewed: bool, workers: int
    ) -> None:
        self._remotes = [Remote(SingleRows, task, interface, renewed) for _ in range(workers)]

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask."""
        return np.concatenate(self._all("reset", mask, seeds))

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step the rows of a mask."""
        observations, *others = zip(*self._all("step", mask, actions), strict=True)
        rewards, terminated, truncated = (np.concatenate(each) for each in others)
        return np.concatenate(observations), rewards, terminated, truncated

    def close(self) -> None:
        """End the processes."""
        for remote in self._remotes:
            remote.close()

    def _all(self, method: str, mask: Mask, values: np.ndarray) -> list[Any]:
        """What a method of each process returns for its part of the rows.

        After an error the processes are closed: what some of them have begun is not known.
        """
        parts = len(self._remotes)
        masks, shares = np.array_split(mask, parts), np.array_split(values, parts)
        answers, first = [], 0
        try:
            for remote, own, share in zip(self._remotes, masks, shares, strict=True):
                remote.ask(method, own, share)
            for remote, own in zip(self._remotes, masks, strict=True):
                answers.append(remote.answer())
                first += len(own)
            return answers
        except Exception as error:
            self.close()
            if isinstance(error, RowError):
                raise RowError(first + error.row, error.message) from error
            raise


class VectorRows:
    """The vectorised environment that an id brings; rows that are not meant take a zero action."""

    def __init__(self, task: GymnasiumTask, interface: Interface) -> None:
        self._task, self._interface = task, interface
        self._env: VectorEnv[Any, Any, Any] | None = None

    @staticmethod
    def of(task: GymnasiumTask, interface: Interface) -> VectorRows | None:
        """The rows of a task whose vectorised environment resets rows by mask and seed.

        None if the id brings no such environment.
        """
        if task.spec().vector_entry_point is None:
            return None
        rows = VectorRows(task, interface)
        try:
            env = rows._make(2)
            if env.metadata.get("autoreset_mode") != AutoresetMode.DISABLED:
                return None
            seeds: Any = [1, 2]
            env.reset(seed=seeds)
            env.reset(seed=seeds, options={"reset_mask": np.array([True, False])})
        except Exception:  # whatever it objects to, single environments will do
            return None
        return rows

    def _make(self, rows: int) -> VectorEnv[Any, Any, Any]:
        mode = "vector_entry_point"
        return gymnasium.make_vec(self._task.id, rows, vectorization_mode=mode, **self._task.kwargs)

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask."""
        each: Any = seeds.tolist()  # Gymnasium's annotation forgets that there may be several
        options: dict[str, Any] | None = {"reset_mask": mask}
        if self._env is None or self._env.num_envs != len(mask):
            self._env, options = self._make(len(mask)), None
        observations, _ = self._env.reset(seed=each, options=options)
        return self._read(observations)

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step all rows."""
        assert self._env is not None
        own = np.asarray(self._interface.act(np.where(mask[:, None], actions, 0)))
        observations, rewards, terminated, truncated, _ = self._env.step(own)
        rewards = np.asarray(rewards, np.float64)
        return self._read(observations), rewards, np.asarray(terminated), np.asarray(truncated)

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            self._env.close()

    def _read(self, observations: Any) -> np.ndarray:
        if isinstance(self._interface.observation, gymnasium.spaces.Discrete):
            place = np.asarray(observations) - int(self._interface.observation.start)
            return np.eye(self._interface.inputs)[place]
        return np.asarray(observations, np.float64).reshape(len(observations), -1)


def make_rows(
    task: GymnasiumTask, *, renewed: bool = False, workers: int = 1
) -> tuple[EnvRows, Interface]:
    """The rows of a task and their interface, or a `TaskError`.

    Args:
        task: The environment.
        renewed: Make a new environment for every episode; see `SingleRows`.
        workers: Processes that the rows are dealt to, 1: none but this one. A vectorised
            environment stays in this one. The results are the same.
    """
    env = task.make()
    interface = Interface.of(env, task.id)
    env.close()
    vector = None if renewed else VectorRows.of(task, interface)
    if vector is None and workers > 1:
        return DealtRows(task, interface, renewed=renewed, workers=workers), interface
    return vector or SingleRows(task, interface, renewed), interface


def _raise_for(row: int, error: Exception) -> NoReturn:
    where = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(where.filename).name}:{where.lineno}"
    raise RowError(row, f"{type(error).__name__}: {error} ({place})") from error
