"""The study that is kept in docs/study still holds: a small part of it, run again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neatq_experiments.compare.cells import outdated
from neatq_experiments.compare.report import report
from neatq_experiments.compare.tables import Curves, read_tables
from neatq_experiments.variants import register
from neatq_trainers.cli import main

STUDY = Path(__file__).resolve().parents[2] / "docs" / "study"
TABLES = sorted(path.parent for path in STUDY.rglob("results.csv.gz"))
EARLIER = ("alone",)
"""Of arms whose settings changed since, as docs/study.md says; to be made again."""
register()


@pytest.mark.parametrize("folder", TABLES, ids=lambda path: path.name)
def test_saved_tables_are_those_of_this_versions_arms(folder: Path) -> None:
    earlier = folder.name in EARLIER
    assert bool(outdated(read_tables(folder))) == earlier
    assert not earlier or "are of an earlier version" in (STUDY.parent / "study.md").read_text()


@pytest.mark.parametrize("folder", TABLES, ids=lambda path: path.name)
def test_the_saved_report_is_made_of_the_saved_tables(folder: Path) -> None:
    assert report(read_tables(folder)) == (folder / "report.md").read_text()


def holds(saved: Curves, fresh: Curves) -> bool:
    """Whether fresh seeds are the saved ones, or on another machine have a mean like theirs.

    The interval is that of the mean of as many seeds as are fresh, drawn from the saved ones.
    """
    at = np.isin(saved.ticks, fresh.ticks)
    if np.allclose(saved.values[np.isin(saved.seeds, fresh.seeds)][:, at], fresh.values, rtol=1e-5):
        return True
    last = saved.values[:, at][:, -1]
    drawn = np.random.default_rng(0).choice(last, (2000, len(fresh.seeds))).mean(1)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return low <= fresh.values[:, -1].mean() <= high


@pytest.mark.slow
def test_a_quick_comparison_reproduces_the_saved_one(tmp_path: Path, here: list[str]) -> None:
    arguments = ["compare", "--quick", "--tasks", "flag", "--arms", "rtneat", "replay"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    fresh = read_tables(tmp_path)
    assert fresh.arms("flag") == ["rtneat", "replay"]
    ends = []
    for arm in fresh.arms("flag"):
        before, now = (one.curves("flag", arm, "team") for one in (read_tables(STUDY), fresh))
        assert holds(before, now), arm
        ends.append(now.values[:, -1].mean())
    assert ends[1] < 0.7 * ends[0]  # what was found shows after 4,000 ticks
