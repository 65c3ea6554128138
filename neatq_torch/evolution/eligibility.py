"""The law of eligibility: how often a population of living robots can replace one.

A share I of the population P is too young to be judged if every n = m / (|P| I) ticks one
robot is replaced and each is judged at the age of m ticks (Stanley, Bryant & Miikkulainen 2005).
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache


def interval_ticks(life_ticks: int, robots: int, ineligible_fraction: float) -> float:
    """Return the ticks between two replacements; below 1 if several fall on one tick."""
    return float(life_ticks / (robots * _exact(ineligible_fraction)))


def intervals_until(tick: int, life_ticks: int, robots: int, ineligible_fraction: float) -> int:
    """Return how many whole intervals have passed at a tick."""
    share = _exact(ineligible_fraction)
    return tick * robots * share.numerator // (life_ticks * share.denominator)


@lru_cache
def _exact(fraction: float) -> Fraction:
    # In floating point 0.3 is a little less than 3/10, and multiples of the interval would
    # come a tick late now and then.
    return Fraction(fraction).limit_denominator(1_000_000)
