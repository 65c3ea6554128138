"""The physics of two poles against a second derivation, and the rules of the benchmark."""

from __future__ import annotations

import math

import numpy as np
import pytest

from neatq_envs import double_pole
from neatq_envs.double_pole import PAPER_START_RAD, observe, resting_poles, step

CART = 1.0
POLES = ((0.1, 0.5), (0.01, 0.05))  # kg, m from hinge to centre
G = 9.8
NO_FORCE = 0.5


def failed(state: np.ndarray) -> np.ndarray:
    """Whether the cart has left the track or a pole has fallen, bool [rows]."""
    return np.array([not double_pole._alive_row(row) for row in state])


def lagrange(y: np.ndarray, force: float) -> np.ndarray:
    """Return the rates of change, from the equations of Lagrange instead of Wieland's.

    Cart: (M + sum m) x'' + sum m l cos(a) a'' = F - mu_c sgn(x') + sum m l a'^2 sin(a).
    Each pole: m l cos(a) x'' + 4/3 m l^2 a'' = m g l sin(a) - mu_p a'.
    """
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    matrix[0, 0] = CART + sum(mass for mass, _ in POLES)
    right[0] = force - 5e-4 * np.sign(y[1])
    for pole, (mass, length) in enumerate(POLES, start=1):
        angle, rate = y[2 * pole], y[2 * pole + 1]
        matrix[0, pole] = matrix[pole, 0] = mass * length * math.cos(angle)
        matrix[pole, pole] = 4 / 3 * mass * length**2
        right[0] += mass * length * rate**2 * math.sin(angle)
        right[pole] = mass * G * length * math.sin(angle) - 2e-6 * rate
    cart, long, short = np.linalg.solve(matrix, right)
    return np.array([y[1], cart, y[3], long, y[5], short])


def integrate(y: np.ndarray, force: float, *, steps: int, step_s: float) -> np.ndarray:
    for _ in range(steps):
        a = lagrange(y, force)
        b = lagrange(y + step_s / 2 * a, force)
        c = lagrange(y + step_s / 2 * b, force)
        d = lagrange(y + step_s * c, force)
        y = y + step_s / 6 * (a + 2 * b + 2 * c + d)
    return y


