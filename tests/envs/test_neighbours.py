"""Friends nearby and the nearest friend, against all pairs in plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neatq_envs.neighbours import friend_offsets, grid_of, nearest_friend_squared

REACH = 15.0


def ways(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ways [robots, robots, 2] from each robot to each, and their squared lengths."""
    way = place[None] - place[:, None]
    return way, (way**2).sum(-1)


def middle_of_friends(place: np.ndarray) -> np.ndarray:
    way, squared = ways(place)
    near = (squared <= REACH**2)[..., None]
    return (way * near).sum(1) / near.sum(1)


def nearest_squared(place: np.ndarray) -> np.ndarray:
    _, squared = ways(place)
    np.fill_diagonal(squared, np.inf)
    return squared.min(1)


@given(
    seed=st.integers(0, 2**32 - 1),
    robots=st.sampled_from([1, 2, 7, 50, 150, 400]),
    size=st.sampled_from([(800.0, 800.0), (90.0, 700.0), (20.0, 20.0)]),
    spread=st.sampled_from([1.2, 1.0, 0.1, 0.01, 0.0]),
)
def test_friends_equal_those_of_all_pairs(
    seed: int, robots: int, size: tuple[float, float], spread: float
) -> None:
    # From all over the field, and 10 % beyond its edges, to all at one place.
    rng = np.random.default_rng(seed)
    centre = rng.uniform(0, size, (2, 1, 2)) if spread < 1 else np.array(size) / 2
    place = centre + np.array(size) * spread * rng.uniform(-0.5, 0.5, (2, robots, 2))
    place[0, 0] = rng.uniform(0, size)  # one strays
    offsets = friend_offsets(place, grid_of(*size, robots, REACH), REACH)
    nearest = nearest_friend_squared(place, grid_of(*size, robots, 1.0))
    for arena in range(2):
        assert offsets[arena] == pytest.approx(middle_of_friends(place[arena]), abs=1e-9)
        assert nearest[arena] == pytest.approx(nearest_squared(place[arena]), abs=1e-9)


def test_cells_are_wide_enough_and_as_many_as_robots_need() -> None:
    assert grid_of(800.0, 800.0, 50, REACH)[:2] == (1, 1)
    assert grid_of(800.0, 400.0, 1000, REACH) == (11, 5, 800 / 11, 80.0)
    assert grid_of(75.0, 30.0, 100_000, REACH) == (5, 2, 15.0, 15.0)
    assert grid_of(10.0, 10.0, 100_000, REACH)[:2] == (1, 1)


@pytest.mark.parametrize("elsewhere", [(0, 270), (340, 800)])
def test_what_a_robot_senses_does_not_depend_on_robots_far_away(
    elsewhere: tuple[float, float],
) -> None:
    rng = np.random.default_rng(0)
    group = rng.uniform(300, 310, (1, 10, 2))
    others = rng.uniform(*elsewhere, (1, 290, 2))
    grid = grid_of(800.0, 800.0, 300, REACH)
    together = friend_offsets(np.concatenate([group, others], axis=1), grid, REACH)[:, :10]
    assert np.array_equal(together, friend_offsets(group, grid, REACH))  # bit for bit
