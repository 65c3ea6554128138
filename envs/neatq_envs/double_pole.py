"""Two poles on one cart: the task that NEAT was measured on. Plain numpy in, plain numpy out.

The state of a row is float64 [6]: place of the cart (m) and its velocity (m/s); angle of the long
pole (rad, 0 is upright) and its rate (rad/s); the same of the short pole.

Equations and constants: Wieland (1991), as given in the appendix of Stanley & Miikkulainen (2002),
"Evolving neural networks through augmenting topologies"; a cart of 1 kg, poles of 0.5 m and 0.05 m
half-length and 0.1 kg and 0.01 kg; friction 5e-4 of the cart and 2e-6 of the hinges; 10 N at most.
Stanley's own program leaves the friction of the cart out, which moves it by 1e-7 m in an action.
"""

from __future__ import annotations

import math

import numpy as np
from gymnasium.spaces import Box

from neatq_envs.row_env import RowEnv, RowVectorEnv
from neatq_torch.jit import cached_njit

PAPER_START_RAD = math.radians(1)
"""Where the long pole starts."""
TRACK_M, FALLEN_RAD = 2.4, math.radians(36)
STEP_S, STEPS_PER_ACTION = 0.01, 2
FORCE_N, GRAVITY = 20.0, -9.8
CART_KG, CART_FRICTION, POLE_FRICTION = 1.0, 5e-4, 2e-6
POLE_KG = (0.1, 0.01)
HALF_LENGTH_M = (0.5, 0.05)
# What Stanley's program divides the six variables by. Angles near the fall exceed 1 a little.
SCALES = np.array([4.8, 2.0, 0.52, 2.0, 0.52, 2.0])
PLACES = np.array([0, 2, 4])  # what is left to see without velocities


def resting_poles(rows: int, long_pole_rad: float = PAPER_START_RAD) -> np.ndarray:
    """Start states float64 [rows, 6]: all at rest, only the long pole leans."""
    state = np.zeros((rows, 6))
    state[:, 2] = long_pole_rad
    return state


def observe(state: np.ndarray, velocities: bool = True) -> np.ndarray:
    """The variables divided by `SCALES`, float64 [rows, 6], or [rows, 3] without velocities."""
    return state / SCALES if velocities else state[:, PLACES] / SCALES[PLACES]


def step(state: np.ndarray, output: np.ndarray) -> np.ndarray:
    """Act for 0.02 s by two steps of Runge-Kutta's method: whether rows still live, bool [rows].

    Args:
        state: float64 [rows, 6]; written.
        output: of the networks, [rows], in [0, 1]: the force is (output - 0.5) * 20 N.
    """
    if state.ndim != 2 or state.shape[1] != 6 or output.shape != state.shape[:1]:
        got = f"{list(state.shape)} and {list(output.shape)}"
        raise ValueError(f"expected a state [rows, 6] and an output [rows], got {got}")
    return _step_poles(state, output)


