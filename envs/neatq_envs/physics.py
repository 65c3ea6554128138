"""Motion and contact by pymunk: arrays in, arrays out.

Chipmunk integrates positions, then finds contacts, then solves velocities. Bodies are therefore
driven by force, with a step of one tick: a velocity written from outside would carry a body into
a wall before any contact is found. The position reported is the one that is about to hold,
P + V, so the wished velocity acts without a tick of lag.
"""

from __future__ import annotations

import math

import numpy as np
import pymunk
from pymunk import batch

from neatq_envs.rays import barriers, ray_distances
from neatq_envs.scenario import BORDER_INSET, Scenario
from neatq_envs.walls import Wall
from neatq_torch.jit import cached_njit

# What robots of one Space cost when heaped up grows with the square of their number, even if
# they pass through each other; those that do not meet may be dealt into several Spaces.
ROBOTS_PER_SPACE = 25
BORDER_THICKNESS, COLLISION_BIAS = 60.0, 0.9
# Of the solver. With pymunk's ten, robots that press into a corner overlap by up to 1.6 radii.
CROWD_ITERATIONS = 30
_ROBOT_BIT, _WALL_BIT = 0b01, 0b10
# Getting may write past the last row when a buffer is exactly full.
_SPARE_ROWS = 2
_FORCE = batch.BodyFields.FORCE
_PLACE_AND_VELOCITY = batch.BodyFields.POSITION | batch.BodyFields.VELOCITY
_AHEAD = np.array([[1.0, 0.0]])


class Room:
    """One Space: the walls of the field and some robots in it.

    pymunk's batch functions read and write all bodies of a Space at once, without bounds: their
    rows are all dynamic bodies in the order in which they were added, then the static body, so no
    body is ever removed from a Space in use. A `batch.Buffer` is never freed, so each is kept.

    Args:
        scenario: gives the walls and the size of robots.
        robots: how many.
        force: float64 [robots + 1 or more, 2], contiguous; the row of the static body stays 0.
        motion: float64 [robots + 1 + spare or more, 4], contiguous: x, y and velocity.
    """

    def __init__(
        self, scenario: Scenario, robots: int, force: np.ndarray, motion: np.ndarray
    ) -> None:
        ground = pymunk.Body(body_type=pymunk.Body.STATIC)
        walls = (*border_walls(scenario), *scenario.walls)
        self.bodies = [pymunk.Body(mass=1.0, moment=math.inf) for _ in range(robots)]
        circles = (_circle(body, scenario) for body in self.bodies)
        self._parts = ground, *self.bodies, *(wall_box(ground, w) for w in walls), *circles
        self._force, self._motion = batch.Buffer(), batch.Buffer()
        self._force.set_float_buf(force)
        self._motion.set_float_buf(motion)
        self.space, self._collide = pymunk.Space(), scenario.collide

    def rebuild(self, place: np.ndarray, velocity: np.ndarray) -> None:
        """Put the walls and robots into a new Space, from arrays [robots, 2]."""
        self.space.remove(*self.space.shapes, *self.space.bodies)
        for body, where, speed in zip(self.bodies, place.tolist(), velocity.tolist(), strict=True):
            # The push out of a contact waits in the body for its next update.
            pymunk.Body.update_position(body, 0.0)
            body.position, body.velocity = tuple(where), tuple(speed)
        self.space = pymunk.Space()
        # pymunk's default belongs to steps of 1/60: at one tick it throws crowds through walls.
        self.space.collision_bias = COLLISION_BIAS
        if self._collide:
            self.space.iterations = CROWD_ITERATIONS
        self.space.add(*self._parts)

    def step(self) -> None:
        """Let one tick pass under the forces; then read positions and velocities."""
        batch.set_space_bodies(self.space, _FORCE, self._force)
        self.space.step(1.0)
        self._motion.clear()
        batch.get_space_bodies(self.space, _PLACE_AND_VELOCITY, self._motion)


