"""What a user wrote, read and checked: errors say what was expected, what came, how to mend it."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from typing import Any


class ScenarioError(ValueError):
    """A scenario that cannot be run, with what is wrong and how to mend it."""


def require(fine: bool, message: str) -> None:
    """Raise the message unless all is fine."""
    if not fine:
        raise ScenarioError(message)


def require_known(where: str, word: object, known: Collection[str], what: str = "value") -> None:
    """Require one of the known words; the error suggests the one that was probably meant."""
    if word not in known:
        close = difflib.get_close_matches(str(word), known, n=1)
        meant = f'did you mean "{close[0]}"? ' if close else ""
        known_words = f"{meant}known: {', '.join(known)}"
        raise ScenarioError(f'{where}: unknown {what} "{word}"; {known_words}')


def is_number(value: object) -> bool:
    """Whether a value is a finite number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def require_fields(kind: type, values: Any, where: str = "") -> None:
    """Require an object of fields of a dataclass, with values of the types that they are given.

    `where` is the path by which messages call the object; the outermost one has none.
    """
    owner, types = where or kind.__name__, {entry.name: entry.type for entry in fields(kind)}
    words = f"{owner}: expected an object {{...}} of keys, got {values!r}"
    require(isinstance(values, Mapping), words)
    for name, value in values.items():
        require_known(owner, name, types, "key")
        typed = str(types[name])
        numbers = isinstance(value, Mapping) and all(map(is_number, value.values()))
        words, fits = {
            "str": ("a text", isinstance(value, str)),
            "bool": ("true or false", isinstance(value, bool)),
            "float": ("a number (finite)", is_number(value)),
            "int": ("a whole number of at least 0", type(value) is int and value >= 0),
            "Mapping[str, float]": ("an object of numbers (finite)", numbers),
            "list": ("a list", isinstance(value, list | tuple)),
        }.get("list" if typed.endswith("...]") else typed, ("", True))
        path = f"{where}.{name}" if where else name
        require(fits, f"{path}: expected {words}, got {value!r}")


def pair(key: str, value: Any) -> tuple[float, float]:
    """Two finite numbers, such as a place (x, y)."""
    two = isinstance(value, list | tuple) and len(value) == 2 and all(map(is_number, value))
    require(two, f"{key}: expected two numbers (finite), got {value!r}")
    return float(value[0]), float(value[1])


def read_object(kind: type, values: Any, where: str) -> Any:
    """The dataclass of a JSON object (or of itself); errors name the key by its path."""
    if isinstance(values, kind):
        return values
    require_fields(kind, values, where)
    needed = {entry.name for entry in fields(kind) if entry.default is MISSING}
    missing = ", ".join(sorted(needed - values.keys()))
    require(not missing, f"{where}: missing keys: {missing}")
    try:
        return kind(**values)
    except ScenarioError as error:
        raise ScenarioError(f"{where}.{error}") from error
