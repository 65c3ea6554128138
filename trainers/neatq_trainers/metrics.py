"""What a run says of itself: one row for each arena and every 100 ticks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.evolution import RtNEAT
from neatq_trainers.build import Run

ROW_TICKS = 100
"""One tick of the published figures."""


class Row(NamedTuple):
    """One row of `metrics.csv`; distances are to the flag, in units. None is an empty cell."""

    arena: int
    tick: int
    min_distance: float
    mean_distance: float
    max_distance: float
    eligible_mean_distance: float | None
    newborn_mean_distance: float | None
    champion_distance: float | None
    births: int
    species: int
    mean_nodes: float | None
    mean_links: float | None
    td_loss: float | None
    epsilon: float

    def csv(self) -> str:
        """The row as a line of CSV."""
        return csv_line(self)


Line = tuple[int | float | None, ...]
"""A row: a NamedTuple of numbers. None is an empty cell."""


def csv_line(row: Line) -> str:
    """A row as a line of CSV."""
    return ",".join(map(_cell, row)) + "\n"


HEADER = ",".join(Row._fields) + "\n"


def _cell(value: float | None) -> str:
    if value is None:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def rows(run: Run, batch: TensorDictBase, error: Tensor) -> Iterator[Row]:
    """The rows that fall into a batch.

    Args:
        run: The run, its `tick` at the end of the batch.
        batch: [arenas, robots, ticks].
        error: Mean squared TD error of each robot in the batch [arenas, robots]; half of it is the
            row's `td_loss`.
    """
    distance = batch.get(("next", "distance")).squeeze(-1).numpy()
    first = run.tick - distance.shape[-1]
    loss = 0.5 * error.mean(-1).numpy()
    for tick in range((first // ROW_TICKS + 1) * ROW_TICKS, run.tick + 1, ROW_TICKS):
        for arena, now in enumerate(distance[:, :, tick - first - 1]):
            population = run.populations[arena] if run.populations else None
            distances = {
                "min_distance": float(now.min()),
                "mean_distance": float(now.mean()),
                "max_distance": float(now.max()),
            }
            learning = {
                "td_loss": None if np.isnan(loss[arena]) else float(loss[arena]),
                "epsilon": _epsilon(run, arena),
            }
            yield Row(arena=arena, tick=tick, **distances, **_judged(population, now), **learning)


def _epsilon(run: Run, arena: int) -> float:
    """That of all robots; where it is a gene, their mean."""
    if run.genes is None:
        return run.config.learning.epsilon
    return float(run.genes.values[arena, :, 1].mean())


def _judged(population: RtNEAT | None, now: np.ndarray) -> dict[str, Any]:
    """What evolution adds to a row; `now` are the distances [robots]."""
    if population is None:
        nothing = ("eligible_mean_distance", "newborn_mean_distance", "champion_distance")
        empty = (*nothing, "mean_nodes", "mean_links")
        return {"births": 0, "species": 0, **dict.fromkeys(empty)}
    eligible, champion = population.eligible, population.champion
    return {
        "eligible_mean_distance": _mean(now[eligible]),
        "newborn_mean_distance": _mean(now[~eligible]),
        "champion_distance": None if champion is None else float(now[champion]),
        "births": population.births,
        "species": len(population.species),
        "mean_nodes": float(np.mean([genome.node_id.size for genome in population.genomes])),
        "mean_links": float(np.mean([g.link_enabled.sum() for g in population.genomes])),
    }


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None
