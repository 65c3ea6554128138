"""A run while it trains, as callbacks see it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from neatq_envs.random_play import EnvFacts
from neatq_trainers.changes import AnyChange
from neatq_trainers.config import LENGTHS, RunConfig
from neatq_trainers.folder import RunFolder


@dataclass(kw_only=True)
class Session:
    """A run while it trains.

    Attributes:
        config: What runs.
        folder: Where the results go.
        facts: Of a Gymnasium task.
        lengths: How long the run is so far, by unit.
        score: The best return of a champion in its evaluation.
        stop: Set it to end the training in order; `resume` goes on.
        wants_checkpoint: Set it to have a checkpoint written soon.
        paused: Set it to let the run stand; `idle` of the callbacks is called until it goes on.
        signals: Numbers of signals that are to end the training, as they come.
        migrations: How many times arenas have exchanged genomes.
        wanted: Changes that somebody asks for; each is made, or refused, when the run can stop.
    """

    config: RunConfig
    folder: RunFolder
    facts: EnvFacts | None
    lengths: dict[str, int] = field(default_factory=lambda: dict.fromkeys(LENGTHS, 0))
    score: float = -math.inf
    stop: bool = False
    wants_checkpoint: bool = False
    paused: bool = False
    signals: Sequence[int] = ()
    migrations: int = 0
    wanted: deque[AnyChange] = field(default_factory=deque)

    @property
    def done(self) -> int:
        """How long the run is so far, in the unit of its length."""
        return self.lengths[self.config.length[0]]

    @property
    def next_migration(self) -> float:
        """The tick at which arenas exchange genomes next; inf: never."""
        migration = self.config.migration
        return math.inf if migration is None else migration.every_ticks * (self.migrations + 1)

    @property
    def over(self) -> bool:
        """Whether the run has its length, or is solved."""
        return self.done >= self.config.length[1] or self.config.solved_by(self.score)
