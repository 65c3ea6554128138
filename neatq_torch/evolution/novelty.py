"""Novelty: how unlike others a robot behaved, as a reason to keep it and to breed from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

NEIGHBOURS = 15
"""Nearest behaviours from which the distance is taken, as Lehman & Stanley (2011) have it."""
ARCHIVE_EVERY = 10
"""Of all behaviours one in so many stays in the archive for ever."""


class Novelty:
    """The behaviours of one population, and an archive of earlier ones (Lehman & Stanley 2011).

    The behaviour of a robot is what is handed in for the tick at which a trial of it closes, as
    `Trials` closes them. Every tenth goes into the archive: one taken blindly serves as well as one
    of the most novel (Lehman & Stanley 2010) and needs no threshold.

    Attributes:
        latest: float64 [robots, dimensions], of the last closed trial; NaN before the first.
        archive: float64 [archived, dimensions], the oldest first.
        seen: behaviours so far.
    """

    def __init__(self, robots: int, trial_ticks: int) -> None:
        """Start with nothing seen; the first behaviours tell how many dimensions there are."""
        self.trial_ticks = trial_ticks
        self.latest = np.full((robots, 0), np.nan)
        self.archive = np.empty((0, 0))
        self.seen = 0

    def record(self, age_ticks: NDArray[np.int64], behaviour: ArrayLike) -> None:
        """Note the behaviours of the trials that close; the cut into batches is no matter.

        Args:
            age_ticks: [robots] before these ticks.
            behaviour: [robots, ticks, dimensions].

        Raises:
            ValueError: the shape is wrong or a behaviour is not finite.
        """
        behaviour = self.checked(behaviour)
        if not self.latest.shape[1]:
            self.latest = np.full((len(self.latest), behaviour.shape[2]), np.nan)
            self.archive = np.empty((0, behaviour.shape[2]))
        after = age_ticks[:, None] + np.arange(1, behaviour.shape[1] + 1)
        # One tick after the other, as they would come in batches of one.
        for tick, robot in np.argwhere(after.T % self.trial_ticks == 0):
            self.latest[robot] = behaviour[robot, tick]
            if self.seen % ARCHIVE_EVERY == 0:
                self.archive = np.vstack((self.archive, self.latest[robot]))
            self.seen += 1

    def checked(self, behaviour: ArrayLike | None) -> NDArray[np.float64]:
        """Return behaviour as float64; ValueError if it is not as `record` needs it."""
        if behaviour is None:
            raise ValueError("novelty counts here: expected the behaviour of the robots, got none.")
        behaviour = np.asarray(behaviour, dtype=np.float64)
        robots, dimensions = self.latest.shape
        known = (robots, dimensions or behaviour.shape[-1])
        if behaviour.ndim != 3 or behaviour.shape[::2] != known:
            raise ValueError(
                f"behaviour must have the shape [robots = {robots}, ticks, dimensions"
                f"{f' = {dimensions}' if dimensions else ''}], not {list(behaviour.shape)}."
            )
        if not np.isfinite(behaviour).all():
            raise ValueError("behaviour must be finite everywhere.")
        return behaviour

    def of(self, slots: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the novelty of robots [slots] that have closed a trial.

        It is the mean distance to the nearest 15 behaviours of the others and of the archive; 0
        where there are none.
        """
        own = self.latest[slots]
        distance = np.sqrt(np.square(own[:, None] - np.vstack((own, self.archive))).sum(-1))
        distance[np.arange(slots.size), np.arange(slots.size)] = np.inf
        nearest = np.sort(distance)[:, : min(NEIGHBOURS, distance.shape[1] - 1)]
        return nearest.mean(-1) if nearest.size else np.zeros(slots.size)

    def state_dict(self) -> dict[str, Any]:
        """Return copies of the arrays."""
        return {"latest": self.latest.copy(), "archive": self.archive.copy(), "seen": self.seen}

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Take over what `state_dict` gave."""
        self.latest = np.array(state["latest"], dtype=np.float64)
        archive = np.array(state["archive"], dtype=np.float64)
        self.archive = archive.reshape(len(archive), self.latest.shape[1])
        self.seen = state["seen"]


def mixed(
    fitness: NDArray[np.float64],
    novelty: NDArray[np.float64],
    eligible: NDArray[np.bool_],
    weight: float,
) -> NDArray[np.float64]:
    """Return (1 - weight) * fitness + weight * novelty [robots], each brought to [0, 1] first.

    So Cuccu & Gomez (2011) mix them: the worst eligible robot has 0 and the best 1, or all have 0
    where they are equal. Robots that are not eligible have 0.

    Args:
        fitness: [robots].
        novelty: [eligible robots].
        eligible: [robots].
        weight: of novelty, in [0, 1].
    """
    score = np.zeros(eligible.size)
    score[eligible] = (1 - weight) * _unit(fitness[eligible]) + weight * _unit(novelty)
    return score


def _unit(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values [n] between 0 for the least and 1 for the greatest."""
    if not values.size:
        return values
    span = values.max() - values.min()
    return (values - values.min()) / span if span > 0 else np.zeros(values.size)
