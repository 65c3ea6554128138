"""Motion and contact by pymunk: arrays in, arrays out.

Chipmunk integrates positions, then finds contacts, then solves velocities. Bodies are therefore
driven by force, with a step of one tick: a velocity written from outside would carry a body into
a wall before any contact is found. The position reported is the one that is about to hold,
P + V, so the wished velocity acts without a tick of lag.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pymunk
from pymunk import batch

from neatq_envs.scenario import BORDER_INSET, Scenario
from neatq_envs.walls import Wall, ray_distance

# What robots of one Space cost when heaped up grows with the square of their number, even if
# they pass through each other; those that do not meet may be dealt into several Spaces.
ROBOTS_PER_SPACE = 50
BORDER_THICKNESS = 60.0
COLLISION_BIAS = 0.9
_ROBOT = 0b01
_WALL = 0b10
# Getting may write past the last row when a buffer is exactly full.
_SPARE_ROWS = 2


class BodyIO:
    """Forces into and positions and velocities out of all bodies of one Space at once.

    pymunk's batch functions know no bounds: rows are all dynamic bodies in the order in which
    they were added, then the static body, so no body is ever removed. A `batch.Buffer` is never
    freed, so each is kept for ever and over rebuilds of its Space.

    Args:
        force: float64 [bodies + 1 or more, 2], contiguous; the row of the static body stays 0.
        motion: float64 [bodies + 1 + spare or more, 4], contiguous: x, y and velocity.
    """

    def __init__(self, force: np.ndarray, motion: np.ndarray) -> None:
        self._force, self._motion = batch.Buffer(), batch.Buffer()
        self._force.set_float_buf(force)
        self._motion.set_float_buf(motion)

    def push(self, space: pymunk.Space) -> None:
        """Set the forces of all bodies."""
        batch.set_space_bodies(space, batch.BodyFields.FORCE, self._force)

    def pull(self, space: pymunk.Space) -> None:
        """Read positions and velocities of all bodies."""
        self._motion.clear()
        fields = batch.BodyFields.POSITION | batch.BodyFields.VELOCITY
        batch.get_space_bodies(space, fields, self._motion)


class Physics:
    """The bodies of all arenas, each arena in Spaces of its own.

    Attributes:
        place: float64 [arenas, robots, 2], where the bodies are.
        velocity: float64 [arenas, robots, 2], units per tick, after contacts were solved.
    """

    def __init__(self, scenario: Scenario, arenas: int) -> None:
        self._scenario = scenario
        robots = scenario.robots
        spaces = 1 if scenario.collide else math.ceil(robots / ROBOTS_PER_SPACE)
        self._size = math.ceil(robots / spaces)
        rows = self._size + 1 + _SPARE_ROWS
        self._force = np.zeros((arenas, spaces, rows, 2))
        self._motion = np.zeros((arenas, spaces, rows, 4))
        self._io = [
            [BodyIO(self._force[a, s], self._motion[a, s]) for s in range(spaces)]
            for a in range(arenas)
        ]
        self._spaces: list[list[tuple[pymunk.Space, list[pymunk.Body]]]] = []
        self.place = np.zeros((arenas, robots, 2))
        self.velocity = np.zeros((arenas, robots, 2))

    @property
    def position(self) -> np.ndarray:
        """Where the bodies are about to be, float64 [arenas, robots, 2]."""
        return self.place + self.velocity

    def rebuild(self, place: np.ndarray, velocity: np.ndarray) -> None:
        """Build all Spaces anew from arrays [arenas, robots, 2].

        A Space also holds contacts that no array shows. Two runs continue alike from the same
        arrays only if both build their Spaces anew at that moment.
        """
        self.place, self.velocity = place.copy(), velocity.copy()
        self._spaces = [
            [
                self._build_space(place[arena, block], velocity[arena, block])
                for block in self._blocks()
            ]
            for arena in range(len(place))
        ]

    def move(self, velocity: np.ndarray) -> None:
        """Let one tick pass in which each body wishes a velocity [arenas, robots, 2]."""
        before = self.position
        push = velocity - self.velocity  # mass 1, step 1: force = change of velocity
        for index, block in enumerate(self._blocks()):
            size = block.stop - block.start
            self._force[:, index, :size] = push[:, block]
        for spaces, ios in zip(self._spaces, self._io, strict=True):
            for (space, _), io in zip(spaces, ios, strict=True):
                io.push(space)
                space.step(1.0)
                io.pull(space)
        motion = self._motion[:, :, : self._size].reshape(len(push), -1, 4)[:, : push.shape[1]]
        self.place, self.velocity = motion[..., :2].copy(), motion[..., 2:].copy()
        if self._scenario.collide:
            self._hold_back(before)

    def teleport(self, mask: np.ndarray, place: np.ndarray) -> None:
        """Put the bodies of `mask` [arenas, robots] at rest at `place` [arenas, robots, 2]."""
        self.place = np.where(mask[..., None], place, self.place)
        self.velocity = np.where(mask[..., None], 0.0, self.velocity)
        for arena, robot in np.argwhere(mask).tolist():
            body = self._spaces[arena][robot // self._size][1][robot % self._size]
            body.position = tuple(place[arena, robot].tolist())
            body.velocity = (0.0, 0.0)

    def _hold_back(self, before: np.ndarray) -> None:
        """Undo the tick of bodies whose centre was pressed into or through a wall by others."""
        now = self.position
        x, y = before[..., 0], before[..., 1]
        way_x, way_y = now[..., 0] - x, now[..., 1] - y
        low, high = BORDER_INSET, (self._scenario.width, self._scenario.height)
        outside = (now <= low) | (now >= np.array(high) - low)
        lost = outside[..., 0] | outside[..., 1]
        for wall in self._scenario.walls:
            lost |= ray_distance(x, y, way_x, way_y, wall) <= 1.0
        if lost.any():
            self.teleport(lost, before)

    def _blocks(self) -> Iterator[slice]:
        robots = self._scenario.robots
        for start in range(0, robots, self._size):
            yield slice(start, min(start + self._size, robots))

    def _build_space(
        self, place: np.ndarray, velocity: np.ndarray
    ) -> tuple[pymunk.Space, list[pymunk.Body]]:
        space = pymunk.Space()
        # pymunk's default belongs to steps of 1/60: at one tick it throws crowds through walls.
        space.collision_bias = COLLISION_BIAS
        walls = ShapeMaker(space.static_body)
        space.add(
            *(walls.box(wall) for wall in (*border_walls(self._scenario), *self._scenario.walls))
        )
        bodies = []
        for where, speed in zip(place.tolist(), velocity.tolist(), strict=True):
            body = pymunk.Body(mass=1.0, moment=math.inf)
            body.position, body.velocity = tuple(where), tuple(speed)
            space.add(body, self._circle(body))
            bodies.append(body)
        return space, bodies

    def _circle(self, body: pymunk.Body) -> pymunk.Circle:
        circle = pymunk.Circle(body, self._scenario.robot_radius)
        circle.friction = 0.0
        mask = _WALL | _ROBOT if self._scenario.collide else _WALL
        circle.filter = pymunk.ShapeFilter(categories=_ROBOT, mask=mask)
        return circle


class ShapeMaker:
    """Makes the shapes of walls on one static body."""

    def __init__(self, body: pymunk.Body) -> None:
        self._body = body

    def box(self, wall: Wall) -> pymunk.Poly:
        """Return the box of a wall."""
        turn = pymunk.Transform(
            a=math.cos(wall.angle_rad),
            b=math.sin(wall.angle_rad),
            c=-math.sin(wall.angle_rad),
            d=math.cos(wall.angle_rad),
            tx=wall.x,
            ty=wall.y,
        )
        half_x, half_y = wall.width / 2, wall.height / 2
        corners = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
        shape = pymunk.Poly(self._body, corners, transform=turn)
        shape.friction = 0.0
        shape.filter = pymunk.ShapeFilter(categories=_WALL)
        return shape


def border_walls(scenario: Scenario) -> tuple[Wall, ...]:
    """Return four walls whose inner faces lie `BORDER_INSET` inside the edges of the field."""
    width, height, thick = scenario.width, scenario.height, BORDER_THICKNESS
    off = thick / 2 - BORDER_INSET
    long_x, long_y = width + 2 * thick, height + 2 * thick
    return (
        Wall(x=-off, y=height / 2, width=thick, height=long_y),
        Wall(x=width + off, y=height / 2, width=thick, height=long_y),
        Wall(x=width / 2, y=-off, width=long_x, height=thick),
        Wall(x=width / 2, y=height + off, width=long_x, height=thick),
    )
