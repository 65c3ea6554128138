"""The whole team as a PettingZoo task, for multi-agent trainers. Needs the extra "pettingzoo"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise ImportError(
        'TeamEnv needs PettingZoo; install it with: pip install "neatq_torch[pettingzoo]"'
    ) from error

from neatq_envs.robot import METADATA, Worlds, robot_spaces
from neatq_envs.scenario import Source

TEAM_METADATA = {**METADATA, "name": "neatq_team_v0", "is_parallelizable": True}
Actions = dict[str, np.ndarray]
Infos = dict[str, dict[str, Any]]


class TeamEnv(Worlds, ParallelEnv[str, np.ndarray, np.ndarray]):
    """All robots of one arena, each an agent: "robot_0", "robot_1", ...

    `reset(seed=s)` makes, bit for bit, the world of `Arena(scenario, [s])`, and each `reset()` the
    next one. Spaces, rewards and `infos` of an agent are those of
    `neatq_envs.robot.RobotEnv`; here friends are sensed. Each agent has a reward of its own.

    All lives begin together and are truncated together after `lifetime_ticks` (0: never); none
    is terminated. Then `agents` is empty until the next `reset`. Arguments are as in `RobotEnv`.
    """

    metadata = TEAM_METADATA

    def __init__(
        self,
        scenario: Source = "flag",
        *,
        reward: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._prepare(scenario, render_mode, reward=reward)
        self.possible_agents = [f"robot_{robot}" for robot in range(self.scenario.robots)]
        self.agents = []
        # An object for each agent, so that each may be seeded for sampling.
        self._spaces = {agent: robot_spaces(self.scenario) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Box:
        """What an agent may see; the same object in each call."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> Box:
        """What an agent may do; the same object in each call."""
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], Infos]:
        """Make a new world: of the seed, or with the random numbers of the last world going on."""
        arena = self._renew([seed], seeding.np_random()[0])
        self.agents = list(self.possible_agents)
        return self._by_agent(arena.observation[0]), self._infos()

    def step(
        self, actions: Actions
    ) -> tuple[dict[str, np.ndarray], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let one tick pass; actions, one for each agent, are clipped to the bounds."""
        if not self.agents:
            raise ValueError("step: all lives are over; call reset()")
        check_agents(self.agents, actions)
        arena = self.arena
        arena.step(np.stack([actions[agent] for agent in self.agents])[None])
        truncated = bool(arena.truncated[0, 0])
        if truncated:
            self.agents = []
        return (
            self._by_agent(arena.observation[0]),
            self._by_agent(arena.reward[0].tolist()),
            dict.fromkeys(self.possible_agents, False),
            dict.fromkeys(self.possible_agents, truncated),
            self._infos(),
        )

    def _by_agent(self, values: Any) -> dict[str, Any]:
        return dict(zip(self.possible_agents, values, strict=True))

    def _infos(self) -> Infos:
        pairs = zip(self.arena.distance[0].tolist(), self._poses[0], strict=True)
        return self._by_agent({"distance": distance, "pose": pose} for distance, pose in pairs)


def check_agents(agents: Sequence[str], actions: Mapping[str, object]) -> None:
    """Raise ValueError unless there is an action for each agent and for nobody else."""
    if actions.keys() != set(agents):
        missing = [agent for agent in agents if agent not in actions]
        unknown = [agent for agent in actions if agent not in agents]
        raise ValueError(
            f"actions: expected one for each of {len(agents)} agents; "
            f"missing: {missing}, unknown: {unknown}"
        )
