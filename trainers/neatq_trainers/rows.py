"""The rows of numbers that a run writes into `metrics.csv`."""

from __future__ import annotations

from typing import NamedTuple

from neatq_trainers.config import RunConfig
from neatq_trainers.nero.nero_world import NeroConfig
from neatq_trainers.worlds import ArenaConfig

ROW_TICKS = 100
"""One tick of the published figures."""


class DistanceRow(NamedTuple):
    """A row for every 100 ticks in the arena; distances are to the flag, in units.

    The least and the greatest distance are those of the last of these ticks, the others means over
    all of them: lives may all begin at a multiple of 100 ticks, and then a single one of these is
    at the same age in every life. None is an empty cell.
    """

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


class ReturnRow(NamedTuple):
    """A row for every generation in worlds of returns. None is an empty cell.

    Attributes:
        arena: Number of the arena.
        generation: From 1. Where genomes are replaced one at a time, as many lives as there are
            slots.
        episodes: In which genomes of the arena have lived so far; evaluations do not count.
        steps: Of these episodes.
        best_fitness: Best mean return of a life, exploration included.
        mean_fitness: Mean over all slots.
        evaluated_return: Best mean return of an evaluated genome, if there was an evaluation.
        champion_return: That of the champion, when it was evaluated.
        species: Species among which the genomes are divided.
        mean_nodes: Nodes of a genome.
        mean_links: Enabled links of a genome.
        td_error: Mean squared TD error.
    """

    arena: int
    generation: int
    episodes: int
    steps: int
    best_fitness: float
    mean_fitness: float
    evaluated_return: float | None
    champion_return: float
    species: int
    mean_nodes: float
    mean_links: float
    td_error: float | None


class NeroRow(NamedTuple):
    """A row for every 100 ticks on NERO's field. None is an empty cell.

    Hits, damage and deaths are those of a robot in 100 ticks, the mean over the team; distances (to
    the nearest enemy, the nearest friend and the flag, in units) and |speed| (units per tick) are
    means over robots and ticks, empty where there is nothing to measure. `held_out_wins` is the
    share of matches that the team won against teams that training never meets, if it was measured.
    """

    arena: int
    tick: int
    hits: float
    damage: float
    deaths: float
    enemy_distance: float | None
    friend_distance: float | None
    flag_distance: float | None
    speed: float
    births: int
    species: int
    mean_nodes: float | None
    mean_links: float | None
    td_loss: float | None
    epsilon: float
    held_out_wins: float | None = None


Row = DistanceRow | NeroRow | ReturnRow


def row_kind(config: RunConfig) -> type[Row]:
    """The rows that a run writes."""
    if isinstance(config.world, NeroConfig):
        return NeroRow
    return DistanceRow if isinstance(config.world, ArenaConfig) else ReturnRow


def header(kind: type[Row]) -> str:
    """First line of `metrics.csv`."""
    return ",".join(kind._fields) + "\n"


def csv_line(row: Row) -> str:
    """A row as a line of CSV."""
    return ",".join(map(_cell, row)) + "\n"


def _cell(value: float | None) -> str:
    if value is None:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"
