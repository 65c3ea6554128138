"""The table that compares the published arms with their specification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neatq_experiments import arena
from neatq_experiments.arena import ARENA, arena_table, draw_arms, quarter_means, run_arm
from neatq_experiments.published import published_curves
from neatq_experiments.seeds import Result, SeedTask


def curves(*values: float, rows: int) -> list[Result]:
    return [{"mean_distance": [value] * rows} for value in values]


def test_quarters_and_last_tenth_by_hand() -> None:
    curve = np.arange(40.0)[None]
    assert quarter_means(curve, 40).tolist() == [[4.5, 14.5, 24.5, 34.5, 37.5]]


def test_quarters_that_are_not_over_are_left_out() -> None:
    assert quarter_means(np.arange(25.0)[None], 40).tolist() == [[4.5, 14.5]]


def test_the_difference_stands_beside_what_is_allowed() -> None:
    # Two seeds at 60 and 64: mean 62, standard error 2; the specification has 56.3 and 7.5.
    ours, specification, apart = arena_table(
        {"flag-rtneat": curves(60, 64, rows=400)}
    ).splitlines()[2:]
    assert "| 2 | 62.0 ± 2.0 |" in ours
    assert "| 8 | 116 | 81 | 69 | 58 | 56.3 |" in specification
    assert apart.endswith("| +5.7 (11.5) |")


def test_what_the_specification_does_not_give_is_left_empty() -> None:
    text = arena_table({"wall-qlearning": curves(267, 267, rows=700)})
    assert text.splitlines()[-1] == "| | specification | 1 | 268 | 268 | 268 | 266 |  |"


def test_every_panel_has_a_published_curve_of_the_same_length() -> None:
    published = published_curves()
    lengths = {task: published[task, "rtneat"][-1, 0] for task in ("flag", "moving", "wall")}
    assert lengths == {"flag": 396, "moving": 596, "wall": 696}
    figure = draw_arms({cell: curves(1, 1, rows=400) for cell in ARENA.arms})
    assert len(figure.axes) == 6


def test_a_seed_has_the_same_curve_whatever_runs_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(arena.TASK_TICKS, "flag", 800)
    both = run_arm(SeedTask("flag-rtneat", (0, 1), True, tmp_path / "both"))
    alone = run_arm(SeedTask("flag-rtneat", (1,), True, tmp_path / "alone"))
    assert both[1] == alone[0]
    assert len(alone[0]["mean_distance"]) == 2  # a quarter of 800 ticks
