"""Who is near whom, without looking at all pairs: robots sorted into the cells of a grid.

The robots of one cell meet those of the cells around it in a plain loop over contiguous arrays,
which the compiler turns into vector instructions. The grid follows from the scenario alone, so
how a number is computed never depends on where robots stand. Few robots share a single cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neatq_torch.jit import cached_njit

ROBOTS_PER_CELL = 16  # if spread evenly; with fewer, loops are too short to be fast


class Grid(NamedTuple):
    """Cells of a field, numbered column by column. What lies outside belongs to the edge cells."""

    columns: int
    rows: int
    cell_width: float
    cell_height: float


class Sorted(NamedTuple):
    """The robots of one arena, sorted by cell."""

    robot: np.ndarray  # int64 [robots], their numbers
    start: np.ndarray  # int64 [cells + 1]; cell c holds the entries start[c] to start[c + 1] - 1
    x: np.ndarray  # float64 [robots], units
    y: np.ndarray


def grid_of(width: float, height: float, robots: int, least: float) -> Grid:
    """The grid for so many robots on a field, its cells at least `least` units wide."""
    side = max(least, math.sqrt(width * height * ROBOTS_PER_CELL / robots))
    columns, rows = max(1, int(width / side)), max(1, int(height / side))
    return Grid(columns, rows, width / columns, height / rows)


@cached_njit()
def friend_offsets(position: np.ndarray, grid: Grid, reach: float) -> np.ndarray:
    """The way from each robot to the middle of all within reach, itself included.

    All in units, [arenas, robots, 2]; cells, unless there is one, must be at least `reach` wide.
    """
    offsets = np.empty_like(position)
    for arena in range(len(position)):
        crowd = _sort(position[arena], grid)
        for cell in range(grid.columns * grid.rows):
            low, high = crowd.start[cell], crowd.start[cell + 1]
            sums = np.zeros((3, high - low))
            for column in _nearby_columns(cell, 1, grid):
                first, last = _entries(cell, column, 1, grid, crowd)
                _add_friends(crowd, (low, high), (first, last), reach, sums)
            for entry in range(low, high):
                friends = sums[2, entry - low]
                offsets[arena, crowd.robot[entry], 0] = sums[0, entry - low] / friends
                offsets[arena, crowd.robot[entry], 1] = sums[1, entry - low] / friends
    return offsets


@cached_njit()
def nearest_friend_squared(position: np.ndarray, grid: Grid) -> np.ndarray:
    """Squared distances [arenas, robots] to the nearest friend, infinite for a robot alone."""
    nearest = np.empty(position.shape[:2])
    side = min(grid.cell_width, grid.cell_height)
    for arena in range(len(position)):
        crowd = _sort(position[arena], grid)
        for cell in range(grid.columns * grid.rows):
            low, high = crowd.start[cell], crowd.start[cell + 1]
            best, rings = np.full(high - low, np.inf), 1
            while low < high:
                for column in _nearby_columns(cell, rings, grid):
                    first, last = _entries(cell, column, rings, grid, crowd)
                    _approach(crowd, (low, high), (first, last), best)
                # Whoever was not looked at is further away than so many cells.
                if best.max() <= (rings * side) ** 2 or rings >= max(grid.columns, grid.rows):
                    break
                rings *= 2
            for entry in range(low, high):
                nearest[arena, crowd.robot[entry]] = best[entry - low]
    return nearest


@cached_njit()
def _nearby_columns(cell: int, rings: int, grid: Grid) -> range:
    """The columns at most `rings` away from that of a cell."""
    column = cell // grid.rows
    return range(max(column - rings, 0), min(column + rings + 1, grid.columns))


@cached_njit()
def _entries(cell: int, column: int, rings: int, grid: Grid, crowd: Sorted) -> tuple[int, int]:
    """The entries of a column whose rows are at most `rings` away from that of a cell."""
    row, bottom = cell % grid.rows, column * grid.rows
    first = bottom + max(row - rings, 0)
    last = bottom + min(row + rings, grid.rows - 1)
    return crowd.start[first], crowd.start[last + 1]


@cached_njit()
def _sort(place: np.ndarray, grid: Grid) -> Sorted:
    """Sort the robots at `place`, float64 [robots, 2], by counting those of each cell."""
    robots = len(place)
    cell, robot = np.empty(robots, np.int64), np.empty(robots, np.int64)
    start = np.zeros(grid.columns * grid.rows + 1, np.int64)
    for i in range(robots):
        column = min(max(int(place[i, 0] / grid.cell_width), 0), grid.columns - 1)
        row = min(max(int(place[i, 1] / grid.cell_height), 0), grid.rows - 1)
        cell[i] = column * grid.rows + row
        start[cell[i]] += 1
    for i in range(1, len(start)):
        start[i] += start[i - 1]  # where each cell ends: filled from behind, where it starts
    x, y = np.empty(robots), np.empty(robots)
    for i in range(robots - 1, -1, -1):
        start[cell[i]] -= 1
        entry = start[cell[i]]
        robot[entry], x[entry], y[entry] = i, place[i, 0], place[i, 1]
    return Sorted(robot, start, x, y)


@cached_njit()
def _add_friends(
    crowd: Sorted, own: tuple[int, int], others: tuple[int, int], reach: float, sums: np.ndarray
) -> None:
    """Add to `sums` [3, own entries] the ways to the others within reach and their number."""
    x, y = crowd.x[own[0] : own[1]], crowd.y[own[0] : own[1]]
    way_x, way_y, friends = sums[0], sums[1], sums[2]
    for other in range(others[0], others[1]):
        other_x, other_y = crowd.x[other], crowd.y[other]
        for i in range(len(x)):
            dx, dy = other_x - x[i], other_y - y[i]
            near = 1.0 if dx * dx + dy * dy <= reach * reach else 0.0
            way_x[i] += near * dx
            way_y[i] += near * dy
            friends[i] += near


@cached_njit()
def _approach(
    crowd: Sorted, own: tuple[int, int], others: tuple[int, int], best: np.ndarray
) -> None:
    """Lower `best` [own entries] to the squared distance of the nearest of the others."""
    x, y = crowd.x[own[0] : own[1]], crowd.y[own[0] : own[1]]
    for other in range(others[0], others[1]):
        other_x, other_y = crowd.x[other], crowd.y[other]
        for i in range(len(x)):
            dx, dy = other_x - x[i], other_y - y[i]
            squared = np.inf if own[0] + i == other else dx * dx + dy * dy
            best[i] = min(best[i], squared)
