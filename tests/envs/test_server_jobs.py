"""Server jobs against a plain queue."""

from __future__ import annotations

import numpy as np
import pytest

from neatq_envs.server_jobs import UTILITIES, count_jobs, draw_jobs, serve


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
    return draw_jobs(np.random.default_rng(seed))


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
        assert count_jobs(state)[0].tolist() == counts
        filled = [action for action in range(16) if counts[action]]
        # Half of the choices are for jobs that are there.
        action = int(rng.choice(filled)) if number % 2 else int(rng.integers(16))
        kind, waited = queue.serve(action)
        utility, empty = serve(state, np.array([action]))
        assert utility[0] == -lost(kind, waited)
        assert empty[0] == (number == 199)
    assert not queue.waiting and count_jobs(state).sum() == 0


def test_the_server_takes_the_youngest_of_a_type_and_age() -> None:
    state = draw(0)[None]
    state[0, 1:] = 2  # all of type 3
    serve(state, np.array([8]))  # all have age 0; then job 100 arrives
    utility, _ = serve(state, np.array([8]))
    assert utility[0] == 0  # job 100 has not waited; the others have lost 2
    assert state[0, 1 + 100] == -1 and (state[0, 1:101] == -1).sum() == 1


def test_an_empty_choice_takes_the_oldest() -> None:
    state = draw(0)[None]
    state[0, 1:] = 2
    serve(state, np.array([8]))
    utility, _ = serve(state, np.array([0]))  # there is no job of type 1
    assert utility[0] == -2
    assert state[0, 1 + 0] == -1 and state[0, 1 + 100] == 2


def test_what_comes_is_not_seen() -> None:
    one, other = draw(0)[None], draw(0)[None]
    other[0, 150:] = (other[0, 150:] + 1) % 4
    for action in range(16):
        assert count_jobs(one).tolist() == count_jobs(other).tolist()
        serve(one, np.array([action]))
        serve(other, np.array([action]))


def test_types_are_equally_likely() -> None:
    types = np.concatenate([draw(seed)[1:] for seed in range(200)])
    assert np.bincount(types) / len(types) == pytest.approx([0.25] * 4, abs=0.01)


def test_wrong_actions_are_refused() -> None:
    for wrong in (np.array([16]), np.array([-1]), np.array([0, 1])):
        with pytest.raises(ValueError, match=r"0 to 15 \[1\]"):
            serve(draw(0)[None], wrong)
