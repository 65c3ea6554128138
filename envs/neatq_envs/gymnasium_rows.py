"""A Gymnasium environment many times side by side: row i has an environment of its own."""

from __future__ import annotations

import contextlib
import traceback
import warnings
from pathlib import Path
from typing import Any, Protocol, Self

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from neatq_envs.gymnasium_task import GymnasiumTask, Interface, TaskError
from neatq_envs.machines import Crew
from neatq_envs.observations import Misfit, raised_by_environment


class RowError(Exception):
    """The environment of a row failed; the message says how."""

    def __init__(self, row: int, message: str) -> None:
        super().__init__(row, message)  # all arguments, so that it can be sent
        self.row, self.message = row, message


Mask = NDArray[np.bool_]
Step = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Observations [rows, inputs], rewards, terminated and truncated [rows]; of others, anything."""


class EnvRows(Protocol):
    """Environments side by side."""

    @property
    def interface(self) -> Interface:
        """How they are read."""
        ...

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask; observations [rows, inputs], theirs count."""
        ...

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step the rows of a mask with actions [rows, actions]."""
        ...

    def close(self) -> None:
        """Close the environments, for good."""
        ...


class SingleRows:
    """An environment for each row, made by `gymnasium.make`; only rows that are meant are called.

    Args:
        task: The environment.
        interface: How it is read.
        renewed: Make a new environment for every episode. Some (BipedalWalker-v3) keep something
            from the episode before that no seed covers.
    """

    def __init__(self, task: GymnasiumTask, interface: Interface, renewed: bool = False) -> None:
        self._task, self.interface, self._renewed = task, interface, renewed
        self._envs: list[gymnasium.Env[Any, Any]] = []

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask."""
        while len(self._envs) < len(mask):
            self._envs.append(self._task.make())
        observations = np.zeros((len(mask), self.interface.inputs))
        with _Failures() as at:
            for at.row in np.flatnonzero(mask).tolist():
                row = at.row
                if self._renewed:
                    close(self._envs[row])
                    self._envs[row] = self._task.make()
                observations[row] = self.interface.read(begin(self._envs[row], int(seeds[row])))
                self._check_action_space(row)
        return observations

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step the rows of a mask."""
        rows = len(mask)
        observations, rewards = np.zeros((rows, self.interface.inputs)), np.zeros(rows)
        terminated, truncated = np.zeros(rows, bool), np.zeros(rows, bool)
        own, read, envs = self.interface.act(actions[mask]), self.interface.read, self._envs
        with _Failures() as at:
            for at.row, action in zip(np.flatnonzero(mask).tolist(), own, strict=True):
                row = at.row
                came: Any = envs[row].step(action)
                if not isinstance(came, tuple) or len(came) != 5:
                    raise Misfit(_STEP_WORDS.format(_words(came)))
                seen, reward, over, cut_off, _ = came
                observations[row], rewards[row] = read(seen), number(reward, "reward")
                terminated[row] = number(over, "terminated")
                truncated[row] = number(cut_off, "truncated")
                if terminated[row] or truncated[row]:
                    self._check_action_space(row)
        return observations, rewards, terminated, truncated

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs:
            close(env)

    def _check_action_space(self, row: int) -> None:
        now, known = self._envs[row].action_space, self.interface.action
        if now is not known and now != known:
            raise Misfit(f"action_space: expected {known} for ever, as it was at first, got {now}")


class DealtRows:
    """Rows dealt to processes, with a `SingleRows` in each; a step is one message to and fro.

    Rows that stand together live together. Arguments are those of `SingleRows`, the processes, and
    what lives in each.

    Attributes:
        remotes: A `kind` each.
    """

    def __init__(
        self,
        task: GymnasiumTask,
        interface: Interface,
        *,
        renewed: bool,
        crew: Crew,
        kind: type[SingleRows] = SingleRows,
    ) -> None:
        self.interface = interface
        self.remotes = crew.open(kind, task, interface, renewed)

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask."""
        return np.concatenate(self._all("reset", mask, seeds))

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step the rows of a mask."""
        observations, *others = zip(*self._all("step", mask, actions), strict=True)
        rewards, terminated, truncated = (np.concatenate(each) for each in others)
        return np.concatenate(observations), rewards, terminated, truncated

    def close(self) -> None:
        """End the processes."""
        for remote in self.remotes:
            remote.close()

    def _all(self, method: str, mask: Mask, values: np.ndarray) -> list[Any]:
        """What a method of each process returns for its part of the rows.

        After an error the processes are closed: what some of them have begun is not known.
        """
        parts = len(self.remotes)
        masks, shares = np.array_split(mask, parts), np.array_split(values, parts)
        answers, first = [], 0
        try:
            for remote, own, share in zip(self.remotes, masks, shares, strict=True):
                remote.ask(method, own, share)
            for remote, own in zip(self.remotes, masks, strict=True):
                answers.append(remote.answer())
                first += len(own)
            return answers
        except Exception as error:
            self.close()
            if isinstance(error, RowError):
                raise RowError(first + error.row, error.message) from error
            raise


class VectorRows:
    """The vectorised environment that an id brings; rows that are not meant take a zero action."""

    def __init__(self, task: GymnasiumTask, interface: Interface) -> None:
        self._task, self.interface = task, interface
        self._env: VectorEnv[Any, Any, Any] | None = None

    @staticmethod
    def of(task: GymnasiumTask, interface: Interface) -> VectorRows | None:
        """The rows of a task whose vectorised environment resets rows by mask and seed.

        None if the id brings no such environment.
        """
        plain = isinstance(interface.observation, spaces.Box | spaces.Discrete)
        plain = plain and isinstance(interface.action, spaces.Box | spaces.Discrete)
        if not plain or task.spec().vector_entry_point is None:
            return None
        rows = VectorRows(task, interface)
        try:
            with contextlib.closing(rows._make(2)) as env:
                if env.metadata.get("autoreset_mode") != AutoresetMode.DISABLED:
                    return None
                seeds: Any = [1, 2**32 - 1]
                env.reset(seed=seeds)
                env.reset(seed=seeds, options={"reset_mask": np.array([True, False])})
        except BaseException as error:
            if raised_by_environment(error):  # whatever it objects to, single ones will do
                return None
            raise
        return rows

    def _make(self, rows: int) -> VectorEnv[Any, Any, Any]:
        mode = "vector_entry_point"
        return gymnasium.make_vec(self._task.id, rows, vectorization_mode=mode, **self._task.kwargs)

    def reset(self, mask: Mask, seeds: NDArray[np.int64]) -> np.ndarray:
        """Begin an episode in the rows of a mask."""
        each: Any = seeds.tolist()  # Gymnasium's annotation forgets that there may be several
        options: dict[str, Any] | None = {"reset_mask": mask}
        if self._env is None or self._env.num_envs != len(mask):
            self._env, options = self._make(len(mask)), None
        with _Failures(int(mask.argmax())):
            observations, _ = self._env.reset(seed=each, options=options)
            return self._read(observations, len(mask))

    def step(self, mask: Mask, actions: np.ndarray) -> Step:
        """Step all rows."""
        assert self._env is not None
        own = np.stack(self.interface.act(np.where(mask[:, None], actions, 0)))
        with _Failures(int(mask.argmax())):
            observations, rewards, terminated, truncated, _ = self._env.step(own)
            rewards = np.asarray(rewards, np.float64).reshape(len(mask))
            seen = self._read(observations, len(mask))
        return seen, rewards, np.asarray(terminated), np.asarray(truncated)

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            close(self._env)

    def _read(self, observations: Any, rows: int) -> np.ndarray:
        if isinstance(self.interface.observation, spaces.Discrete):
            place = np.asarray(observations) - int(self.interface.observation.start)
            return np.eye(self.interface.inputs)[place]
        return np.asarray(observations, np.float64).reshape(rows, self.interface.inputs)


def interface_of(task: GymnasiumTask) -> Interface:
    """How a task is read, or a `TaskError`."""
    env = task.make()
    try:
        return Interface.of(env, task.id)
    finally:
        close(env)


def make_rows(
    task: GymnasiumTask,
    *,
    renewed: bool = False,
    crew: Crew | None = None,
    kind: type[SingleRows] = SingleRows,
) -> tuple[EnvRows, Interface]:
    """The rows of a task and their interface, or a `TaskError`.

    Args:
        task: The environment.
        renewed: Make a new environment for every episode; see `SingleRows`.
        crew: To whom the rows are dealt; of one, or None: they stay in this process, as a
            vectorised environment always does. The results are the same.
        kind: What each of them gets.
    """
    interface = interface_of(task)
    vector = None if renewed else VectorRows.of(task, interface)
    if vector is None and crew is not None and crew.size > 1:
        return DealtRows(task, interface, renewed=renewed, crew=crew, kind=kind), interface
    return vector or SingleRows(task, interface, renewed), interface


_SEEDS_BELOW_2_31 = 2**31 - 1
_PLAIN = (float, bool, np.bool_)
_STEP_WORDS = (
    "step: expected a tuple of 5 (observation, reward, terminated, truncated, info), got {}; an "
    "environment of the old Gym, with one done, is wrapped by shimmy.GymV21CompatibilityV0"
)


def begin(env: gymnasium.Env[Any, Any], seed: int) -> Any:
    """Reset an environment; returns its observation.

    One that fails with a seed of more than 31 bits gets the lower 31 of it.

    Raises:
        Misfit: If what it returns is no observation and info.
    """
    try:
        came: Any = env.reset(seed=seed)
    except Exception:
        if seed <= _SEEDS_BELOW_2_31:
            raise
        came = env.reset(seed=seed & _SEEDS_BELOW_2_31)
    if not isinstance(came, tuple) or len(came) != 2:
        raise Misfit(f"reset: expected a tuple of 2 (observation, info), got {_words(came)}")
    return came[0]


def number(value: Any, name: str) -> float:
    """A number that an environment gave, whether as one or as an array of one.

    Raises:
        Misfit: If it is none.
    """
    if isinstance(value, _PLAIN):
        return float(value)
    try:
        return float(np.asarray(value).item())
    except (TypeError, ValueError, OverflowError) as error:
        raise Misfit(f"{name}: expected a number, got {value!r}") from error


def close(env: Any) -> None:
    """Close an environment; one that fails then takes nothing with it, and is warned of."""
    try:
        env.close()
    except BaseException as error:
        if not raised_by_environment(error):
            raise
        warnings.warn(f"close() of {env}: {type(error).__name__}: {error}", stacklevel=2)


def _words(came: Any) -> str:
    return f"{len(came)} values" if isinstance(came, tuple) else f"a {type(came).__name__}"


class _Failures:
    """Make what the environment of a `row` raises a `RowError`, a `sys.exit` in it, too."""

    def __init__(self, row: int = 0) -> None:
        self.row = row

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, where: object) -> None:
        if isinstance(error, Misfit | TaskError):
            raise RowError(self.row, str(error)) from error
        if error is not None and raised_by_environment(error):
            raise RowError(self.row, _told(error)) from error


def _told(error: BaseException) -> str:
    """What an environment raised, and where."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    if "to unpack (expected 5" in str(error) and "gymnasium" in where.filename:  # a wrapper of its
        return _STEP_WORDS.format(str(error).rpartition("got ")[2].rstrip(")") + " values")
    what = "sys.exit was called" if isinstance(error, SystemExit) else type(error).__name__
    return f"{what}: {error} ({Path(where.filename).name}:{where.lineno})"
