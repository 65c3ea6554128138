"""What a user wrote, read and checked: errors say what was expected, what came, how to mend it."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Any


class ScenarioError(ValueError):
    """A scenario that cannot be run, with what is wrong and how to mend it."""


def require(fine: bool, message: str) -> None:
    """Raise the message unless all is fine."""
    if not fine:
        raise ScenarioError(message)


def require_known(where: str, word: object, known: Collection[str], what: str = "value") -> None:
    """Require one of the known words; the error suggests the one that was probably meant."""
    close = difflib.get_close_matches(str(word), known, n=1)
    meant = f'did you mean "{close[0]}"? ' if close else ""
    require(word in known, f'{where}: unknown {what} "{word}"; {meant}known: {", ".join(known)}')


def is_number(value: object) -> bool:
    """Whether a value is a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def require_fields(kind: type, values: Mapping[str, Any], owner: str, **least: int) -> None:
    """Require plain values of the types that a dataclass's fields are annotated with.

    Args:
        kind: the dataclass; fields of other types than text, truth and numbers are not looked at.
        values: of its fields, or of some of them.
        owner: what messages call them.
        least: the least value of fields that hold whole numbers; 0 if not said.
    """
    for entry in fields(kind):
        if entry.name not in values:
            continue
        value, minimum = values[entry.name], least.get(entry.name, 0)
        whole = is_number(value) and isinstance(value, int)
        words, fits = {
            "str": ("a text", isinstance(value, str)),
            "bool": ("true or false", isinstance(value, bool)),
            "float": ("a number (finite)", is_number(value) and math.isfinite(value)),
            "int": (f"a whole number of at least {minimum}", whole and value >= minimum),
        }.get(str(entry.type), ("", True))
        require(fits, f"{owner}.{entry.name}: expected {words}, got {value!r}")


def pair(key: str, value: Any) -> tuple[float, float]:
    """Two finite numbers, such as a place (x, y)."""
    two = isinstance(value, list | tuple) and len(value) == 2 and all(map(is_number, value))
    require(two, f"{key}: expected two numbers, got {value!r}")
    require(all(map(math.isfinite, value)), f"{key}: expected finite numbers, got {value!r}")
    return float(value[0]), float(value[1])


def require_keys(values: Any, kind: type, where: str) -> None:
    """Require an object that has no keys but the fields of a dataclass."""
    words = f"{where}: expected an object {{...}} of keys, got {values!r}"
    require(isinstance(values, Mapping), words)
    for key in values:
        require_known(where, key, [entry.name for entry in fields(kind)], "key")


def read_list(kind: type, values: Any, key: str) -> tuple[Any, ...]:
    """The dataclasses of a list of JSON objects (or of dataclasses)."""
    require(isinstance(values, list | tuple), f"{key}: expected a list, got {values!r}")
    return tuple(_read_entry(kind, entry, f"{key}[{i}]") for i, entry in enumerate(values))


def _read_entry(kind: type, values: Any, where: str) -> Any:
    if isinstance(values, kind):
        return values
    require_keys(values, kind, where)
    try:
        return kind(**values)
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error
    except TypeError as error:  # a key without a default is missing
        needed = [entry.name for entry in fields(kind) if entry.name not in values]
        raise ScenarioError(f"{where}: missing keys, of: {', '.join(needed)}") from error
