"""Tiny comparisons."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neatq_experiments.compare import cells, variants
from neatq_experiments.compare.tables import POINT_TICKS, Point, SeedOutcome, Study
from neatq_experiments.variants import register
from neatq_trainers.config import RunConfig

LIFE_TICKS = 50
register()


@pytest.fixture
def tiny_cells(monkeypatch: pytest.MonkeyPatch) -> int:
    """Make all cells of comparisons short and small; returns their ticks."""

    def tiny(task: str, arm: str, env_kwargs: Any = None) -> RunConfig:
        small = {"robots": 6, "lifetime_ticks": LIFE_TICKS}
        config = variants.config_of(task, arm, small | (env_kwargs or {}))
        return config.changed({"ticks": 10 * POINT_TICKS})

    monkeypatch.setattr(cells, "config_of", tiny)
    return 10 * POINT_TICKS


@pytest.fixture
def study_of() -> Callable[..., Study]:
    """Make a study of the task flag from curves of the team [seeds, rows] by arm."""

    def make(**arms: object) -> Study:
        points, outcomes = [], []
        for arm, curves in arms.items():
            for seed, curve in enumerate(np.asarray(curves, np.float64).tolist()):
                for row, team in enumerate(curve, 1):
                    tick = row * POINT_TICKS
                    values = team, team - 1, None, team / 2, team / 4, row
                    points.append(Point("flag", arm, seed, tick, *values))
                ticks = len(curve) * POINT_TICKS
                extras = ticks, 100 * seed or None, None, seed % 2, 0.5, "0123456789ab"
                outcomes.append(SeedOutcome("flag", arm, seed, *extras))
        return Study(points=tuple(points), outcomes=tuple(outcomes))

    return make
