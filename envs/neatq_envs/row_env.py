"""Tasks of independent rows as Gymnasium environments: one class for one row, one for many.

A task says how rows start, step and are observed, in plain numpy. Both classes below run the same
task with the same calls, so row i of the many, reset with seed s, is bit for bit the environment
of one row reset with seed s.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space


class RowTask(Protocol):
    """A task whose rows do not influence each other."""

    @property
    def observation_space(self) -> Box:
        """The space of the observations of one row, float32."""
        ...

    @property
    def action_space(self) -> Box | Discrete:
        """The space of the actions of one row."""
        ...

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Return the state [...] that a row begins an episode with; draw nothing later."""
        ...

    def step(self, state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step all rows, in place.

        Args:
            state: [rows, ...]; written.
            actions: [rows] if discrete, else [rows, actions].

        Returns:
            Rewards, float64 [rows], and whether episodes are over, bool [rows].
        """
        ...

    def observe(self, state: np.ndarray) -> np.ndarray:
        """Return new observations, float32 [rows, observations]."""
        ...


class RowEnv(gymnasium.Env[np.ndarray, Any]):
    """One row of a task. `gymnasium.make` puts the limit of time around it."""

    metadata = {"render_modes": []}  # noqa: RUF012  (Gymnasium's type)

    def __init__(self, task: RowTask) -> None:
        self._task = task
        self.observation_space, self.action_space = task.observation_space, task.action_space
        self._state = np.empty(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; there are no options."""
        super().reset(seed=seed)
        self._state = self._task.start(self.np_random)[None]
        return self._task.observe(self._state)[0], {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Return observation, reward, terminated, truncated (never) and an empty dictionary."""
        reward, terminated = self._task.step(self._state, np.asarray(action)[None])
        observation = self._task.observe(self._state)[0]
        return observation, float(reward[0]), bool(terminated[0]), False, {}


class RowVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many rows of a task, stepped by one compiled call.

    Episodes do not begin by themselves (`AutoresetMode.DISABLED`): a finished row stands still
    until it is reset with `options={"reset_mask": bool [rows]}`. For the other modes, wrap the
    single environment: `make_vec(..., vectorization_mode="sync")`.
    """

    def __init__(self, task: RowTask, num_envs: int, max_episode_steps: int | None) -> None:
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.DISABLED}
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
        self.single_observation_space = task.observation_space
        self.single_action_space = task.action_space
        self.observation_space = batch_space(task.observation_space, num_envs)
        self.action_space = batch_space(task.action_space, num_envs)
        self._task = task
        self._generators = [seeding.np_random()[0] for _ in range(num_envs)]
        self._state = np.empty(0)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._finished = np.zeros(num_envs, dtype=bool)
        self._terminated = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: one for each row; None goes on with the row's random numbers. A number s means
                s, s + 1, and so on.
            options: `reset_mask`, bool [rows]: the rows to reset; all others stay as they are.

        Returns:
            Observations of all rows, float32 [rows, observations], and an empty dictionary.
        """
        seeds, mask = row_seeds(seed, self.num_envs), self._mask(options)
        starts = {row: self._begin(row, seeds[row]) for row in np.flatnonzero(mask).tolist()}
        if len(starts) == self.num_envs:
            self._state = np.stack(list(starts.values()))
        else:
            for row, state in starts.items():
                self._state[row] = state
        self._steps[mask], self._finished[mask], self._terminated[mask] = 0, False, False
        return self._task.observe(self._state), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Return observations, rewards, terminated, truncated, and an empty dictionary.

        Finished rows stand still: they have no reward, and their episodes remain over.
        """
        running, limit = ~self._finished, self.max_episode_steps
        reward = np.zeros(self.num_envs)
        reward[running], self._terminated[running] = self._step_rows(running, np.asarray(actions))
        self._steps += running
        truncated = self._steps >= limit if limit else np.zeros(self.num_envs, dtype=bool)
        self._finished = self._terminated | truncated
        return self._task.observe(self._state), reward, self._terminated.copy(), truncated, {}

    def _step_rows(self, running: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if running.all():
            return self._task.step(self._state, actions)
        state = self._state[running]
        reward, terminated = self._task.step(state, actions[running])
        self._state[running] = state
        return reward, terminated

    def _begin(self, row: int, seed: int | None) -> np.ndarray:
        if seed is not None:
            self._generators[row] = seeding.np_random(int(seed))[0]
        return self._task.start(self._generators[row])

    def _mask(self, options: dict[str, Any] | None) -> np.ndarray:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ValueError(
                f"reset_mask: expected bool [{self.num_envs}], got {mask.dtype} {list(mask.shape)}"
            )
        if len(self._state) == 0:
            raise ValueError("reset_mask: the first reset must be of all rows; leave the mask out")
        return mask


def row_seeds(seed: int | Sequence[int | None] | None, rows: int) -> Sequence[int | None]:
    """Return one seed for each row: a number s means s, s + 1, and so on."""
    if seed is None:
        return [None] * rows
    if isinstance(seed, int | np.integer):
        return range(int(seed), int(seed) + rows)
    if len(seed) != rows:
        raise ValueError(f"seed: expected one for each of {rows} rows, got {len(seed)}")
    return seed
