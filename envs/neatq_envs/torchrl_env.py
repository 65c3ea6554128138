"""The arena as a TorchRL environment, and the quick steps of all environments of many rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from neatq_envs.arena import Arena
from neatq_envs.scenario import REWARD_DIMENSIONS, Scenario

ACTION, OBSERVATION, REWARD, REWARD_VECTOR = "action", "observation", "reward", "reward_vector"
DISTANCE, POSE, STEP_COUNT = "distance", "pose", "step_count"
DONE, TERMINATED, TRUNCATED = "done", "terminated", "truncated"


class RowsEnv(EnvBase):
    """Rows, each with its own `done`; sub-classes call `_declare`, give `_observe` and `_act`."""

    def _declare(
        self, bounds: Sequence[ArrayLike], observed: Mapping[str, TensorSpec], reward: TensorSpec
    ) -> None:
        """Make the specs: of actions [actions] within bounds, and of the reward.

        `observed` is what every step and every reset bring up to date, besides the ends.
        """
        low, high = (torch.from_numpy(np.array(bound, np.float32)) for bound in bounds)
        size = self._size(len(low))
        self.action_spec = Bounded(low.expand(size), high.expand(size), dtype=torch.float32)
        self.observation_spec = Composite(dict(observed), shape=self.batch_size)
        self.reward_spec = reward
        ends = {name: self._truth() for name in (DONE, TERMINATED, TRUNCATED)}
        self.full_done_spec = Composite(ends, shape=self.batch_size)
        self._outdated = {*observed, *ends, REWARD, "next"}

    def _observe(self) -> dict[str, torch.Tensor]:
        """What is observed now, and the ends."""
        raise NotImplementedError

    def _act(self, actions: np.ndarray) -> torch.Tensor:
        """Step with actions [arenas, rows, actions]; returns the reward."""
        raise NotImplementedError

    def _advance(self, tensordict: TensorDictBase) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        reward = self._act(tensordict.get(ACTION).detach().numpy())
        return self._observe(), reward

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        values, reward = self._advance(tensordict)
        return self._tensordict({**values, REWARD: reward})

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """Do what `EnvBase.step_and_maybe_reset` does, without looking up which keys go where.

        The next root has all entries of this one but the reward, with what is observed brought up
        to date. Steps that need more than that are left to TorchRL.
        """
        if not self._is_plain(tensordict):
            return super().step_and_maybe_reset(tensordict)
        values, reward = self._advance(tensordict)
        outdated = self._outdated
        root = {key: _carried(value) for key, value in tensordict.items() if key not in outdated}
        upcoming = self._tensordict({**root, **values})
        values[REWARD] = reward
        preset = tensordict.get("next", None)
        if preset is not None:
            values = {**dict(preset.items()), **values}
        tensordict.set("next", self._tensordict(values))
        return tensordict, self.maybe_reset(upcoming) if values[DONE].any() else upcoming

    def _is_plain(self, tensordict: TensorDictBase) -> bool:
        """Whether a step needs nothing but the ordinary."""
        return (
            type(tensordict) is TensorDict
            and tensordict.batch_size == self.batch_size
            and tensordict.device is None
            and not any(tensordict.names)
            and "_step" not in tensordict
            and "_reset" not in tensordict
            and self._post_step_mdp_hooks is None
            and "_compiled_step_and_maybe_reset" not in self.__dict__
        )

    def _tensordict(self, values: dict[str, Any]) -> TensorDict:
        # The public constructor takes eight times as long: it checks what is right by making.
        return TensorDict._new_unsafe(values, self.batch_size)

    def _size(self, features: int) -> torch.Size:
        return torch.Size([*self.batch_size, features])

    def _truth(self) -> Categorical:
        return Categorical(2, shape=self._size(1), dtype=torch.bool)

    def _count(self) -> Unbounded:
        return Unbounded(shape=self._size(1), dtype=torch.int64)


class FieldEnv(RowsEnv):
    """Rows that are robots on fields; sub-classes give `_make` and `_observe`.

    Attributes:
        arena: The fields, as `_make` gives them: `reset`, `respawn` (of a mask), `step`, `reward`
            [arenas, robots], `world_state` and `load_world_state`.
    """

    arena: Any
    _restored = False

    def _make(self, seeds: range) -> Any:
        """The fields of seeds, one for each arena."""
        raise NotImplementedError

    def world_state(self) -> dict[str, Any]:
        """The worlds as nested dicts of numpy arrays and JSON values."""
        return self.arena.world_state()

    def load_world_state(self, state: dict[str, Any]) -> None:
        """Restore worlds; `reset()` without a mask then returns them until the next step."""
        self.arena.load_world_state(state)
        self._restored = True

    def change(self, scenario: Any) -> None:
        """Let the worlds go on in another scenario, until it is another again.

        As after `load_world_state`, `reset()` returns them as they are until the next step.
        """
        self.arena.change(scenario)
        self._restored = True

    def begin_lives(self, mask: np.ndarray) -> None:
        """Begin the lives of a mask, bool [arenas, robots], anew; then `reset()` as in `change`."""
        self.arena.respawn(mask)
        self._restored = True

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

    def _set_seed(self, seed: int | None) -> None:
        first = 0 if seed is None else seed
        self.arena = self._make(range(first, first + self.batch_size[0]))
        self._restored = False


class ArenaEnv(FieldEnv):
    """Robots that learn to reach a flag, as one TorchRL environment of [arenas, robots] rows.

    ## Description
    Each arena is a walled field with robots, walls and a flag, and each robot a row with its own
    `done`. Arena e has the seed `seed + e` and is, bit for bit, the arena of an environment of one
    arena with that seed.

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
    (`arena-1-two-flags`) and 10-14 of "opennero" (`opennero-2014-two-flags`). With sensors
    "arena-feedback", which are those of "arena" elsewhere, last_reward follows as index 17
    (`arena-1-feedback-two-flags`): `reward` of the tick before, 0.5 at the beginning of a life, by
    which a robot can tell within its life what counts (compare Duan et al. 2016).

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

    `seed` is that of arena 0.
    """

    def __init__(self, scenario: Scenario, *, arenas: int = 1, seed: int = 0) -> None:
        super().__init__(device=None, batch_size=torch.Size([arenas, scenario.robots]))
        self.arena = Arena(scenario, range(seed, seed + arenas))
        schema = self.arena.schema
        inputs = self._size(len(schema.observations))
        observed = {
            OBSERVATION: Bounded(0.0, 1.0, shape=inputs, dtype=torch.float32),
            REWARD_VECTOR: Unbounded(shape=self._size(len(REWARD_DIMENSIONS))),
            DISTANCE: Unbounded(shape=self._size(1)),
            POSE: Unbounded(shape=self._size(3)),
            STEP_COUNT: self._count(),
        }
        reward = Bounded(0.0, 1.0, shape=self._size(1), dtype=torch.float32)
        self._declare(schema.action_bounds(scenario), observed, reward)

    @property
    def scenario(self) -> Scenario:
        """That in which all arenas are."""
        return self.arena.scenario

    def _make(self, seeds: range) -> Arena:
        return Arena(self.scenario, seeds)

    def rebuild(self) -> None:
        """See `Arena.rebuild`."""
        self.arena.rebuild()

    def _observe(self) -> dict[str, torch.Tensor]:
        # The arena replaces its arrays and never writes into them: those of the right type are
        # handed out without a copy.
        arena = self.arena
        pose = np.concatenate([arena.position, arena.heading_rad[..., None]], axis=-1)
        truncated = arena.truncated[..., None]
        return {
            OBSERVATION: torch.from_numpy(arena.observation),
            REWARD_VECTOR: single(arena.reward_vector),
            DISTANCE: single(arena.distance[..., None]),
            POSE: single(pose),
            STEP_COUNT: torch.from_numpy(arena.age_ticks[..., None]),
            DONE: torch.from_numpy(truncated),
            TERMINATED: torch.from_numpy(np.zeros_like(truncated)),
            TRUNCATED: torch.from_numpy(truncated.copy()),
        }


def _carried(value: Any) -> Any:
    """A tensor itself, and of nested entries a copy that shares the tensors."""
    return value if isinstance(value, torch.Tensor) else value.copy()


def single(array: np.ndarray) -> torch.Tensor:
    """A tensor of single precision."""
    return torch.from_numpy(array.astype(np.float32))
