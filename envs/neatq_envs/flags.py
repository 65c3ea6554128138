"""Where the flags of all arenas stand, and which one counts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from neatq_envs.scenario import Scenario, ScenarioError

_TRIES = 10_000


class Flags:
    """The flags of all arenas, moved by the scenario's schedule.

    Args:
        scenario: gives the schedule.
        generators: one for each arena, used for nothing else.

    Attributes:
        place: of the flag that counts, float64 [arenas, 2] in units; replaced as a whole, never
            written in place.
    """

    def __init__(self, scenario: Scenario, generators: Sequence[np.random.Generator]) -> None:
        self._scenario = scenario
        self._generators = generators
        self._positions = scenario.flag.positions
        self.place = np.zeros((len(generators), 2))
        places = self._positions if scenario.flag.switch_ticks else ()
        self._both = [np.tile(place, (len(generators), 1)) for place in places]

    @property
    def sensed(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Places of the first and the second flag, float64 [arenas, 2] in units.

        Of two flags each keeps its sensors, whichever counts; one flag has no second.
        """
        return (self._both[0], self._both[1]) if self._both else (self.place, None)

    def begin(self, arenas: np.ndarray) -> None:
        """Put the flags of the arenas of a mask, bool [arenas], where they stand at first."""
        self._put(np.flatnonzero(arenas), np.zeros(len(self.place), dtype=np.int64))

    def update(self, ticks: np.ndarray) -> bool:
        """Move the flags that are due, or let the other one count; return whether any was due.

        Args:
            ticks: since the world of each arena was made, int64 [arenas], greater than 0.
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
        """Return where the flag that counts stands after a move; its first place is move 0."""
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
