"""Server jobs against a plain queue, and the baselines that results are measured by."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from neatq_envs import server_jobs
from neatq_envs.server_jobs import (
    UTILITIES,
    best_returns,
    greedy_policy,
    observe,
    oldest_policy,
    ordered_policy,
    play,
    random_policy,
    start,
    step,
    urgent_policy,
)


class Queue:
    """The task as a list of (type, time of arrival) and nothing clever."""

    def __init__(self, types: list[int]) -> None:
        self.waiting = [(kind, 0) for kind in types[:100]]
        self.coming = types[100:]
        self.time = 0

    def counts(self) -> list[int]:
        ages = [(kind, (self.time - arrival) // 50) for kind, arrival in self.waiting]
        return [ages.count((kind, age)) for kind in range(4) for age in range(4)]

    def serve(self, action: int) -> tuple[int, int]:
        """Do a job, and return its type and how long it waited."""
        fitting = [
            place
            for place, (kind, arrival) in enumerate(self.waiting)
            if (kind, (self.time - arrival) // 50) == divmod(action, 4)
        ]
        kind, arrival = self.waiting.pop(fitting[-1] if fitting else 0)
        waited = self.time - arrival
        self.time += 1
        if self.coming:
            self.waiting.append((self.coming.pop(0), self.time))
        return kind, waited


def draw(seed: int) -> np.ndarray:
    return start(np.random.default_rng(seed))


def lost(kind: int, waited: int) -> int:
    """Return the loss of a job, from the table of rates at the top of the module."""
    rates = [(0, 0, 1, 2), (0, 0, 2, 1), (2, 1, 0, 0), (1, 2, 0, 0)][kind]
    return sum(rates[tick // 50] for tick in range(waited))


def test_utilities_by_hand() -> None:
    assert UTILITIES.shape == (4, 201)
    knots = UTILITIES[:, [0, 50, 100, 150, 200]].tolist()
    assert knots[0] == [0, 0, 0, -50, -150]
    assert knots[1] == [0, 0, 0, -100, -150]
    assert knots[2] == [0, -100, -150, -150, -150]
    assert knots[3] == [0, -50, -150, -150, -150]


@pytest.mark.parametrize("seed", range(3))
def test_an_episode_is_that_of_a_plain_queue(seed: int) -> None:
    state = draw(seed)[None]
    queue = Queue(state[0, 1:].tolist())
    rng = np.random.default_rng(seed)
    for number in range(200):
        counts = queue.counts()
        assert observe(state)[0].tolist() == counts
        filled = [action for action in range(16) if counts[action]]
        # Half of the choices are for jobs that are there.
        action = int(rng.choice(filled)) if number % 2 else int(rng.integers(16))
        kind, waited = queue.serve(action)
        utility, empty = step(state, np.array([action]))
        assert utility[0] == -lost(kind, waited)
        assert empty[0] == (number == 199)
    assert not queue.waiting and observe(state).sum() == 0


def test_the_server_takes_the_youngest_of_a_type_and_age() -> None:
    state = draw(0)[None]
    state[0, 1:] = 2  # all of type 3
    step(state, np.array([8]))  # all have age 0; then job 100 arrives
    utility, _ = step(state, np.array([8]))
    assert utility[0] == 0  # job 100 has not waited; the others have lost 2
    assert state[0, 1 + 100] == -1 and (state[0, 1:101] == -1).sum() == 1


def test_an_empty_choice_takes_the_oldest() -> None:
    state = draw(0)[None]
    state[0, 1:] = 2
    step(state, np.array([8]))
    utility, _ = step(state, np.array([0]))  # there is no job of type 1
    assert utility[0] == -2
    assert state[0, 1 + 0] == -1 and state[0, 1 + 100] == 2


def test_what_comes_is_not_seen() -> None:
    one, other = draw(0)[None], draw(0)[None]
    other[0, 150:] = (other[0, 150:] + 1) % 4
    for action in range(16):
        assert observe(one).tolist() == observe(other).tolist()
        step(one, np.array([action]))
        step(other, np.array([action]))


def test_types_are_equally_likely() -> None:
    types = np.concatenate([draw(seed)[1:] for seed in range(200)])
    assert np.bincount(types) / len(types) == pytest.approx([0.25] * 4, abs=0.01)


def test_baselines_stand_where_the_table_says() -> None:
    seeds = range(100)
    within = 200  # three standard errors of 100 episodes
    random = play(random_policy(np.random.default_rng(0)), seeds)
    assert random.mean() == pytest.approx(-11_161, abs=within)
    assert play(oldest_policy, seeds).mean() == pytest.approx(-14_395, abs=within)
    assert play(greedy_policy, seeds).mean() == pytest.approx(-12_505, abs=within)
    assert play(urgent_policy, seeds).mean() == pytest.approx(-6_903, abs=within)
    assert play(ordered_policy, seeds).mean() == pytest.approx(-5_585, abs=within)


def test_nobody_beats_the_oracle() -> None:
    seeds = range(30)
    best = best_returns(seeds)
    assert best.mean() == pytest.approx(-4_772, abs=300)
    for policy in (ordered_policy, urgent_policy, oldest_policy):
        assert (play(policy, seeds) <= best).all()


def test_the_oracle_is_exact() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 4, 6):
        for _ in range(20):
            prices = rng.integers(0, 8, size=(n, n)).astype(float)
            rows = range(n)
            least = min(prices[rows, list(order)].sum() for order in itertools.permutations(rows))
            assert server_jobs._cheapest(prices) == least


def test_the_oracle_does_no_job_before_it_arrives() -> None:
    prices = server_jobs._prices(draw(0))
    for job, arrival in ((0, 0), (99, 0), (100, 1), (199, 100)):
        assert (prices[job, :arrival] == 1e6).all()
        assert (prices[job, arrival:] <= 150).all() and prices[job, arrival] == 0


def test_wrong_actions_are_refused() -> None:
    for wrong in (np.array([16]), np.array([-1]), np.array([0, 1])):
        with pytest.raises(ValueError, match=r"0 to 15 \[1\]"):
            step(draw(0)[None], wrong)
