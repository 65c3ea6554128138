"""Where lives begin and where the flag stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neatq_envs.checks import ScenarioError, pair, require_finite, require_whole


@dataclass(frozen=True, kw_only=True)
class Spawn:
    """Where lives begin: (x, y) plus a whole number from -jitter to jitter - 1 on each axis."""

    x: float
    y: float
    jitter: int = 20

    def __post_init__(self) -> None:
        require_finite(self, "spawn")
        require_whole("spawn", "jitter", self.jitter, minimum=0)

    def offsets(self) -> np.ndarray:
        """Every offset of one axis that a robot may get."""
        return np.arange(-self.jitter, max(self.jitter, 1))


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
        require_whole("flag", "interval_ticks", self.interval_ticks, minimum=0)
        places = tuple(pair("flag.positions", place) for place in self.positions)
        object.__setattr__(self, "positions", places)
        if bool(places) == (self.ring is not None):
            raise ScenarioError(
                "flag: give either positions (a list of [x, y]) or ring ([least, greatest] "
                f"distance to the first spawn), got {'both' if places else 'neither'}"
            )
        if self.ring is not None:
            least, greatest = pair("flag.ring", self.ring)
            object.__setattr__(self, "ring", (least, greatest))
            if not 0 <= least <= greatest:
                raise ScenarioError(
                    f"flag.ring: expected 0 <= least <= greatest, got [{least}, {greatest}]"
                )
        self._check_switch()

    def _check_switch(self) -> None:
        require_whole("flag", "switch_ticks", self.switch_ticks, minimum=0)
        if not self.switch_ticks:
            return
        if len(self.positions) != 2 or self.positions[0] == self.positions[1]:
            raise ScenarioError(
                "flag.switch_ticks: expected two different places in flag.positions, one for each "
                f"flag, got {list(self.positions)}"
            )
        if self.interval_ticks:
            raise ScenarioError(
                "flag.switch_ticks: flags that switch do not move; leave out "
                f"flag.interval_ticks, got {self.interval_ticks}"
            )
