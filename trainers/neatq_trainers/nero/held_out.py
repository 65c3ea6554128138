"""What a team is worth against others that its training never meets."""

from __future__ import annotations

from collections.abc import Sequence

from neatq_envs.nero.scenario import NeroScenario
from neatq_trainers.nero.match import BattleRules, play
from neatq_trainers.nero.teams import Team

HELD_OUT_ROUNDS = 10
"""From one measurement in a run to the next."""


def share_of_wins(
    team: Team, others: Sequence[Team], scenario: NeroScenario, *, matches: int = 2, seed: int = 0
) -> float:
    """The share of matches that a team wins, half of them in each colour; a draw is half a win.

    Args:
        team: The team.
        others: Its opponents.
        scenario: Where they meet; they shoot as robots with their sensors do, see `FIRING_OF`.
        matches: Against each of them.
        seed: Of the first match and of its return match; the next have the next.
    """
    rules = BattleRules(robots=scenario.robots, hit_points=scenario.hit_points, field=scenario)
    points = 0.0
    for other in others:
        for number in range(matches):
            own, sides = ("blue", (team, other)) if number % 2 == 0 else ("red", (other, team))
            winner = play(*sides, seed=seed + number // 2, rules=rules).winner
            points += 0.5 if winner == "draw" else winner == own
    return points / (matches * len(others))
