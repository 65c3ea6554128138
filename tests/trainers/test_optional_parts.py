"""Parts of a run that are off unless asked for."""

from __future__ import annotations

import pytest

from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"target_tau: expected \(0, 1\] or None"):
        preset("flag", "replay").changed({"learner.target_tau": 0.0})


def test_teachers_are_refused_where_nobody_stands_at_a_place_or_lives_on() -> None:
    with pytest.raises(ConfigError, match="teacher_mutation: expected None, as explorers"):
        preset("gym:Pendulum-v1", "neatq").changed({"learner.teacher_mutation": 0.1})
    with pytest.raises(ConfigError, match="teacher_mutation: expected None, as explorers"):
        preset("flag", "neatq").changed({"population.kind": "neat"})
    assert preset("flag", "neatq", population="neat").learner.teacher_mutation is None
