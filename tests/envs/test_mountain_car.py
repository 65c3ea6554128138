"""The motion against Gymnasium's, and the optimum that every result is measured by."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
from numba import njit

from neatq_envs import mountain_car
from neatq_envs.mountain_car import ACTIONS, GOAL, LEFT, MAX_SPEED, MountainCar, _driven

UNIFORM, GYM = MountainCar("uniform"), MountainCar("gym")
CELLS = 401
SETTLED, UNREACHED = 1e-6, 1e9


def steps_to_goal(cells: int = 401) -> np.ndarray:
    """The least steps to the goal from a grid of states, by value iteration.

    Float64 [cells, cells]: places from the left end to the goal, velocities from the least to the
    greatest; between them the table is read linearly in both. 401 cells take about a second.
    """
    table = np.zeros((cells, cells))
    sweep = 0
    while _sweep(table, sweep % 2 == 0, sweep // 2 % 2 == 0) > SETTLED:
        sweep += 1
    return table


@njit
def _sweep(table: np.ndarray, rightwards: bool, upwards: bool) -> float:
    """Improve all entries once, in the given order; the greatest change."""
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


@njit
def optimal_actions(table: np.ndarray, state: np.ndarray) -> np.ndarray:
    """The best actions by a table of `steps_to_goal`, int64 [rows], for states [rows, 2]."""
    actions = np.empty(len(state), dtype=np.int64)
    for row in range(len(state)):
        _, actions[row] = _best(table, state[row, 0], state[row, 1])
    return actions


@njit
def _best(table: np.ndarray, place: float, velocity: float) -> tuple[float, int]:
    """The least steps to the goal by one look ahead, and the action."""
    least, best = UNREACHED, 0
    for action in range(ACTIONS):
        x, v = _driven(place, velocity, action - 1)
        steps = 1 + _read(table, x, v)
        if steps < least:
            least, best = steps, action
    return least, best


@njit
def _read(table: np.ndarray, place: float, velocity: float) -> float:
    """The entry at a state, linear in both variables between the grid's points."""
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


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    return steps_to_goal(CELLS)


def starts(car: MountainCar, rows: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.stack([car.start(rng) for _ in range(rows)])


def optimal_steps(table: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Return how many steps the best actions take from states [rows, 2], [rows]."""
    state, steps = state.copy(), np.zeros(len(state), dtype=int)
    while (driving := state[:, 0] < mountain_car.GOAL).any():
        steps += driving
        assert steps.max() < 500, "the policy does not drive to the goal"
        moved = state.copy()
        UNIFORM.step(moved, optimal_actions(table, state))
        state = np.where(driving[:, None], moved, state)
    return steps


def test_a_car_moves_as_in_gymnasium() -> None:
    theirs = gymnasium.make("MountainCar-v0").unwrapped
    rng = np.random.default_rng(0)
    states = starts(UNIFORM, 300)
    actions = rng.integers(0, 3, size=300)
    moved = states.copy()
    _, done = UNIFORM.step(moved, actions)
    for before, action, after, finished in zip(states, actions, moved, done, strict=True):
        theirs.reset(seed=0)
        theirs.state = tuple(before)  # type: ignore[attr-defined]
        _, _, terminated, _, _ = theirs.step(action)
        place, velocity = theirs.state  # type: ignore[attr-defined]
        # Theirs may roll on to 0.6 after the goal.
        assert after.tolist() == pytest.approx([min(place, 0.5), velocity], abs=1e-15)
        assert finished == terminated


def test_one_step_by_hand() -> None:
    state = np.array([[-math.pi / 6, 0.0]] * 3)  # where it is flat
    UNIFORM.step(state, np.array([0, 1, 2]))
    assert state[:, 1] == pytest.approx([-0.001, 0.0, 0.001])
    assert state[:, 0] + math.pi / 6 == pytest.approx([-0.001, 0.0, 0.001])


def test_walls() -> None:
    state = np.array([[-1.19, -0.07], [0.49, 0.07], [0.0, 0.07]])
    _, done = UNIFORM.step(state, np.array([0, 2, 2]))
    assert state[0].tolist() == [-1.2, 0.0]
    assert state[1, 0] == 0.5 and state[1, 1] == 0.07
    assert done.tolist() == [False, True, False]


@pytest.mark.slow
def test_the_optimum_from_UNIFORMs(table: np.ndarray) -> None:
    # A policy can only be worse than the optimum, a table read linearly can be either. The two
    # agree, and 40,000 starts leave a standard error of 0.13.
    states = starts(UNIFORM, 40_000)
    steps = optimal_steps(table, states)
    assert steps.mean() == pytest.approx(49.2, abs=0.4)
    near = np.rint((states - [-1.2, -0.07]) / [1.7, 0.14] * (CELLS - 1)).astype(int)
    promised = table[near[:, 0], near[:, 1]]
    assert np.mean(promised) == pytest.approx(steps.mean(), abs=0.5)


@pytest.mark.slow
def test_the_optimum_from_the_starts_of_gymnasium(table: np.ndarray) -> None:
    steps = optimal_steps(table, starts(GYM, 10_000))
    assert steps.mean() == pytest.approx(97.7, abs=0.2)


def test_the_table_is_exact_near_the_goal(table: np.ndarray) -> None:
    # At x = 0.5 - 1.5 * 0.07 with full speed: two steps; one cell before the goal: one.
    assert table[-1].tolist() == [0.0] * CELLS
    assert table[-2, -1] == 1.0
    fast = np.array([[0.5 - 0.105, 0.07], [0.5 - 0.05, 0.07]])
    assert optimal_steps(table, fast).tolist() == [2, 1]


def test_starts_fill_the_state_space() -> None:
    states = starts(UNIFORM, 2_000)
    assert states.min(axis=0) == pytest.approx([-1.2, -0.07], abs=0.01)
    assert states.max(axis=0) == pytest.approx([0.5, 0.07], abs=0.01)
    resting = starts(GYM, 2_000)
    assert (resting[:, 1] == 0).all()
    assert resting[:, 0].min() == pytest.approx(-0.6, abs=0.001)
    assert resting[:, 0].max() == pytest.approx(-0.4, abs=0.001)


def test_wrong_actions_are_refused() -> None:
    for wrong in (np.array([3]), np.array([-1]), np.array([0, 1])):
        with pytest.raises(ValueError, match=r"0, 1 or 2 \[1\]"):
            UNIFORM.step(np.zeros((1, 2)), wrong)


def test_unknown_starts_are_refused() -> None:
    with pytest.raises(ValueError, match='expected "uniform" or "gym"'):
        mountain_car.MountainCar("random")  # type: ignore[arg-type]
