"""Server job scheduling: which job should the server do next?

After Whiteson & Stone (2006), "Evolutionary Function Approximation for Reinforcement Learning". A
done job pays its utility, which falls with the steps that it has waited. The paper shows utilities
as curves only: types 1 and 2 do not mind waiting for 100 steps and then do, at rates that switch at
150; types 3 and 4 mind from the beginning, at rates that switch at 50, until it is too late at 100.
The rates are our own, so that every job can lose 150:

| utility lost per step of waiting | 0 to 50 | 50 to 100 | 100 to 150 | 150 to 200 |
| --- | --- | --- | --- | --- |
| type 1 | 0 | 0 | 1 | 2 |
| type 2 | 0 | 0 | 2 | 1 |
| type 3 | 2 | 1 | 0 | 0 |
| type 4 | 1 | 2 | 0 | 0 |

One step: the server does a job, all others grow older, then the new job arrives. The state of a
row is int16 [201]: the time in steps, then the type (0 to 3) of each of the 200 jobs in the order
of their arrival, or -1 once it is done. Of the first 100, the first counts as the oldest.
"""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box, Discrete

from neatq_envs.row_env import RowEnv, RowVectorEnv
from neatq_torch.jit import cached_njit

JOB_TYPES, AGES, AGE_STEPS = 4, 4, 50
CHOICES = JOB_TYPES * AGES
QUEUE, JOBS = 100, 200  # jobs at the beginning, and in all: as many as steps
LOSSES = np.array([[0, 0, 1, 2], [0, 0, 2, 1], [2, 1, 0, 0], [1, 2, 0, 0]])  # [types, ages]

# Utilities [types, waited steps 0 to 200].
UTILITIES = -np.pad(np.cumsum(np.repeat(LOSSES, AGE_STEPS, axis=1), axis=1), ((0, 0), (1, 0)))
_DONE = -1


def draw_jobs(rng: np.random.Generator) -> np.ndarray:
    """The state that a row begins with, int16 [201]: all jobs are known, but not to see."""
    state = np.zeros(1 + JOBS, dtype=np.int16)
    state[1:] = rng.integers(0, JOB_TYPES, size=JOBS)
    return state


def serve(state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Do a job in every row: utilities, float64 [rows], and whether queues are empty, bool [rows].

    Args:
        state: int16 [rows, 201]; written.
        actions: 4 * type + age, whole numbers [rows]: the server does the youngest job of this
            type whose age in steps is in [50 age, 50 age + 50), or else the oldest of the queue.
    """
    if actions.shape != state.shape[:1] or not ((actions >= 0) & (actions < CHOICES)).all():
        words = f"0 to {CHOICES - 1} [{len(state)}], got {actions!r}"
        raise ValueError(f"actions: expected whole numbers {words}")
    return _serve_rows(state, actions, UTILITIES)


class ServerJobs:
    """The task of `RowTask`."""

    def __init__(self) -> None:
        self.observation_space = Box(0.0, float(QUEUE), shape=(CHOICES,), dtype=np.float32)
        self.action_space = Discrete(CHOICES)
        self.start, self.step, self.observe = draw_jobs, serve, count_jobs


class ServerJobsEnv(RowEnv):
    """Do the right job next, while new ones arrive.

    ## Description
    A server has 100 waiting jobs of four types, gets another one in each of the first 100 steps and
    does one in each step. Utilities fall as jobs wait, at rates of our own (see
    `neatq_envs.server_jobs`), so results do not compare with those of Whiteson & Stone (2006).

    ## Observation Space
    `Box`, float32 [16]: how many jobs of each type and age wait, from 0 to 100.

    | number | jobs |
    | --- | --- |
    | 0, 1, 2, 3 | type 1 that are 0 to 49, 50 to 99, 100 to 149, 150 to 199 steps old |
    | 4 to 7, 8 to 11, 12 to 15 | types 2, 3, 4, likewise |

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

    task = ServerJobs


class ServerJobsVectorEnv(RowVectorEnv):
    """Many rows of `ServerJobsEnv`."""

    task = ServerJobs


@cached_njit()
def _arrival(job: int) -> int:
    """The first step in which a job can be done."""
    return max(job - QUEUE + 1, 0)


@cached_njit()
def _serve_rows(
    state: np.ndarray, actions: np.ndarray, utilities: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    utility, empty = np.empty(len(state)), np.empty(len(state), dtype=np.bool_)
    for row in range(len(state)):
        time, jobs = state[row, 0], state[row, 1:]
        job = _chosen_job(jobs, time, actions[row] // AGES, actions[row] % AGES)
        utility[row] = utilities[jobs[job], time - _arrival(job)]
        jobs[job] = _DONE
        state[row, 0] = time + 1
        empty[row] = time + 1 >= JOBS
    return utility, empty


@cached_njit()
def _chosen_job(jobs: np.ndarray, time: int, kind: int, age: int) -> int:
    """The youngest waiting job of a type and age, or else the oldest of all."""
    for job in range(min(QUEUE + time, JOBS) - 1, -1, -1):
        if jobs[job] == kind and (time - _arrival(job)) // AGE_STEPS == age:
            return job
    oldest = 0
    while jobs[oldest] == _DONE:
        oldest += 1
    return oldest


@cached_njit()
def count_jobs(state: np.ndarray) -> np.ndarray:
    """How many jobs wait of each type and age, float32 [rows, 16], number 4 type + age."""
    counts = np.zeros((len(state), CHOICES), dtype=np.float32)
    for row in range(len(state)):
        time, jobs = state[row, 0], state[row, 1:]
        for job in range(min(QUEUE + time, JOBS)):
            if jobs[job] != _DONE:
                counts[row, jobs[job] * AGES + (time - _arrival(job)) // AGE_STEPS] += 1
    return counts
