"""The generalisation test and the fitness that are published for double pole balancing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from neatq_envs.double_pole import step
from neatq_experiments.double_pole_rules import damping_fitness, generalisation_starts


def test_the_generalisation_test_has_625_starts() -> None:
    starts = generalisation_starts()
    assert starts.shape == (625, 6) and len(np.unique(starts, axis=0)) == 625
    # 0.05 of a range from its end: 0.9 of half the range from its middle.
    assert starts[0] == pytest.approx(
        [-0.9 * 2.16, -0.9 * 1.35, -0.9 * math.radians(3.6), -0.9 * math.radians(8.6), 0, 0],
        rel=1e-5,
    )
    assert starts[1, :4] == pytest.approx([*starts[0, :3], -0.5 * math.radians(8.6)], rel=1e-5)
    assert starts[312].tolist() == [0] * 6
    assert starts[-1] == pytest.approx(-starts[0])
    assert step(starts.copy(), np.full(625, 0.5)).all()


def test_fitness_without_velocities() -> None:
    # Steps 0 to 249; the wobble of step i is i. The last hundred: (150 + 249) / 2 * 100 = 19,950.
    wobble = np.zeros((2, 100))
    for number in range(250):
        wobble[:, number % 100] = number
    fitness = damping_fitness(np.array([250, 99]), wobble)
    assert fitness[0] == pytest.approx(0.1 * 0.25 + 0.9 * 0.75 / 19_950)
    assert fitness[1] == pytest.approx(0.1 * 0.099)  # fewer than 100 steps: f2 counts nothing
