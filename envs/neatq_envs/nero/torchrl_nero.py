"""The training field of NERO as a TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Bounded, Unbounded

from neatq_envs.nero.scenario import NeroScenario, Stage
from neatq_envs.nero.state import TeamBrains
from neatq_envs.nero.training import MEASURES, TrainingField
from neatq_envs.torchrl_env import (
    DONE,
    OBSERVATION,
    POSE,
    REWARD_VECTOR,
    STEP_COUNT,
    TERMINATED,
    TRUNCATED,
    RowsEnv,
    single,
)

MEASURE = "measures"


class NeroEnv(RowsEnv):
    """Robots that learn to fight, as one TorchRL environment of [arenas, robots] rows.

    Each arena is a field with a team of learners, turrets, and perhaps a team that does not learn;
    arena e has the seed `seed + e` and is, bit for bit, that of an environment of one arena.

    * `observation` [arenas, robots, observations], float32 in [0, 1]; see `kernels.sense`.
    * `action` [.., actions] in physical units, clipped: speed (units per tick), turn (rad per tick,
      before the move), and fire and ignore_friends (0..1) where the sensors' robots have them.
    * `reward` [.., 1] in [0, 1] and `reward_vector` [.., 6]; see `TrainingField`.
    * `measures` [.., 6], see `MEASURES`; `pose` [.., 3] = x, y (units), heading (rad);
      `step_count` [.., 1] = age of the life in ticks.
    * `terminated`: the robot died; `truncated`: its life reached `lifetime_ticks`. Either way it
      begins anew at its spawn. `reset()` without a mask makes new worlds, but returns restored
      ones after `load_world_state`.

    Args:
        stages: The field, or fields one after the other; see `TrainingField`.
        arenas: How many.
        seed: That of arena 0.
        enemies: Networks of the enemies of one arena, and how many there are.
    """

    def __init__(
        self,
        stages: NeroScenario | Sequence[Stage],
        *,
        arenas: int = 1,
        seed: int = 0,
        enemies: tuple[TeamBrains, int] | None = None,
    ) -> None:
        if isinstance(stages, NeroScenario):
            stages = (Stage(scenario=stages),)
        robots = stages[0].scenario.robots
        super().__init__(device=None, batch_size=torch.Size([arenas, robots]))
        self._stages, self._enemies = tuple(stages), enemies
        self.arena = TrainingField(self._stages, range(seed, seed + arenas), enemies)
        self._restored = False
        inputs = self._size(self.arena.observation.shape[-1])
        observed = {
            OBSERVATION: Bounded(0.0, 1.0, shape=inputs, dtype=torch.float32),
            REWARD_VECTOR: Unbounded(shape=self._size(self.arena.reward_vector.shape[-1])),
            MEASURE: Unbounded(shape=self._size(len(MEASURES))),
            POSE: Unbounded(shape=self._size(3)),
            STEP_COUNT: self._count(),
        }
        reward = Bounded(0.0, 1.0, shape=self._size(1), dtype=torch.float32)
        self._declare(self.arena.bounds, observed, reward)

    def world_state(self) -> dict[str, Any]:
        """The worlds as nested dicts of numpy arrays and JSON values."""
        return self.arena.world_state()

    def load_world_state(self, state: dict[str, Any]) -> None:
        """Restore worlds; `reset()` without a mask then returns them until the next step."""
        self.arena.load_world_state(state)
        self._restored = True

    def rebuild(self) -> None:
        """Do nothing: the arrays are all that the worlds are."""

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is not None:
            self.arena.respawn(mask.reshape(self.batch_size).numpy())
        elif not self._restored:
            self.arena.reset()
        return self._tensordict(self._observe())

    def _act(self, actions: np.ndarray) -> torch.Tensor:
        self._restored = False
        self.arena.step(actions)
        return single(self.arena.reward[..., None])

    def _observe(self) -> dict[str, torch.Tensor]:
        field = self.arena
        ends = field.terminated[..., None], field.truncated[..., None]
        return {
            OBSERVATION: torch.from_numpy(field.observation),
            REWARD_VECTOR: single(field.reward_vector),
            MEASURE: single(field.measures),
            POSE: single(field.pose),
            STEP_COUNT: torch.from_numpy(field.age_ticks[..., None]),
            DONE: torch.from_numpy(ends[0] | ends[1]),
            TERMINATED: torch.from_numpy(ends[0].copy()),
            TRUNCATED: torch.from_numpy(ends[1].copy()),
        }

    def _set_seed(self, seed: int | None) -> None:
        first = 0 if seed is None else seed
        seeds: Sequence[int] = range(first, first + self.batch_size[0])
        self.arena = TrainingField(self._stages, seeds, self._enemies)
        self._restored = False