class DoublePole:
    """The task of `RowTask`; the state of a row is float64 [6]."""

    def __init__(self, velocities: bool = True, long_pole_rad: float = PAPER_START_RAD) -> None:
        self._velocities, self._long_pole_rad = velocities, long_pole_rad
        sensed = 6 if velocities else 3
        self.observation_space = Box(-np.inf, np.inf, shape=(sensed,), dtype=np.float32)
        self.action_space = Box(-1.0, 1.0, shape=(1,), dtype=np.float32)

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """The start state [6], which is always the same."""
        return resting_poles(1, self._long_pole_rad)[0]

    def step(self, state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rewards [rows], 1 for the living, and who has failed [rows]; state is written."""
        if actions.shape != (len(state), 1) or not np.isfinite(actions).all():
            raise ValueError(f"actions: expected finite numbers [{len(state)}, 1], got {actions!r}")
        output = (np.clip(actions[:, 0].astype(np.float64), -1.0, 1.0) + 1) / 2
        alive = step(state, output)
        return alive.astype(np.float64), ~alive

    def observe(self, state: np.ndarray) -> np.ndarray:
        """The scaled variables in single precision, [rows, 6] or [rows, 3]."""
        return observe(state, self._velocities).astype(np.float32)


class DoublePoleEnv(RowEnv):
    """Balance two poles of different length on one cart.

    ## Description
    The benchmark of Wieland (1991), see `neatq_envs.double_pole`. The id
    `neatq/DoublePoleNoVelocities-v0` hides the velocities, so that it takes a memory to balance.

    ## Observation Space
    `Box`, float32 [6], or [3] without velocities (those marked *):

    | number | variable | is divided by |
    | --- | --- | --- |
    | 0 * | place of the cart | 4.8 m |
    | 1 | velocity of the cart | 2 m/s |
    | 2 * | angle of the long pole | 0.52 rad |
    | 3 | its rate | 2 rad/s |
    | 4 * | angle of the short pole | 0.52 rad |
    | 5 | its rate | 2 rad/s |

    These are scaled already, as in Stanley's program: about [-1, 1] while the poles are balanced.
    The space has no bounds, because velocities have none.

    ## Action Space
    `Box(-1, 1)`, float32 [1]: the force on the cart for the next 0.02 s, times 10 N.

    ## Rewards
    1 for every action that ends in balance, 0 for the last one if it does not.

    ## Starting State
    All at rest; the long pole leans by one degree (`long_pole_rad`), the short one is upright.
    Nothing is random.

    ## Episode End
    Terminated when the cart is more than 2.4 m from the middle or a pole leans by more than 36
    degrees; truncated after 100,000 actions (`max_episode_steps`), which counts as solved.
    """

    task = DoublePole


class DoublePoleVectorEnv(RowVectorEnv):
    """Many rows of `DoublePoleEnv`."""

    task = DoublePole


@cached_njit()
def step_row(state: np.ndarray, output: float) -> bool:
    """Do what `step` does with one row [6], for loops that are compiled themselves."""
    force = (output - 0.5) * FORCE_N
    y = (state[0], state[1], state[2], state[3], state[4], state[5])
    for _ in range(STEPS_PER_ACTION):
        y = _runge_kutta(y, force)
    for variable in range(6):
        state[variable] = y[variable]
    return _alive_row(state)


@cached_njit()
def _alive_row(state: np.ndarray) -> bool:
    return abs(state[0]) <= TRACK_M and abs(state[2]) <= FALLEN_RAD and abs(state[4]) <= FALLEN_RAD


@cached_njit()
def _step_poles(state: np.ndarray, output: np.ndarray) -> np.ndarray:
    alive = np.empty(len(state), dtype=np.bool_)
    for row in range(len(state)):
        alive[row] = step_row(state[row], output[row])
    return alive


@cached_njit()
def _runge_kutta(y: tuple, force: float) -> tuple:
    """The state [6] one step of 0.01 s later."""
    first = _derivative(y, force)
    second = _derivative(_shifted(y, first, STEP_S / 2), force)
    third = _derivative(_shifted(y, second, STEP_S / 2), force)
    fourth = _derivative(_shifted(y, third, STEP_S), force)
    once = _shifted(_shifted(y, first, STEP_S / 6), fourth, STEP_S / 6)
    return _shifted(_shifted(once, second, STEP_S / 3), third, STEP_S / 3)


@cached_njit()
def _shifted(y: tuple, slope: tuple, by: float) -> tuple:
    return (
        y[0] + by * slope[0],
        y[1] + by * slope[1],
        y[2] + by * slope[2],
        y[3] + by * slope[3],
        y[4] + by * slope[4],
        y[5] + by * slope[5],
    )


@cached_njit()
def _derivative(y: tuple, force: float) -> tuple:
    """The rates of change of the six variables."""
    cart_force = force - CART_FRICTION * np.sign(y[1])
    long_force, long_kg, long_pull = _pole(y[2], y[3], POLE_KG[0], HALF_LENGTH_M[0])
    short_force, short_kg, short_pull = _pole(y[4], y[5], POLE_KG[1], HALF_LENGTH_M[1])
    cart = (cart_force + long_force + short_force) / (CART_KG + long_kg + short_kg)
    long_turn = -0.75 / HALF_LENGTH_M[0] * (cart * math.cos(y[2]) + long_pull)
    short_turn = -0.75 / HALF_LENGTH_M[1] * (cart * math.cos(y[4]) + short_pull)
    return y[1], cart, y[3], long_turn, y[5], short_turn


@cached_njit()
def _pole(angle: float, rate: float, mass: float, half_length: float) -> tuple:
    """A pole's force on the cart (N), the mass it adds (kg) and its pull (m/s^2)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    pull = GRAVITY * sine + POLE_FRICTION * rate / (mass * half_length)
    force = mass * half_length * rate * rate * sine + 0.75 * mass * cosine * pull
    return force, mass * (1 - 0.75 * cosine * cosine), pull
