"""Tables that are read again as they were written."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neatq_experiments.compare.tables import (
    RESULTS,
    SEEDS,
    Curves,
    Study,
    read_tables,
    write_tables,
)
from neatq_trainers.folder import RunFolderError

Make = Callable[..., Study]


@pytest.mark.parametrize("compress", [False, True])
def test_what_was_written_is_read(study_of: Make, tmp_path: Path, compress: bool) -> None:
    study = study_of(rtneat=[[140, 1 / 3], [141.5, 90]], neatq=[[130.25, 80]])
    write_tables(study, tmp_path, compress=compress)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == 2 * [".gz" if compress else ".csv"]
    read = read_tables(tmp_path)
    assert read.outcomes == study.outcomes
    assert read.points[1].team == 0.333333  # six digits
    assert read.points[0] == study.points[0]
    assert read.tasks == ["flag"]
    assert read.arms("flag") == ["rtneat", "neatq"]


def test_compressed_tables_are_the_same_bytes_each_time(study_of: Make, tmp_path: Path) -> None:
    study = study_of(rtneat=[[140, 100]])
    for name in ("one", "two"):
        write_tables(study, tmp_path / name, compress=True)
    write_tables(study, tmp_path / "plain")
    one, two = ((tmp_path / name / f"{RESULTS}.gz").read_bytes() for name in ("one", "two"))
    assert one == two
    assert one[4:8] == bytes(4)  # no time
    assert gzip.decompress(one) == (tmp_path / "plain" / RESULTS).read_bytes()


def test_new_tables_take_the_place_of_old_ones_in_the_other_form(
    study_of: Make, tmp_path: Path
) -> None:
    for arm, compress in (("a", False), ("b", True), ("c", False)):
        write_tables(study_of(**{arm: [[1]]}), tmp_path, compress=compress)
        assert read_tables(tmp_path).arms() == [arm]


def test_the_first_lines_by_hand(study_of: Make, tmp_path: Path) -> None:
    write_tables(study_of(rtneat=[[140.5, 100]]), tmp_path)
    assert (tmp_path / RESULTS).read_text().splitlines()[:2] == [
        "task,arm,seed,tick,team,eligible,newborn,champion,nearest,births",
        "flag,rtneat,0,500,140.5,139.5,,70.25,35.125,1",
    ]
    assert (tmp_path / SEEDS).read_text().splitlines()[1] == (
        "flag,rtneat,0,1000,,,0,0.5,0123456789ab"
    )


def test_a_column_is_seeds_by_rows_with_nan_where_it_is_empty(study_of: Make) -> None:
    study = study_of(rtneat=[[8, 4], [10, 6]])
    curves = study.curves("flag", "rtneat", "champion")
    assert (curves.seeds.tolist(), curves.ticks.tolist()) == ([0, 1], [500, 1000])
    assert curves.values.tolist() == [[4, 2], [5, 3]]
    assert np.isnan(study.curves("flag", "rtneat", "newborn").values).all()


def test_the_last_tenth_is_what_comes_after_nine_tenths_of_the_ticks() -> None:
    ticks = 500 * np.arange(1, 41)  # 20,000: rows after tick 18,000 are the last four
    curves = Curves(np.array([7]), ticks, np.arange(40.0)[None])
    assert curves.last_tenth().tolist() == [37.5]
    short = Curves(np.array([7]), ticks[:8], np.arange(8.0)[None])  # 4,000: after 3,600
    assert short.last_tenth().tolist() == [7]


def test_some_tasks_and_arms_can_be_picked(study_of: Make) -> None:
    study = study_of(rtneat=[[8]], neatq=[[4]])
    assert study.only(None, ["neatq"]).arms() == ["neatq"]
    assert study.only(["flag"], None) == study
    with pytest.raises(RunFolderError, match="arms: the tables hold rtneat, neatq; got 'nope'"):
        study.only(None, ["nope"])


@pytest.mark.parametrize(
    ("name", "damage", "pattern"),
    [
        (SEEDS, lambda _: None, r"expected seeds\.csv or seeds\.csv\.gz"),
        (RESULTS, lambda text: text.replace("team", "crew"), "expected the columns task,.* got"),
        (RESULTS, lambda text: text.replace("140", "near"), r"results\.csv, line 2: .*'near'"),
        (RESULTS, lambda text: text.replace("140,", ""), "line 2: zip"),
        (SEEDS, lambda text: text.replace("rtneat", "neatq"), "do not hold the same runs"),
        (SEEDS, lambda text: text.splitlines()[0], "do not hold the same runs"),
    ],
)
def test_tables_that_cannot_be_used_are_named(
    study_of: Make, tmp_path: Path, name: str, damage: Callable[[str], str | None], pattern: str
) -> None:
    write_tables(study_of(rtneat=[[140, 100]]), tmp_path)
    path = tmp_path / name
    text = damage(path.read_text())
    path.unlink() if text is None else path.write_text(text)
    with pytest.raises(RunFolderError, match=pattern):
        read_tables(tmp_path)


def test_a_truncated_archive_is_named(study_of: Make, tmp_path: Path) -> None:
    write_tables(study_of(rtneat=[[140, 100]]), tmp_path, compress=True)
    path = tmp_path / f"{RESULTS}.gz"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(RunFolderError, match=r"results\.csv\.gz: damaged"):
        read_tables(tmp_path)
