"""What a run asks of a world, of whichever kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from neatq_torch.learning import Heads
from neatq_torch.learning.heads import ValueRange


class RobotsConfig:
    """What configurations of worlds have in common whose robots live on.

    Attributes:
        scenario: The field, with `name`, `robots` and `lifetime_ticks`.
    """

    lengths: ClassVar = ("ticks",)
    slots_name: ClassVar = "robots"
    lasting: ClassVar = True
    scenario: Any

    @property
    def slots(self) -> int | None:
        """Robots in each arena."""
        return self.scenario.robots

    @property
    def together(self) -> int:
        """How many arenas share a field."""
        return 1

    @property
    def label(self) -> str:
        """What it is called in names of files."""
        return self.scenario.name

    @property
    def lifetime_ticks(self) -> int:
        """Length of a life; 0: no limit."""
        return self.scenario.lifetime_ticks


class World(ABC):
    """What a run asks of a world.

    Attributes:
        env: A TorchRL environment of rows [arenas, slots]; with `world_state`, `load_world_state`
            and `rebuild` (see `ArenaEnv`) a run in it goes on exactly.
        inputs: Numbers that a network reads.
        reward_weights: Of the dimensions of its reward vector, for evolution.
        stream: Of the random numbers of evolution, beside the seed.
    """

    env: Any
    inputs: int
    reward_weights: tuple[float, ...] = (1.0,)
    stream = 1

    @property
    def shape(self) -> tuple[int, int]:
        """(arenas, slots)."""
        arenas, slots = self.env.batch_size
        return arenas, slots

    @property
    def present_weights(self) -> tuple[float, ...]:
        """What `reward_weights` have become: they may change while a run goes on."""
        return self.reward_weights

    @abstractmethod
    def heads(self, candidates: int, value_range: ValueRange = (0.0, 1.0)) -> Heads:
        """How outputs are read: as actions of this world, and values in a range."""

    @abstractmethod
    def default_range(self, discount: float, *, normalized: bool) -> ValueRange:
        """The Q-values that its rewards allow."""

    def join(self, run: Any) -> None:  # noqa: B027  (most worlds need nobody)
        """Take notice of the run that lives here, when it is made.

        Raises:
            ConfigError: If it cannot live here.
        """

    def begin(self, generation: int) -> None:  # noqa: B027  (most worlds go on)
        """Say which generation begins to live with the next reset."""

    def close(self) -> None:  # noqa: B027  (most worlds have nothing open)
        """Close what was opened."""


def return_range(discount: float, *, normalized: bool) -> ValueRange:
    """The Q-values of rewards within [0, 1]."""
    return 0.0, 1.0 if normalized or discount >= 1 else 1 / (1 - discount)
