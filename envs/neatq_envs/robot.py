"""One robot in the arena as an ordinary Gymnasium task, alone or in rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from neatq_envs.arena import Arena
from neatq_envs.row_env import row_seeds
from neatq_envs.scenario import Scenario
from neatq_envs.scenario_file import find_scenario
from neatq_envs.sensors import schema_of

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}
SEEDS_BELOW = 2**31
ONE = np.ones(1, dtype=bool)

Source = Scenario | Mapping[str, Any] | Path | str


class RobotEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One robot on its way to the flag.

    ## Description
    A walled field with a flag and perhaps walls, seen through a few sensors. `reset(seed=s)` makes,
    bit for bit, the world of `Arena(scenario, [s])` with one robot, and each `reset()` the next
    one.

    ## Observation Space
    That of one robot of `neatq_envs.torchrl.ArenaEnv`, described there: float32 [12] in [0, 1];
    [18] with sensors "opennero"; [17] and [18] if there are two flags. Alone, a robot is its own
    only friend: `friend_proximity` is 1 and `friend_direction` 0.5. `info` holds `distance` to the
    flag that counts (units) and `pose`, float64 [3] = x, y (units), heading (rad).

    ## Action Space
    Float32 [2] = speed (units per tick), turn (rad per tick), clipped to the bounds; [4] with
    sensors "opennero". The units are physical, at most 1 unit and 0.2 rad: trainers that explore
    with a standard deviation of 1 want
    `gymnasium.wrappers.RescaleAction(env, np.float32(-1), np.float32(1))`.

    ## Rewards
    The scenario's law, in [0, 1] each tick (see `neatq_envs.rewards`). The registered ids use
    "progress": 0.5 for standing still, 1 for a full step towards the flag. "published", the
    law of the scenarios, is the squared distance: near the flag it differs by thousandths only.

    ## Starting State
    The robot stands at its spawn, moved by a whole number of units in each axis, with a heading
    of 0 to 359 whole degrees. A flag with an interval moves within an episode; one with a ring
    stands elsewhere in each. Of two flags, chance decides which one counts first.

    ## Episode End
    Truncated after `lifetime_ticks` (0: never) and never terminated, so that the value of the
    last observation counts.

    Args:
        scenario: a task's name, the path of a JSON file, its content, or a scenario. `robots`
            counts as 1.
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
        check_render_mode(render_mode)
        self.scenario = find_scenario(scenario, robots=1, reward=reward)
        self.observation_space, self.action_space = robot_spaces(self.scenario)
        self.render_mode = render_mode
        self._arena: Arena | None = None

    @property
    def arena(self) -> Arena:
        """The world, of one arena with one robot."""
        return require_reset(self._arena)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Make a new world: of the seed, or with the random numbers of the last world going on."""
        super().reset(seed=seed)
        self._arena = renewed(self._arena, self.scenario, ONE, [seed], self.np_random)
        return self._arena.observation[0, 0], self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Let one tick pass; the action is clipped to the bounds."""
        arena = self.arena
        arena.step(np.asarray(action)[None, None])
        reward, truncated = float(arena.reward[0, 0]), bool(arena.truncated[0, 0])
        return arena.observation[0, 0], reward, False, truncated, self._info()

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture, uint8 [height, width, 3], in mode "rgb_array"."""
        return picture(self.arena) if self.render_mode else None

    def _info(self) -> dict[str, Any]:
        return {"distance": float(self.arena.distance[0, 0]), "pose": poses(self.arena)[0, 0]}


class RobotVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Rows of `RobotEnv`, stepped together as arenas of one `Arena`.

    Row i, reset with seed s, is bit for bit `RobotEnv` reset with seed s. `info` has `distance`
    [rows] and `pose` [rows, 3].

    Episodes do not begin by themselves (`AutoresetMode.DISABLED`): reset a finished row with
    `options={"reset_mask": bool [rows]}`. For other modes, and for pictures, wrap the single
    environment: `gymnasium.make_vec(..., vectorization_mode="sync")`.

    Args:
        num_envs: rows.
        scenario: as in `RobotEnv`.
        reward: likewise.
    """

    def __init__(
        self, num_envs: int = 1, scenario: Source = "flag", *, reward: str | None = None
    ) -> None:
        self.metadata = {"autoreset_mode": AutoresetMode.DISABLED, "render_modes": []}
        self.scenario = find_scenario(scenario, robots=1, reward=reward)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = robot_spaces(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._arena: Arena | None = None

    @property
    def arena(self) -> Arena:
        """The worlds: as many arenas as rows, with one robot each."""
        return require_reset(self._arena)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Make new worlds.

        Args:
            seed: one for each row; None goes on with the row's random numbers. A number s means
                s, s + 1, and so on.
            options: `reset_mask`, bool [rows]: the rows to reset; the others stay as they are.
                The first reset is of all rows.

        Returns:
            Observations of all rows, float32 [rows, observations], and information.
        """
        seeds, mask = row_seeds(seed, self.num_envs), self._mask(options)
        self._arena = renewed(self._arena, self.scenario, mask, seeds, self.np_random)
        return self._arena.observation[:, 0], self._info()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Let one tick pass in every row: actions [rows, actions], clipped to the bounds."""
        arena = self.arena
        arena.step(np.asarray(actions)[:, None])
        truncated = arena.truncated[:, 0]
        ends = np.zeros_like(truncated), truncated
        return arena.observation[:, 0], arena.reward[:, 0], *ends, self._info()

    def _mask(self, options: dict[str, Any] | None) -> np.ndarray:
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ValueError(
                f"reset_mask: expected bool [{self.num_envs}], got {mask.dtype} {list(mask.shape)}"
            )
        return mask

    def _info(self) -> dict[str, Any]:
        known = np.ones(self.num_envs, dtype=bool)
        distance, pose = self.arena.distance[:, 0], poses(self.arena)[:, 0]
        return {"distance": distance, "_distance": known, "pose": pose, "_pose": known.copy()}


def robot_spaces(scenario: Scenario) -> tuple[Box, Box]:
    """Return the observation and the action space of one robot."""
    schema = schema_of(scenario)
    low, high = schema.action_bounds(scenario)
    return Box(0.0, 1.0, (len(schema.observations),), np.float32), Box(low, high, dtype=np.float32)


def renewed(
    arena: Arena | None,
    scenario: Scenario,
    mask: np.ndarray,
    seeds: Sequence[int | None],
    rng: np.random.Generator,
) -> Arena:
    """Return the arena with new worlds, made first if there is none.

    Args:
        arena: what earlier resets made.
        scenario: of the arena.
        mask: bool [arenas], which worlds are to be new, if there are worlds already.
        seeds: of each arena; None goes on with its random numbers.
        rng: draws the seeds of the first worlds that nobody gave one.
    """
    if arena is not None:
        arena.renew(mask, seeds)
        return arena
    drawn = rng.integers(SEEDS_BELOW, size=len(seeds)).tolist()
    pairs = zip(seeds, drawn, strict=True)
    return Arena(scenario, [other if seed is None else seed for seed, other in pairs])


def require_reset(arena: Arena | None) -> Arena:
    """Return the arena, which the first reset makes."""
    if arena is None:
        raise ResetNeeded("there is no world yet: call reset() first")
    return arena


def poses(arena: Arena) -> np.ndarray:
    """Return x, y (units) and headings (rad), float64 [arenas, robots, 3]."""
    return np.concatenate([arena.position, arena.heading_rad[..., None]], axis=-1)


def check_render_mode(render_mode: str | None) -> None:
    """Require a known render mode."""
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f'render_mode: expected "rgb_array" or None, got {render_mode!r}')


def picture(arena: Arena) -> np.ndarray:
    """Draw arena 0, uint8 [height, width, 3]."""
    from neatq_envs.render import frame  # matplotlib takes a second to import

    return frame(arena.scenario, arena.position[0], arena.heading_rad[0], arena.flag[0])
