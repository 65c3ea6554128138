"""The script to copy runs, and its robots learn and breed."""

from __future__ import annotations

from pathlib import Path

import pytest

import neatq_trainers.minimal
from neatq_trainers.minimal import main


def test_the_script_runs_to_its_first_births(capsys: pytest.CaptureFixture[str]) -> None:
    distance = main(ticks=1200)
    # Standing at the spawn is 267 away; the wall stops those who run straight at 139.
    assert 139 < distance < 300
    assert "tick   1000  mean distance" in capsys.readouterr().out


def test_it_fits_on_a_page() -> None:
    assert len(Path(neatq_trainers.minimal.__file__).read_text().splitlines()) <= 80
