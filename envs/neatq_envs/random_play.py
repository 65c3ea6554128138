"""What a run must know of its environment before it begins, from episodes of random play."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from neatq_envs.episodes import RANDOM_PLAY, EpisodeRows, Starts, episode_seeds
from neatq_envs.gymnasium_rows import EnvRows, make_rows
from neatq_envs.gymnasium_task import GymnasiumTask, Interface, TaskError

EPISODES, MOST_STEPS = 20, 5000  # random play is cut off after so many
REPEATED_STEPS = 200  # of each episode, played again to see whether they come out the same
_MARGIN = 0.1
LARGEST = 10.0
"""Scaled observations are clipped to [-LARGEST, LARGEST]."""
_SANE = 1e4  # a bound beyond this says nothing of the values that occur
_LEAST_SHARE = 0.2  # of the reach that bounds allow
_STEADY = 1e-6  # a standard deviation below this is that of a value that never changed


@dataclass(frozen=True)
class ObservationScaling:
    """What a network reads: (observation - offset) / scale, clipped, in single precision."""

    offset: NDArray[np.float64]  # [observations]
    scale: NDArray[np.float64]  # [observations], positive
    largest: ClassVar[float] = LARGEST

    def __call__(self, observation: NDArray[np.float64]) -> NDArray[np.float32]:
        """Scale observations [..., observations]."""
        scaled = (observation - self.offset) / self.scale
        return np.clip(scaled, -self.largest, self.largest).astype(np.float32)

    def then(self, mean: NDArray[np.float64], deviation: NDArray[np.float64]) -> ObservationScaling:
        """This scaling unclipped, and what comes out less a mean, over a deviation [inputs]."""
        return ObservationScaling(self.offset + self.scale * mean, self.scale * deviation)

    @classmethod
    def fit(cls, space: spaces.Space[Any], seen: ArrayLike) -> Self:
        """The scaling of a space, Box or Discrete, in which [times, observations] were seen.

        Entries of a Box with sane bounds are measured from the middle between them, in units of how
        far they were seen to go, but at least of a fifth of how far they may go: some environments
        state bounds that nothing ever reaches. Other entries get mean 0 and standard deviation 1
        over what was seen. The ones and zeros of a Discrete space stay.
        """
        seen = np.asarray(seen, np.float64)
        offset, scale = np.zeros(seen.shape[1]), np.ones(seen.shape[1])
        if isinstance(space, spaces.Box):
            low, high = (b.astype(np.float64).ravel() for b in (space.low, space.high))
            with np.errstate(all="ignore"):
                sane = (np.abs(low) < _SANE) & (np.abs(high) < _SANE) & (high > low)
            spread = seen.std(0)
            offset = np.where(sane, 0, seen.mean(0))
            scale = np.where(spread > _STEADY, spread, 1.0)
            offset[sane] = (low[sane] + high[sane]) / 2
            half = (high[sane] - low[sane]) / 2
            reach = np.abs(seen[:, sane] - offset[sane]).max(0)
            scale[sane] = np.clip(reach, half * _LEAST_SHARE, half)
        return cls(offset, scale)


class WideScaling(ObservationScaling):
    """The same before a normalisation: what random play never saw may be all that is seen later."""

    largest = 1e6


@dataclass(frozen=True)
class EnvFacts:
    """What random play has shown of an environment, for a whole run and the same for all seeds."""

    scaling: ObservationScaling
    value_range: tuple[float, float]  # discounted returns that may occur, see `value_range`
    renewed: bool  # every episode needs a new environment, as seeds alone do not settle it
    repeatable: bool  # the same seeds and actions give the same episode

    def to_dict(self) -> dict[str, Any]:
        """JSON values from which `from_dict` makes an equal one."""
        return {
            "observation": {name: part.tolist() for name, part in vars(self.scaling).items()},
            "value_range": list(self.value_range),
            "renewed": self.renewed,
            "repeatable": self.repeatable,
        }

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> EnvFacts:
        """Read what `to_dict` wrote; ValueError, TypeError or LookupError if it is not that."""
        low, high = values["value_range"]
        offset, scale = (np.array(values["observation"][one], float) for one in ("offset", "scale"))
        same = offset.ndim == 1 and offset.shape == scale.shape
        if not (same and np.isfinite([offset, scale]).all() and (scale > 0).all()):
            raise ValueError("observation: expected an offset and a positive scale for each input")
        known = bool(values["renewed"]), bool(values["repeatable"])
        return EnvFacts(ObservationScaling(offset, scale), (float(low), float(high)), *known)


class Play(NamedTuple):
    """Episodes of random play."""

    observations: np.ndarray  # float64 [steps, episodes, inputs]
    rewards: np.ndarray  # float64 [steps, episodes], 0 where an episode is over
    lengths: np.ndarray  # int64 [episodes]
    ended: np.ndarray  # bool [episodes], whether it came to its end


def look_around(task: GymnasiumTask, discount: float) -> EnvFacts:
    """What random play shows of an environment; `discount` is gamma of the returns.

    Raises:
        TaskError: If the environment cannot be used, or its episodes do not end.
    """
    with ExitStack() as stack:
        return _looked(task, discount, stack)


def _looked(task: GymnasiumTask, discount: float, stack: ExitStack) -> EnvFacts:
    """As `look_around`; `stack` closes the environments."""
    rows, interface = make_rows(task)
    stack.callback(rows.close)
    seen = play_at_random(task, rows, interface, MOST_STEPS)
    limit = task.kwargs.get("max_episode_steps", task.spec().max_episode_steps)
    limit = None if limit is None or limit < 0 else int(limit)
    if limit is None and not seen.ended.all():
        raise TaskError(
            f"task: an episode of random play in {task.id} did not end in {MOST_STEPS} steps, and "
            "it has no time limit; set one, for instance with --env-kwargs max_episode_steps=1000"
        )
    renewed = not _repeats(task, rows, interface, seen)
    if renewed:
        rows, interface = make_rows(task, renewed=True)
        stack.callback(rows.close)
    taken = np.arange(len(seen.rewards))[:, None] < seen.lengths
    return EnvFacts(
        scaling=ObservationScaling.fit(interface.flat_observation, seen.observations[taken]),
        value_range=value_range(seen, discount, limit or int(seen.lengths.max())),
        renewed=renewed,
        repeatable=not renewed or _repeats(task, rows, interface, seen),
    )


def play_at_random(task: GymnasiumTask, rows: EnvRows, interface: Interface, most: int) -> Play:
    """Play at most so many steps at random, with seeds that are the same for every run."""
    rng = np.random.default_rng([RANDOM_PLAY])
    seeds = episode_seeds(0, 0, EPISODES, purpose=RANDOM_PLAY)[:, None]
    episodes = EpisodeRows(rows, task.id)
    episodes.begin(Starts.given(seeds))
    observations, rewards = [], []
    while episodes.living.any() and len(rewards) < most:
        observations.append(episodes.observation)
        if interface.choices is None:
            actions = rng.uniform(*interface.bounds, (EPISODES, len(interface.bounds[0])))
        else:
            actions = rng.integers(interface.choices, size=(EPISODES, 1)).astype(np.float64)
        episodes.step(actions)
        rewards.append(episodes.reward)
        episodes.go_on(episodes.terminated | episodes.truncated)
    return Play(np.stack(observations), np.stack(rewards), episodes.steps, ~episodes.living)


def value_range(seen: Play, discount: float, horizon: int) -> tuple[float, float]:
    """Discounted returns that may occur, for the range of Q-values.

    The returns that random play had from each of its steps on, and those of the reward at the 5th
    and at the 95th percentile if it came in each of `horizon` steps; a tenth wider.
    """
    returns = np.zeros_like(seen.rewards)
    following = np.zeros(seen.rewards.shape[1])
    for step in reversed(range(len(returns))):
        following = returns[step] = seen.rewards[step] + discount * following
    taken = np.arange(len(returns))[:, None] < seen.lengths
    sum_of_weights = float(np.sum(discount ** np.arange(horizon, dtype=np.float64)))
    usual = np.quantile(seen.rewards[taken], [0.05, 0.95]) * sum_of_weights
    low, high = (float(f(returns[taken], initial=usual[i])) for i, f in enumerate((np.min, np.max)))
    if not low < high:
        return low - 1, low + 1
    margin = _MARGIN * (high - low)
    return low - margin, high + margin


def _repeats(task: GymnasiumTask, rows: EnvRows, interface: Interface, seen: Play) -> bool:
    again = play_at_random(task, rows, interface, REPEATED_STEPS)
    steps = len(again.rewards)
    same = np.array_equal(again.observations, seen.observations[:steps])
    return same and np.array_equal(again.rewards, seen.rewards[:steps])
