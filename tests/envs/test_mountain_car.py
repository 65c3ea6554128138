"""The motion against Gymnasium's, and the optimum that every result is measured by."""

from __future__ import annotations

import math
from collections.abc import Callable

import gymnasium
import numpy as np
import pytest

from neatq_envs import mountain_car
from neatq_envs.mountain_car import gym_start, optimal_actions, steps_to_goal, uniform_start

CELLS = 401


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    return steps_to_goal(CELLS)


def starts(draw: Callable[[np.random.Generator], np.ndarray], rows: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.stack([draw(rng) for _ in range(rows)])


def optimal_steps(table: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Return how many steps the best actions take from states [rows, 2], [rows]."""
    state, steps = state.copy(), np.zeros(len(state), dtype=int)
    while (driving := state[:, 0] < mountain_car.GOAL).any():
        steps += driving
        assert steps.max() < 500, "the policy does not drive to the goal"
        moved = state.copy()
        mountain_car.step(moved, optimal_actions(table, state))
        state = np.where(driving[:, None], moved, state)
    return steps


def test_a_car_moves_as_in_gymnasium() -> None:
    theirs = gymnasium.make("MountainCar-v0").unwrapped
    rng = np.random.default_rng(0)
    states = starts(uniform_start, 300)
    actions = rng.integers(0, 3, size=300)
    moved = states.copy()
    done = mountain_car.step(moved, actions)
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
    mountain_car.step(state, np.array([0, 1, 2]))
    assert state[:, 1] == pytest.approx([-0.001, 0.0, 0.001])
    assert state[:, 0] + math.pi / 6 == pytest.approx([-0.001, 0.0, 0.001])


def test_walls() -> None:
    state = np.array([[-1.19, -0.07], [0.49, 0.07], [0.0, 0.07]])
    done = mountain_car.step(state, np.array([0, 2, 2]))
    assert state[0].tolist() == [-1.2, 0.0]
    assert state[1, 0] == 0.5 and state[1, 1] == 0.07
    assert done.tolist() == [False, True, False]


@pytest.mark.slow
def test_the_optimum_from_uniform_starts(table: np.ndarray) -> None:
    # A policy can only be worse than the optimum, a table read linearly can be either. The two
    # agree, and 40,000 starts leave a standard error of 0.13.
    states = starts(uniform_start, 40_000)
    steps = optimal_steps(table, states)
    assert steps.mean() == pytest.approx(49.2, abs=0.4)
    near = np.rint((states - [-1.2, -0.07]) / [1.7, 0.14] * (CELLS - 1)).astype(int)
    promised = table[near[:, 0], near[:, 1]]
    assert np.mean(promised) == pytest.approx(steps.mean(), abs=0.5)


@pytest.mark.slow
def test_the_optimum_from_the_starts_of_gymnasium(table: np.ndarray) -> None:
    steps = optimal_steps(table, starts(gym_start, 10_000))
    assert steps.mean() == pytest.approx(97.7, abs=0.2)


def test_the_table_is_exact_near_the_goal(table: np.ndarray) -> None:
    # At x = 0.5 - 1.5 * 0.07 with full speed: two steps; one cell before the goal: one.
    assert table[-1].tolist() == [0.0] * CELLS
    assert table[-2, -1] == 1.0
    fast = np.array([[0.5 - 0.105, 0.07], [0.5 - 0.05, 0.07]])
    assert optimal_steps(table, fast).tolist() == [2, 1]


def test_starts_fill_the_state_space() -> None:
    states = starts(uniform_start, 2_000)
    assert states.min(axis=0) == pytest.approx([-1.2, -0.07], abs=0.01)
    assert states.max(axis=0) == pytest.approx([0.5, 0.07], abs=0.01)
    resting = starts(gym_start, 2_000)
    assert (resting[:, 1] == 0).all()
    assert resting[:, 0].min() == pytest.approx(-0.6, abs=0.001)
    assert resting[:, 0].max() == pytest.approx(-0.4, abs=0.001)


def test_wrong_actions_are_refused() -> None:
    for wrong in (np.array([3]), np.array([-1]), np.array([0, 1])):
        with pytest.raises(ValueError, match=r"0, 1 or 2 \[1\]"):
            mountain_car.step(np.zeros((1, 2)), wrong)


def test_unknown_starts_are_refused() -> None:
    with pytest.raises(ValueError, match='expected "uniform" or "gym"'):
        mountain_car.MountainCar("random")  # type: ignore[arg-type]
