"""A Gymnasium environment as a task: found by its id, checked, read as numbers.

What networks can read and do is decided here: observations become flat vectors, actions are one of
a few choices or a point in a box. Everything else is refused with the remedy.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces.utils import flatten_space

from neatq_envs.actions import MOST_WHOLE_NUMBERS, ActionPart, action_parts, own_actions
from neatq_envs.checks import from_json
from neatq_envs.observations import (
    MOST_OBSERVATIONS,
    flat,
    flat_size,
    holds_images,
    raised_by_environment,
)

PREFIX = "gym:"
MOST_ACTIONS = MOST_OBSERVATIONS

_EXTRAS = ("box2d", "mujoco", "classic-control", "toy-text")
_REGISTER = "register what you wrapped in a module of yours: --task gym:my_module:MyEnv-v0"
_JSON_WORDS = {"True": "true", "False": "false", "None": "null"}


class TaskError(ValueError):
    """A Gymnasium environment cannot be used; the message says why and how to mend it."""


def assignments(texts: Sequence[str]) -> dict[str, Any]:
    """What "name=value" says, several times.

    A value is read as JSON (`true`, `-5.0`, `"text"`, `null`, `[1, 2]`); what is no JSON is a text.
    A `TaskError` names the one that has no name or no value. What no scenario could have (the same
    key twice, lists nested hundreds deep) is a `ScenarioError`.
    """
    values: dict[str, Any] = {}
    for given in texts:
        # What a terminal of a plain locale hands on as bytes is UTF-8.
        text = given.encode(errors="surrogateescape").decode(errors="replace")
        name, equals, value = text.partition("=")
        if not name.isidentifier() or not equals:
            words = f"expected name=value, such as continuous=true; got {text!r}"
            raise TaskError(f"env_kwargs: {words}")
        try:
            values[name] = from_json(_JSON_WORDS.get(value, value))
        except json.JSONDecodeError:
            values[name] = value
    return values


@dataclass(frozen=True, kw_only=True)
class GymnasiumTask:
    """Id and arguments of `gymnasium.make`, such as `continuous` or `max_episode_steps`.

    The id of an environment that `my_module` registers is "my_module:MyEnv-v0".
    """

    id: str
    kwargs: Mapping[str, Any] = field(default_factory=dict)

    def make(self, **more: Any) -> gymnasium.Env[Any, Any]:
        """Make the environment, with further arguments of `gymnasium.make`.

        Raises:
            TaskError: If there is none, something is not installed, or it refuses its arguments.
        """
        kwargs = {"disable_env_checker": True, **self.kwargs, **more}
        try:
            return gymnasium.make(self.id, **kwargs)
        except gymnasium.error.DependencyNotInstalled as error:
            raise TaskError(f"task: {self.id} needs {self._missing(error)}") from error
        except ModuleNotFoundError as error:
            words = f"{error}; a module of your own is found if its folder is in PYTHONPATH"
            raise TaskError(f"task: {self.id}: {words}") from error
        except (gymnasium.error.UnregisteredEnv, gymnasium.error.DeprecatedEnv) as error:
            raise TaskError(f"task: {self._unknown(error)}") from error
        except BaseException as error:
            if not raised_by_environment(error):
                raise
            words = f"{type(error).__name__}: {error}; see --env-kwargs"
            with_what = f"{self.id} cannot be made with {dict(self.kwargs)}"
            raise TaskError(f"task: {with_what}: {words}") from error

    def spec(self) -> EnvSpec:
        """The entry in Gymnasium's registry; the environment must have been made before."""
        return gymnasium.spec(self.id.rpartition(":")[2])

    def _missing(self, error: Exception) -> str:
        entry = str(self.spec().entry_point)
        for extra in _EXTRAS:
            if extra.replace("-", "_") in entry:
                return f'what pip install "gymnasium[{extra}]" brings ({error})'
        return f"something that is not installed: {error}"

    def _unknown(self, error: Exception) -> str:
        known = sorted(gymnasium.registry)
        wanted = self.id.rpartition(":")[2]
        close = difflib.get_close_matches(wanted, known, n=3, cutoff=0.5)
        family = re.compile(re.escape(re.sub(r"-v\d+$", "", wanted)) + r"(-v\d+)?", re.IGNORECASE)
        close += [name for name in known if family.fullmatch(name) and name not in close]
        meant = f"did you mean {' or '.join(close)}? " if close else ""
        return (
            f"Gymnasium knows no {self.id!r} ({error}); {meant}one of your own is "
            "gym:my_module:ID; all others: "
            'python -c "import gymnasium; gymnasium.pprint_registry()"'
        )


