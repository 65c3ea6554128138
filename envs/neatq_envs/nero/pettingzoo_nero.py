"""A battle of NERO as a PettingZoo task, for multi-agent trainers. Needs the extra "pettingzoo"."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ImportError(
        'NeroBattle needs PettingZoo; install it with: pip install "neatq_torch[pettingzoo]"'
    ) from error

from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import NERO_ACTIONS, OBSERVATIONS, NeroSource, find_nero
from neatq_envs.nero.state import (
    BATTLE_STREAM,
    GIVEN,
    TURRET,
    Field,
    law_of,
    make_field,
    no_brains,
    spawn_robots,
    walls_of,
)
from neatq_envs.nero.training import action_bounds
from neatq_envs.pettingzoo_env import check_agents

BATTLE_METADATA: dict[str, Any] = {
    "name": "nero_battle_v0",
    "is_parallelizable": True,
    "render_modes": ["rgb_array"],
    "render_fps": 50,
}
TEAM_NAMES = "blue", "red"
_FADED = 0.5


class NeroBattle(ParallelEnv[str, np.ndarray, np.ndarray]):
    """Two teams that fight, each robot an agent: "blue_0", ..., "red_0", ...

    In a tick the robots take their turns one after the other, blue's first: each shoots, takes
    the damage that has come in since its last turn, turns and moves (`neatq_envs.nero.kernels`).
    `reset(seed=s)` makes the first tick of a battle of seed s pass, in which robots only turn to
    where chance will have it; `reset()` goes on with the random numbers of the last battle.

    Observations are those of `kernels.sense`, float32, each in [0, 1]. Actions are those of
    `NERO_ACTIONS`: speed in units per tick, turn in rad, the others from 0 to 1; they are clipped
    to the bounds. A reward is the hits that a robot scored less those that it took in its turn;
    what hits blue after its turn is taken a tick later. `infos` have the hit points that are left
    and the pose: x, y (units), heading (rad).

    A robot without hit points is terminated and leaves. When a team has none left, everybody is
    terminated; after `max_ticks` steps everybody else is truncated. Then `winner` tells who won.

    Args:
        scenario: a name, a file or a `NeroScenario`, see `find_nero`.
        robots: in each team; None: as many as the scenario says.
        max_ticks: steps after which a battle is over.
        render_mode: "rgb_array" or None.

    Raises:
        ScenarioError: The scenario cannot be.
    """

    metadata = BATTLE_METADATA

    def __init__(
        self,
        scenario: NeroSource = "battle",
        *,
        robots: int | None = None,
        max_ticks: int = 1000,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f'render_mode: expected "rgb_array" or None, got {render_mode!r}')
        if max_ticks < 1:
            raise ValueError(f"max_ticks: expected at least 1, got {max_ticks}")
        self.scenario = find_nero(scenario, {} if robots is None else {"robots": robots})
        self.max_ticks, self.render_mode = max_ticks, render_mode
        self.possible_agents = [
            f"{team}_{robot}" for team in TEAM_NAMES for robot in range(self.scenario.robots)
        ]
        self.agents: list[str] = []
        self._row = {agent: row for row, agent in enumerate(self.possible_agents)}
        low, high = action_bounds(self.scenario)
        seen = (OBSERVATIONS[self.scenario.sensors],)
        # An object for each agent, so that each may be seeded for sampling.
        self._spaces = {
            agent: (Box(0.0, 1.0, seen, np.float32), Box(low, high, dtype=np.float32))
            for agent in self.possible_agents
        }
        self._bounds = low.astype(np.float64), high.astype(np.float64)
        self._ground, self._law = walls_of(self.scenario), law_of(self.scenario)
        self._brains = no_brains()
        self._rng: np.random.Generator | None = None
        self._field: Field | None = None

    def observation_space(self, agent: str) -> Box:
        """What an agent may see; the same object in each call."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> Box:
        """What an agent may do; the same object in each call."""
        return self._spaces[agent][1]

    @property
    def field(self) -> Field:
        """All robots and turrets, a row each: blue's, red's, turrets."""
        if self._field is None:
            raise ResetNeeded("there is no battle yet: call reset() first")
        return self._field

    @property
    def winner(self) -> str | None:
        """Who took less damage, "blue", "red" or "draw"; None while the battle goes on."""
        if self._field is None or self.agents:
            return None
        taken = np.minimum(self._field.damage, self._law.hit_points)
        blue, red = (int(taken[self._field.team == team].sum()) for team in (0, 1))
        return "draw" if blue == red else TEAM_NAMES[int(red < blue)]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin a battle: of the seed, or with the random numbers of the last one going on."""
        if seed is not None and seed < 0:
            raise ValueError(f"seed: expected 0 or more, got {seed}")
        if seed is not None or self._rng is None:
            self._rng = np.random.default_rng(None if seed is None else [seed, BATTLE_STREAM])
        field = make_field(self.scenario, [self.scenario.robots] * 2)
        fighters = np.flatnonzero(field.control != TURRET)
        field.control[fighters] = GIVEN
        spawn_robots(field, fighters, self.scenario, self._rng)
        self._field, self._passed = field, 0
        self._tick(np.zeros((len(field.team), 4)))
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Let one tick pass; actions, one for each agent, are clipped to the bounds.

        Raises:
            ValueError: The battle is over, or actions are not those that are asked for.
        """
        if not self.agents:
            raise ValueError("step: the battle is over; call reset()")
        self._tick(self._given(actions))
        self._passed += 1
        field, acted = self.field, self.agents
        fallen = field.damage >= self._law.hit_points
        over = any(fallen[field.team == team].all() for team in (0, 1))
        late = self._passed >= self.max_ticks
        terminated = {agent: over or bool(fallen[self._row[agent]]) for agent in acted}
        truncated = {agent: late and not terminated[agent] for agent in acted}
        gained = (field.hits - field.taken).astype(float)
        rewards = {agent: float(gained[self._row[agent]]) for agent in acted}
        seen, infos = self._observations(), self._infos()
        self.agents = [agent for agent in acted if not (terminated[agent] or truncated[agent])]
        return seen, rewards, terminated, truncated, infos

    def render(self) -> np.ndarray | None:
        """A picture of the field, uint8 [height, width, 3]; None without a render mode."""
        if self.render_mode is None:
            return None
        from neatq_envs.nero.picture import Painter, Still  # matplotlib takes a second to import

        field, most = self.field, self._law.hit_points
        left = (1 - field.damage / most).clip(0)
        mark = np.where(left > 0, 0.0, _FADED)
        still = Still(
            pose=field.pose,
            team=field.team,
            left=left,
            shot=field.shot,
            struck=field.taken > 0,
            mark=mark,
        )
        return np.array(Painter(self.scenario).paint(still))

    def _given(self, actions: dict[str, np.ndarray]) -> np.ndarray:
        """Actions as `kernels.tick` takes them, float64 [robots, 4]."""
        check_agents(self.agents, actions)
        given, names = np.zeros((len(self.field.team), 4)), NERO_ACTIONS[self.scenario.sensors]
        for agent, action in actions.items():
            values = np.asarray(action, np.float64)
            if values.shape != (len(names),) or not np.isfinite(values).all():
                raise ValueError(
                    f"actions: {agent}: expected {len(names)} finite numbers "
                    f"({', '.join(names)}), got {action!r}"
                )
            given[self._row[agent], : len(names)] = values.clip(*self._bounds)
        return given

    def _tick(self, given: np.ndarray) -> None:
        kernels.tick(self.field, self._ground, self._law, self._brains, given, self._rng)

    def _observations(self) -> dict[str, np.ndarray]:
        width = OBSERVATIONS[self.scenario.sensors]
        seen = np.zeros((len(self.possible_agents), width), np.float32)
        kernels.look(self.field, self._ground, self._law, len(seen), seen)
        return {agent: seen[self._row[agent]] for agent in self.agents}

    def _infos(self) -> dict[str, dict[str, Any]]:
        left = np.maximum(self._law.hit_points - self.field.damage, 0).tolist()
        pose = self.field.pose.copy()
        return {
            agent: {"hit_points": left[row], "pose": pose[row]}
            for agent in self.agents
            for row in [self._row[agent]]
        }
