from __future__ import annotations

import pytest

from neatq_torch.evolution import interval_ticks, intervals_until


def test_the_law_of_eligibility_gives_40_ticks_for_50_robots() -> None:
    assert interval_ticks(1000, 50, 0.5) == 40.0


def test_an_interval_may_be_shorter_than_a_tick() -> None:
    assert interval_ticks(10, 50, 0.5) == 0.4
    assert intervals_until(2, 10, 50, 0.5) == 5


@pytest.mark.parametrize("fraction", [0.1, 0.3, 0.7])
def test_intervals_are_counted_without_rounding(fraction: float) -> None:
    # 1000 / (10 f) is no whole number of ticks, but 10 f of them are exactly one life.
    assert intervals_until(1000, 1000, 10, fraction) == round(10 * fraction)
    assert intervals_until(999, 1000, 10, fraction) == round(10 * fraction) - 1
