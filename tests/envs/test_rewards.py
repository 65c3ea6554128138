"""Rewards of all laws against hand-computed numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from neatq_envs.rewards import Rewards
from neatq_envs.scenario import TASKS

ALL = {"stand_ground": 1.0, "stick_together": 1.0, "approach_flag": 1.0}
DIAGONAL = math.sqrt(1_280_000)  # 1131.37


def vector(law: str, weights: dict[str, float], speed: float = -0.5) -> np.ndarray:
    """Return the rewards of two robots 10 apart, the first 50 units from the flag."""
    rewards = Rewards(TASKS["flag"].replaced(reward=law, reward_weights=weights))
    place = np.array([[(400.0, 400.0), (410.0, 400.0)]])
    return rewards.vector(np.array([[speed, 1.0]]), place, np.array([[370.0, 440.0]]))[0]


def learning(law: str, weights: dict[str, float], squares: list[float]) -> float:
    rewards = Rewards(TASKS["flag"].replaced(reward=law, reward_weights=weights))
    return float(rewards.learning(np.array([[squares]]), np.zeros((1, 1)), np.zeros((1, 1)))[0, 0])


def test_published_vector() -> None:
    assert vector("published", ALL)[0] == pytest.approx([-0.5, -100, -2500])
    assert vector("published", ALL)[1] == pytest.approx([-1.0, -100, -(40**2 + 40**2)])


def test_bounded_vector() -> None:
    expected = [0.5, 1 / (100 / DIAGONAL + 1), 1 / (2500 / DIAGONAL + 1)]
    assert vector("bounded", ALL)[0] == pytest.approx(expected)


def test_friends_are_looked_for_only_if_they_count() -> None:
    assert vector("published", {"approach_flag": 1.0})[0].tolist() == [-0.5, 0, -2500]


def test_a_robot_alone_gets_nothing_for_sticking_together() -> None:
    for law in ("published", "bounded"):
        task = TASKS["flag"].replaced(reward=law, reward_weights=ALL, robots=1)
        got = Rewards(task).vector(np.zeros((1, 1)), np.full((1, 1, 2), 9.0), np.zeros((1, 2)))
        assert got[0, 0, 1] == 0.0


@pytest.mark.parametrize(("distance", "expected"), [(0, 1.0), (141.42, 0.98438), (400, 0.875)])
def test_published_learning_reward_is_that_of_the_original(
    distance: float, expected: float
) -> None:
    reward = learning("published", {"approach_flag": 1.0}, [0, 0, -(distance**2)])
    assert reward == pytest.approx(expected, abs=1e-5)
    assert reward == pytest.approx(1 - distance**2 / 1_280_000)


def test_learning_rewards_are_weighted_means() -> None:
    # stand_ground at full speed is worst (-1 -> 0), the flag is reached (0 -> 1).
    weights = {"stand_ground": 1.0, "approach_flag": 3.0}
    assert learning("published", weights, [-1, 0, 0]) == pytest.approx(0.75)
    assert learning("bounded", weights, [0, 0, 1]) == pytest.approx((0.75 + 1) / 2)


def test_a_negative_weight_turns_the_reward_round() -> None:
    assert learning("published", {"approach_flag": -1.0}, [0, 0, 0]) == 0.0
    assert learning("published", {"approach_flag": -1.0}, [0, 0, -1_280_000]) == pytest.approx(1)
    assert learning("bounded", {"approach_flag": -2.0}, [0, 0, 1]) == 0.0


@pytest.mark.parametrize(
    ("before", "now", "expected"), [(100, 99, 1), (100, 101, 0), (100, 100, 0.5), (9, 8.5, 0.75)]
)
def test_progress_is_the_way_made_good(before: float, now: float, expected: float) -> None:
    for weight, wanted in ((1.0, expected), (-1.0, 1 - expected)):
        rewards = Rewards(
            TASKS["flag"].replaced(reward="progress", reward_weights={"approach_flag": weight})
        )
        vector = np.zeros((1, 1, 3))
        got = rewards.learning(vector, np.array([[before]]), np.array([[now]]))
        assert got.item() == pytest.approx(wanted)


def test_progress_is_measured_in_ticks_of_full_speed() -> None:
    rewards = Rewards(TASKS["flag"].replaced(reward="progress", max_speed=4.0))
    got = rewards.learning(np.zeros((1, 1, 3)), np.array([[10.0]]), np.array([[8.0]]))
    assert got.item() == pytest.approx(0.75)