def random_states(rows: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    reach = [2.0, 2.0, 0.6, 2.0, 0.6, 6.0]
    return rng.uniform(-1, 1, size=(rows, 6)) * reach


def energy(y: np.ndarray) -> float:
    """Kinetic and potential energy, J; a pole turns about its centre with m l^2 / 3."""
    total = CART * y[1] ** 2 / 2
    for pole, (mass, length) in enumerate(POLES, start=1):
        angle, rate = y[2 * pole], y[2 * pole + 1]
        across = y[1] + length * rate * math.cos(angle)
        down = length * rate * math.sin(angle)
        total += mass * (across**2 + down**2) / 2 + mass * length**2 * rate**2 / 6
        total += mass * G * length * math.cos(angle)
    return total


def test_an_action_is_two_runge_kutta_steps_of_a_hundredth_of_a_second() -> None:
    states, outputs = random_states(50), np.random.default_rng(1).uniform(size=50)
    moved = states.copy()
    step(moved, outputs)
    for before, output, after in zip(states, outputs, moved, strict=True):
        expected = integrate(before, 20 * (output - 0.5), steps=2, step_s=0.01)
        np.testing.assert_allclose(after, expected, rtol=1e-12, atol=1e-13)


def test_the_step_is_fine_enough() -> None:
    states, outputs = random_states(20), np.random.default_rng(1).uniform(size=20)
    moved = states.copy()
    step(moved, outputs)
    for before, output, after in zip(states, outputs, moved, strict=True):
        exact = integrate(before, 20 * (output - 0.5), steps=200, step_s=1e-4)
        np.testing.assert_allclose(after, exact, rtol=1e-4, atol=1e-4)


def test_a_push_from_rest() -> None:
    # Upright: x'' = 10 / (1 + 0.1 / 4 + 0.01 / 4) = 9.7324; angles turn with -0.75 x'' / l. In
    # 0.02 s nothing else changes by more than a percent, the short pole by gravity 2 percent.
    state = resting_poles(1, 0.0)
    step(state, np.array([1.0]))
    cart = 10 / 1.0275
    assert state[0, 0] == pytest.approx(cart * 0.0002, rel=1e-2)
    assert state[0, 1] == pytest.approx(cart * 0.02, rel=1e-2)
    assert state[0, 3] == pytest.approx(-1.5 * cart * 0.02, rel=1e-2)
    assert state[0, 5] == pytest.approx(-15 * cart * 0.02, rel=2e-2)


def test_without_force_energy_is_kept_but_for_friction() -> None:
    for before in random_states(20):
        after = before[None].copy()
        step(after, np.array([NO_FORCE]))
        # Friction takes less than its greatest force times way, within 0.02 s.
        fastest = np.abs(np.stack([before, after[0]])).max(axis=0) + 0.5
        friction = 0.02 * (5e-4 * fastest[1] + 2e-6 * (fastest[3] ** 2 + fastest[5] ** 2))
        change = energy(after[0]) - energy(before)
        assert -friction - 1e-8 <= change <= 1e-8


def test_a_force_does_work() -> None:
    state = resting_poles(1, 0.0)
    before = energy(state[0])
    step(state, np.array([1.0]))
    assert energy(state[0]) - before == pytest.approx(10 * state[0, 0], rel=1e-3)


def test_left_and_right_are_the_same() -> None:
    states, outputs = random_states(30), np.random.default_rng(1).uniform(size=30)
    mirrored = -states
    step(states, outputs)
    step(mirrored, 1 - outputs)
    np.testing.assert_allclose(mirrored, -states, rtol=1e-12, atol=1e-14)


def test_rows_do_not_influence_each_other() -> None:
    states, outputs = random_states(30), np.random.default_rng(1).uniform(size=30)
    together = states.copy()
    alive = step(together, outputs)
    for row in range(30):
        alone = states[[row]]
        assert step(alone, outputs[[row]])[0] == alive[row]
        assert alone[0].tolist() == together[row].tolist()


def test_it_fails_off_the_track_and_beyond_36_degrees() -> None:
    state = np.zeros((9, 6))
    state[0, 0], state[1, 0], state[2, 0] = 2.4, 2.41, -2.41
    state[3, 2], state[4, 2] = math.radians(36), -math.radians(36.1)
    state[5, 4], state[6, 4] = -math.radians(36), math.radians(36.1)
    state[7, 1] = 50.0
    state[8, 2] = np.nan
    assert failed(state).tolist() == [False, True, True, False, True, False, True, False, True]


def test_step_tells_who_is_alive_afterwards() -> None:
    state = np.zeros((2, 6))
    state[1] = [2.39, 3.0, 0, 0, 0, 0]  # 6 cm in 0.02 s
    assert step(state, np.full(2, NO_FORCE)).tolist() == [True, False]
    assert failed(state).tolist() == [False, True]


def test_poles_fall_when_nobody_acts() -> None:
    for angle in (PAPER_START_RAD, 0.07):
        state, steps = resting_poles(1, angle), 0
        while step(state, np.array([NO_FORCE])).all():
            steps += 1
        assert 10 < steps < 100


def test_starts() -> None:
    assert resting_poles(3).tolist() == [[0, 0, math.pi / 180, 0, 0, 0]] * 3
    assert resting_poles(1, 0.07).tolist() == [[0, 0, 0.07, 0, 0, 0]]


def test_networks_see_scaled_variables() -> None:
    state = np.array([[2.4, 1.0, 0.26, -1.0, 0.13, 4.0]])
    assert observe(state)[0] == pytest.approx([0.5, 0.5, 0.5, -0.5, 0.25, 2.0])
    assert observe(state, velocities=False)[0] == pytest.approx([0.5, 0.5, 0.25])


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"state \[rows, 6\].*got \[2, 5\]"):
        step(np.zeros((2, 5)), np.zeros(2))
    with pytest.raises(ValueError, match=r"output \[rows\].*got \[2, 6\] and \[3\]"):
        double_pole.step(np.zeros((2, 6)), np.zeros(3))
