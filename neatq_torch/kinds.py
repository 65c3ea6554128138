"""Names for the kinds of parts that a run can have, and checks of what users configure."""

from __future__ import annotations

import importlib
import operator
from collections.abc import Callable, Iterator
from typing import Any, get_args

ARMS_PAGE, WORLDS_PAGE = "docs/arms.md", "docs/worlds.md"
"""Where the documentation explains arms, populations and learners, and tasks."""


class ConfigError(ValueError):
    """A run cannot be made as asked; the message says what was expected and how to mend it.

    Example:
        >>> try:
        ...     preset("wall", "best")
        ... except ConfigError as error:
        ...     print(error)
        arm: expected one of rtneat, ...; got 'best' (explained in docs/arms.md)
    """


def check_fields(config: Any, **allowed: Any) -> None:
    """Check fields of a configuration; one whose type has `None` may be None.

    Args:
        config: A dataclass.
        allowed: For each field an interval, such as "(0, 1]" or "[0, inf)", or a `Literal`.

    Raises:
        ConfigError: For the first field that has another value.
    """
    for name, range_ in allowed.items():
        value, words = getattr(config, name), get_args(range_)
        optional = "None" in str(config.__dataclass_fields__[name].type)
        if value is None and optional:
            continue
        if words:
            fits, expected = value in words, " or ".join(repr(word) for word in words)
        else:
            fits, expected = _within(value, range_)
        if not fits:
            also = " or None" if optional else ""
            raise ConfigError(f"{name}: expected {expected}{also}, got {value!r}.")


def _within(value: float | None, interval: str) -> tuple[bool, str]:
    """Whether a number is in "[least, most]" ("(" and ")" leave out that end), in words, too."""
    least, most = interval[1:-1].split(", ")
    above = operator.gt if interval[0] == "(" else operator.ge
    below = operator.lt if interval[-1] == ")" else operator.le
    fits = value is not None and above(value, float(least)) and below(value, float(most))
    plain = interval[0] == "[" and interval.endswith("inf]")
    return fits, f"at least {least}" if plain else interval


def import_own(noun: str, name: str, module: str) -> None:
    """Import the module of a name "module:name", which registers what it has.

    Raises:
        ConfigError: If there is no such module.
    """
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{noun}: {name}: {error}; a module of your own is found if its folder is in PYTHONPATH"
        ) from error


class Kinds:
    """A registry: each kind has a name, a configuration class and what makes it.

    Args:
        noun: What messages call such a part: "learner".
    """

    def __init__(self, noun: str) -> None:
        self.noun = noun
        self._kinds: dict[str, tuple[type, Any]] = {}

    def register(self, name: str, config: type, make: Callable[..., Any]) -> None:
        """Add a kind; the same again changes nothing.

        Args:
            name: What it is called in configurations and on the command line.
            config: Its configuration: a frozen keyword-only dataclass that checks itself, with a
                default for every field, and of no other kind.
            make: What makes it.

        Raises:
            ConfigError: If the name or the class is taken.

        Example:
            >>> register_population("mine", MyConfig, MyPopulation)
            >>> train("wall", population="mine")
        """
        for known, (other, _) in self._kinds.items():
            if (known == name) != (other is config):
                taken = f"the name {name!r}" if known == name else f"{config.__name__} as {known!r}"
                raise ConfigError(f"{self.noun}: {taken} is taken; choose another")
        self._kinds[name] = config, make

    def __iter__(self) -> Iterator[str]:
        return iter(self._kinds)

    def config(self, name: str) -> type:
        """The configuration class of a kind; "module:name" imports the module first.

        Raises:
            ConfigError: If there is no such kind.
        """
        module, colon, own = name.rpartition(":")
        if own not in self._kinds and colon:
            import_own(self.noun, name, module)
        if own not in self._kinds:
            raise ConfigError(
                f"{self.noun}: expected one of {', '.join(self._kinds)}, or module:name where the "
                f"module registers it; got {name!r} (explained in {ARMS_PAGE})"
            )
        return self._kinds[own][0]

    def name_of(self, config: object) -> str:
        """The name of the kind that a configuration belongs to; ConfigError if there is none."""
        for name, (kind, _) in self._kinds.items():
            if kind is type(config):
                return name
        raise ConfigError(
            f"{self.noun}: expected a configuration of one of {', '.join(self._kinds)}; got "
            f"{config!r} (a kind of your own is registered first)"
        )

    def address_of(self, config: object) -> str:
        """The name of a kind by which another process finds it: "module:name" of a user's own."""
        module, name = type(config).__module__, self.name_of(config)
        own = module.partition(".")[0] not in ("neatq_torch", "neatq_trainers", "__main__")
        return f"{module}:{name}" if own else name

    def maker_of(self, config: object) -> Any:
        """What makes the kind that a configuration belongs to."""
        return self._kinds[self.name_of(config)][1]
