"""What a user wrote, read and checked: errors say what was expected, what came, how to mend it."""

from __future__ import annotations

import difflib
import json
import math
import reprlib
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from typing import Any

_FAR = 1_000_000
_PLACE = (-_FAR, _FAR, "units; farther away, the way of a tick is lost in rounding")
_SIZE = (0.01, _FAR, "units; smaller, contacts are lost in rounding")
_TICKS = (0, 1_000_000_000, "ticks; longer than any run")
_LIMITS: dict[str, tuple[float, float, str]] = {
    "x": _PLACE,
    "y": _PLACE,
    "positions": _PLACE,
    "ring": (0, _FAR, "units, 0 <= least <= greatest"),
    "width": _SIZE,
    "height": _SIZE,
    "robot_radius": _SIZE,
    "max_speed": (0.0001, _FAR, "units per tick"),
    "angle_rad": (-2 * math.pi, 2 * math.pi, "radians; a whole turn is 2 pi"),
    "max_turn_rad": (0, math.pi, "radians, 0..pi"),
    "jitter": (0, 1000, "units; each place is compared with each wall"),
    "robots": (1, 100_000, "at least 1; each is a body and a network in memory"),
    "lifetime_ticks": _TICKS,
    "interval_ticks": _TICKS,
    "switch_ticks": _TICKS,
    "hit_points": (1, 100_000, "hits"),
    "reward_weights": (-_FAR, _FAR, "rewards are numbers of float32"),
}
"""Least and greatest value of each number of a scenario, and why or in which unit."""
_MOST = {"walls": 1000, "spawns": 1000, "positions": 10_000, "turrets": 1000}
"""Entries of each list: each wall is looked for by each ray of each robot."""
_LONGEST_NAME = 200

_short = reprlib.Repr()
_short.maxstring = _short.maxother = 80


class ScenarioError(ValueError):
    """A scenario that cannot be run, with what is wrong and how to mend it."""


def require(fine: bool, message: str) -> None:
    """Raise the message unless all is fine."""
    if not fine:
        raise ScenarioError(message)


def require_known(where: str, word: object, known: Collection[str], what: str = "value") -> None:
    """Require one of the known words; the error suggests the one that was probably meant."""
    if word not in known:
        word = str(word) if len(str(word)) <= _LONGEST_NAME else shown(word)
        close = difflib.get_close_matches(word, known, n=1)
        meant = f'did you mean "{close[0]}"? ' if close else ""
        known_words = f"{meant}known: {', '.join(known)}"
        raise ScenarioError(f'{where}: unknown {what} "{word}"; {known_words}')


def shown(value: object) -> str:
    """What came, for a message: cut where it is long, deep or has thousands of digits."""
    try:
        return _short.repr(value)
    except ValueError:
        return "a number of thousands of digits"


def from_json(text: str) -> Any:
    """The value of a JSON text; a whole number of thousands of digits is infinite.

    Raises:
        json.JSONDecodeError: If it is no JSON.
        ScenarioError: If a key is given twice, or lists are nested hundreds deep.
    """
    try:
        return json.loads(text, object_pairs_hook=_once, parse_int=_whole)
    except RecursionError as error:
        raise ScenarioError("expected a scenario, got lists nested hundreds deep") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ScenarioError(f"the key {shown(twice)} is given twice; keep one of them")
    return values


def _whole(digits: str) -> float:
    return int(digits) if len(digits) < 1000 else math.copysign(math.inf, float(digits[:2]))


def is_number(value: object) -> bool:
    """Whether a value is a number, finite or not; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number_fault(name: str, value: object, *, whole: bool = False) -> str:
    """What is expected of a number of a scenario; "" if it is."""
    least, most, why = _LIMITS[name]
    right = type(value) is int if whole else is_number(value)
    if right and least <= value <= most:  # type: ignore[operator]
        return ""
    kind = "a whole number" if whole else "a number (finite)"
    ends = " to ".join(f"{end:,}" if isinstance(end, int) else f"{end:g}" for end in (least, most))
    return f"{kind} from {ends} ({why})"


def _fault(name: str, typed: str, value: Any) -> str:
    """What is expected of a field of this type; "" if it is."""
    if typed in ("int", "float"):
        return _number_fault(name, value, whole=typed == "int")
    if typed == "str":
        fine = isinstance(value, str) and value.isprintable() and 0 < len(value) <= _LONGEST_NAME
        return "" if fine else f"a text of 1 to {_LONGEST_NAME} printable characters"
    if typed == "bool":
        return "" if isinstance(value, bool) else "true or false"
    if typed == "Mapping[str, float]":
        if not isinstance(value, Mapping):
            return "an object of numbers"
        return max((_number_fault(name, one) for one in value.values()), default="")
    if typed.endswith("...]"):
        most = _MOST[name]
        fine = isinstance(value, list | tuple) and len(value) <= most
        return "" if fine else f"a list of at most {most:,}"
    return ""


def require_fields(kind: type, values: Any, where: str = "") -> None:
    """Require an object of fields of a dataclass, with values of their types and in their limits.

    `where` is the path by which messages call the object; the outermost one has none.
    """
    owner, types = where or kind.__name__, {entry.name: entry.type for entry in fields(kind)}
    if not isinstance(values, Mapping):
        raise ScenarioError(f"{owner}: expected an object {{...}} of keys, got {shown(values)}")
    for name, value in values.items():
        require_known(owner, name, types, "key")
        if fault := _fault(name, str(types[name]), value):
            path = f"{where}.{name}" if where else name
            raise ScenarioError(f"{path}: expected {fault}, got {shown(value)}")


def require_alike(before: Any, after: Any, changeable: Collection[str]) -> None:
    """Require that two of a dataclass differ in nothing but the fields that may change."""
    for name in (entry.name for entry in fields(before)):
        own, other = getattr(before, name), getattr(after, name)
        require(
            own == other or name in changeable,
            f"{name}: expected {shown(own)}, as it was, got {shown(other)}; while robots live only "
            f"{', '.join(changeable)} may change",
        )


def pair(key: str, value: Any, limits: str) -> tuple[float, float]:
    """Two numbers within the limits of a field, such as a place (x, y)."""
    two = isinstance(value, list | tuple) and len(value) == 2
    fault = max(_number_fault(limits, one) for one in value) if two else "two numbers"
    require(not fault, f"{key}: expected {fault}, got {shown(value) if fault else ''}")
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
