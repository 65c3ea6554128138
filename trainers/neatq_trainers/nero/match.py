"""A battle between two teams: a pure function of the teams, the rules and a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import NeroScenario, NeroSource, find_nero
from neatq_envs.nero.state import BATTLE_STREAM, Field, law_of, make_field, spawn_robots, walls_of
from neatq_torch.kinds import ConfigError
from neatq_trainers.nero.brains import team_brains
from neatq_trainers.nero.teams import FIRING_OF, Team

BLUE, RED = 0, 1


@dataclass(frozen=True, kw_only=True)
class BattleRules:
    """What a battle is fought by; the defaults are those of the tournament of 2011.

    Attributes:
        ticks: after so many a battle is over. In 2011 it was after 300 seconds.
        robots: in each team.
        hit_points: hits that take a robot off the field.
        field: name or file of the field, see `find_nero`.
    """

    ticks: int = 1000
    robots: int = 50
    hit_points: int = 20
    field: NeroSource = "battle"

    def scenario(self, sensors: str) -> NeroScenario:
        """The field for teams with such sensors."""
        own = {"sensors": sensors, "firing": FIRING_OF[sensors]}
        return find_nero(self.field, {"robots": self.robots, "hit_points": self.hit_points} | own)


@dataclass(frozen=True, kw_only=True)
class MatchResult:
    """How a battle ended.

    Attributes:
        damage_blue: damage that blue took: hits, and for a robot that died its hit points.
        damage_red: likewise.
        ticks: how long it lasted.
        winner: who took less damage: "blue", "red" or "draw".
    """

    damage_blue: int
    damage_red: int
    ticks: int

    @property
    def winner(self) -> str:
        """Who took less damage."""
        if self.damage_blue == self.damage_red:
            return "draw"
        return "blue" if self.damage_blue < self.damage_red else "red"


@dataclass(frozen=True, kw_only=True)
class Film:
    """A battle to look at.

    Attributes:
        result: how it ended.
        scenario: where it was fought.
        pose: x, y in units and heading in rad, float32 [ticks, robots, 3].
        hit_points: what is left, -1 off the field, int16 [ticks, robots].
        shot: at whom a robot shot, -1: at nobody, int16 [ticks, robots].
        team: 0 blue, 1 red, int64 [robots].
    """

    result: MatchResult
    scenario: NeroScenario
    pose: np.ndarray
    hit_points: np.ndarray
    shot: np.ndarray
    team: np.ndarray


def play(blue: Team, red: Team, *, seed: int, rules: BattleRules) -> MatchResult:
    """Let two teams fight.

    Raises:
        ConfigError: If they sense differently.
    """
    return _play(blue, red, seed, rules, 0).result


def filmed(blue: Team, red: Team, *, seed: int, rules: BattleRules) -> Film:
    """Let two teams fight as `play` does, and keep all that is to be seen."""
    return _play(blue, red, seed, rules, rules.ticks)


def _play(blue: Team, red: Team, seed: int, rules: BattleRules, kept: int) -> Film:
    if blue.sensors != red.sensors:
        raise ConfigError(
            f"{blue.name} and {red.name}: expected teams that sense the same, got "
            f"{blue.sensors!r} and {red.sensors!r}"
        )
    scenario = rules.scenario(blue.sensors)
    rng = np.random.default_rng([seed, BATTLE_STREAM])
    field = make_field(scenario, [scenario.robots] * 2)
    robots = len(field.team)
    spawn_robots(field, np.arange(2 * scenario.robots), scenario, rng)
    pose, rest = np.zeros((kept, robots, 3), np.float32), np.zeros((kept, robots, 2), np.int16)
    brains = team_brains([blue, red], scenario.robots, bare=len(scenario.turrets))
    ground, law = walls_of(scenario), law_of(scenario)
    ticks = kernels.play(field, ground, law, brains, rules.ticks, rng, (pose, rest))
    result = MatchResult(
        damage_blue=_damage(field, BLUE, law.hit_points),
        damage_red=_damage(field, RED, law.hit_points),
        ticks=ticks,
    )
    seen = pose[:ticks], rest[:ticks, :, 0], rest[:ticks, :, 1]
    return Film(
        result=result,
        scenario=scenario,
        pose=seen[0],
        hit_points=seen[1],
        shot=seen[2],
        team=field.team,
    )


def _damage(field: Field, team: int, hit_points: int) -> int:
    """Damage that a team took; a robot's counts up to its hit points."""
    return int(np.minimum(field.damage[field.team == team], hit_points).sum())
