"""Whether a comparison that was saved still holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neatq_envs.scenario import TASKS
from neatq_trainers.compare.cells import digest
from neatq_trainers.compare.statistics import RESAMPLES
from neatq_trainers.compare.tables import Curves, Study
from neatq_trainers.compare.variants import ARMS, VARIANTS, config_of
from neatq_trainers.config import ConfigError


class Verdict(NamedTuple):
    """How a fresh arm stands to the saved one, by the mean distance of the team.

    Attributes:
        task: Where it ran.
        arm: What ran.
        tick: The last that both have.
        fresh: Mean over the fresh seeds at that tick, units.
        low: Lower end of the saved 95 % interval of such a mean.
        high: Upper end.
        same: Whether every row of every seed that both have is the same, up to rounding.
    """

    task: str
    arm: str
    tick: int
    fresh: float
    low: float
    high: float
    same: bool

    @property
    def holds(self) -> bool:
        """Whether the saved arm still stands: the same rows, or others within the interval."""
        return self.same or self.low <= self.fresh <= self.high


def check_against(saved: Study, fresh: Study) -> list[Verdict]:
    """Compare fresh runs, such as those of `--quick`, with the saved ones of the same arms.

    The saved interval is that of the mean of as many seeds as are fresh, drawn from the saved
    ones: two seeds may lie further from the mean of twenty than its own interval is wide.

    Args:
        saved: What was found before.
        fresh: What was found now; of each of its arms the saved tables must have runs.

    Returns:
        One verdict for each task and arm of `fresh`.

    Raises:
        ConfigError: If the saved tables lack an arm or have no tick in common with it.
    """
    return [_verdict(saved, fresh, task, arm) for task in fresh.tasks for arm in fresh.arms(task)]


def _verdict(saved: Study, fresh: Study, task: str, arm: str) -> Verdict:
    if not saved.outcomes_of(task, arm):
        raise ConfigError(f"saved tables: expected runs of {arm} on {task}, got none; add them")
    before, now = (study.curves(task, arm, "team") for study in (saved, fresh))
    common = np.intersect1d(before.ticks, now.ticks)
    if not common.size:
        raise ConfigError(f"saved tables: {arm} on {task} has no tick that the fresh runs have")
    before, now = (_at(curves, common) for curves in (before, now))
    _, old, new = np.intersect1d(before.seeds, now.seeds, return_indices=True)
    same = bool(new.size) and np.allclose(before.values[old], now.values[new], rtol=1e-5)
    drawn = np.random.default_rng(0).choice(before.values[:, -1], (RESAMPLES, len(now.seeds)))
    low, high = np.quantile(drawn.mean(1), (0.025, 0.975))
    fresh_mean = float(now.values[:, -1].mean())
    return Verdict(task, arm, int(common[-1]), fresh_mean, float(low), float(high), same)


def _at(curves: Curves, ticks: np.ndarray) -> Curves:
    """The rows at some ticks."""
    wanted = np.isin(curves.ticks, ticks)
    return Curves(curves.seeds, curves.ticks[wanted], curves.values[:, wanted])


def outdated(study: Study) -> list[tuple[str, str]]:
    """The tasks and arms that have another configuration in this version than in the tables.

    Tasks of scenario files and arms that this version does not know are left out.
    """
    return [
        (task, arm)
        for task in study.tasks
        for arm in study.arms(task)
        if task in TASKS
        and arm in (*ARMS, *VARIANTS)
        and {one.digest for one in study.outcomes_of(task, arm)} != {digest(config_of(task, arm))}
    ]