class Physics:
    """The bodies of all arenas, each arena in rooms of its own.

    Attributes:
        place: float64 [arenas, robots, 2], where the bodies are.
        velocity: float64 [arenas, robots, 2], units per tick, after contacts were solved.
        position: float64 [arenas, robots, 2], where the bodies are about to be.
    """

    def __init__(self, scenario: Scenario, arenas: int) -> None:
        self._scenario = scenario
        robots = scenario.robots
        rooms = 1 if scenario.collide else math.ceil(robots / ROBOTS_PER_SPACE)
        self._size = math.ceil(robots / rooms)
        starts = range(0, robots, self._size)
        self._blocks = [slice(start, min(start + self._size, robots)) for start in starts]
        rows = self._size + 1 + _SPARE_ROWS
        self._force = np.zeros((arenas, rooms, rows, 2))
        self._motion = np.zeros((arenas, rooms, rows, 4))
        crowds = [block.stop - block.start for block in self._blocks]
        self.rooms = [
            [Room(scenario, crowd, *both) for crowd, *both in zip(crowds, *buffers, strict=True)]
            for buffers in zip(self._force, self._motion, strict=True)
        ]
        self._barriers = barriers(scenario.walls, scenario.width, scenario.height, BORDER_INSET)
        self._hold(np.zeros((arenas, robots, 2)), np.zeros((arenas, robots, 2)))

    def rebuild(
        self, place: np.ndarray, velocity: np.ndarray, arenas: np.ndarray | None = None
    ) -> None:
        """Build the Spaces of `arenas`, bool [arenas], anew from arrays [arenas, robots, 2].

        The rows of all others must be as they are; see `Arena.rebuild`.
        """
        self._hold(place.copy(), velocity.copy())
        for arena in range(len(self.rooms)) if arenas is None else np.flatnonzero(arenas):
            for room, block in zip(self.rooms[arena], self._blocks, strict=True):
                room.rebuild(place[arena, block], velocity[arena, block])

    def move(self, velocity: np.ndarray) -> None:
        """Let one tick pass in which each body wishes a velocity [arenas, robots, 2]."""
        before = self.position
        _write_forces(self._force, self._size, velocity, self.velocity)
        for rooms in self.rooms:
            for room in rooms:
                room.step()
        self._hold(*_read_motion(self._motion, self._size, velocity.shape[1]))
        if self._scenario.collide:
            self._slow_down(before)
            self._hold_back(before)

    def teleport(self, mask: np.ndarray, place: np.ndarray) -> None:
        """Put the bodies of `mask` [arenas, robots] at rest at `place` [arenas, robots, 2]."""
        self._put(mask, place)

    def _put(self, mask: np.ndarray, place: np.ndarray) -> None:
        where = mask[..., None]
        self._hold(np.where(where, place, self.place), np.where(where, 0.0, self.velocity))
        for arena, robot in np.argwhere(mask).tolist():
            body = self.rooms[arena][robot // self._size].bodies[robot % self._size]
            body.position = tuple(place[arena, robot].tolist())
            body.velocity = (0.0, 0.0)

    def _hold(self, place: np.ndarray, velocity: np.ndarray) -> None:
        self.place, self.velocity = place, velocity
        self.position = place + velocity

    def _slow_down(self, before: np.ndarray) -> None:
        """Stop bodies that others have thrown at more than the greatest speed, where it ends."""
        way, most = self.position - before, self._scenario.max_speed
        length = np.hypot(way[..., 0], way[..., 1])
        thrown = length > most * (1 + 1e-9)  # rounding throws nobody
        if thrown.any():
            self._put(thrown, before + way * (most / np.maximum(length, most))[..., None])

    def _hold_back(self, before: np.ndarray) -> None:
        """Undo the tick of bodies whose centre was pressed into or through a wall by others."""
        way = self.position - before
        lost = ray_distances(before, way, _AHEAD, 1.0, self._barriers)[..., 0] <= 1.0
        if lost.any():
            self.teleport(lost, before)


@cached_njit()
def _write_forces(force: np.ndarray, size: int, wished: np.ndarray, velocity: np.ndarray) -> None:
    """Write forces [arenas, rooms, rows, 2] that change velocities [arenas, robots, 2]."""
    for arena in range(len(wished)):
        for robot in range(len(wished[arena])):
            for axis in range(2):  # mass 1, step 1: force = change of velocity
                change = wished[arena, robot, axis] - velocity[arena, robot, axis]
                force[arena, robot // size, robot % size, axis] = change


@cached_njit()
def _read_motion(motion: np.ndarray, size: int, robots: int) -> tuple[np.ndarray, np.ndarray]:
    """Places and velocities, float64 [arenas, robots, 2], of [arenas, rooms, rows, 4]."""
    place, velocity = np.empty((len(motion), robots, 2)), np.empty((len(motion), robots, 2))
    for arena in range(len(motion)):
        for robot in range(robots):
            for axis in range(2):
                place[arena, robot, axis] = motion[arena, robot // size, robot % size, axis]
                velocity[arena, robot, axis] = motion[arena, robot // size, robot % size, axis + 2]
    return place, velocity


def _circle(body: pymunk.Body, scenario: Scenario) -> pymunk.Circle:
    circle = pymunk.Circle(body, scenario.robot_radius)
    circle.friction = 0.0
    mask = _WALL_BIT | _ROBOT_BIT if scenario.collide else _WALL_BIT
    circle.filter = pymunk.ShapeFilter(categories=_ROBOT_BIT, mask=mask)
    return circle


def wall_box(body: pymunk.Body, wall: Wall) -> pymunk.Poly:
    """The shape of a wall on a static body."""
    cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
    turn = pymunk.Transform(cosine, sine, -sine, cosine, wall.x, wall.y)
    half_x, half_y = wall.width / 2, wall.height / 2
    corners = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
    shape = pymunk.Poly(body, corners, transform=turn)
    shape.friction = 0.0
    shape.filter = pymunk.ShapeFilter(categories=_WALL_BIT)
    return shape


def border_walls(scenario: Scenario) -> tuple[Wall, ...]:
    """Four walls whose inner faces lie `BORDER_INSET` inside the edges of the field."""
    width, height, thick = scenario.width, scenario.height, BORDER_THICKNESS
    off = thick / 2 - BORDER_INSET
    long_x, long_y = width + 2 * thick, height + 2 * thick
    sides = [Wall(x=x, y=height / 2, width=thick, height=long_y) for x in (-off, width + off)]
    ends = [Wall(x=width / 2, y=y, width=long_x, height=thick) for y in (-off, height + off)]
    return (*sides, *ends)
