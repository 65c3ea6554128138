"""Parts of a run that are off unless asked for."""

from __future__ import annotations

from typing import Any

import pytest

from neatq_trainers.compare.variants import changed
from neatq_trainers.config import ConfigError, preset


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"learning.inherited_share": 0.0}, r"inherited_share: expected a number within \(0, 1\]"),
        ({"learning.safe_mutation": 0}, "safe_mutation: expected at least 1 observation"),
        (
            {"learning.inherited_share": 0.5, "learning.inheritance": "darwinian"},
            "inherited_share: expected none with inheritance darwinian, got 0.5",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        changed(preset("flag", "neatq"), changes)
