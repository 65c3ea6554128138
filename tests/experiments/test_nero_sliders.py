"""NERO's sliders: what a table says of results, and that runs give them."""

from __future__ import annotations

from pathlib import Path

import pytest

from neatq_experiments import nero_sliders
from neatq_experiments.nero_sliders import (
    ARM_NAMES,
    SLIDERS,
    at_both_ends,
    draw_sliders,
    sliders_table,
)
from neatq_experiments.seeds import SeedTask


def test_each_reward_has_both_ends_of_its_slider_and_a_measure() -> None:
    assert len(ARM_NAMES) == len(set(ARM_NAMES)) == 2 * 2 * 6
    assert "neatq-avoid_fire-down" in ARM_NAMES


def test_the_table_says_whether_a_reward_moves_its_measure_the_right_way() -> None:
    def of(*hits: float) -> list[dict[str, float]]:
        return [{"seed": seed, "hits": one} for seed, one in enumerate(hits)]

    results = {
        "rtneat-hit_target-up": of(5.0, 6.0, 7.0),
        "rtneat-hit_target-down": of(1.0, 2.0, 3.0),
        "neatq-hit_target-up": of(1.0, 2.0, 9.0)[1:],
        "neatq-hit_target-down": of(1.0, 5.0, 12.0, 1.0),
    }
    # Of seeds that have both ends.
    assert at_both_ends(results, "neatq", "hit_target").tolist() == [[2.0, 9.0], [5.0, 12.0]]
    assert at_both_ends(results, "neatq", "avoid_fire").size == 0
    rows = sliders_table(results).splitlines()[2:]
    assert len(rows) == 2
    assert rows[0].endswith("| 4 [4, 4] | yes |")
    assert "| neatq | 2 | 5.5 [2, 9] | 8.5 [5, 12] | -3 [-3, -3] |" in rows[1]
    assert rows[1].endswith("| no: the other way |")
    results["neatq-hit_target-down"] = of(1.0, 0.0, 12.0)
    assert sliders_table(results).endswith("| not told apart |\n")


@pytest.mark.parametrize("arm", ["rtneat-stand_ground-up", "neatq-hit_target-down"])
def test_a_run_measures_all_that_a_team_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arm: str
) -> None:
    monkeypatch.setattr(nero_sliders, "QUICK_TICKS", 200)
    monkeypatch.setattr(nero_sliders, "FIELD", {**nero_sliders.FIELD, "robots": 6})
    results = nero_sliders.run_slider(SeedTask(arm, (3, 4), True, tmp_path))
    assert len(results) == 2
    assert results[0] != results[1]
    results = [{"seed": seed, **one} for seed, one in zip((3, 4), results, strict=True)]
    for result in results:
        assert set(result) == {"seed"} | {slider.measure for slider in SLIDERS.values()}
    both = {
        arm: results,
        arm.replace("up", "x").replace("down", "up").replace("x", "down"): results,
    }
    assert len(draw_sliders(both).axes) == 6
