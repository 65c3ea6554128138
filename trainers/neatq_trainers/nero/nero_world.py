"""NERO's field as a world of a run: teams that learn, against turrets, teams or each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from neatq_envs.nero.scenario import NERO_ACTIONS, NERO_TASKS, NeroScenario, Stage, find_stages
from neatq_envs.nero.torchrl_nero import NeroEnv
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CandidateHeads, Heads
from neatq_torch.learning.heads import ValueRange
from neatq_trainers.nero.brains import team_brains
from neatq_trainers.nero.league import HALL_GENOMES, LEAGUE, PRESENT, RIVAL_NAME, League
from neatq_trainers.nero.teams import FIRING_OF, Team, fittest_team
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
        enemy: "turrets" (those of the scenario), "none", or a team, which fights as it is: the path
            of an OpenNERO file or of a run folder (FOLDER:N for its arena N).
        against: Opponents that change from round to round: "league" (a rival population as it is,
            and what both once were), "present" (the rival alone), teams; see `League`.
        round_ticks: Length of a round, with which all lives end.
        held_out: Teams that no learner meets; how many matches are won against them is
            measured every 10 rounds.
    """

    stages: tuple[Stage, ...] = (Stage(scenario=NERO_TASKS["nero"]),)
    enemy: str = "turrets"
    against: tuple[str, ...] = ()
    round_ticks: int = 1000
    held_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.enemy:
            raise ConfigError(f"enemy: expected {', '.join(ENEMIES)} or the path of a team file")
        if type(self.round_ticks) is not int or self.round_ticks < 1:
            raise ConfigError(f"round_ticks: expected a whole number >= 1, got {self.round_ticks}")
        if self.against and self.enemy != "none":
            known = " ".join(self.against)
            raise ConfigError(f"enemy: expected none beside against {known}, got {self.enemy}")
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
    def together(self) -> int:
        """How many arenas share a field, as rivals."""
        return 2 if {LEAGUE, PRESENT}.intersection(self.against) else 1

    @property
    def schema(self) -> str:
        """Name of the observations."""
        return self.scenario.sensors


def nero_config(kwargs: Mapping[str, Any]) -> NeroConfig:
    """The world of the task "nero" with keys of its fields, and other attributes, changed."""
    own = ("enemy", "field", "against", "round_ticks", "held_out")
    changes = {name: value for name, value in kwargs.items() if name not in own}
    against, held_out = (_opponents(name, kwargs.get(name, ())) for name in ("against", "held_out"))
    enemy = str(kwargs.get("enemy", "none" if against else "turrets"))
    if "firing" in changes:
        changes["firing"] = str(changes["firing"])  # a year, which is no number
    if enemy != "turrets":
        changes.setdefault("turrets", [])
    config = NeroConfig(
        stages=find_stages(kwargs.get("field", NERO), changes),
        enemy=enemy if enemy in ENEMIES else _absolute(enemy),
        against=tuple(one if one in (LEAGUE, PRESENT) else _absolute(one) for one in against),
        round_ticks=kwargs.get("round_ticks", NeroConfig.round_ticks),
        held_out=tuple(map(_absolute, held_out)),
    )
    teams_of(config)  # so that a file that cannot be used is told now
    return config


def _opponents(key: str, value: Any) -> list[str]:
    """Opponents that somebody named, one or several."""
    several = [value] if isinstance(value, str | Path) else value
    if not isinstance(several, list | tuple):
        raise ConfigError(f"{key}: expected names or paths of teams, got {value!r}")
    return [str(one) for one in several]


def _absolute(path: str) -> str:
    return str(Path(path).resolve())


def teams_of(config: NeroConfig) -> dict[str, list[Team]]:
    """Teams of files, by what they are: "enemy", "against" and "held_out".

    Raises:
        ConfigError: If one cannot be read, senses otherwise than the learners, or is called as
            another opponent is.
    """
    paths = {
        "enemy": [config.enemy] if config.enemy not in ENEMIES else [],
        "against": [one for one in config.against if one not in (LEAGUE, PRESENT)],
        "held_out": config.held_out,
    }
    teams = {what: [_team(what, one, config) for one in names] for what, names in paths.items()}
    for what, some in teams.items():
        names = [RIVAL_NAME, *(team.name for team in some)]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"{what}: {name}: expected opponents of different names")
    return teams


def _team(what: str, path: str, config: NeroConfig) -> Team:
    from neatq_trainers.nero.run_teams import find_team  # it reads runs, which know this world

    team = find_team(path)
    if team.sensors != config.schema:
        raise ConfigError(
            f"{what}: {team.name}: expected a team that senses {config.schema!r}, as the "
            f"learners do, got {team.sensors!r}; let these do, too: --field battle, or "
            f"--env-kwargs sensors={team.sensors} firing={FIRING_OF[team.sensors]}"
        )
    return team


class NeroWorld(World):
    """NERO's field; its rewards are numbers within [0, 1], see `TrainingField`."""

    def __init__(self, config: NeroConfig, seeds: range) -> None:
        self.config = config
        teams, robots = teams_of(config), config.scenario.robots
        enemies = (team_brains(teams["enemy"], robots), robots) if teams["enemy"] else None
        self.held_out, self.league = teams["held_out"], None
        if config.against:
            self.league = League(
                teams["against"],
                robots=robots,
                seeds=seeds,
                ticks=config.round_ticks,
                together=config.together,
                remembers=LEAGUE in config.against,
            )
        self.env = NeroEnv(
            config.stages, arenas=len(seeds), seed=seeds[0], enemies=enemies, rounds=self.league
        )
        self.inputs = self.env.arena.observation.shape[-1]
        self.reward_weights = self.present_weights

    @property
    def present_weights(self) -> tuple[float, ...]:
        """Those of the stage, or whatever somebody made of `env.arena.weights`."""
        return tuple(self.env.arena.weights.tolist())

    def join(self, run: Any) -> None:
        """Let the league find its hall of fame."""
        if not self.config.against and not self.held_out:
            return
        if run.config.network.double_activation:
            raise ConfigError(
                f"against, held_out: the networks of the arm {run.config.arm} are activated twice "
                "a tick, which no battle knows"
            )
        if self.league is None:
            return
        if LEAGUE in self.config.against and run.config.generational:
            raise ConfigError(
                f"against: expected {PRESENT} or team files: in the generations of the arm "
                f"{run.config.arm} nobody is known as fit before all are replaced"
            )
        self.league.fittest = partial(fittest_team, run, HALL_GENOMES)

    def heads(self, candidates: int, value_range: ValueRange = (0.0, 1.0)) -> Heads:
        """Speed, turn, and what the sensors' robots do besides."""
        low, high = self.env.arena.bounds
        return CandidateHeads(candidates, low.tolist(), high.tolist(), value_range=value_range)

    def default_range(self, discount: float, *, normalized: bool) -> ValueRange:
        """Returns of rewards within [0, 1]."""
        return return_range(discount, normalized=normalized)
