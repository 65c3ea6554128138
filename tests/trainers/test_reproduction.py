"""The table that compares the published arms with their specification."""

from __future__ import annotations

import numpy as np

from neatq_trainers.reproduction import (
    SPECIFICATION,
    Curves,
    draw,
    published_curves,
    summary,
    table,
)


def test_quarters_and_last_tenth_by_hand() -> None:
    curve = np.arange(40.0)[None]
    assert summary(curve).tolist() == [[4.5, 14.5, 24.5, 34.5, 37.5]]


def test_the_difference_stands_beside_what_is_allowed() -> None:
    # Two seeds at 60 and 64: mean 62, standard error 2; the specification has 56.3 and 7.5.
    curves: Curves = {("flag", "rtneat"): np.array([[60.0] * 40, [64.0] * 40])}
    ours, specification, apart = table(curves).splitlines()[2:]
    assert "| 2 | 62.0 ± 2.0 |" in ours
    assert "| 8 | 116 | 81 | 69 | 58 | 56.3 |" in specification
    assert apart.endswith("| +5.7 (11.5) |")


def test_what_the_specification_does_not_give_is_left_empty() -> None:
    curves: Curves = {("wall", "qlearning"): np.full((2, 40), 267.0)}
    assert table(curves).splitlines()[-1] == "| | specification | 1 | 268 | 268 | 268 | 266 |  |"


def test_every_panel_has_a_published_curve_of_the_same_length() -> None:
    published = published_curves()
    lengths = {task: published[task, "rtneat"][-1, 0] for task in ("flag", "moving", "wall")}
    assert lengths == {"flag": 396, "moving": 596, "wall": 696}
    figure = draw({key: np.ones((3, 400)) for key in SPECIFICATION})
    assert len(figure.axes) == 6
