"""Rewards of all laws against hand-computed numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from neatq_envs.rewards import Rewards
from neatq_envs.scenario import TASKS

ALL = {"stand_ground": 1.0, "stick_together": 1.0, "approach_flag": 1.0}


def give(
    law: str, weights: dict[str, float], flag: tuple[float, float], **changes: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rewards [2, dimensions] and [2] of two robots 10 apart, the first at (400, 400).

    Their speeds are -0.5 and 1; before the move both were 100 units from the flag.
    """
    task = TASKS["flag"].replaced(reward=law, reward_weights=weights, robots=2, **changes)
    place, before = np.array([[(400.0, 400.0), (410.0, 400.0)]]), np.full((1, 2), 100.0)
    vector, learning, distance = Rewards(task).after_move(
        np.array([[-0.5, 1.0]]), place, np.array([flag]), before
    )
    assert distance[0] == pytest.approx(np.hypot(*(place[0] - flag).T))
    return vector[0], learning[0]


AT_50 = (370.0, 440.0)  # a flag 50 units from the first robot


def test_published_vector() -> None:
    vector, _ = give("published", ALL, AT_50)
    assert vector[0] == pytest.approx([-0.5, -100, -2500])
    assert vector[1] == pytest.approx([-1.0, -100, -(40**2 + 40**2)])


def test_friends_are_looked_for_only_if_they_count() -> None:
    vector, _ = give("published", {"approach_flag": 1.0}, AT_50)
    assert vector[0].tolist() == [-0.5, 0, -2500]


def test_a_robot_alone_gets_nothing_for_sticking_together() -> None:
    task = TASKS["flag"].replaced(reward_weights=ALL, robots=1)
    zero, place = np.zeros((1, 1)), np.full((1, 1, 2), 9.0)
    vector, _, _ = Rewards(task).after_move(zero, place, np.zeros((1, 2)), zero)
    assert vector[0, 0, 1] == 0.0


@pytest.mark.parametrize(("distance", "expected"), [(0, 1.0), (141.42, 0.98438), (400, 0.875)])
def test_published_learning_reward_is_that_of_the_original(
    distance: float, expected: float
) -> None:
    _, learning = give("published", {"approach_flag": 1.0}, (400.0, 400.0 - distance))
    assert learning[0] == pytest.approx(expected, abs=1e-5)
    assert learning[0] == pytest.approx(1 - distance**2 / 1_280_000)


def test_learning_rewards_are_weighted_means() -> None:
    # Half and full speed are 0 and -1 on a scale of -1 to 1; the flag, if reached, is 1.
    weights = {"stand_ground": 1.0, "approach_flag": 3.0}
    assert give("published", weights, (410.0, 400.0))[1][1] == pytest.approx((1 + 0.5) / 2)
    assert give("published", weights, (400.0, 400.0))[1][0] == pytest.approx((1 + 0.75) / 2)


def test_friends_count_with_their_weight() -> None:
    # 10 units: -100 of 640,000; the flag is reached.
    weights = {"stick_together": 1.0, "approach_flag": 1.0}
    far = 1 - 100 / 640_000
    assert give("published", weights, (400.0, 400.0))[1][0] == pytest.approx(
        ((far + 1) / 2 + 1) / 2
    )


def test_a_negative_weight_turns_the_reward_round() -> None:
    away = {"approach_flag": -1.0}
    assert give("published", away, (400.0, 400.0))[1][0] == 0.0
    assert give("published", away, (400.0 + 800, 400.0 + 800))[1][0] == pytest.approx(1)


@pytest.mark.parametrize(
    ("now", "expected"), [(99, 1), (101, 0), (100, 0.5), (99.5, 0.75), (90, 1)]
)
def test_progress_is_the_way_made_good(now: float, expected: float) -> None:
    for weight, wanted in ((1.0, expected), (-1.0, 1 - expected)):
        _, learning = give("progress", {"approach_flag": weight}, (400.0, 400.0 + now))
        assert learning[0] == pytest.approx(wanted)


def test_progress_is_measured_in_ticks_of_full_speed() -> None:
    _, learning = give("progress", {"approach_flag": 1.0}, (400.0, 498.0), max_speed=4.0)
    assert learning[0] == pytest.approx(0.75)
