"""Checks of what a user wrote: each says what was expected, what came and how to mend it."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection
from dataclasses import fields
from typing import Any


class ScenarioError(ValueError):
    """A scenario that cannot be run, with what is wrong and how to mend it."""


def suggestion(word: str, known: Collection[str]) -> str:
    """Return the known words, led by the one that was probably meant."""
    close = difflib.get_close_matches(word, known, n=1)
    return (f'did you mean "{close[0]}"? ' if close else "") + "known: " + ", ".join(known)


def require_choice(key: str, value: object, known: tuple[str, ...]) -> None:
    """Require one of the known words."""
    if not isinstance(value, str):
        raise ScenarioError(f"{key}: expected one of {', '.join(known)}, got {value!r}")
    if value not in known:
        raise ScenarioError(f'{key}: "{value}" is unknown; {suggestion(value, known)}')


def require_finite(values: Any, owner: str) -> None:
    """Require finite numbers in all fields of a dataclass that are annotated `float`."""
    for entry in fields(values):
        value = getattr(values, entry.name)
        if entry.type == "float" and not (is_number(value) and math.isfinite(value)):
            raise ScenarioError(f"{owner}.{entry.name}: expected a finite number, got {value!r}")


def require_whole(owner: str, name: str, value: object, *, minimum: int) -> None:
    """Require a whole number; true and false are none."""
    if not isinstance(value, int) or isinstance(value, bool) or value < minimum:
        raise ScenarioError(
            f"{owner}.{name}: expected a whole number of at least {minimum}, got {value!r}"
        )


def is_number(value: object) -> bool:
    """Return whether a value is a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def pair(key: str, value: Any) -> tuple[float, float]:
    """Return two finite numbers, such as a place (x, y)."""
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(map(is_number, value)):
        raise ScenarioError(f"{key}: expected two numbers, got {value!r}")
    if not all(map(math.isfinite, value)):
        raise ScenarioError(f"{key}: expected finite numbers, got {value!r}")
    return float(value[0]), float(value[1])
