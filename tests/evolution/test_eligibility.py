from __future__ import annotations

from fractions import Fraction

import pytest

from neatq_torch.evolution import interval_ticks
from neatq_torch.evolution.rtneat import replacements_until


def test_the_law_of_eligibility_gives_40_ticks_for_50_robots() -> None:
    assert interval_ticks(1000, 50, 0.5) == 40.0


def test_an_interval_may_be_shorter_than_a_tick() -> None:
    assert interval_ticks(10, 50, 0.5) == 0.4
    assert replacements_until(Fraction(2 * 50, 10), 0.5) == 5


@pytest.mark.parametrize("fraction", [0.1, 0.3, 0.7])
def test_intervals_are_counted_without_rounding(fraction: float) -> None:
    # 1000 / (10 f) is no whole number of ticks, but 10 f of them are exactly one life.
    assert replacements_until(10, fraction) == round(10 * fraction)
    assert replacements_until(Fraction(999 * 10, 1000), fraction) == round(10 * fraction) - 1


def test_the_same_law_counts_lives_that_end_with_episodes() -> None:
    # One for every 1 / 0.3 lives: with the 4th, the 7th and the 10th.
    assert [replacements_until(lives, 0.3) for lives in range(11)] == [
        0,
        0,
        0,
        0,
        1,
        1,
        1,
        2,
        2,
        2,
        3,
    ]
    # In floating point 0.29 * 100 is 28.999999999999996.
    assert replacements_until(100, 0.29) == 29
