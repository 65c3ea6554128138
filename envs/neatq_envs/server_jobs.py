"""Server job scheduling after Whiteson & Stone (2006): which job should the server do next?

A queue begins with 100 jobs of random types, and in each of the first 100 steps another one
arrives. The server does one job in each of 200 steps, and then the queue is empty. A done job pays
its utility, which falls with the steps that it has waited. The paper shows the utilities as curves
only. It says that users of types 1 and 2 do not mind waiting for 100 steps and then do, at rates
that switch at 150, and that users of types 3 and 4 mind from the beginning, at rates that switch at
50, until it is too late at 100. The rates are our own, so that every job can lose 150:

| utility lost per step of waiting | 0 to 50 | 50 to 100 | 100 to 150 | 150 to 200 |
| --- | --- | --- | --- | --- |
| type 1 | 0 | 0 | 1 | 2 |
| type 2 | 0 | 0 | 2 | 1 |
| type 3 | 2 | 1 | 0 | 0 |
| type 4 | 1 | 2 | 0 | 0 |

Mean returns of 300 episodes, seeds 0 to 299, with standard errors:

| who | return |
| --- | --- |
| `oldest_policy`, first come first served | -14,395 +- 55 |
| `greedy_policy`, what pays most now | -12,505 +- 33 |
| `random_policy` | -11,161 +- 39 |
| `urgent_policy`, what loses most by waiting | -6,903 +- 35 |
| `ordered_policy`, the best fixed order that we know | -5,585 +- 30 |
| `best_returns`, a bound: an oracle that knows all arrivals | -4,772 +- 32 |

One step: the server does a job, all others grow older by a step, then the new job arrives. The
state of a row is int16 [201]: the time in steps, then the type (0 to 3) of each of the 200 jobs in
the order of their arrival, or -1 once it is done. The 100 of the beginning have an order, too: the
first counts as the oldest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from gymnasium.spaces import Box, Discrete
from numba import njit

from neatq_envs.row_env import RowEnv, RowVectorEnv

TYPES, AGES, AGE_STEPS = 4, 4, 50
CHOICES = TYPES * AGES
QUEUE, JOBS = 100, 200  # jobs at the beginning, and in all: as many as steps
LOSSES = np.array([[0, 0, 1, 2], [0, 0, 2, 1], [2, 1, 0, 0], [1, 2, 0, 0]])  # [types, ages]

# Utilities [types, waited steps 0 to 200].
UTILITIES = -np.pad(np.cumsum(np.repeat(LOSSES, AGE_STEPS, axis=1), axis=1), ((0, 0), (1, 0)))

# The best of all fixed orders of the 16 choices that a hill climb over 60 episodes found, three
# times from different orders.
BEST_ORDER = (6, 13, 12, 3, 8, 2, 7, 14, 5, 10, 9, 1, 0, 4, 15, 11)

Policy = Callable[[np.ndarray], np.ndarray]
"""Actions [rows] from observations [rows, 16]."""

_DONE = -1
_BLOCKED = 1e6  # the price of doing a job before it arrives


def start(rng: np.random.Generator) -> np.ndarray:
    """Return the state that a row begins with, int16 [201]: all jobs are known, but not to see."""
    state = np.zeros(1 + JOBS, dtype=np.int16)
    state[1:] = rng.integers(0, TYPES, size=JOBS)
    return state


def step(state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Do a job in every row, in place.

    Args:
        state: int16 [rows, 201]; written.
        actions: 4 * type + age, whole numbers [rows]: the server does the youngest job of this
            type whose age in steps is in [50 age, 50 age + 50). If there is none, it does the
            oldest job of the queue.

    Returns:
        Utilities of the done jobs, float64 [rows], and whether queues are empty, bool [rows].
    """
    if actions.shape != state.shape[:1] or not ((actions >= 0) & (actions < CHOICES)).all():
        raise ValueError(
            f"actions: expected whole numbers 0 to {CHOICES - 1} [{len(state)}], got {actions!r}"
        )
    return _step(state, actions, UTILITIES)


