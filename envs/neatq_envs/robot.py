"""One robot in the arena as an ordinary Gymnasium task, alone or in rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box

from neatq_envs.arena import Arena
from neatq_envs.row_env import VectorRowEnv
from neatq_envs.scenario import Scenario, Source, find_scenario
from neatq_envs.sensors import schema_of

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}
_SEEDS_BELOW = 2**31


class Worlds:
    """What the environments of robots share: arenas that the first reset makes, and pictures."""

    _arena: Arena | None = None

    def _prepare(
        self, source: Source, render_mode: str | None = None, **changes: Any
    ) -> tuple[Box, Box]:
        """Find the scenario; returns the observation and the action space of a robot."""
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f'render_mode: expected "rgb_array" or None, got {render_mode!r}')
        self.scenario, self.render_mode = find_scenario(source, changes=changes), render_mode
        return robot_spaces(self.scenario)

    @property
    def arena(self) -> Arena:
        """The worlds."""
        if self._arena is None:
            raise ResetNeeded("there is no world yet: call reset() first")
        return self._arena

    def _renew(
        self, seeds: Sequence[int | None], rng: np.random.Generator, mask: np.ndarray | None = None
    ) -> Arena:
        """Make new worlds of seeds, one for each arena; None goes on with its random numbers.

        `rng` draws the seeds of first worlds that nobody gave one. `mask`, bool [arenas], tells
        which worlds are to be new, if there are worlds already.
        """
        if self._arena is None:
            drawn = rng.integers(_SEEDS_BELOW, size=len(seeds)).tolist()
            pairs = zip(seeds, drawn, strict=True)
            given = [other if seed is None else seed for seed, other in pairs]
            self._arena = Arena(self.scenario, given)
        else:
            self._arena.renew(np.ones(len(seeds), bool) if mask is None else mask, seeds)
        return self._arena

    @property
    def _poses(self) -> np.ndarray:
        """X, y (units) and headings (rad), float64 [arenas, robots, 3]."""
        return np.concatenate([self.arena.position, self.arena.heading_rad[..., None]], axis=-1)

    def render(self) -> Any:
        """A picture of arena 0, uint8 [height, width, 3], in mode "rgb_array", else None."""
        if self.render_mode is None:
            return None
        from neatq_envs.render import frame  # matplotlib takes a second to import

        arena = self.arena
        return frame(arena.scenario, arena.position[0], arena.heading_rad[0], arena.flag[0])


def robot_spaces(scenario: Scenario) -> tuple[Box, Box]:
    """The observation and the action space of one robot."""
    schema = schema_of(scenario)
    low, high = schema.action_bounds(scenario)
    return Box(0.0, 1.0, (len(schema.observations),), np.float32), Box(low, high, dtype=np.float32)


class RobotEnv(Worlds, gymnasium.Env[np.ndarray, np.ndarray]):
    """One robot on its way to the flag.

    ## Description
    `reset(seed=s)` makes, bit for bit, the world of `Arena(scenario, [s])` with one robot, and each
    `reset()` the next one.

    ## Observation Space
    That of one robot of `neatq_envs.torchrl_env.ArenaEnv`, described there: float32 [12] in [0, 1]
    with sensors "arena" and "arena-feedback", [18] with "opennero"; [17], [18] and [18] if there
    are two flags. Alone, a robot is its own only friend: `friend_proximity` is 1 and
    `friend_direction` 0.5. `info` holds `distance` to the flag that counts (units) and `pose`,
    float64 [3] = x, y (units), heading (rad).

    ## Action Space
    That of `ArenaEnv`, too: float32 [2], or [4] with sensors "opennero". Trainers that explore
    with a standard deviation of 1 want
    `gymnasium.wrappers.RescaleAction(env, np.float32(-1), np.float32(1))`.

    ## Rewards
    The scenario's law, in [0, 1] each tick (see `neatq_envs.rewards`). The registered ids use
    "progress": 0.5 for standing still, 1 for a full step towards the flag. "published", the
    law of the scenarios, is the squared distance: near the flag it differs by thousandths only.

    ## Starting State
    That of a life in `ArenaEnv`. A flag with an interval moves within an episode; one with a ring
    stands elsewhere in each. Of two flags, chance decides which one counts first.

    ## Episode End
    Truncated after `lifetime_ticks` (0: never) and never terminated, so that the value of the
    last observation counts.

    Args:
        scenario: a task's name, the path of a JSON file, its content, or a scenario; with 1 robot.
        reward: another law than the scenario's.
        render_mode: "rgb_array" or None.
    """

    metadata = METADATA

    def __init__(
        self,
        scenario: Source = "flag",
        *,
        reward: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.observation_space, self.action_space = self._prepare(
            scenario, render_mode, robots=1, reward=reward
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Make a new world: of the seed, or with the random numbers of the last world going on."""
        super().reset(seed=seed)
        return self._renew([seed], self.np_random).observation[0, 0], self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Let one tick pass; the action is clipped to the bounds."""
        arena = self.arena
        arena.step(np.asarray(action)[None, None])
        reward, truncated = float(arena.reward[0, 0]), bool(arena.truncated[0, 0])
        return arena.observation[0, 0], reward, False, truncated, self._info()

    def _info(self) -> dict[str, Any]:
        return {"distance": float(self.arena.distance[0, 0]), "pose": self._poses[0, 0]}


class RobotVectorEnv(Worlds, VectorRowEnv):
    """Rows of `RobotEnv`, stepped together as arenas of one `Arena`.

    Row i, reset with seed s, is bit for bit `RobotEnv` reset with seed s. `info` has `distance`
    [rows] and `pose` [rows, 3]. Arguments are as in `RobotEnv`.
    """

    def __init__(
        self, num_envs: int = 1, scenario: Source = "flag", *, reward: str | None = None
    ) -> None:
        super().__init__(num_envs, *self._prepare(scenario, robots=1, reward=reward))

    def _reset(
        self, seeds: Sequence[int | None], mask: np.ndarray | None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        arena = self._renew(seeds, self.np_random, mask)
        return arena.observation[:, 0], self._info()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Let one tick pass in every row: actions [rows, actions], clipped to the bounds."""
        arena = self.arena
        arena.step(np.asarray(actions)[:, None])
        truncated = arena.truncated[:, 0]
        ends = np.zeros_like(truncated), truncated
        return arena.observation[:, 0], arena.reward[:, 0], *ends, self._info()

    def _info(self) -> dict[str, Any]:
        known = np.ones(self.num_envs, dtype=bool)
        distance, pose = self.arena.distance[:, 0], self._poses[:, 0]
        return {"distance": distance, "_distance": known, "pose": pose, "_pose": known.copy()}
