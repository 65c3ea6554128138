"""NERO's field as a world of a run: a team that learns, against turrets or another team."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neatq_envs.nero.scenario import NERO_ACTIONS, NERO_TASKS, NeroScenario, Stage, find_stages
from neatq_envs.nero.state import TeamBrains
from neatq_envs.nero.torchrl_nero import NeroEnv
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CandidateHeads, Heads
from neatq_torch.learning.heads import ValueRange
from neatq_trainers.nero.brains import team_brains
from neatq_trainers.nero.teams import FIRING_OF, read_team
from neatq_trainers.world import RobotsConfig, World, return_range

NERO = "nero"
"""What the task is called."""
ENEMIES = ("turrets", "none")


@dataclass(frozen=True, kw_only=True)
class NeroConfig(RobotsConfig):
    """NERO's field.

    Attributes:
        stages: The field, or several one after the other, of which the last has no end;
            `--env-kwargs` changes keys of all, such as robots=30.
        enemy: "turrets" (those of the scenario), "none", or the path of a team, which fights as it
            is beside them.
    """

    stages: tuple[Stage, ...] = (Stage(scenario=NERO_TASKS["nero"]),)
    enemy: str = "turrets"

    def __post_init__(self) -> None:
        if not self.enemy:
            raise ConfigError(f"enemy: expected {', '.join(ENEMIES)} or the path of a team file")
        for stage in self.stages:
            own = stage.scenario
            if own.firing != "2011" and "fire" not in NERO_ACTIONS[own.sensors]:
                raise ConfigError(
                    f"firing: robots that sense {own.sensors!r} cannot ask for fire; expected "
                    f"--env-kwargs firing=2011, got {own.firing!r}"
                )

    @property
    def scenario(self) -> NeroScenario:
        """The field of the last stage."""
        return self.stages[-1].scenario

    @property
    def schema(self) -> str:
        """Name of the observations."""
        return self.scenario.sensors


def nero_config(kwargs: Mapping[str, Any]) -> NeroConfig:
    """The world of the task "nero" with keys of its fields, and `enemy` and `field`, changed."""
    changes = {name: value for name, value in kwargs.items() if name not in ("enemy", "field")}
    enemy = str(kwargs.get("enemy", "turrets"))
    if "firing" in changes:
        changes["firing"] = str(changes["firing"])  # a year, which is no number
    if enemy != "turrets":
        changes.setdefault("turrets", [])
    stages = find_stages(kwargs.get("field", NERO), changes)
    if enemy not in ENEMIES:
        _enemies(enemy, stages[0].scenario)  # so that a file that cannot be used is told now
        enemy = str(Path(enemy).resolve())
    return NeroConfig(stages=stages, enemy=enemy)


def _enemies(enemy: str, scenario: NeroScenario) -> tuple[TeamBrains, int] | None:
    """Networks of the enemies of one arena, and how many; None of turrets and nobody."""
    if enemy in ENEMIES:
        return None
    team = read_team(Path(enemy))
    if team.sensors != scenario.sensors:
        raise ConfigError(
            f"enemy: {team.name}: expected a team that senses {scenario.sensors!r}, as the "
            f"learners do, got {team.sensors!r}; let these do, too: --field battle, or "
            f"--env-kwargs sensors={team.sensors} firing={FIRING_OF[team.sensors]}"
        )
    return team_brains([team], scenario.robots), scenario.robots


class NeroWorld(World):
    """NERO's field; its rewards are numbers within [0, 1], see `TrainingField`."""

    def __init__(self, config: NeroConfig, seeds: range) -> None:
        enemies = _enemies(config.enemy, config.scenario)
        self.env = NeroEnv(config.stages, arenas=len(seeds), seed=seeds[0], enemies=enemies)
        self.inputs = self.env.arena.observation.shape[-1]
        self.reward_weights = self.present_weights

    @property
    def present_weights(self) -> tuple[float, ...]:
        """Those of the stage, or whatever somebody made of `env.arena.weights`."""
        return tuple(self.env.arena.weights.tolist())

    def heads(self, candidates: int, value_range: ValueRange = (0.0, 1.0)) -> Heads:
        """Speed, turn, and what the sensors' robots do besides."""
        low, high = self.env.arena.bounds
        return CandidateHeads(candidates, low.tolist(), high.tolist(), value_range=value_range)

    def default_range(self, discount: float, *, normalized: bool) -> ValueRange:
        """Returns of rewards within [0, 1]."""
        return return_range(discount, normalized=normalized)