def observe(state: np.ndarray) -> np.ndarray:
    """Return how many jobs wait of each type and age, float32 [rows, 16], number 4 type + age."""
    return _count(state)


def random_policy(rng: np.random.Generator) -> Policy:
    """Return the policy that chooses any of the 16 actions."""
    return lambda observation: rng.integers(0, CHOICES, size=len(observation))


def oldest_policy(observation: np.ndarray) -> np.ndarray:
    """Choose a job of the oldest age, whatever its type; ties by type."""
    return _first_waiting(observation, np.tile(np.arange(AGES), TYPES))


def greedy_policy(observation: np.ndarray) -> np.ndarray:
    """Choose the job that pays most now, by the middle of its age."""
    middles = AGE_STEPS * np.arange(AGES) + AGE_STEPS // 2
    return _first_waiting(observation, UTILITIES[:, middles].ravel())


def urgent_policy(observation: np.ndarray) -> np.ndarray:
    """Choose the job that loses most by waiting for another step; ties by type, then young."""
    return _first_waiting(observation, LOSSES.ravel())


def ordered_policy(observation: np.ndarray) -> np.ndarray:
    """Choose by the best fixed order that we know: it gives up old jobs of types 3 and 4."""
    return _first_waiting(observation, -np.argsort(BEST_ORDER))


def play(policy: Policy, seeds: Sequence[int]) -> np.ndarray:
    """Return the returns of episodes, float64 [episodes], with the jobs of the given seeds."""
    state, total = _starts(seeds), np.zeros(len(seeds))
    for _ in range(JOBS):
        utility, _ = step(state, policy(observe(state)))
        total += utility
    return total


def best_returns(seeds: Sequence[int]) -> np.ndarray:
    """Return what no policy can exceed, float64 [episodes]: the best plan by an oracle.

    The oracle knows all arrivals and may do any waiting job, also one that is not the youngest of
    its type and age. Its plan is the best assignment of 200 jobs to 200 steps, which is exact.
    """
    return np.array([-_cheapest(_prices(state)) for state in _starts(seeds)])


class ServerJobs:
    """The task of `RowTask`."""

    def __init__(self) -> None:
        self.observation_space = Box(0.0, float(QUEUE), shape=(CHOICES,), dtype=np.float32)
        self.action_space = Discrete(CHOICES)
        self.start, self.step, self.observe = start, step, observe


class ServerJobsEnv(RowEnv):
    """Do the right job next, while new ones arrive.

    ## Description
    Whiteson & Stone (2006), "Evolutionary Function Approximation for Reinforcement Learning": a
    server has 100 waiting jobs of four types, gets another one in each of the first 100 steps and
    does one in each step. Utilities fall as jobs wait; the rates at the top of
    `neatq_envs.server_jobs` are our own, because the paper gives none, so results compare with
    those below and not with the paper's.

    ## Observation Space
    `Box`, float32 [16]: how many jobs of each type and age wait, from 0 to 100.

    | number | jobs |
    | --- | --- |
    | 0, 1, 2, 3 | type 1 that are 0 to 49, 50 to 99, 100 to 149, 150 to 199 steps old |
    | 4 to 7 | type 2, likewise |
    | 8 to 11 | type 3 |
    | 12 to 15 | type 4 |

    ## Action Space
    `Discrete(16)`: the type and age of the next job, numbered as above. The server does the
    youngest job that fits. If none does, it does the oldest job of all.

    ## Rewards
    The utility of the done job, from -150 to 0.

    ## Starting State
    100 jobs, all of age 0, of types that are independent and equally likely, as those to come.

    ## Episode End
    Terminated after 200 steps, when the queue is empty.
    """

    def __init__(self) -> None:
        super().__init__(ServerJobs())


class ServerJobsVectorEnv(RowVectorEnv):
    """Many rows of `ServerJobsEnv`."""

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None) -> None:
        super().__init__(ServerJobs(), num_envs, max_episode_steps)


