"""Mountain car with starts anywhere, as Whiteson & Stone (2006) had it, and its optimum.

A car in a valley is too weak for the hill and must swing up. With the action a in -1, 0, 1:

    v' = bound(v + 0.001 a - 0.0025 cos(3 x)),  x' = bound(x + v'),

x in [-1.2, 0.5], v in [-0.07, 0.07]; a car that meets the left end stops there (Sutton & Barto).
From starts all over the state space the best mean return is -49.2 (it would be -52.7 if the left
end did not stop the car), from those of Gymnasium's `MountainCar-v0`, which has the same motion,
-97.7: `tests/envs/test_mountain_car.py` finds them by value iteration.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from gymnasium.spaces import Box, Discrete

from neatq_envs.row_env import RowEnv, RowVectorEnv
from neatq_torch.jit import cached_njit

CarStarts = Literal["uniform", "gym"]

LEFT, GOAL, MAX_SPEED = -1.2, 0.5, 0.07
ENGINE, SLOPE = 0.001, 0.0025
ACTIONS = 3
_GYM_STARTS = (-0.6, -0.4)


class MountainCar:
    """The task of `RowTask`; the state of a row is place and velocity, float64 [2]."""

    def __init__(self, starts: CarStarts = "uniform") -> None:
        if starts not in get_args(CarStarts):
            raise ValueError(f'starts: expected "uniform" or "gym", got {starts!r}')
        self._starts = starts
        high = np.array([GOAL, MAX_SPEED], dtype=np.float32)
        self.observation_space = Box(np.array([LEFT, -MAX_SPEED], dtype=np.float32), high)
        self.action_space = Discrete(ACTIONS)

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Place and velocity [2]."""
        if self._starts == "gym":
            return np.array([rng.uniform(*_GYM_STARTS), 0.0])
        return np.array([rng.uniform(LEFT, GOAL), rng.uniform(-MAX_SPEED, MAX_SPEED)])

    def step(self, state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rewards -1 [rows] and who is at the goal [rows]; the state is written."""
        if actions.shape != state.shape[:1] or not ((actions >= 0) & (actions < ACTIONS)).all():
            words = f"0, 1 or 2 [{len(state)}], got {actions!r}"
            raise ValueError(f"actions: expected whole numbers {words}")
        return np.full(len(state), -1.0), _step_cars(state, actions)

    def observe(self, state: np.ndarray) -> np.ndarray:
        """The state in single precision, [rows, 2]."""
        return state.astype(np.float32)


class MountainCarEnv(RowEnv):
    """Swing a weak car out of a valley, from any start.

    ## Description
    The car of Moore (1990): an episode begins anywhere in the state space, so a policy must know
    all of it. The equations are at the top of `neatq_envs.mountain_car`.

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

    task = MountainCar


class MountainCarVectorEnv(RowVectorEnv):
    """Many rows of `MountainCarEnv`."""

    task = MountainCar


@cached_njit()
def _step_cars(state: np.ndarray, actions: np.ndarray) -> np.ndarray:
    done = np.empty(len(state), dtype=np.bool_)
    for row in range(len(state)):
        state[row, 0], state[row, 1] = _driven(state[row, 0], state[row, 1], actions[row] - 1)
        done[row] = state[row, 0] >= GOAL
    return done


@cached_njit()
def _driven(place: float, velocity: float, push: int) -> tuple[float, float]:
    velocity += ENGINE * push - SLOPE * math.cos(3 * place)
    velocity = min(max(velocity, -MAX_SPEED), MAX_SPEED)
    place = min(max(place + velocity, LEFT), GOAL)
    if place == LEFT and velocity < 0:
        velocity = 0.0
    return place, velocity
