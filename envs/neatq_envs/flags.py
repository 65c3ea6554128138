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

    def update(self, tick: int) -> bool:
        """Put the flags where they stand from `tick` on; return whether they were moved."""
        interval = self._scenario.flag.interval_ticks
        if tick and (not interval or tick % interval):
            return False
        if self._scenario.flag.ring is not None:
            self.place = np.array([self._draw(rng) for rng in self._generators])
        else:
            positions = self._scenario.flag.positions
            index = tick // interval % len(positions) if interval else 0
            self.place = np.tile(np.array(positions[index]), (len(self.place), 1))
        return True

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
