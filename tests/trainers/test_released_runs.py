"""Run folders of earlier releases are read, used and gone on with.

Those of a release were made by its own code; NAME-resumed.csv are the metrics that it wrote when it
went on with them itself.
"""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import neatq_torch as nq

AVERAGED = ["mean_distance", "eligible_mean_distance", "newborn_mean_distance", "champion_distance"]
"""Of a row these were the distances at its last tick, and are means over its ticks."""
RELEASES = Path(__file__).parents[1] / "data"
LATER: dict[str, dict[str, Any]] = {"arena": {"ticks": 320}, "gymnasium": {"generations": 2}}
FOLDERS = sorted(path for path in RELEASES.glob("release-*/*") if path.is_dir())
pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture(params=FOLDERS, ids=lambda path: f"{path.parent.name}-{path.name}")
def released(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return Path(shutil.copytree(request.param, tmp_path / request.param.name))


def test_there_are_released_runs() -> None:
    assert {path.name for path in FOLDERS} == LATER.keys()


def test_a_released_run_is_read(released: Path) -> None:
    run = nq.load_run(released)
    unit = run.config.length[0]
    assert run.read()["done"][unit] >= run.config.length[1]
    assert run.metrics()["arena"].tolist() == ([0, 0] if unit == "ticks" else [0])
    result = run.result()
    assert (result is None) == (unit == "ticks")
    assert run.champion().observation_schema == run.config.world.schema


def test_the_champion_of_a_released_run_acts(released: Path) -> None:
    policy = nq.load_policy(released)
    run = nq.load_run(released)
    inputs = run.champion().input_ids.size
    action = np.asarray(policy(np.full(inputs, 0.5, np.float32)))
    assert np.isfinite(action).all()


def test_a_released_run_goes_on_as_it_would_have_then(released: Path) -> None:
    run = nq.resume(released, workers=1, **LATER[released.name])
    (there,) = [path for path in FOLDERS if path.name == released.name]
    with there.with_name(f"{there.name}-resumed.csv").open(newline="") as file:
        wanted = list(csv.DictReader(file))
    metrics = run.metrics()
    for name, column in metrics.items():
        expected = [float(row[name] or "nan") for row in wanted]
        if name in AVERAGED:  # since then: the row that was not there yet
            expected, column = expected[:-1], column[:-1]
        # Bits may depend on the processor; more than they may not.
        assert column.tolist() == pytest.approx(expected, rel=1e-3, nan_ok=True), name
    assert len(wanted) == (3 if released.name == "arena" else 2)
