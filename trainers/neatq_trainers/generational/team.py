"""Who lets genomes live: this process, or several at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from neatq_torch.genome import Genome, pack_genomes
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.lives import LifeWorker, Lives, Outcome
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
        self, genomes: Sequence[Genome], seeds: np.ndarray, exploration: np.ndarray | None
    ) -> Outcome:
        """Let genomes live.

        Args:
            genomes: Whose lives.
            seeds: Of the starts of their episodes [lives, episodes].
            exploration: Seeds of their exploration [lives]; None: no exploration, no learning.
        """
        if self._local is not None:
            return self._local.live(Lives(pack_genomes(genomes), seeds, exploration))
        count = min(len(self._remote), len(genomes))
        hands = [slice(first, None, count) for first in range(count)]
        for worker, hand in zip(self._remote, hands, strict=False):
            chance = None if exploration is None else exploration[hand]
            worker.ask("live", Lives(pack_genomes(genomes[hand]), seeds[hand], chance))
        came = [worker.answer() for worker in self._remote[:count]]
        return _gathered(came, hands, len(genomes))

    def close(self) -> None:
        """End the processes."""
        for worker in self._remote:
            worker.close()


def _gathered(came: Sequence[Outcome], hands: Sequence[slice], lives: int) -> Outcome:
    order = np.argsort(np.concatenate([np.arange(lives)[hand] for hand in hands]))
    returns, steps, td_error = (
        np.concatenate([outcome[part] for outcome in came])[order] for part in range(3)
    )
    weights = [one for outcome in came for one in outcome.weights]
    return Outcome(returns, steps, td_error, [weights[place] for place in order])


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