@dataclass(frozen=True)
class Interface:
    """What a network reads and does in an environment of these spaces."""

    observation: spaces.Space[Any]
    action: spaces.Space[Any]

    @staticmethod
    def of(env: Any, name: str) -> Interface:
        """The interface of an environment, or a `TaskError` that calls it by its name."""
        _check_observations(env.observation_space, name)
        _check_actions(env.action_space, name)
        return Interface(env.observation_space, env.action_space)

    @property
    def inputs(self) -> int:
        """Numbers that a network reads: entries of a Box, or one for each Discrete value."""
        return flat_size(self.observation) or 0

    @property
    def flat_observation(self) -> spaces.Box | spaces.Discrete:
        """The space of what `read` gives; a Discrete space stays."""
        if isinstance(self.observation, spaces.Box | spaces.Discrete):
            return self.observation
        return flatten_space(self.observation)  # type: ignore[return-value]

    @property
    def choices(self) -> int | None:
        """Actions to choose from; None in a box."""
        return int(self.action.n) if isinstance(self.action, spaces.Discrete) else None

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        """Smallest and largest action, flat; of choices, their number from 0.

        Where actions are whole numbers, k is all that is at least k and below k + 1: each of them
        has an equal share, and the largest bound is one more than the largest number.
        """
        if isinstance(self.action, spaces.Discrete):
            return [0.0], [float(self.action.n) - 1]
        ends = zip(*((part.low, part.end) for part in self._action_parts), strict=True)
        low, high = (np.concatenate(end).tolist() for end in ends)
        return low, high

    def read(self, observation: Any) -> np.ndarray:
        """An observation as numbers, float64 [inputs], before scaling.

        Raises:
            Misfit: If it is none of the space.
        """
        return flat(self.observation, observation)

    def act(self, actions: np.ndarray) -> list[Any]:
        """The environment's own actions for those of rows [rows, actions], clipped to the bounds.

        One for each row, of the type, shape and dtype that `space.sample()` gives.
        """
        if isinstance(self.action, spaces.Discrete):
            actions = actions.astype(np.float64) + float(self.action.start)
        return own_actions(self.action, self._action_parts, actions)

    @cached_property
    def _action_parts(self) -> list[ActionPart]:
        parts = action_parts(self.action)
        assert parts is not None  # checked by `of`
        return parts


def _check_observations(space: Any, name: str) -> None:
    size = flat_size(space)
    begin = f"task: {name} observes"
    fewer = f"an observation of at most {MOST_OBSERVATIONS} numbers, and {_REGISTER}"
    transform = f"gymnasium.wrappers.TransformObservation can make {fewer}"
    if holds_images(space):
        small = (size or 0) <= MOST_OBSERVATIONS
        raise TaskError(
            f"{begin} images ({space}), which are not for these networks: they begin with a link "
            "from every number, and know no neighbours. Observe what is to be seen (places, "
            f"speeds), or let an encoder of yours tell it: {transform}"
            + ("; if it is no picture: gymnasium.wrappers.FlattenObservation" if small else "")
        )
    if size is None or not size:
        raise TaskError(
            f"{begin} {space}, which networks cannot read; supported are Box, Discrete, "
            f"MultiDiscrete, MultiBinary, and Dict and Tuple of them; {transform}"
        )
    if size > MOST_OBSERVATIONS:
        where = f" ({space.shape})" if isinstance(space, spaces.Box) else f" ({space})"
        raise TaskError(
            f"{begin} {size} numbers{where}; supported are at most {MOST_OBSERVATIONS}, as a "
            f"network begins with a link from each; {transform}"
        )


def _check_actions(space: Any, name: str) -> None:
    parts = action_parts(space)
    begin = f"task: {name} has"
    other = f"gymnasium.wrappers.TransformAction can put another space before it, and {_REGISTER}"
    if not parts or not all(part.low.size for part in parts):
        raise TaskError(
            f"{begin} the actions {space}; supported are Discrete, Box with finite bounds, "
            f"MultiDiscrete, MultiBinary, and Dict and Tuple of them; {other}"
        )
    choices = isinstance(space, spaces.Discrete)
    count = int(space.n) if choices else sum(part.low.size for part in parts)
    if count > MOST_ACTIONS:
        what = "actions to choose from" if choices else "numbers in an action"
        raise TaskError(
            f"{begin} {count} {what}; supported are at most {MOST_ACTIONS}, as a network begins "
            f"with a link from every input to each; {other}"
        )
    low, high = (np.concatenate([getattr(part, end) for part in parts]) for end in ("low", "high"))
    with np.errstate(all="ignore"):
        spans = high.astype(np.float32) - low.astype(np.float32)
    if not np.isfinite(spans).all():
        raise TaskError(
            f"{begin} actions without bounds ({space}); supported are finite ones; {other}"
        )
    if any(part.whole and (part.high - part.low >= MOST_WHOLE_NUMBERS).any() for part in parts):
        raise TaskError(
            f"{begin} actions of more than {MOST_WHOLE_NUMBERS} whole numbers ({space}), which "
            f"single precision cannot tell apart; {other}"
        )
    if (low == high).all():
        raise TaskError(
            f"{begin} one action only ({space}): there is nothing to choose, so nothing that "
            "evolution or learning could find; give it another action space"
        )
