"""Mountain car with starts anywhere, as Whiteson & Stone (2006) had it, and its optimum.

A car in a valley is too weak for the hill and must swing up. With the action a in -1, 0, 1:

    v' = bound(v + 0.001 a - 0.0025 cos(3 x)),  x' = bound(x + v'),

x in [-1.2, 0.5], v in [-0.07, 0.07]; a car that meets the left end stops there (Sutton & Barto).
Every step costs 1 until x reaches 0.5. From starts all over the state space the best mean return
is -49.2 (it would be -52.7 if the left end did not stop the car), from those of Gymnasium's
`MountainCar-v0`, which has the same motion, -97.7. To compute them (`optimal_actions`)::

    table = steps_to_goal()
    actions = optimal_actions(table, state)
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from gymnasium.spaces import Box, Discrete
from numba import njit

from neatq_envs.row_env import RowEnv, RowVectorEnv

Starts = Literal["uniform", "gym"]

LEFT, GOAL, MAX_SPEED = -1.2, 0.5, 0.07
ENGINE, SLOPE = 0.001, 0.0025
ACTIONS = 3
_GYM_STARTS = (-0.6, -0.4)  # at rest
_SETTLED = 1e-6
_UNREACHED = 1e9


def uniform_start(rng: np.random.Generator) -> np.ndarray:
    """Return place and velocity [2], uniform over the state space."""
    return np.array([rng.uniform(LEFT, GOAL), rng.uniform(-MAX_SPEED, MAX_SPEED)])


def gym_start(rng: np.random.Generator) -> np.ndarray:
    """Return place and velocity [2]: at rest near the bottom, as in Gymnasium."""
    return np.array([rng.uniform(*_GYM_STARTS), 0.0])


def step(state: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Move the cars, in place.

    Args:
        state: place and velocity, float64 [rows, 2]; written.
        actions: 0 (left), 1 (coast) or 2 (right), whole numbers [rows].

    Returns:
        Whether cars are at the goal, bool [rows].
    """
    if actions.shape != state.shape[:1] or not ((actions >= 0) & (actions < ACTIONS)).all():
        raise ValueError(
            f"actions: expected whole numbers 0, 1 or 2 [{len(state)}], got {actions!r}"
        )
    return _step(state, actions)


