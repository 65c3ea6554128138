"""A league: whom learning teams meet, round after round.

Two populations evolve and learn against each other on one field; now and then each meets its own
past or that of the other, a hall of fame (Rosin & Belew 1997; Stanley & Miikkulainen 2004), or
given teams, the more often the less it has beaten them (prioritised fictitious self-play, Vinyals
et al. 2019).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from neatq_envs.nero.training import Enemies
from neatq_torch.genome import pack_genomes, unpack_genomes
from neatq_trainers.nero.brains import team_brains
from neatq_trainers.nero.teams import Team

LEAGUE, PRESENT = "league", "present"
"""Opponents by name: the rival as it is and a hall of fame; the rival alone."""
HALL_ROUNDS = 4
"""From one entry of the hall of fame to the next."""
HALL_GENOMES = 10
"""How many of the fittest are an entry."""
PRESENT_SHARE = 0.5
"""Of rounds against the rival as it is, once there is anybody else."""
HARDNESS = 2.0
"""A team is met with a chance that grows as (1 - share of rounds won against it) ^ HARDNESS."""
WIN_RATE_STEP = 0.25
"""What the last round counts in that share."""
RIVAL_NAME = "rival"
LEAGUE_STREAM = 10
_RIVAL = -1


class RoundRow(NamedTuple):
    """A row of `rounds.csv`: a round of one arena.

    Attributes:
        arena: Number of the arena.
        tick: In which the round ended.
        opponent: "rival"; from the hall of fame "rival at 4000" or "itself at 4000"; or the name of
            a team's file.
        hits: Hits that the arena's robots scored.
        damage: That they took.
        won: 1 if they scored more than they took, 0 if fewer, else 0.5.
    """

    arena: int
    tick: int
    opponent: str
    hits: int
    damage: int
    won: float


class League:
    """Draws opponents; see `Rounds`.

    Args:
        given: Teams that do not learn.
        robots: In a team.
        seeds: One for each arena; those of a pair of rivals follow each other.
        ticks: Of a round.
        together: 2 where arenas 2 k and 2 k + 1 are each other's rivals, else 1.
        remembers: Whether there is a hall of fame.

    Attributes:
        fittest: Gives the fittest of an arena as a team of a name; set by whoever has them.
        rows: Of all rounds that are over.
    """

    def __init__(
        self,
        given: Sequence[Team],
        *,
        robots: int,
        seeds: Sequence[int],
        ticks: int,
        together: int = 1,
        remembers: bool = False,
    ) -> None:
        self.ticks = ticks
        self.fittest: Callable[[int, str], Team] = _nobody
        self._together, self._remembers = together, remembers
        self._given, self._robots, self._seeds = tuple(given), robots, tuple(seeds)
        self.reset()

    def reset(self) -> None:
        """Begin with the first round."""
        self._rngs = [
            np.random.default_rng([seed, LEAGUE_STREAM]) for seed in self._seeds[:: self._together]
        ]
        self.rows: list[RoundRow] = []
        self._teams = list(self._given)
        self._made = [self._enemies_of(team) for team in self._teams]
        self._wins = np.full((len(self._seeds), len(self._teams)), 0.5)
        self._draw()

    @property
    def lineup(self) -> list[Enemies]:
        """The enemies of each arena in this round."""
        return [None if one == _RIVAL else self._made[one] for one in self._drawn]

    def advance(self, tick: int, tally: np.ndarray) -> None:
        """Note how a round ended, hits and damage int64 [arenas, 2], and draw the next."""
        for arena, (hits, damage) in enumerate(tally.tolist()):
            against = self._drawn[arena]
            won = 0.5 * (1 + float(np.sign(hits - damage)))
            name = self._name(arena, against)
            self.rows.append(RoundRow(arena, tick, name, hits, damage, won))
            if against != _RIVAL:
                self._wins[arena, against] += WIN_RATE_STEP * (won - self._wins[arena, against])
        if self._remembers and tick // self.ticks % HALL_ROUNDS == 0:
            for arena in range(len(self._seeds)):
                self._add(self.fittest(arena, f"at {tick}"))
        self._draw()

    def _name(self, arena: int, against: int) -> str:
        """What an opponent of an arena is called."""
        if against == _RIVAL:
            return RIVAL_NAME
        whose = ""
        if against >= len(self._given):
            whose = "itself " if self._arena_of(against) == arena else "rival "
        return whose + self._teams[against].name

    def _arena_of(self, entry: int) -> int:
        """Whose an entry of the hall of fame is: all arenas add one at the same time."""
        return (entry - len(self._given)) % len(self._seeds)

    def _add(self, team: Team) -> None:
        self._teams.append(team)
        self._made.append(self._enemies_of(team))
        self._wins = np.column_stack([self._wins, np.full(len(self._seeds), 0.5)])

    def _enemies_of(self, team: Team) -> Enemies:
        return team_brains([team], self._robots), self._robots

    def _draw(self) -> None:
        self._drawn: list[int] = []
        for pair, rng in enumerate(self._rngs):
            first = self._together * pair
            arenas = range(first, first + self._together)
            known = self._known_to(arenas)
            if self._together == 2 and (not known or rng.random() < PRESENT_SHARE):
                self._drawn += [_RIVAL, _RIVAL]
                continue
            for arena in arenas:
                weight = np.maximum(1 - self._wins[arena, known], 0.01) ** HARDNESS
                self._drawn.append(int(rng.choice(known, p=weight / weight.sum())))

    def _known_to(self, arenas: range) -> list[int]:
        """Whom a pair can meet besides each other: given teams, and its own part of the hall."""
        given = len(self._given)
        hall = range(given, len(self._teams))
        return [*range(given), *(one for one in hall if self._arena_of(one) in arenas)]

    def state(self) -> dict[str, Any]:
        """All that it is: a nested dict of numpy arrays and JSON values."""
        hall = self._teams[len(self._given) :]
        return {
            "generators": [rng.bit_generator.state for rng in self._rngs],
            "drawn": list(self._drawn),
            "wins": self._wins.copy(),
            "rows": [list(row) for row in self.rows],
            "hall": [
                {**vars(team), "genomes": pack_genomes(team.genomes), "notes": []} for team in hall
            ],
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`."""
        self.reset()
        for one in state["hall"]:
            self._add(Team(**{**one, "genomes": tuple(unpack_genomes(one["genomes"]))}))
        self._wins, self._drawn = np.array(state["wins"]), list(state["drawn"])
        self.rows = [RoundRow(*row) for row in state["rows"]]
        for rng, saved in zip(self._rngs, state["generators"], strict=True):
            rng.bit_generator.state = saved


def _nobody(arena: int, name: str) -> Team:
    raise RuntimeError(f"arena {arena}: nobody has said who lives there")
