"""The hard maze of Lehman & Stanley (2011), "Abandoning objectives", as walls.

The numbers are those of `hard_maze.txt` in Lehman's published code (mazerobot-python). One unit of
the map is one unit of ours, and its y, which pointed down, points up: the maze is mirrored.

Start and goal are exchanged. Theirs had its dead end so close to the goal, 37 units, that a robot
that waits there all its life is nearer on average than one that takes 450 ticks to arrive, and
nearer on average is what is rewarded here. The other way round, each dead end is farther away
than the whole way costs.
"""

from __future__ import annotations

from neatq_envs.walls import Wall

START, GOAL = (31.0, 20.0), (36.0, 184.0)
WALL_THICKNESS = 4.0
# (x, y) of both ends; the first seven are the outer walls.
_SEGMENTS = (
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


def hard_maze(x: float, y: float) -> tuple[Wall, ...]:
    """Return the walls of the map, its origin at (x, y) in units."""
    return tuple(
        Wall.between((x + a, y + b), (x + c, y + d), thickness=WALL_THICKNESS)
        for a, b, c, d in _SEGMENTS
    )