def steps_to_goal(cells: int = 401) -> np.ndarray:
    """Return the least steps to the goal from a grid of states, by value iteration.

    Args:
        cells: of the grid, in each direction; 401 take about a second.

    Returns:
        Float64 [cells, cells]: places from the left end to the goal, velocities from the least
        to the greatest. Between them the table is read linearly in both.
    """
    table = np.zeros((cells, cells))
    sweep = 0
    while _sweep(table, sweep % 2 == 0, sweep // 2 % 2 == 0) > _SETTLED:
        sweep += 1
    return table


def optimal_actions(table: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Return the best actions by a table of `steps_to_goal`, int64 [rows], for states [rows, 2]."""
    return _best_actions(table, state)


class MountainCar:
    """The task of `RowTask`; the state of a row is place and velocity, float64 [2]."""

    def __init__(self, starts: Starts = "uniform") -> None:
        if starts not in get_args(Starts):
            raise ValueError(f'starts: expected "uniform" or "gym", got {starts!r}')
        self._starts = starts
        high = np.array([GOAL, MAX_SPEED], dtype=np.float32)
        self.observation_space = Box(np.array([LEFT, -MAX_SPEED], dtype=np.float32), high)
        self.action_space = Discrete(ACTIONS)

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Return place and velocity [2]."""
        return uniform_start(rng) if self._starts == "uniform" else gym_start(rng)

    def step(self, state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rewards -1 [rows] and who is at the goal [rows]; the state is written."""
        done = step(state, actions)
        return np.full(len(state), -1.0), done

    def observe(self, state: np.ndarray) -> np.ndarray:
        """Return the state in single precision, [rows, 2]."""
        return state.astype(np.float32)


class MountainCarEnv(RowEnv):
    """Swing a weak car out of a valley, from any start.

    ## Description
    The car of Moore (1990) with the starts of Whiteson & Stone (2006), "Evolutionary Function
    Approximation for Reinforcement Learning": an episode begins anywhere in the state space, so a
    policy must know all of it. The equations are at the top of `neatq_envs.mountain_car`.

    ## Observation Space
    `Box`, float32 [2]:

    | number | variable | least | greatest |
    | --- | --- | --- | --- |
    | 0 | place of the car | -1.2 | 0.5 |
    | 1 | velocity, per step | -0.07 | 0.07 |

    ## Action Space
    `Discrete(3)`: 0 drives left, 1 coasts, 2 drives right.

    ## Rewards
    -1 for every step. The best mean return is -49.2, and -97.7 with `starts="gym"`.

    ## Starting State
    Place and velocity are uniform over their ranges. With `starts="gym"` the car is at rest
    between -0.6 and -0.4.

    ## Episode End
    Terminated at the goal, place 0.5; truncated after 1,000 steps (`max_episode_steps`, our
    choice: a random policy needs about 12,000).
    """

    def __init__(self, starts: Starts = "uniform") -> None:
        super().__init__(MountainCar(starts))


class MountainCarVectorEnv(RowVectorEnv):
    """Many rows of `MountainCarEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        starts: Starts = "uniform",
    ) -> None:
        super().__init__(MountainCar(starts), num_envs, max_episode_steps)


@njit(cache=True)
def _step(state: np.ndarray, actions: np.ndarray) -> np.ndarray:
    done = np.empty(len(state), dtype=np.bool_)
    for row in range(len(state)):
        state[row, 0], state[row, 1] = _moved(state[row, 0], state[row, 1], actions[row] - 1)
        done[row] = state[row, 0] >= GOAL
    return done


@njit(cache=True)
def _moved(place: float, velocity: float, push: int) -> tuple[float, float]:
    velocity += ENGINE * push - SLOPE * math.cos(3 * place)
    velocity = min(max(velocity, -MAX_SPEED), MAX_SPEED)
    place = min(max(place + velocity, LEFT), GOAL)
    if place == LEFT and velocity < 0:
        velocity = 0.0
    return place, velocity


@njit(cache=True)
def _sweep(table: np.ndarray, rightwards: bool, upwards: bool) -> float:
    """Improve all entries once, in the given order, and return the greatest change."""
    cells, change = len(table), 0.0
    for i in range(cells - 1):  # the last row is the goal
        x = i if rightwards else cells - 2 - i
        for j in range(cells):
            v = j if upwards else cells - 1 - j
            place = LEFT + (GOAL - LEFT) * x / (cells - 1)
            velocity = MAX_SPEED * (2 * v / (cells - 1) - 1)
            best, _ = _best(table, place, velocity)
            change = max(change, abs(best - table[x, v]))
            table[x, v] = best
    return change


@njit(cache=True)
def _best_actions(table: np.ndarray, state: np.ndarray) -> np.ndarray:
    actions = np.empty(len(state), dtype=np.int64)
    for row in range(len(state)):
        _, actions[row] = _best(table, state[row, 0], state[row, 1])
    return actions


@njit(cache=True)
def _best(table: np.ndarray, place: float, velocity: float) -> tuple[float, int]:
    """Return the least steps to the goal by one look ahead, and the action."""
    least, best = _UNREACHED, 0
    for action in range(ACTIONS):
        x, v = _moved(place, velocity, action - 1)
        steps = 1 + _read(table, x, v)
        if steps < least:
            least, best = steps, action
    return least, best


@njit(cache=True)
def _read(table: np.ndarray, place: float, velocity: float) -> float:
    """Return the entry at a state, linear in both variables between the grid's points."""
    if place >= GOAL:
        return 0.0
    cells = len(table)
    x = (place - LEFT) / (GOAL - LEFT) * (cells - 1)
    v = (velocity + MAX_SPEED) / (2 * MAX_SPEED) * (cells - 1)
    i, j = min(int(x), cells - 2), min(int(v), cells - 2)
    x, v = x - i, v - j
    low = (1 - v) * table[i, j] + v * table[i, j + 1]
    high = (1 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
    return (1 - x) * low + x * high
