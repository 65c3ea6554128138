"""Battles of a team that trains, shown in the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from neatq_torch.kinds import ConfigError
from neatq_trainers.live.recording import record_battle
from neatq_trainers.nero.match import BattleRules, filmed
from neatq_trainers.nero.nero_world import NERO, NeroConfig
from neatq_trainers.nero.run_teams import find_team
from neatq_trainers.nero.teams import present_team
from neatq_trainers.run import Run

_TEAM_FILES = ("*.txt.gz", "*.pop.txt", "*/*.txt.gz", "*/*.pop.txt")


def opponents() -> list[str]:
    """Team files (.txt.gz, .pop.txt) of the working directory and its folders, and its runs."""
    here = Path()
    files = {path for pattern in _TEAM_FILES for path in here.glob(pattern)}
    runs = {path.parent for path in here.glob("runs/*/checkpoint.npz")}
    return sorted(path.as_posix() for path in files | runs)


def fight(run: Run, against: str) -> dict[str, Any]:
    """A battle of the team as it is against one of the `opponents`, as a message for pages.

    Raises:
        ConfigError: If there is no such team, or it senses something else.
    """
    if not isinstance(run.config.world, NeroConfig):
        raise ConfigError(f"battle: it is for --task {NERO}")
    if run.config.network.double_activation:
        raise ConfigError("battle: networks that are activated twice a tick know no battle")
    if against not in opponents():
        raise ConfigError("battle: expected a team file or a run of the working directory")
    own, other = present_team(run, 0, "this team"), find_team(against)
    rules = BattleRules(robots=run.shape[1], hit_points=run.world.env.arena.scenario.hit_points)
    film = filmed(own, other, seed=run.tick, rules=rules)
    return {
        "type": "battle",
        "blue": own.name,
        "red": other.name,
        "damage_blue": film.result.damage_blue,
        "damage_red": film.result.damage_red,
        "winner": film.result.winner,
        "recording": record_battle(film, (own.name, other.name)),
    }
