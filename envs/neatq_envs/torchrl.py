"""The arena as a TorchRL environment: specs and TensorDict keys, declared once."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded

from neatq_envs.arena import Arena
from neatq_envs.scenario import REWARD_DIMENSIONS, Scenario
from neatq_envs.torchrl_steps import ACTION, DONE, REWARD, RowsEnv, single

OBSERVATION = "observation"
REWARD_VECTOR = "reward_vector"
DISTANCE = "distance"
POSE = "pose"
STEP_COUNT = "step_count"
TERMINATED = "terminated"
TRUNCATED = "truncated"


class ArenaEnv(RowsEnv):
    """Robots that learn to reach a flag, as one TorchRL environment of [arenas, robots] rows.

    ## Description
    Each arena is a walled field with robots, walls and a flag. Each robot is a row of its own
    with its own `done`; the robots of an arena share its world. Arena e has the seed `seed + e`
    and is, bit for bit, the arena of an environment of one arena with that seed.

    ## Observation space
    `observation`, float32 [arenas, robots, observations]. With sensors "arena" (`arena-1`):

    | index | name | range | meaning |
    | --- | --- | --- | --- |
    | 0-4 | wall_left_90, wall_left_45, wall_ahead, wall_right_45, wall_right_90 | 0..1 | \
min(1, 5 / distance in units) along a ray of 50 units; 0 = no wall |
    | 5-9 | flag_left (12..90 degrees), flag_ahead_left (-3..18), flag_ahead_right (-18..3), \
flag_right (-90..-12), flag_rear (87 and more) | 0..1 | min(1, 30 / distance in units) if the flag \
is in the sector and within 300 units |
    | 10 | friend_proximity | 0..1 | 1 - d / 15 units to the middle of the robots within 15 units, \
