"""A Gymnasium environment as a task: found by its id, checked, read as numbers.

What networks can read and do is decided here: observations are flat vectors, actions are one of a
few choices or a point in a box. Everything else is refused with the remedy.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

PREFIX = "gym:"
MOST_OBSERVATIONS = 512
"""Beyond this, a network that begins with a link from every input has too many to evolve."""

_EXTRAS = ("box2d", "mujoco", "classic-control", "toy-text")
_REGISTER = "register what you wrapped in a module of yours: --task gym:my_module:MyEnv-v0"
_JSON_WORDS = {"True": "true", "False": "false", "None": "null"}


class TaskError(ValueError):
    """A Gymnasium environment cannot be used; the message says why and how to mend it."""


def assignments(texts: Sequence[str]) -> dict[str, Any]:
    """What "name=value" says, several times.

    A value is read as JSON (`true`, `-5.0`, `"text"`, `null`, `[1, 2]`); what is no JSON is a text.
    A `TaskError` names the one that has no name or no value.
    """
    values: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not name.isidentifier() or not equals:
            words = f"expected name=value, such as continuous=true; got {text!r}"
            raise TaskError(f"env_kwargs: {words}")
        try:
            values[name] = json.loads(_JSON_WORDS.get(value, value))
        except ValueError:
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
        except Exception as error:
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
            f"Gymnasium knows no {self.id!r} ({error}); {meant}all ids: "
            'python -c "import gymnasium; gymnasium.pprint_registry()"'
        )


@dataclass(frozen=True)
class Interface:
    """What a network reads and does in an environment of these spaces."""

    observation: spaces.Box | spaces.Discrete
    action: spaces.Box | spaces.Discrete

    @staticmethod
    def of(env: Any, name: str) -> Interface:
        """The interface of an environment, or a `TaskError` that calls it by its name."""
        _check_observations(env.observation_space, name)
        _check_actions(env.action_space, name)
        return Interface(env.observation_space, env.action_space)

    @property
    def inputs(self) -> int:
        """Numbers that a network reads: entries of a Box, or one for each Discrete value."""
        if isinstance(self.observation, spaces.Discrete):
            return int(self.observation.n)
        return math.prod(self.observation.shape)

    @property
    def choices(self) -> int | None:
        """Actions to choose from; None in a box."""
        return int(self.action.n) if isinstance(self.action, spaces.Discrete) else None

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        """Smallest and largest action, flat; of choices, their number from 0."""
        if isinstance(self.action, spaces.Discrete):
            return [0.0], [float(self.action.n) - 1]
        low, high = self.action.low, self.action.high
        return low.astype(float).ravel().tolist(), high.astype(float).ravel().tolist()

    def read(self, observation: Any) -> np.ndarray:
        """An observation as numbers, float64 [inputs], before scaling."""
        if isinstance(self.observation, spaces.Discrete):
            place = int(observation) - int(self.observation.start)
            return np.eye(1, self.inputs, place)[0]
        return np.asarray(observation, np.float64).reshape(-1)

    def act(self, actions: np.ndarray) -> Any:
        """The environment's own actions for those of rows [rows, actions], clipped to the bounds.

        A list of numbers, or an array [rows, *shape of the box].
        """
        space = self.action
        if isinstance(space, spaces.Discrete):
            return (actions[:, 0].astype(np.int64) + int(space.start)).tolist()
        own = np.clip(actions.reshape(len(actions), *space.shape), space.low, space.high)
        return own.astype(space.dtype)


def _check_observations(space: Any, name: str) -> None:
    supported = (
        f"supported are Box of at most {MOST_OBSERVATIONS} numbers and Discrete; wrap it, for "
        f"instance with gymnasium.wrappers.FlattenObservation, and {_REGISTER}"
    )
    size = math.prod(space.shape) if isinstance(space, spaces.Box) else 0
    if size and len(space.shape) >= 2 and np.dtype(space.dtype) == np.uint8:
        what = f"images ({space})"
    elif size > MOST_OBSERVATIONS:
        what = f"{size} numbers ({space.shape})"
    elif size or (isinstance(space, spaces.Discrete) and space.n <= MOST_OBSERVATIONS):
        return
    else:
        what = f"{space}, which networks cannot read"
    raise TaskError(f"task: {name} observes {what}; {supported}")


def _check_actions(space: Any, name: str) -> None:
    if isinstance(space, spaces.Discrete):
        return
    supported = "supported are Discrete and Box with finite bounds"
    if isinstance(space, spaces.Box) and math.prod(space.shape):
        if np.isfinite(space.low).all() and np.isfinite(space.high).all():
            return
        raise TaskError(
            f"task: {name} has actions without bounds ({space}); {supported}: give it bounds with "
            "gymnasium.wrappers.TransformAction, and register what you wrapped"
        )
    raise TaskError(f"task: {name} has the actions {space}; {supported}; wrap it, and {_REGISTER}")