def _starts(seeds: Sequence[int]) -> np.ndarray:
    return np.stack([start(np.random.default_rng(seed)) for seed in seeds])


def _first_waiting(observation: np.ndarray, urgency: np.ndarray) -> np.ndarray:
    """Return the most urgent of the choices [16] for which jobs wait, int64 [rows]."""
    return np.where(observation > 0, urgency, -np.inf).argmax(axis=1)


def _prices(state: np.ndarray) -> np.ndarray:
    """Return what each job loses if it is done in each step, float64 [jobs, steps]."""
    arrival = np.maximum(np.arange(JOBS) - QUEUE + 1, 0)
    waited = np.arange(JOBS) - arrival[:, None]
    utilities = UTILITIES[state[1:, None], np.maximum(waited, 0)]
    return np.where(waited < 0, _BLOCKED, -utilities.astype(float))


@njit(cache=True)
def _arrival(job: int) -> int:
    """Return the first step in which a job can be done."""
    return max(job - QUEUE + 1, 0)


@njit(cache=True)
def _step(
    state: np.ndarray, actions: np.ndarray, utilities: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    utility, empty = np.empty(len(state)), np.empty(len(state), dtype=np.bool_)
    for row in range(len(state)):
        time, jobs = state[row, 0], state[row, 1:]
        job = _chosen(jobs, time, actions[row] // AGES, actions[row] % AGES)
        utility[row] = utilities[jobs[job], time - _arrival(job)]
        jobs[job] = _DONE
        state[row, 0] = time + 1
        empty[row] = time + 1 >= JOBS
    return utility, empty


@njit(cache=True)
def _chosen(jobs: np.ndarray, time: int, kind: int, age: int) -> int:
    """Return the youngest waiting job of a type and age, or else the oldest of all."""
    for job in range(min(QUEUE + time, JOBS) - 1, -1, -1):
        if jobs[job] == kind and (time - _arrival(job)) // AGE_STEPS == age:
            return job
    oldest = 0
    while jobs[oldest] == _DONE:
        oldest += 1
    return oldest


@njit(cache=True)
def _count(state: np.ndarray) -> np.ndarray:
    counts = np.zeros((len(state), CHOICES), dtype=np.float32)
    for row in range(len(state)):
        time, jobs = state[row, 0], state[row, 1:]
        for job in range(min(QUEUE + time, JOBS)):
            if jobs[job] != _DONE:
                counts[row, jobs[job] * AGES + (time - _arrival(job)) // AGE_STEPS] += 1
    return counts


@njit(cache=True)
def _cheapest(prices: np.ndarray) -> float:
    """Return the least sum of prices [n, n] with one entry from each row and column.

    The Hungarian method by shortest augmenting paths (Kuhn 1955; Jonker & Volgenant 1987). Row
    and column n are dummies: the path that brings in a new row begins at column n.
    """
    n = len(prices)
    row_of = np.full(n + 1, n)  # [columns]
    row_worth, column_worth = np.zeros(n + 1), np.zeros(n + 1)
    for row in range(n):
        row_of[n] = row
        column = n
        distance, before = np.full(n + 1, np.inf), np.full(n + 1, n)
        seen = np.zeros(n + 1, dtype=np.bool_)
        while row_of[column] != n:
            seen[column] = True
            here, nearest, gap = row_of[column], n, np.inf
            for other in range(n):
                if seen[other]:
                    continue
                price = prices[here, other] - row_worth[here] - column_worth[other]
                if price < distance[other]:
                    distance[other], before[other] = price, column
                if distance[other] < gap:
                    gap, nearest = distance[other], other
            for other in range(n + 1):
                if seen[other]:
                    row_worth[row_of[other]] += gap
                    column_worth[other] -= gap
                else:
                    distance[other] -= gap
            column = nearest
        while column != n:
            row_of[column] = row_of[before[column]]
            column = before[column]
    total = 0.0
    for column in range(n):
        total += prices[row_of[column], column]
    return total
