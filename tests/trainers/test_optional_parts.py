"""Parts of a run that are off unless asked for."""

from __future__ import annotations

from typing import Any

import pytest

from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset
from neatq_trainers.config import RunConfig


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"learner.target_tau": 0.0}, r"target_tau: expected \(0, 1\] or None"),
    ],
)
def test_what_makes_no_sense_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        preset("flag", "replay").changed(changes)


def small(arm: str, changes: dict[str, Any]) -> RunConfig:
    config = preset("flag", arm, env_kwargs={"robots": 6, "lifetime_ticks": 80})
    return config.changed({"batch_ticks": 40} | changes)
