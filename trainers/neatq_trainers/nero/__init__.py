"""NERO: teams from OpenNERO's files and from run folders, battles and tournaments.

>>> from neatq_trainers.nero import BattleRules, find_team, play
>>> play(find_team("runs/shooters"), find_team("synth.pop.txt.gz"), seed=0, rules=BattleRules())
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from neatq_trainers.nero.match import BattleRules, Film, MatchResult, filmed, play
    from neatq_trainers.nero.ranking import standings
    from neatq_trainers.nero.run_teams import find_team
    from neatq_trainers.nero.teams import Team
    from neatq_trainers.nero.tournament import play_tournament

__all__ = ["BattleRules", "Film", "MatchResult", "Team", "filmed", "find_team", "play"]
__all__ += ["play_tournament", "standings"]
_NAMES = {
    "match": "BattleRules Film MatchResult filmed play",
    "ranking": "standings",
    "run_teams": "find_team",
    "teams": "Team",
    "tournament": "play_tournament",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
