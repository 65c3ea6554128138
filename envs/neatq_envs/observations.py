"""What an environment observes, as the numbers that a network reads."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

MOST_OBSERVATIONS = 512
"""Beyond this, a network that begins with a link from every input has too many to evolve."""


class Misfit(ValueError):
    """What an environment gave does not fit its spaces; the message says how."""


def raised_by_environment(error: BaseException) -> bool:
    """Whether an environment failed: its sys.exit must not end a run, Ctrl-C and signals do.

    What a handler of signals raises to end the program is a class of its own.
    """
    return isinstance(error, Exception) or type(error) is SystemExit


def flat_size(space: Any) -> int | None:
    """Numbers of an observation of a space, as `gymnasium.wrappers.FlattenObservation` counts them.

    A Discrete value is as many, of which one is 1. None if networks cannot read the space.
    """
    if isinstance(space, spaces.Dict | spaces.Tuple):
        sizes = [flat_size(part) for _, part in parts_of(space)]
        return None if None in sizes else sum(size for size in sizes if size is not None)
    if isinstance(space, spaces.Discrete):
        return int(space.n)
    if isinstance(space, spaces.MultiDiscrete):
        return int(np.sum(space.nvec))
    if isinstance(space, spaces.Box | spaces.MultiBinary):
        return math.prod(space.shape)
    return None


def holds_images(space: Any) -> bool:
    """Whether an observation is a picture, or holds one."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        return any(holds_images(part) for _, part in parts_of(space))
    if not isinstance(space, spaces.Box) or len(space.shape) < 2:
        return False
    large = math.prod(space.shape) > MOST_OBSERVATIONS and len(space.shape) > 2
    return large or np.dtype(space.dtype) == np.uint8


def flat(space: Any, value: Any) -> np.ndarray:
    """An observation as numbers, float64 [inputs], in Gymnasium's order.

    Raises:
        Misfit: If it is none of the space; the message names the part.
    """
    if isinstance(space, spaces.Box):
        return _array(value, space.shape, "observation").reshape(-1)
    return np.concatenate([*_numbers(space, value, "observation")])


def flat_rows(space: Any, value: Any) -> np.ndarray:
    """Observations of any batch as numbers, float64 [*batch, inputs], each as `flat` reads it."""
    batch = _batch_of(space, value)
    each = (_one_of(space, value, batch, at) if batch else value for at in np.ndindex(batch))
    rows = [flat(space, one) for one in each]
    return np.reshape(rows, (*batch, flat_size(space) or 0))


def input_name(space: Any, index: int, name: str = "observation") -> str:
    """What the number of an index in a flat observation is called: "observation['speed'][0]"."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        for key, part in parts_of(space):
            size = flat_size(part) or 0
            if index < size:
                return input_name(part, index, f"{name}[{key!r}]")
            index -= size
    shape = space.shape if isinstance(space, spaces.Box) else (flat_size(space) or 1,)
    place = [str(one) for one in np.unravel_index(index, shape)] if shape else []
    return f"{name}[{', '.join(place)}]" if place else name


def parts_of(space: spaces.Dict | spaces.Tuple) -> list[tuple[Any, Any]]:
    """The spaces in a space, each with its key or number."""
    if isinstance(space, spaces.Dict):
        return [*space.spaces.items()]
    return [*enumerate(space.spaces)]


def _batch_of(space: Any, value: Any) -> tuple[int, ...]:
    """What stands before the shape of the first part; `flat` tells what is no observation."""
    try:
        while isinstance(space, spaces.Dict | spaces.Tuple):
            key, space = parts_of(space)[0]
            value = value[key]
        return np.shape(value)[: max(np.ndim(value) - len(space.shape), 0)]
    except (LookupError, TypeError, ValueError):
        return ()


def _one_of(space: Any, value: Any, batch: tuple[int, ...], at: tuple[int, ...]) -> Any:
    """The observation at an index of a batch."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        parts = dict(parts_of(space))
        given = value.items() if isinstance(value, Mapping) else enumerate(value)
        own = {k: _one_of(parts[k], one, batch, at) if k in parts else one for k, one in given}
        return own if isinstance(space, spaces.Dict) else [*own.values()]
    if np.shape(value)[: len(batch)] != batch:
        raise Misfit(f"observation: expected a batch {list(batch)} in every part, got {value!r}")
    return np.asarray(value)[at]


def _numbers(space: Any, value: Any, name: str) -> Iterator[np.ndarray]:
    if isinstance(space, spaces.Dict | spaces.Tuple):
        parts, given = parts_of(space), ()
        if isinstance(space, spaces.Dict) and isinstance(value, Mapping):
            given = value.keys()
        elif isinstance(space, spaces.Tuple) and isinstance(value, tuple | list):
            given = range(len(value))
        if {*given} != {key for key, _ in parts}:
            keys = [key for key, _ in parts]
            raise Misfit(f"{name}: expected the parts {keys} of its space, got {value!r}")
        for key, part in parts:
            yield from _numbers(part, value[key], f"{name}[{key!r}]")
    elif isinstance(space, spaces.Discrete):
        yield _one_hot(_array(value, (), name), np.array(space.start), np.array(space.n), name)
    elif isinstance(space, spaces.MultiDiscrete):
        yield _one_hot(_array(value, space.shape, name), space.start, space.nvec, name)
    else:
        yield _array(value, space.shape, name).reshape(-1)


def _array(value: Any, shape: tuple[int, ...], name: str) -> np.ndarray:
    """A value as float64 of a shape."""
    try:
        array = np.asarray(value)
    except ValueError as error:  # lists of unequal length
        raise Misfit(f"{name}: expected numbers of the shape {list(shape)}: {error}") from error
    if array.dtype.kind not in "biuf":
        raise Misfit(f"{name}: expected numbers, got {value!r} ({array.dtype})")
    if array.shape != shape:
        words = f"the shape {list(shape)} that its space has, got {list(array.shape)}"
        raise Misfit(f"{name}: expected {words}")
    return array.astype(np.float64, copy=False)


def _one_hot(numbers: np.ndarray, start: np.ndarray, count: np.ndarray, name: str) -> np.ndarray:
    """A 1 for each of the numbers, start <= number < start + count, among zeros; flat."""
    place, count = (numbers - start).ravel(), count.ravel()
    if not ((place >= 0) & (place < count) & (place == np.floor(place))).all():
        most = (start + count.reshape(start.shape) - 1).tolist()
        words = f"whole numbers from {start.tolist()} to {most}, got {numbers.tolist()}"
        raise Misfit(f"{name}: expected {words}")
    ones = np.zeros(int(count.sum()))
    ones[(np.cumsum(count) - count + place).astype(np.int64)] = 1.0
    return ones
