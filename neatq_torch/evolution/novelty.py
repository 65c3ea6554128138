"""Novelty: how unlike others a robot behaved, as a reason to keep it and to breed from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.evolution.trials import Kept, checked

NEIGHBOURS = 15
"""Nearest behaviours from which the distance is taken, as Lehman & Stanley (2011) have it."""
ARCHIVE_EVERY = 10
"""Of all behaviours one in so many stays in the archive for ever."""


class Novelty(Kept):
    """The behaviours of one population, and an archive of earlier ones (Lehman & Stanley 2011).

    The behaviour of a robot is what is handed in for the tick at which a trial of it closes. Every
    tenth goes into the archive: one taken blindly serves as well as one of the most novel (Lehman &
    Stanley 2010) and needs no threshold.

    Attributes:
        latest: float64 [slots, dimensions], of the last closed trial; NaN before the first.
        archive: float64 [archived, dimensions], the oldest first.
        seen: behaviours so far.
    """

    kept = ("latest", "archive", "seen")

    def __init__(self, slots: int) -> None:
        self.latest = np.full((slots, 0), np.nan)
        self.archive = np.empty((0, 0))
        self.seen = 0

    def record(self, closing: NDArray[np.bool_], behaviour: NDArray[np.float64]) -> None:
        """Note behaviours [slots, ticks, dimensions] where trials close [slots, ticks]."""
        if not self.latest.shape[1]:
            self.latest = np.full((len(self.latest), behaviour.shape[2]), np.nan)
            self.archive = np.empty((0, behaviour.shape[2]))
        # One tick after the other, as they would come in batches of one.
        for tick, slot in np.argwhere(closing.T):
            self.latest[slot] = behaviour[slot, tick]
            if self.seen % ARCHIVE_EVERY == 0:
                self.archive = np.vstack((self.archive, self.latest[slot]))
            self.seen += 1

    def checked(self, behaviour: ArrayLike | None) -> NDArray[np.float64]:
        """Behaviour as float64; ValueError if it is not as `record` needs it."""
        slots, dimensions = self.latest.shape
        axes = {"slots": slots, "ticks": None, "dimensions": dimensions or None}
        return checked("behaviour", behaviour, mend=" Novelty counts here.", **axes)

    def of(self, slots: NDArray[np.intp]) -> NDArray[np.float64]:
        """Novelty of slots that have closed a trial.

        It is the mean distance to the nearest 15 behaviours of the others and of the archive; 0
        where there are none.
        """
        own = self.latest[slots]
        distance = np.sqrt(np.square(own[:, None] - np.vstack((own, self.archive))).sum(-1))
        distance[np.arange(slots.size), np.arange(slots.size)] = np.inf
        nearest = np.sort(distance)[:, : min(NEIGHBOURS, distance.shape[1] - 1)]
        return nearest.mean(-1) if nearest.size else np.zeros(slots.size)

    def load_state(self, state: Mapping[str, Any]) -> None:
        """See `Kept`; the shapes are those of the state."""
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
    """(1 - weight) * fitness [slots] + weight * novelty [eligible slots], each in [0, 1]; [slots].

    So Cuccu & Gomez (2011) mix them: the worst eligible robot has 0 and the best 1, or all have 0
    where they are equal. Robots that are not eligible have 0.
    """
    score = np.zeros(eligible.size)
    score[eligible] = (1 - weight) * _scaled(fitness[eligible]) + weight * _scaled(novelty)
    return score


def _scaled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values [n] between 0 for the least and 1 for the greatest."""
    span = np.ptp(values) if values.size else 0.0
    return (values - values.min()) / span if span > 0 else np.zeros(values.size)
