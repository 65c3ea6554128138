"""Who lets genomes live: this process, or several at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from neatq_torch.genome import Genome, pack_genomes
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.lives import LifeWorker, Lives, Outcome
from neatq_trainers.generational.recording import Lessons
from neatq_trainers.generational.scout import Surroundings
from neatq_trainers.processes import Remote, usable_cores


class Team:
    """Deals genomes to workers. No life depends on another, so neither do results on the dealing.

    Args:
        config: The run.
        surroundings: What random play has shown.
        workers: Processes; 1 works in this one.
    """

    def __init__(
        self, config: GenerationalConfig, surroundings: Surroundings, workers: int
    ) -> None:
        self._local = LifeWorker(config, surroundings) if workers == 1 else None
        self._remote = [
            Remote(LifeWorker, config, surroundings) for _ in range(workers if workers > 1 else 0)
        ]

    def live(
        self,
        genomes: Sequence[Genome],
        seeds: np.ndarray,
        exploration: np.ndarray | None,
        lessons: Lessons | None = None,
    ) -> Outcome:
        """Let genomes live.

        Args:
            genomes: Whose lives.
            seeds: Of the starts of their episodes [lives, episodes].
            exploration: Seeds of their exploration [lives]; None: no exploration, no learning.
            lessons: What they learn before; None: nothing.
        """
        if self._local is not None:
            return self._local.live(Lives(pack_genomes(genomes), seeds, exploration, lessons))
        count = min(len(self._remote), len(genomes))
        hands = [slice(first, None, count) for first in range(count)]
        for worker, hand in zip(self._remote, hands, strict=False):
            chance = None if exploration is None else exploration[hand]
            before = None if lessons is None else lessons.of(hand)
            worker.ask("live", Lives(pack_genomes(genomes[hand]), seeds[hand], chance, before))
        came = [worker.answer() for worker in self._remote[:count]]
        return _gathered(came, hands, len(genomes))

    def close(self) -> None:
        """End the processes."""
        for worker in self._remote:
            worker.close()


def _gathered(came: Sequence[Outcome], hands: Sequence[slice], lives: int) -> Outcome:
    order = np.argsort(np.concatenate([np.arange(lives)[hand] for hand in hands]))

    def rows(name: str) -> np.ndarray:
        return np.concatenate([getattr(outcome, name) for outcome in came])[order]

    returns, steps, td_error = rows("returns"), rows("steps"), rows("td_error")
    weights = [one for outcome in came for one in outcome.weights]
    left = [one for outcome in came for one in outcome.transitions]
    return Outcome(
        returns,
        steps,
        td_error,
        [weights[place] for place in order],
        [left[place] for place in order] if left else [],
    )


@contextmanager
def open_team(
    config: GenerationalConfig, surroundings: Surroundings, workers: int | None
) -> Iterator[Team]:
    """A team of so many workers; None: one for each core, but no more than genomes."""
    most = config.arenas * config.population
    team = Team(config, surroundings, min(usable_cores() if workers is None else workers, most))
    try:
        yield team
    finally:
        team.close()
