"""JSON values to a `Scenario`, with errors that name the key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from neatq_envs.checks import ScenarioError, is_number, pair, suggestion
from neatq_envs.scenario import TASKS, FlagSchedule, Scenario, Spawn, load_scenario
from neatq_envs.walls import Wall


def find_scenario(source: Scenario | Mapping[str, Any] | Path | str, **changes: Any) -> Scenario:
    """Return the scenario that somebody means, with `changes` that are not None.

    Args:
        source: a task's name, the path of a JSON file, the content of one, or a scenario.
        **changes: values of `Scenario`; None leaves the scenario's own.

    Raises:
        ScenarioError: there is no such task or file, or the scenario cannot be.
    """
    scenario = _find(source)
    return scenario.replaced(**{key: value for key, value in changes.items() if value is not None})


def _find(source: Scenario | Mapping[str, Any] | Path | str) -> Scenario:
    if isinstance(source, Scenario):
        return source
    if isinstance(source, Mapping):
        return Scenario.from_dict(source)
    if source in TASKS:
        return TASKS[str(source)]
    if not Path(source).suffix and not Path(source).exists():
        raise ScenarioError(
            f"scenario: expected {', '.join(TASKS)} or the path of a scenario file (.json); got "
            f"{str(source)!r}"
        )
    return load_scenario(source)


def parse_scenario(values: Any, defaults: Scenario) -> Scenario:
    """Return `defaults` with the keys of `values` put in place.

    Raises:
        ScenarioError: naming the key that is unknown, of a wrong type or impossible.
    """
    known = {entry.name: entry.type for entry in fields(Scenario)}
    _check_keys(values, known, "the scenario")
    changes = dict(values)
    if "walls" in changes:
        changes["walls"] = _parse_list(Wall, changes["walls"], "walls")
    if "spawns" in changes:
        changes["spawns"] = _parse_list(Spawn, changes["spawns"], "spawns")
    if "flag" in changes:
        changes["flag"] = _parse_flag(changes["flag"])
    if not isinstance(changes.get("reward_weights", {}), Mapping):
        raise ScenarioError(
            "reward_weights: expected an object of names and numbers, "
            f"got {changes['reward_weights']!r}"
        )
    for key, value in changes.items():
        _check_plain(key, value, str(known[key]))
    return defaults.replaced(**changes)


def _check_keys(values: Any, known: Mapping[str, Any], where: str) -> None:
    if not isinstance(values, Mapping):
        raise ScenarioError(f"{where}: expected an object {{...}} of keys, got {values!r}")
    for key in values:
        if key not in known:
            raise ScenarioError(f'{where}: unknown key "{key}"; {suggestion(str(key), known)}')


def _check_plain(key: str, value: Any, wanted: str) -> None:
    """Check the keys that hold one JSON value; lists and objects have parsers of their own."""
    right = {
        "str": isinstance(value, str),
        "bool": isinstance(value, bool),
        "float": is_number(value),
        "int": isinstance(value, int) and not isinstance(value, bool),
    }
    words = {"str": "a text", "bool": "true or false", "float": "a number", "int": "a whole number"}
    if not right.get(wanted, True):
        raise ScenarioError(f"{key}: expected {words[wanted]}, got {value!r}")


def _parse_list(kind: type, values: Any, key: str) -> tuple[Any, ...]:
    if not isinstance(values, list | tuple):
        raise ScenarioError(f"{key}: expected a list, got {values!r}")
    return tuple(_parse_entry(kind, entry, f"{key}[{i}]") for i, entry in enumerate(values))


def _parse_entry(kind: type, values: Any, where: str) -> Any:
    _check_keys(values, {entry.name: entry.type for entry in fields(kind)}, where)
    try:
        return kind(**values)
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error
    except TypeError as error:  # a key without a default is missing
        needed = [entry.name for entry in fields(kind) if entry.name not in values]
        raise ScenarioError(f"{where}: missing keys, of: {', '.join(needed)}") from error


def _parse_flag(values: Any) -> FlagSchedule:
    _check_keys(values, {entry.name: entry.type for entry in fields(FlagSchedule)}, "flag")
    changes = dict(values)
    places = changes.get("positions", ())
    if not isinstance(places, list | tuple):
        raise ScenarioError(f"flag.positions: expected a list of [x, y], got {places!r}")
    changes["positions"] = tuple(
        pair(f"flag.positions[{number}]", place) for number, place in enumerate(places)
    )
    return FlagSchedule(**changes)
