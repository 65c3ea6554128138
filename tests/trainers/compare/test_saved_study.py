"""The study that is kept in docs/study still holds: a small part of it, run again."""

from __future__ import annotations

from pathlib import Path

import pytest

from neatq_trainers.cli import main
from neatq_trainers.compare.check import check_against, outdated
from neatq_trainers.compare.tables import read_tables

STUDY = Path(__file__).resolve().parents[3] / "docs" / "study"
TABLES = sorted(path.parent for path in STUDY.rglob("results.csv.gz"))


@pytest.mark.parametrize("folder", TABLES, ids=lambda path: path.name)
def test_saved_tables_are_those_of_this_versions_arms(folder: Path) -> None:
    assert outdated(read_tables(folder)) == []


@pytest.mark.slow
def test_a_quick_comparison_reproduces_the_saved_one(tmp_path: Path) -> None:
    arguments = ["compare", "--quick", "--tasks", "flag", "--arms", "rtneat", "neatq"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    verdicts = check_against(read_tables(STUDY), read_tables(tmp_path))
    assert [(one.task, one.arm) for one in verdicts] == [("flag", "rtneat"), ("flag", "neatq")]
    for verdict in verdicts:
        assert verdict.holds, verdict
    far, near = (verdict.fresh for verdict in verdicts)
    assert near < 0.7 * far  # what was found shows after 4,000 ticks
