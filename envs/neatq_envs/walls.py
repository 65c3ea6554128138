"""Walls: boxes that stop robots and that wall sensors see; the hard maze as walls.

The maze is that of Lehman & Stanley (2011), "Abandoning objectives": the numbers are those of
`hard_maze.txt` in Lehman's published code (mazerobot-python). One unit of the map is one unit of
ours, and its y, which pointed down, points up: the maze is mirrored.

Start and goal are exchanged. Theirs had its dead end so close to the goal, 37 units, that a robot
that waits there all its life is nearer on average than one that takes 450 ticks to arrive, and
nearer on average is what is rewarded here. The other way round, each dead end is farther away
than the whole way costs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neatq_envs.checks import require_fields

MAZE_START, MAZE_GOAL = (31.0, 20.0), (36.0, 184.0)
# Both ends of each wall; the first seven are the outer walls.
_FROM_X = 41, 3, 4, 4, 7, 195, 186, 56, 57, 77, 6, 192, 56
_FROM_Y = 5, 8, 49, 49, 202, 198, 8, 54, 106, 201, 80, 146, 55
_TO_X = 3, 4, 57, 7, 195, 186, 39, 56, 158, 108, 33, 87, 133
_TO_Y = 8, 49, 53, 202, 198, 8, 5, 157, 162, 164, 121, 91, 30


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A box of `width` x `height` units, centred at (x, y), turned by `angle_rad`."""

    x: float
    y: float
    width: float
    height: float
    angle_rad: float = 0.0

    def __post_init__(self) -> None:
        require_fields(Wall, vars(self))

    @staticmethod
    def between(start: tuple[float, float], end: tuple[float, float], *, thickness: float) -> Wall:
        """A wall along a line, so much longer that walls with a common end close."""
        (x, y), (to_x, to_y) = start, end
        return Wall(
            x=(x + to_x) / 2,
            y=(y + to_y) / 2,
            width=math.dist(start, end) + thickness,
            height=thickness,
            angle_rad=math.atan2(to_y - y, to_x - x),
        )


def box_distance(x: np.ndarray, y: np.ndarray, wall: Wall) -> np.ndarray:
    """The distance in units from points to the surface of a wall; negative inside."""
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    dx, dy = x - wall.x, y - wall.y
    along = np.abs(cosine * dx + sine * dy) - wall.width / 2
    across = np.abs(cosine * dy - sine * dx) - wall.height / 2
    outside = np.hypot(np.maximum(along, 0), np.maximum(across, 0))
    return outside + np.minimum(np.maximum(along, across), 0)


def hard_maze(x: float, y: float) -> tuple[Wall, ...]:
    """The walls of the map, its origin at (x, y) in units."""
    return tuple(
        Wall.between((x + a, y + b), (x + c, y + d), thickness=4.0)
        for a, b, c, d in zip(_FROM_X, _FROM_Y, _TO_X, _TO_Y, strict=True)
    )
