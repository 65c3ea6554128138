"""Two poles on one cart: the task that NEAT was measured on. Plain numpy in, plain numpy out.

The state of a row is float64 [6]: place of the cart (m) and its velocity (m/s); angle of the long
pole (rad, 0 is upright) and its rate (rad/s); the same of the short pole. All rows are stepped by
one compiled call. A loop that evaluates a population drops fallen rows as it goes::

    state, rows = start(len(networks)), np.arange(len(networks))
    for _ in range(100_000):
        alive = step(state, outputs(rows, observe(state)))
        state, rows = state[alive], rows[alive]

Equations and constants: Wieland (1991), as given in the appendix of Stanley & Miikkulainen (2002),
"Evolving neural networks through augmenting topologies"; a cart of 1 kg, poles of 0.5 m and 0.05 m
half-length and 0.1 kg and 0.01 kg; friction 5e-4 of the cart and 2e-6 of the hinges; 10 N at most.
Stanley's own program leaves the friction of the cart out, which moves it by 1e-7 m in an action.
"""

from __future__ import annotations

import math

import numpy as np
from gymnasium.spaces import Box
from numba import njit

from neatq_envs.row_env import RowEnv, RowVectorEnv

# Where the long pole starts: the paper says one degree, Stanley's program uses 0.07 rad.
PAPER_START_RAD, PROGRAM_START_RAD = math.radians(1), 0.07

TRACK_M = 2.4
FALLEN_RAD = math.radians(36)
STEP_S = 0.01
STEPS_PER_ACTION = 2
FORCE_N = 20.0
GRAVITY = -9.8
CART_KG, CART_FRICTION, POLE_FRICTION = 1.0, 5e-4, 2e-6
POLE_KG = (0.1, 0.01)
HALF_LENGTH_M = (0.5, 0.05)

# What Stanley's program divides the six variables by. Angles near the fall exceed 1 a little.
SCALES = np.array([4.8, 2.0, 0.52, 2.0, 0.52, 2.0])
PLACES = np.array([0, 2, 4])  # what is left to see without velocities

# The generalisation test of Gruau, Whitley & Pyeatt (1996): shares of the ranges of the cart's
# place and velocity and of the long pole's angle (3.6 degrees) and rate (8.6 degrees/s).
_GRID = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
_GRID_REACH = np.array([2.16, 1.35, 0.06283152, 0.15009752])

WOBBLE_STEPS = 100
_TRIAL_STEPS = 1000
_WOBBLE_SCALE = 0.75


def start(rows: int, long_pole_rad: float = PAPER_START_RAD) -> np.ndarray:
    """Return start states float64 [rows, 6]: all at rest, only the long pole leans."""
    state = np.zeros((rows, 6))
    state[:, 2] = long_pole_rad
    return state


