"""The training field of NERO as a TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torchrl.data import Bounded, Unbounded

from neatq_envs.nero.scenario import NeroScenario, Stage
from neatq_envs.nero.state import TeamBrains
from neatq_envs.nero.training import MEASURES, Rounds, TrainingField
from neatq_envs.torchrl_env import (
    DONE,
    OBSERVATION,
    POSE,
    REWARD_VECTOR,
    STEP_COUNT,
    TERMINATED,
    TRUNCATED,
    FieldEnv,
    single,
)

MEASURE = "measures"


class NeroEnv(FieldEnv):
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
        rounds: Draws enemies round after round instead; see `TrainingField`.
    """

    def __init__(
        self,
        stages: NeroScenario | Sequence[Stage],
        *,
        arenas: int = 1,
        seed: int = 0,
        enemies: tuple[TeamBrains, int] | None = None,
        rounds: Rounds | None = None,
    ) -> None:
        if isinstance(stages, NeroScenario):
            stages = (Stage(scenario=stages),)
        robots = stages[0].scenario.robots
        super().__init__(device=None, batch_size=torch.Size([arenas, robots]))
        self._stages, self._enemies, self._rounds = tuple(stages), enemies, rounds
        self.arena: TrainingField = self._make(range(seed, seed + arenas))
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

    def _make(self, seeds: range) -> TrainingField:
        return TrainingField(self._stages, seeds, self._enemies, self._rounds)

    def rebuild(self) -> None:
        """Do nothing: the arrays are all that the worlds are."""

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
