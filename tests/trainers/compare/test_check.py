"""Whether saved results still hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neatq_trainers.compare.cells import digest
from neatq_trainers.compare.check import check_against, outdated
from neatq_trainers.compare.tables import Study
from neatq_trainers.compare.variants import config_of
from neatq_trainers.config import ConfigError

Make = Callable[..., Study]


def saved_curves() -> np.ndarray:
    """Twenty seeds, four rows: means 100, 90, 80, 70 and a spread of 5."""
    spread = np.random.default_rng(0).normal(0, 5, (20, 4))
    return spread - spread.mean(0) + [100, 90, 80, 70]


def test_the_same_runs_stopped_earlier_hold_wherever_they_lie(study_of: Make) -> None:
    curves = saved_curves()
    curves[:2, 1] = 500.0  # far from all others, and still the same
    (verdict,) = check_against(study_of(rtneat=curves), study_of(rtneat=curves[:2, :2] + 1e-9))
    assert (verdict.task, verdict.arm, verdict.tick) == ("flag", "rtneat", 1000)
    assert verdict.same
    assert verdict.holds
    assert verdict.fresh == pytest.approx(500)


def test_other_runs_hold_within_the_interval_of_a_mean_of_as_many_seeds(study_of: Make) -> None:
    saved = study_of(rtneat=saved_curves())
    # Means of two seeds have a standard error of 5 / sqrt(2): 80 +- 7, roughly.
    (near,) = check_against(saved, study_of(rtneat=[[99, 99, 75], [99, 99, 76]]))
    (far,) = check_against(saved, study_of(rtneat=[[99, 99, 60], [99, 99, 61]]))
    assert (near.same, near.holds, near.fresh) == (False, True, 75.5)
    assert (far.same, far.holds) == (False, False)
    assert near.low == pytest.approx(80 - 7, abs=2)
    assert near.high == pytest.approx(80 + 7, abs=2)


def test_an_arm_that_was_not_saved_is_named(study_of: Make) -> None:
    with pytest.raises(ConfigError, match="expected runs of neatq on flag"):
        check_against(study_of(rtneat=[[1]]), study_of(neatq=[[1]]))


def test_an_arm_that_has_changed_since_is_outdated(study_of: Make) -> None:
    study = study_of(rtneat=[[1]], unknown=[[1]])
    assert outdated(study) == [("flag", "rtneat")]
    now = digest(config_of("flag", "rtneat"))
    same = tuple(one._replace(digest=now) for one in study.outcomes)
    assert outdated(replace(study, outcomes=same)) == []
