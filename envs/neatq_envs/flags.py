"""Where the flags of all arenas stand."""

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
        place: float64 [arenas, 2] in units; replaced as a whole, never written in place.
    """

    def __init__(self, scenario: Scenario, generators: Sequence[np.random.Generator]) -> None:
        self._scenario = scenario
        self._generators = generators
        self.place = np.zeros((len(generators), 2))

    def begin(self, arenas: np.ndarray) -> None:
        """Put the flags of the arenas of a mask, bool [arenas], where they stand at first."""
        self._put(np.flatnonzero(arenas), np.zeros(len(self.place), dtype=np.int64))

    def update(self, ticks: np.ndarray) -> bool:
        """Move the flags that are due; return whether any was.

        Args:
            ticks: since the world of each arena was made, int64 [arenas], greater than 0.
        """
        interval = self._scenario.flag.interval_ticks
        due = np.flatnonzero(ticks % interval == 0) if interval else ()
        if len(due):
            self._put(due, ticks // interval)
        return len(due) > 0

    def _put(self, arenas: Sequence[int] | np.ndarray, moves: np.ndarray) -> None:
        """Put the flags of some arenas where they stand after `moves` [arenas]."""
        positions, place = self._scenario.flag.positions, self.place.copy()
        for arena in arenas:
            if self._scenario.flag.ring is not None:
                place[arena] = self._draw(self._generators[arena])
            else:
                place[arena] = positions[moves[arena] % len(positions)]
        self.place = place

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
