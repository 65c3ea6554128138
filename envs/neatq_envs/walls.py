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

from neatq_envs.checks import require, require_fields

MAZE_START, MAZE_GOAL = (31.0, 20.0), (36.0, 184.0)
_MAZE_THICKNESS = 4.0
# (x, y) of both ends; the first seven are the outer walls.
_MAZE_SEGMENTS = (
    (41, 5, 3, 8),
    (3, 8, 4, 49),
    (4, 49, 57, 53),
    (4, 49, 7, 202),
    (7, 202, 195, 198),
    (195, 198, 186, 8),
    (186, 8, 39, 5),
    (56, 54, 56, 157),
    (57, 106, 158, 162),
    (77, 201, 108, 164),
    (6, 80, 33, 121),
    (192, 146, 87, 91),
    (56, 55, 133, 30),
)


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A box of `width` x `height` units, centred at (x, y), turned by `angle_rad`."""

    x: float
    y: float
    width: float
    height: float
    angle_rad: float = 0.0

    def __post_init__(self) -> None:
        require_fields(Wall, vars(self), "wall")
        require(
            self.width > 0 and self.height > 0,
            f"wall at ({self.x}, {self.y}): width and height must be greater than 0, "
            f"got {self.width} and {self.height}",
        )

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
        Wall.between((x + a, y + b), (x + c, y + d), thickness=_MAZE_THICKNESS)
        for a, b, c, d in _MAZE_SEGMENTS
    )
