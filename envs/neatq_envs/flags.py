"""Where the flags of all arenas stand, when they move, and which one counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from neatq_envs.checks import ScenarioError, pair, require, require_fields

if TYPE_CHECKING:
    from neatq_envs.scenario import Scenario

_TRIES = 10_000


@dataclass(frozen=True, kw_only=True)
class FlagSchedule:
    """Where the flag stands and when it moves, or where two flags stand and which one counts.

    Attributes:
        positions: places (x, y) in units, visited in order; the list wraps.
        interval_ticks: ticks between two moves; 0 = the flag never moves.
        ring: instead of `positions`: (least, greatest) distance to the first spawn, drawn anew
            for each move by a random generator of the flag's own, so that the places do not
            depend on how often robots respawn.
        switch_ticks: greater than 0: a flag stands at each of two `positions` all the time, and
            only one of them counts: rewards and distances are to that one. After so many ticks
            the other one counts, and so on; which is the first is drawn for each world.
    """

    positions: tuple[tuple[float, float], ...] = ()
    interval_ticks: int = 0
    ring: tuple[float, float] | None = None
    switch_ticks: int = 0

    def __post_init__(self) -> None:
        require_fields(FlagSchedule, vars(self))
        numbered = enumerate(self.positions)
        places = tuple(pair(f"positions[{i}]", at, "positions") for i, at in numbered)
        object.__setattr__(self, "positions", places)
        require(
            bool(places) == (self.ring is None),
            "positions: give either these (a list of [x, y]) or ring ([least, greatest] "
            f"distance to the first spawn), got {'both' if places else 'neither'}",
        )
        if self.ring is not None:
            least, greatest = pair("ring", self.ring, "ring")
            object.__setattr__(self, "ring", (least, greatest))
            words = f"ring: expected 0 <= least <= greatest, got [{least}, {greatest}]"
            require(least <= greatest, words)
        require(
            not self.switch_ticks or (len(places) == 2 and places[0] != places[1]),
            "switch_ticks: expected two different places in positions, one for each flag, got "
            f"{list(places)}",
        )
        require(
            not (self.switch_ticks and self.interval_ticks),
            "switch_ticks: flags that switch do not move; leave out interval_ticks, got "
            f"{self.interval_ticks}",
        )


class ArenaFlags:
    """The flags of all arenas, each with a random generator that is used for nothing else.

    Attributes:
        place: of the flag that counts, float64 [arenas, 2] in units; replaced as a whole, never
            written in place.
    """

    def __init__(self, scenario: Scenario, generators: Sequence[np.random.Generator]) -> None:
        self._generators = generators
        self.place = np.zeros((len(generators), 2))
        self._obey(scenario)

    def _obey(self, scenario: Scenario) -> None:
        self._scenario, self._positions = scenario, scenario.flag.positions
        places = self._positions if scenario.flag.switch_ticks else ()
        self._both = [np.tile(place, (len(self.place), 1)) for place in places]

    @property
    def sensed(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Places of the first and the second flag, float64 [arenas, 2] in units.

        Of two flags each keeps its sensors, whichever counts; one flag has no second.
        """
        return (self._both[0], self._both[1]) if self._both else (self.place, None)

    def begin(self, arenas: np.ndarray) -> None:
        """Put the flags of the arenas of a mask, bool [arenas], where they stand at first."""
        self._put(np.flatnonzero(arenas), np.zeros(len(self.place), dtype=np.int64))

    def change(self, scenario: Scenario, ticks: np.ndarray) -> None:
        """Stand as another scenario says, `ticks` [arenas] after each world was made.

        Of two flags the same one goes on to count, and one that was drawn in a ring stays there.
        """
        before, ring = self._positions, self._scenario.flag.ring
        self._obey(scenario)
        flag, place = scenario.flag, self.place.copy()
        for arena, moves in enumerate(ticks // (flag.interval_ticks or 1)):
            if flag.switch_ticks:
                place[arena] = flag.positions[before.index(tuple(place[arena]))]
            elif flag.ring is None:
                place[arena] = flag.positions[moves % len(flag.positions)]
            elif flag.ring != ring or scenario.in_wall(*place[arena]):
                place[arena] = self._draw(self._generators[arena])
        self.place = place

    def update(self, ticks: np.ndarray) -> bool:
        """Move the flags that are due, or let the other one count; whether any was due.

        `ticks`, int64 [arenas], are those since the world of each arena was made, 1 or more.
        """
        interval = self._scenario.flag.interval_ticks or self._scenario.flag.switch_ticks
        due = np.flatnonzero(ticks % interval == 0) if interval else ()
        if len(due):
            self._put(due, ticks // interval)
        return len(due) > 0

    def _put(self, arenas: Sequence[int] | np.ndarray, moves: np.ndarray) -> None:
        """Put the flags of some arenas where they stand after `moves` [arenas]."""
        place = self.place.copy()
        for arena in arenas:
            place[arena] = self._next(arena, moves[arena])
        self.place = place

    def _next(self, arena: int, move: int) -> tuple[float, float]:
        """Where the flag that counts stands after a move; its first place is move 0."""
        rng, positions = self._generators[arena], self._positions
        if self._scenario.flag.ring is not None:
            return self._draw(rng)
        if not self._scenario.flag.switch_ticks:
            return positions[move % len(positions)]
        if move == 0:
            return positions[rng.integers(2)]
        return positions[1 if tuple(self.place[arena]) == positions[0] else 0]

    def _draw(self, rng: np.random.Generator) -> tuple[float, float]:
        """Draw a place in the ring that is not inside a wall."""
        assert self._scenario.flag.ring is not None
        spawn = self._scenario.spawns[0]
        for _ in range(_TRIES):
            angle, radius = rng.uniform(0.0, 2 * math.pi), rng.uniform(*self._scenario.flag.ring)
            x, y = spawn.x + radius * math.cos(angle), spawn.y + radius * math.sin(angle)
            if not self._scenario.in_wall(x, y):
                return x, y
        raise ScenarioError("flag.ring: found no place outside the walls; move the walls")