itself included |
    | 11 | friend_direction | 0..1 | angle to it, to the left, (degrees + 180) / 360 |

    With sensors "opennero" (`opennero-2014`): 0-9 as above, 10-14 enemy radar (always 0),
    15 friend_proximity, 16 friend_direction, 17 unused (always 0).

    Where two flags stand (`switch_ticks`), both are sensed and nothing tells which one counts.
    Flag sensors are those of the first; second_flag_left and so on, alike, are 12-16 of "arena"
    (`arena-1-two-flags`) and 10-14 of "opennero" (`opennero-2014-two-flags`).

    Beside it: `distance` [.., 1] to the flag that counts (units, float32), `pose` [.., 3] = x, y
    (units), heading (rad), float32, `step_count` [.., 1] = age of the life (ticks, int64), and
    `reward_vector` [.., 3] of the last tick (float32, 0 at the beginning of a life).

    ## Action space
    `action`, float32 [arenas, robots, actions] in physical units, clipped to the bounds:

    | index | name | range | unit |
    | --- | --- | --- | --- |
    | 0 | speed | -max_speed..max_speed | units per tick, along the heading |
    | 1 | turn | -max_turn_rad..max_turn_rad | rad per tick, before the move |
    | 2 | fire ("opennero" only) | 0..1 | no effect: there are no enemies |
    | 3 | ignore_friends ("opennero" only) | 0..1 | above 0.5: indices 15 and 16 are 0 next |

    ## Rewards
    `reward` [.., 1] in [0, 1] is the weighted reward for learning, `reward_vector` holds
    (stand_ground, stick_together, approach_flag) for evolution; see `neatq_envs.rewards`.

    ## Starting state
    A robot begins each life at its spawn, moved by a whole number of units in each axis, with a
    heading of 0 to 359 whole degrees. `reset()` without a mask makes new worlds; with a mask,
    even one that is true everywhere, it respawns those robots only and the world goes on: the
    other rows keep what they observed at the end of the last tick. After `load_world_state`,
    until the next step, `reset()` without a mask returns the restored worlds instead of new ones.

    ## Episode end
    A life is `truncated` when its age reaches `lifetime_ticks`. It is never `terminated`.

    Args:
        scenario: the world.
        arenas: how many arenas are stepped together.
        seed: of arena 0.
    """

    seen = (OBSERVATION, REWARD_VECTOR, DISTANCE, POSE, STEP_COUNT, DONE, TERMINATED, TRUNCATED)

    def __init__(self, scenario: Scenario, *, arenas: int = 1, seed: int = 0) -> None:
        super().__init__(device=None, batch_size=torch.Size([arenas, scenario.robots]))
        self.scenario = scenario
        self.arena = Arena(scenario, range(seed, seed + arenas))
        self._restored = False
        self._make_specs()

    def world_state(self) -> dict[str, Any]:
        """Return the worlds as nested dicts of numpy arrays and JSON values.

        The run continues bit for bit if `rebuild` is called at this tick, too.
        """
        return self.arena.world_state()

    def load_world_state(self, state: dict[str, Any]) -> None:
        """Restore worlds; `reset()` without a mask then returns them until the next step."""
        self.arena.load_world_state(state)
        self._restored = True

    def rebuild(self) -> None:
        """Rebuild the physics from the arrays; see `Arena.rebuild`."""
        self.arena.rebuild()

    def _make_specs(self) -> None:
        schema = self.arena.schema
        low, high = (torch.from_numpy(b) for b in schema.action_bounds(self.scenario))
        size = self._size(len(schema.actions))
        self.action_spec = Bounded(low.expand(size), high.expand(size), dtype=torch.float32)
        seen, one = self._size(len(schema.observations)), self._size(1)
        self.observation_spec = Composite(
            {
                OBSERVATION: Bounded(0.0, 1.0, shape=seen, dtype=torch.float32),
                REWARD_VECTOR: Unbounded(shape=self._size(len(REWARD_DIMENSIONS))),
                DISTANCE: Unbounded(shape=one),
                POSE: Unbounded(shape=self._size(3)),
                STEP_COUNT: Unbounded(shape=one, dtype=torch.int64),
            },
            shape=self.batch_size,
        )
        self.reward_spec = Bounded(0.0, 1.0, shape=one, dtype=torch.float32)
        done = Categorical(2, shape=one, dtype=torch.bool)
        ends = {DONE: done, TERMINATED: done.clone(), TRUNCATED: done.clone()}
        self.full_done_spec = Composite(ends, shape=self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is not None:
            self.arena.respawn(mask.reshape(self.batch_size).numpy())
        elif not self._restored:
            self.arena.reset()
        return self._tensordict(self._observe())

    def _advance(self, tensordict: TensorDictBase) -> dict[str, torch.Tensor]:
        self._restored = False
        self.arena.step(tensordict.get(ACTION).detach().numpy())
        values = self._observe()
        values[REWARD] = single(self.arena.reward[..., None])
        return values

    def _observe(self) -> dict[str, torch.Tensor]:
        # The arena replaces its arrays and never writes into them: those of the right type are
        # handed out without a copy.
        arena = self.arena
        pose = np.empty((*arena.shape, 3), dtype=np.float32)
        pose[..., :2] = arena.position
        pose[..., 2] = arena.heading_rad
        truncated = arena.truncated[..., None]
        return {
            OBSERVATION: torch.from_numpy(arena.observation),
            REWARD_VECTOR: single(arena.reward_vector),
            DISTANCE: single(arena.distance[..., None]),
            POSE: torch.from_numpy(pose),
            STEP_COUNT: torch.from_numpy(arena.age_ticks[..., None]),
            DONE: torch.from_numpy(truncated),
            TERMINATED: torch.from_numpy(np.zeros_like(truncated)),
            TRUNCATED: torch.from_numpy(truncated.copy()),
        }

    def _set_seed(self, seed: int | None) -> None:
        first = 0 if seed is None else seed
        self.arena = Arena(self.scenario, range(first, first + self.batch_size[0]))
        self._restored = False