def generalisation_starts() -> np.ndarray:
    """Return the 625 starts of the generalisation test, float64 [625, 6].

    Without velocities, a network's generalisation is the number of starts from which it balances
    for 1,000 actions. The last variable, the long pole's rate, turns fastest.
    """
    shares = np.stack(np.meshgrid(*[_GRID] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    state = np.zeros((len(shares), 6))
    state[:, :4] = (2 * shares - 1) * _GRID_REACH
    return state


def observe(state: np.ndarray, velocities: bool = True) -> np.ndarray:
    """Return what networks see, float64 [rows, 6], or [rows, 3] without velocities.

    The variables are divided by `SCALES`; a bias (0.5 in Stanley's program) is not among them.
    """
    return state / SCALES if velocities else state[:, PLACES] / SCALES[PLACES]


def failed(state: np.ndarray) -> np.ndarray:
    """Return whether the cart has left the track or a pole has fallen, bool [rows].

    A state that is not finite has failed.
    """
    return ~_alive(state)


def step(state: np.ndarray, output: np.ndarray) -> np.ndarray:
    """Act for 0.02 s, in place: two steps of the classical Runge-Kutta method.

    Args:
        state: float64 [rows, 6]; written.
        output: of the networks, [rows], in [0, 1]: the force is (output - 0.5) * 20 N.

    Returns:
        Whether rows are still alive, bool [rows].
    """
    if state.ndim != 2 or state.shape[1] != 6 or output.shape != state.shape[:1]:
        raise ValueError(
            "expected a state [rows, 6] and an output [rows], "
            f"got {list(state.shape)} and {list(output.shape)}"
        )
    return _step(state, output)


def unrest(state: np.ndarray) -> np.ndarray:
    """Return |x| + |x'| + |angle| + |angle'|, of the long pole only, float64 [rows]."""
    return np.abs(state[:, :4]).sum(axis=1)


def damping_fitness(steps: np.ndarray, wobble: np.ndarray) -> np.ndarray:
    """Return the fitness of Gruau, Whitley & Pyeatt (1996) for networks without velocities.

    F = 0.1 f1 + 0.9 f2 with f1 = t / 1000 and f2 = 0 if t < 100, else 0.75 / (sum of
    |x| + |x'| + |angle| + |angle'| over the last 100 balanced actions, long pole only). It keeps
    networks from surviving by shaking the cart.

    Args:
        steps: t, how many actions of at most 1,000 each row stayed alive, [rows].
        wobble: `unrest` after each of the last 100 balanced actions, float64 [rows, 100].
    """
    total = np.maximum(wobble.sum(axis=1), np.finfo(float).tiny)
    calm = np.where(steps < WOBBLE_STEPS, 0.0, _WOBBLE_SCALE / total)
    return 0.1 * steps / _TRIAL_STEPS + 0.9 * calm


class DoublePole:
    """The task of `RowTask`; the state of a row is float64 [6]."""

    def __init__(self, velocities: bool, long_pole_rad: float) -> None:
        self._velocities, self._long_pole_rad = velocities, long_pole_rad
        sensed = 6 if velocities else 3
        self.observation_space = Box(-np.inf, np.inf, shape=(sensed,), dtype=np.float32)
        self.action_space = Box(-1.0, 1.0, shape=(1,), dtype=np.float32)

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Return the start state [6], which is always the same."""
        return start(1, self._long_pole_rad)[0]

    def step(self, state: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rewards [rows], 1 for the living, and who has failed [rows]; state is written."""
        if actions.shape != (len(state), 1) or not np.isfinite(actions).all():
            raise ValueError(f"actions: expected finite numbers [{len(state)}, 1], got {actions!r}")
        output = (np.clip(actions[:, 0].astype(np.float64), -1.0, 1.0) + 1) / 2
        alive = step(state, output)
        return alive.astype(np.float64), ~alive

    def observe(self, state: np.ndarray) -> np.ndarray:
        """Return the scaled variables in single precision, [rows, 6] or [rows, 3]."""
        return observe(state, self._velocities).astype(np.float32)


class DoublePoleEnv(RowEnv):
    """Balance two poles of different length on one cart.

    ## Description
    The benchmark of Wieland (1991) with the constants of Stanley & Miikkulainen (2002), "Evolving
    neural networks through augmenting topologies". `neatq/DoublePoleNoVelocities-v0` hides the
    velocities, so that it takes a memory to balance.

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

    def __init__(self, velocities: bool = True, long_pole_rad: float = PAPER_START_RAD) -> None:
        super().__init__(DoublePole(velocities, long_pole_rad))


class DoublePoleVectorEnv(RowVectorEnv):
    """Many rows of `DoublePoleEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        velocities: bool = True,
        long_pole_rad: float = PAPER_START_RAD,
    ) -> None:
        super().__init__(DoublePole(velocities, long_pole_rad), num_envs, max_episode_steps)


@njit(cache=True)
def step_row(state: np.ndarray, output: float) -> bool:
    """Do what `step` does with one row [6], for loops that are compiled themselves."""
    force = (output - 0.5) * FORCE_N
    y = (state[0], state[1], state[2], state[3], state[4], state[5])
    for _ in range(STEPS_PER_ACTION):
        y = _runge_kutta(y, force)
    for variable in range(6):
        state[variable] = y[variable]
    return _alive_row(state)


@njit(cache=True)
def _alive_row(state: np.ndarray) -> bool:
    return abs(state[0]) <= TRACK_M and abs(state[2]) <= FALLEN_RAD and abs(state[4]) <= FALLEN_RAD


@njit(cache=True)
def _alive(state: np.ndarray) -> np.ndarray:
    alive = np.empty(len(state), dtype=np.bool_)
    for row in range(len(state)):
        alive[row] = _alive_row(state[row])
    return alive


@njit(cache=True)
def _step(state: np.ndarray, output: np.ndarray) -> np.ndarray:
    alive = np.empty(len(state), dtype=np.bool_)
    for row in range(len(state)):
        alive[row] = step_row(state[row], output[row])
    return alive


@njit(cache=True)
def _runge_kutta(y: tuple, force: float) -> tuple:
    """Return the state [6] one step of 0.01 s later."""
    first = _derivative(y, force)
    second = _derivative(_moved(y, first, STEP_S / 2), force)
    third = _derivative(_moved(y, second, STEP_S / 2), force)
    fourth = _derivative(_moved(y, third, STEP_S), force)
    once = _moved(_moved(y, first, STEP_S / 6), fourth, STEP_S / 6)
    return _moved(_moved(once, second, STEP_S / 3), third, STEP_S / 3)


@njit(cache=True)
def _moved(y: tuple, slope: tuple, by: float) -> tuple:
    return (
        y[0] + by * slope[0],
        y[1] + by * slope[1],
        y[2] + by * slope[2],
        y[3] + by * slope[3],
        y[4] + by * slope[4],
        y[5] + by * slope[5],
    )


@njit(cache=True)
def _derivative(y: tuple, force: float) -> tuple:
    """Return the rates of change of the six variables."""
    cart_force = force - CART_FRICTION * np.sign(y[1])
    long_force, long_kg, long_pull = _pole(y[2], y[3], POLE_KG[0], HALF_LENGTH_M[0])
    short_force, short_kg, short_pull = _pole(y[4], y[5], POLE_KG[1], HALF_LENGTH_M[1])
    cart = (cart_force + long_force + short_force) / (CART_KG + long_kg + short_kg)
    long_turn = -0.75 / HALF_LENGTH_M[0] * (cart * math.cos(y[2]) + long_pull)
    short_turn = -0.75 / HALF_LENGTH_M[1] * (cart * math.cos(y[4]) + short_pull)
    return y[1], cart, y[3], long_turn, y[5], short_turn


@njit(cache=True)
def _pole(angle: float, rate: float, mass: float, half_length: float) -> tuple:
    """Return a pole's force on the cart (N), the mass it adds (kg) and its pull (m/s^2)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    pull = GRAVITY * sine + POLE_FRICTION * rate / (mass * half_length)
    force = mass * half_length * rate * rate * sine + 0.75 * mass * cosine * pull
    return force, mass * (1 - 0.75 * cosine * cosine), pull
