"""Checks of what users configure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import pytest

from neatq_torch.kinds import ConfigError, check_fields

Words = Literal["one", "two"]


@dataclass
class Settings:
    share: float = 0.5
    count: int = 1
    rate: float = 0.0
    optional: int | None = None
    word: str = "one"

    def check(self) -> None:
        check_fields(self, share="(0, 1]", count="[1, inf]", optional="[1, inf]", word=Words)
        check_fields(self, rate="[0, inf)")


@pytest.mark.parametrize(
    "fields", [{}, {"share": 1.0}, {"count": float("inf"), "optional": 1}, {"word": "two"}]
)
def test_fields_within_their_limits_pass(fields: dict[str, Any]) -> None:
    Settings(**fields).check()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"share": 0.0}, r"share: expected \(0, 1\], got 0.0"),
        ({"share": 1.5}, r"share: expected \(0, 1\], got 1.5"),
        ({"share": float("nan")}, r"share: expected \(0, 1\], got nan"),
        ({"count": 0}, "count: expected at least 1, got 0"),
        ({"count": None}, "count: expected at least 1, got None"),
        ({"rate": float("inf")}, r"rate: expected \[0, inf\), got inf"),
        ({"optional": 0}, "optional: expected at least 1 or None, got 0"),
        ({"word": "three"}, "word: expected 'one' or 'two', got 'three'"),
    ],
)
def test_a_field_beyond_them_is_named(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Settings(**fields).check()
