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
from neatq_envs.scenario import Scenario
from neatq_envs.scenario_file import find_scenario
from neatq_envs.sensors import SCHEMAS

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}
SEEDS_BELOW = 2**31

Source = Scenario | Mapping[str, Any] | Path | str


class RobotEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One robot on its way to the flag.

    `reset(seed=s)` followed by steps gives, bit for bit, what `ArenaEnv(scenario, seed=s)` with
    one robot gives from its first `reset()` on.

    ## Observation and action space
    Those of one robot of `neatq_envs.torchrl.ArenaEnv`, described there: float32 [12] in [0, 1]
    and float32 [2] = speed (units per tick), turn (rad per tick); 18 and 4 with sensors
    "opennero". Alone, a robot is its own only friend: `friend_proximity` is 1 and
    `friend_direction` 0.5. Actions are in physical units, at most 0.2 rad for a turn: trainers
    that explore with a standard deviation of 1 want
    `gymnasium.wrappers.RescaleAction(env, np.float32(-1), np.float32(1))`.

    ## Rewards
    The scenario's law, in [0, 1] each tick (see `neatq_envs.rewards`). The registered ids use
    "progress": 0.5 for standing still, 1 for a full step towards the flag. "published", the
    law of the scenarios, is the squared distance: near the flag it differs by thousandths only.

    ## Episodes
    Truncated after `lifetime_ticks` (0: never) and never terminated: the value of the last
    observation counts. `reset(seed=s)` makes a world from the seed, `reset()` makes another one
    and its random numbers go on. A flag with an interval moves within a world, counted from its
    reset; one with a ring stands elsewhere in each world.

    `info` holds `distance` to the flag (units) and `pose`, float64 [3] = x, y (units), heading
    (rad).

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
        if seed is not None:
            self._arena = Arena(self.scenario, [seed])
        elif self._arena is None:
            self._arena = Arena(self.scenario, draw_seeds(self.np_random, 1))
        self.arena.reset()
        return self.arena.observation[0, 0], self._info()

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
    """Rows of `RobotEnv` that are stepped together; row i with seed s is `RobotEnv` with seed s.

    No life ends early, so all rows end in the same tick and are reset together. `info` has
    `distance` [rows] and `pose` [rows, 3].

    Args:
        num_envs: rows.
        scenario: as in `RobotEnv`.
        reward: likewise.
        autoreset_mode: NEXT_STEP: the step after the last one of an episode resets and ignores
            the action, as Gymnasium's own vector environments do; DISABLED: call `reset`.
        render_mode: None; rows have no picture.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Source = "flag",
        *,
        reward: str | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        if autoreset_mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED):
            raise ValueError(f"autoreset_mode: NEXT_STEP or DISABLED, got {autoreset_mode}")
        if render_mode is not None:
            raise ValueError(f"render_mode: rows have no picture, got {render_mode!r}")
        self.scenario = find_scenario(scenario, robots=1, reward=reward)
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": []}
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
        seed: int | Sequence[int] | None = None,  # pyright: ignore[reportIncompatibleMethodOverride]
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Make new worlds for all rows.

        Args:
            seed: of row 0, the others count on; or one for each row; None: random numbers go on.
            options: `reset_mask`, bool [rows], is accepted where it is true for all rows.
        """
        self._check_mask((options or {}).get("reset_mask"))
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is not None:
            self._arena = Arena(self.scenario, self._row_seeds(seed))
        elif self._arena is None:
            self._arena = Arena(self.scenario, draw_seeds(self.np_random, self.num_envs))
        self.arena.reset()
        return self.arena.observation[:, 0], self._info()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Let one tick pass in every row: actions [rows, actions], clipped to the bounds."""
        arena = self.arena
        over = self.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP and arena.truncated.all()
        if over:
            arena.reset()
        else:
            arena.step(np.asarray(actions)[:, None])
        truncated = arena.truncated[:, 0]
        ends = np.zeros_like(truncated), truncated
        return arena.observation[:, 0], arena.reward[:, 0], *ends, self._info()

    def _row_seeds(self, seed: int | Sequence[int]) -> list[int]:
        if isinstance(seed, int | np.integer):
            return [int(seed) + row for row in range(self.num_envs)]
        if len(seed) != self.num_envs or any(value is None for value in seed):
            raise ValueError(
                f"seed: expected one whole number for each of {self.num_envs} rows, got {seed}"
            )
        return [int(value) for value in seed]

    def _check_mask(self, mask: np.ndarray | None) -> None:
        if mask is not None and (mask.shape != (self.num_envs,) or not mask.all()):
            raise ValueError(
                "reset_mask: all rows live equally long, so they are reset together: expected "
                f"true for each of {self.num_envs} rows, got {mask.tolist()}"
            )

    def _info(self) -> dict[str, Any]:
        known = np.ones(self.num_envs, dtype=bool)
        distance, pose = self.arena.distance[:, 0], poses(self.arena)[:, 0]
        return {"distance": distance, "_distance": known, "pose": pose, "_pose": known.copy()}


def robot_spaces(scenario: Scenario) -> tuple[Box, Box]:
    """Return the observation and the action space of one robot."""
    schema = SCHEMAS[scenario.sensors]
    low, high = schema.action_bounds(scenario)
    return Box(0.0, 1.0, (len(schema.observations),), np.float32), Box(low, high, dtype=np.float32)


def draw_seeds(rng: np.random.Generator, arenas: int) -> list[int]:
    """Draw seeds for worlds that nobody gave one."""
    return rng.integers(SEEDS_BELOW, size=arenas).tolist()


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
