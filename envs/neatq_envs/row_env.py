"""Tasks of independent rows as Gymnasium environments: one class for one row, one for many.

Both run the same task with the same calls, so row i of the many, reset with seed s, is bit for bit
the environment of one row reset with seed s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Protocol

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space


class RowTask(Protocol):
    """A task whose rows do not influence each other, in plain numpy."""

    @property
    def observation_space(self) -> Box:
        """Of one row, float32."""
        ...

    @property
    def action_space(self) -> Box | Discrete:
        """Of one row."""
        ...

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """The state [...] that a row begins an episode with; draw nothing later."""
        ...

    def step(self, state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step all rows; `state` [rows, ...] is written, actions are [rows] or [rows, actions].

        Returns rewards, float64 [rows], and whether episodes are over, bool [rows].
        """
        ...

    def observe(self, state: np.ndarray) -> np.ndarray:
        """New observations, float32 [rows, observations]."""
        ...


class RowEnv(gymnasium.Env[np.ndarray, Any]):
    """One row of a task with its settings. `gymnasium.make` puts the limit of time around it."""

    metadata = {"render_modes": []}  # noqa: RUF012  (Gymnasium's type)
    task: ClassVar[Callable[..., RowTask]]

    def __init__(self, **settings: Any) -> None:
        self._task = type(self).task(**settings)
        self.observation_space = self._task.observation_space
        self.action_space = self._task.action_space
        self._state = np.empty(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; there are no options."""
        super().reset(seed=seed)
        self._state = self._task.start(self.np_random)[None]
        return self._task.observe(self._state)[0], {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated (never) and an empty dictionary."""
        reward, terminated = self._task.step(self._state, np.asarray(action)[None])
        observation = self._task.observe(self._state)[0]
        return observation, float(reward[0]), bool(terminated[0]), False, {}


class VectorRowEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Rows whose episodes do not begin by themselves (`AutoresetMode.DISABLED`).

    A finished row is reset with `options={"reset_mask": bool [rows]}`; all others stay as they
    are. The first reset is of all rows. `seed` is one for each row; None goes on with the row's
    random numbers, and a number s means s, s + 1, and so on. For other modes, and for pictures,
    wrap the single environment: `gymnasium.make_vec(..., vectorization_mode="sync")`.
    """

    def __init__(self, num_envs: int, observation_space: Box, action_space: Box | Discrete) -> None:
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.DISABLED}
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = observation_space, action_space
        self.observation_space = batch_space(observation_space, num_envs)
        self.action_space = batch_space(action_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes: observations of all rows, float32 [rows, observations], and infos."""
        rows = self.num_envs
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else int(seed) + row for row in range(rows)]
        if len(seed) != rows:
            raise ValueError(f"seed: expected one for each of {rows} rows, got {len(seed)}")
        mask = (options or {}).get("reset_mask")
        if mask is not None and (mask.shape != (rows,) or mask.dtype != bool):
            words = f"expected bool [{rows}], got {mask.dtype} {list(mask.shape)}"
            raise ValueError(f"reset_mask: {words}")
        return self._reset(seed, mask)

    def _reset(
        self, seeds: Sequence[int | None], mask: np.ndarray | None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Do `reset` for the rows of a mask, or for all; `seeds` holds one for each row."""
        raise NotImplementedError


class RowVectorEnv(VectorRowEnv):
    """Many rows of a task with its settings, stepped by one call; a finished row stands still.

    Episodes are truncated after `max_episode_steps`; None: never.
    """

    task: ClassVar[Callable[..., RowTask]]

    def __init__(
        self, num_envs: int = 1, max_episode_steps: int | None = None, **settings: Any
    ) -> None:
        self._task = task = type(self).task(**settings)
        super().__init__(num_envs, task.observation_space, task.action_space)
        self.max_episode_steps = max_episode_steps
        self._generators = [seeding.np_random()[0] for _ in range(num_envs)]
        self._state = np.empty(0)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._finished = np.zeros(num_envs, dtype=bool)
        self._terminated = np.zeros(num_envs, dtype=bool)

    def _reset(
        self, seeds: Sequence[int | None], mask: np.ndarray | None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        if mask is None:
            mask = np.ones(self.num_envs, dtype=bool)
        elif not len(self._state):
            raise ValueError("reset_mask: the first reset must be of all rows; leave the mask out")
        for row in np.flatnonzero(mask).tolist():
            if (seed := seeds[row]) is not None:
                self._generators[row] = seeding.np_random(int(seed))[0]
            start = self._task.start(self._generators[row])
            if not len(self._state):
                self._state = np.empty((self.num_envs, *start.shape), start.dtype)
            self._state[row] = start
        self._steps[mask], self._finished[mask], self._terminated[mask] = 0, False, False
        return self._task.observe(self._state), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all rows; finished ones have no reward, and their episodes remain over."""
        running, limit = ~self._finished, self.max_episode_steps
        actions, reward, state = np.asarray(actions), np.zeros(self.num_envs), self._state
        if not running.all():
            actions, state = actions[running], state[running]
        reward[running], self._terminated[running] = self._task.step(state, actions)
        self._state[running] = state
        self._steps += running
        truncated = self._steps >= limit if limit else np.zeros(self.num_envs, dtype=bool)
        self._finished = self._terminated | truncated
        return self._task.observe(self._state), reward, self._terminated.copy(), truncated, {}
