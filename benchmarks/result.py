"""What a row found: costs, the reference's costs, and what was to be reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Cost:
    """One figure over all rounds; less is better.

    Attributes:
        rounds: The figure of each round, in six digits, which are more than any clock has.
    """

    rounds: tuple[float, ...]

    @staticmethod
    def of(samples: np.ndarray) -> Cost:
        """The cost of samples [rounds]."""
        return Cost(rounds=tuple(float(f"{sample:.6g}") for sample in samples))

    @property
    def median(self) -> float:
        """Of the rounds."""
        return float(np.median(self.rounds))

    @property
    def quartiles(self) -> tuple[float, float]:
        """The first and the third."""
        low, high = np.quantile(self.rounds, [0.25, 0.75]).tolist()
        return low, high


@dataclass(frozen=True, kw_only=True)
class Goal:
    """What was to be reached.

    Attributes:
        text: In words.
        limit: Largest cost, or largest ratio to the reference's cost.
        of: Which of the two.
    """

    text: str
    limit: float
    of: Literal["cost", "ratio"]


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of the table.

    Attributes:
        what: What was measured.
        unit: Of the costs: us, ms, bytes, ...
        ours: Our cost.
        reference: What stands beside it; empty if nothing does.
        theirs: Its cost; None if it was not measured here.
        ratio: Our cost in units of the reference's, round by round.
        goal: What was to be reached; None for a line that only explains.
        note: What else the reader should know.
    """

    what: str
    unit: str
    ours: Cost
    reference: str = ""
    theirs: Cost | None = None
    ratio: Cost | None = None
    goal: Goal | None = None
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the goal was reached; None if there is none."""
        if self.goal is None:
            return None
        value = self.ours if self.goal.of == "cost" else self.ratio
        return value is not None and value.median <= self.goal.limit


def compare(
    what: str,
    ours: np.ndarray,
    reference: str = "",
    theirs: np.ndarray | None = None,
    *,
    unit: str,
    goal: Goal | None = None,
    note: str = "",
) -> Line:
    """A line from samples [rounds] of ours and of the reference."""
    return Line(
        what=what,
        unit=unit,
        ours=Cost.of(ours),
        reference=reference,
        theirs=None if theirs is None else Cost.of(theirs),
        ratio=None if theirs is None else Cost.of(ours / theirs),
        goal=goal,
        note=note,
    )


def cost_at_most(limit: float, text: str) -> Goal:
    """Our cost must not be larger than `limit`."""
    return Goal(text=text, limit=limit, of="cost")


def times_at_most(limit: float) -> Goal:
    """Our cost must not be larger than `limit` times the reference's."""
    if limit >= 1:
        text = "cheaper" if limit == 1 else f"at most {limit:g} times the cost"
    else:
        text = f"at least {1 / limit:g} times cheaper"
    return Goal(text=text, limit=limit, of="ratio")
