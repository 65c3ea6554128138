"""A report that can be checked by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from neatq_experiments.compare.figures import by_life, draw_halves, draw_task
from neatq_experiments.compare.report import (
    arms_table,
    configurations,
    differences_table,
    paired_differences,
    reference_of,
    report,
)
from neatq_experiments.compare.tables import Curves, Study

Make = Callable[..., Study]


def test_the_row_of_an_arm_by_hand(study_of: Make) -> None:
    # Last tenth of two rows: the second. Eligible: 1 less; champion: a half; first contact of
    # seed 0 never, of seed 1 at 100: the median of both is not known.
    text = arms_table(study_of(neatq=[[100, 40], [100, 40]]), "flag").splitlines()
    assert text[0].split(" | ")[1:4] == ["seeds", "team: IQM", "team: mean"]
    assert text[2] == (
        "| neatq | 2 | 40.0 [40.0, 40.0] | 40.0 [40.0, 40.0] | 39.0 | – | 20.0 | "  # noqa: RUF001
        "– (1 of 2) | – (0 of 2) | 1 of 2 | 2 | 0.50 |"  # noqa: RUF001
    )


def test_the_median_counts_never_as_later_than_all(study_of: Make) -> None:
    row = arms_table(study_of(neatq=[[1], [1], [1], [1]]), "flag").splitlines()[2]
    assert "| 250 (3 of 4) |" in row  # 100, 200, 300, never


def test_differences_are_of_pairs_of_equal_seeds(study_of: Make) -> None:
    study = study_of(neatq=[[9], [19], [29]], rtneat=[[10], [20], [30], [100]])
    row = differences_table(study, "flag").splitlines()
    assert row[0] == "| arm | pairs | difference to rtneat | probability of improvement |"
    assert row[2].startswith("| neatq | 3 | -1.0 [-1.0, -1.0] | 0.75 [")  # 9 of 12
    assert len(row) == 3


def test_seeds_that_one_arm_lacks_are_no_pairs() -> None:
    tick = np.array([500])
    ours = Curves(np.array([1, 2]), tick, np.array([[21.0], [32.0]]))
    theirs = Curves(np.array([0, 1, 2]), tick, np.array([[10.0], [20.0], [30.0]]))
    assert paired_differences(ours, theirs).tolist() == [1, 2]


def test_rtneat_is_the_reference_wherever_it_stands() -> None:
    assert reference_of(["neatq", "rtneat"]) == "rtneat"
    assert reference_of(["neatq", "described"]) == "neatq"


def test_the_report_says_what_everything_is_and_where_it_comes_from(study_of: Make) -> None:
    text = report(study_of(neatq=[[9], [19]], rtneat=[[10], [20]]))
    for wanted in ("(flag.png)", "within 10 units", "first contact", "Agarwal et al. 2021"):
        assert wanted in text
    assert "| flag | neatq | rtNEAT, and a critic" in text
    assert "newborn.png" not in text  # nobody was born


def test_configurations_name_ticks_seeds_and_digest(study_of: Make) -> None:
    text = configurations(study_of(mine=[[9, 8], [7, 6]]))
    assert "| flag | mine |  | 1,000 | 0-1 | `0123456789ab` |" in text


def test_other_curves_are_behind_where_there_are_some(study_of: Make) -> None:
    study = study_of(rtneat=[[9, 8]])
    curve = np.array([[5.0, 10.0], [100.0, 50.0]])
    (axes,) = draw_task(study, "flag", {"flag": {"one": curve, "two": curve}, "wall": {}}).axes
    assert [line.get_label() for line in axes.lines] == ["rtneat (1 seed)", "one", "two"]
    (axes,) = draw_task(study, "flag", {"wall": {"one": curve}}).axes
    assert len(axes.lines) == 1


def test_halves_are_drawn_for_arms_that_have_newborns(study_of: Make) -> None:
    study = study_of(qlearning=[[9, 8]], rtneat=[[9, 8]])
    assert draw_halves(study) is None
    points = tuple(
        point._replace(newborn=5.0) if point.arm == "rtneat" else point for point in study.points
    )
    figure = draw_halves(Study(points=points, outcomes=study.outcomes))
    assert figure is not None
    assert [len(axes.lines) for axes in figure.axes] == [1, 1]


def test_a_point_of_a_line_is_a_life_in_the_middle_of_its_ticks() -> None:
    curves = Curves(np.array([0]), np.array([500, 1000, 1500]), np.array([[4.0, 6.0, 9.0]]))
    middle, values = by_life(curves)
    assert values.tolist() == [[5, 9]]
    assert middle.tolist() == [5.5, 13]  # of the looks at 100 ... 1000, and at 1100 ... 1500
