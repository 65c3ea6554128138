"""What a run must know of its environment before it begins, from episodes of random play."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from neatq_envs.gymnasium_rows import EpisodeRows, Rows, make_rows
from neatq_envs.gymnasium_task import GymnasiumTask, Interface, TaskError
from neatq_envs.observation_scaling import ObservationScaling
from neatq_envs.torchrl_rows import episode_seeds
from neatq_trainers.generational.purposes import SCOUTING

EPISODES = 20
MOST_STEPS = 5000
"""Random play is cut off here."""
REPEATED_STEPS = 200
"""Steps of each episode that are played again, to see whether they come out the same."""
_MARGIN = 0.1


@dataclass(frozen=True)
class Surroundings:
    """What is fixed for a whole run; the same for all seeds.

    Attributes:
        scaling: Of the observations.
        value_range: Discounted returns that may occur, see `value_range`.
        renewed: Every episode needs a new environment, as seeds alone do not settle it.
        repeatable: The same seeds and actions give the same episode.
    """

    scaling: ObservationScaling
    value_range: tuple[float, float]
    renewed: bool
    repeatable: bool

    def to_dict(self) -> dict[str, Any]:
        """JSON values from which `from_dict` makes an equal one."""
        return {
            "observation": self.scaling.to_dict(),
            "value_range": list(self.value_range),
            "renewed": self.renewed,
            "repeatable": self.repeatable,
        }

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Surroundings:
        """Read what `to_dict` wrote."""
        low, high = values["value_range"]
        return Surroundings(
            ObservationScaling.from_dict(values["observation"]),
            (float(low), float(high)),
            bool(values["renewed"]),
            bool(values["repeatable"]),
        )


class Play(NamedTuple):
    """Episodes of random play.

    Attributes:
        observations: Float64 [steps, episodes, inputs].
        rewards: Float64 [steps, episodes], 0 where an episode is over.
        lengths: Int64 [episodes].
        ended: Bool [episodes], whether it came to its end.
    """

    observations: np.ndarray
    rewards: np.ndarray
    lengths: np.ndarray
    ended: np.ndarray


def scout(task: GymnasiumTask, discount: float) -> Surroundings:
    """Look around by random play.

    Args:
        task: The environment.
        discount: gamma of the returns.

    Raises:
        TaskError: If the environment cannot be used, or its episodes do not end.
        EpisodeError: If it fails.
    """
    rows, interface = make_rows(task)
    seen = play(task, rows, interface, MOST_STEPS)
    limit = _time_limit(task)
    if limit is None and not seen.ended.all():
        raise TaskError(
            f"task: an episode of random play in {task.id} did not end in {MOST_STEPS} steps, and "
            "it has no time limit; set one, for instance with --env-kwargs max_episode_steps=1000"
        )
    renewed = not _repeats(task, rows, interface, seen)
    if renewed:
        rows, interface = make_rows(task, renewed=True)
    taken = np.arange(len(seen.rewards))[:, None] < seen.lengths
    return Surroundings(
        scaling=ObservationScaling.fit(interface.observation, seen.observations[taken]),
        value_range=value_range(seen, discount, limit or int(seen.lengths.max())),
        renewed=renewed,
        repeatable=not renewed or _repeats(task, rows, interface, seen),
    )


def play(task: GymnasiumTask, rows: Rows, interface: Interface, most_steps: int) -> Play:
    """Play at random, with seeds that are the same for every run."""
    rng = np.random.default_rng([SCOUTING])
    seeds = episode_seeds(0, 0, EPISODES, purpose=SCOUTING)[:, None]
    episodes = EpisodeRows(rows, task.id)
    episodes.begin(seeds)
    observations, rewards = [], []
    while episodes.living.any() and len(rewards) < most_steps:
        observations.append(episodes.observation)
        episodes.step(_random_actions(interface, rng))
        rewards.append(episodes.reward)
        episodes.go_on(episodes.terminated | episodes.truncated)
    return Play(np.stack(observations), np.stack(rewards), episodes.steps, ~episodes.living)


def value_range(seen: Play, discount: float, horizon: int) -> tuple[float, float]:
    """Discounted returns that may occur, for the range of Q-values.

    The returns that random play had from each of its steps on, and those of the reward at the 5th
    and at the 95th percentile if it came in every step of the longest episode; a tenth wider.

    Args:
        seen: Random play.
        discount: gamma.
        horizon: Steps of the longest episode.
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


def _random_actions(interface: Interface, rng: np.random.Generator) -> np.ndarray:
    if interface.choices is not None:
        return rng.integers(interface.choices, size=(EPISODES, 1)).astype(np.float64)
    low, high = interface.bounds
    return rng.uniform(low, high, (EPISODES, len(low)))


def _repeats(task: GymnasiumTask, rows: Rows, interface: Interface, seen: Play) -> bool:
    again = play(task, rows, interface, REPEATED_STEPS)
    steps = len(again.rewards)
    same = np.array_equal(again.observations, seen.observations[:steps])
    return same and np.array_equal(again.rewards, seen.rewards[:steps])


def _time_limit(task: GymnasiumTask) -> int | None:
    limit = task.kwargs.get("max_episode_steps", task.spec().max_episode_steps)
    return None if limit is None or limit < 0 else int(limit)
