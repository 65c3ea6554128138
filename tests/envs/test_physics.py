"""Motion, walls and crowds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pymunk
import pytest

from neatq_envs.arena import Arena
from neatq_envs.physics import Physics
from neatq_envs.scenario import TASKS, Scenario, Spawn
from neatq_envs.walls import Wall, box_distance

Drive = Callable[[Arena], np.ndarray]


def one_robot(x: float, y: float, task: str = "wall", **changes: object) -> Physics:
    physics = Physics(TASKS[task].replaced(robots=1, **changes), 1)
    physics.rebuild(np.array([[[x, y]]]), np.zeros((1, 1, 2)))
    return physics


def go(physics: Physics, velocity: tuple[float, float], ticks: int) -> list[float]:
    for _ in range(ticks):
        physics.move(np.array([[velocity]]))
    return physics.position[0, 0].tolist()


def test_a_wished_velocity_acts_in_the_same_tick() -> None:
    assert go(one_robot(400, 300), (0.6, -0.8), 1) == pytest.approx([400.6, 299.2])
    assert go(one_robot(400, 300), (0.6, -0.8), 50) == pytest.approx([430, 260])


def test_a_robot_stops_at_the_wall_as_in_the_original() -> None:
    # 398 - 4.09 = 393.91; contacts give way by 0.1.
    x, y = go(one_robot(400, 380), (0.0, 1.0), 100)
    assert (x, y) == pytest.approx((400, 393.9), abs=0.15)


def test_a_robot_slides_along_a_wall() -> None:
    physics = one_robot(380, 380)
    go(physics, (0.5**0.5, 0.5**0.5), 40)
    x, y = physics.position[0, 0]
    later = go(physics, (0.5**0.5, 0.5**0.5), 20)
    assert later[0] - x == pytest.approx(20 * 0.5**0.5, abs=1e-3)
    assert (y, later[1]) == pytest.approx((393.9, 393.9), abs=0.15)


@pytest.mark.parametrize(
    ("velocity", "edge"), [((1, 0), 793.91), ((-1, 0), 6.09), ((0, 1), 793.91), ((0, -1), 6.09)]
)
def test_the_border_stops_robots_on_all_sides(velocity: tuple[float, float], edge: float) -> None:
    place = go(one_robot(400, 400, "flag"), velocity, 450)
    assert place[velocity[0] == 0] == pytest.approx(edge, abs=0.15)


def test_the_fastest_robot_allowed_does_not_pass_a_thin_wall() -> None:
    wall = Wall(x=400, y=400, width=300, height=0.5)
    for start in np.linspace(380, 384, 9):
        physics = one_robot(400, float(start), walls=(wall,), max_speed=4.09)
        assert go(physics, (0.0, 4.09), 60)[1] < 399.75


def test_robots_pass_through_each_other_unless_they_collide() -> None:
    ends = []
    for collide in (False, True):
        physics = Physics(TASKS["flag"].replaced(robots=2, collide=collide), 1)
        physics.rebuild(np.array([[[300.0, 300.0], [330.0, 300.0]]]), np.zeros((1, 2, 2)))
        for _ in range(60):
            physics.move(np.array([[[1.0, 0.0], [-1.0, 0.0]]]))
        ends.append(physics.position[0, :, 0].tolist())
    assert ends[0] == pytest.approx([360, 270])
    assert ends[1] == pytest.approx([315 - 4.09, 315 + 4.09], abs=0.15)


@pytest.mark.parametrize("collide", [False, True])
def test_nobody_leaves_the_field_when_all_push_into_one_corner(
    collide: bool, to_corner: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Contacts alone must hold them: nobody may need to be put back.
    monkeypatch.setattr(Physics, "teleport", lambda *_: pytest.fail("a body was put back"))
    task = Scenario(name="corner", robots=200, collide=collide, spawns=(Spawn(x=60, y=60),))
    arena = Arena(task, [0])
    for _ in range(300):
        arena.step(to_corner(arena))
        assert (arena.position > 2).all() and (arena.position < 798).all()
    near = 300.0 if collide else 30.0
    assert (arena.position.sum(-1) < near).all()


@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_a_crowd_that_presses_into_a_corner_throws_nobody_and_overlaps_little(
    speed: float, to_corner: Drive
) -> None:
    spawn = Spawn(x=120, y=120, jitter=110)
    task = Scenario(name="corner", robots=200, collide=True, max_speed=speed, spawns=(spawn,))
    arena = Arena(task, [0])
    for tick in range(200):
        before = arena.position
        arena.step(to_corner(arena))
        assert np.linalg.norm(arena.position - before, axis=-1).max() <= speed * (1 + 1e-6)
        if tick >= 100:  # those that began on top of each other have parted
            apart = np.linalg.norm(arena.position[0, :, None] - arena.position[0], axis=-1)
            assert apart[~np.eye(200, dtype=bool)].min() > task.robot_radius  # of two radii


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_a_crowd_that_collides_never_enters_or_passes_a_thin_wall(speed: float) -> None:
    walls = (
        Wall(x=400, y=400, width=300, height=4),
        Wall(x=400, y=300, width=4, height=200),
    )
    task = Scenario(
        name="pocket",
        robots=120,
        collide=True,
        walls=walls,
        max_speed=speed,
        spawns=(Spawn(x=350, y=350),),
    )
    arena = Arena(task, [0])
    for _ in range(250):
        way = np.array([398.0, 398.0]) - arena.position
        turn = np.arctan2(way[..., 1], way[..., 0]) - arena.heading_rad
        turn = np.clip((turn + np.pi) % (2 * np.pi) - np.pi, -0.2, 0.2)
        arena.step(np.stack([np.full(arena.shape, speed), turn], -1))
        x, y = arena.position[..., 0], arena.position[..., 1]
        assert all((box_distance(x, y, wall) > 0).all() for wall in walls)
        assert (y[(x > 250) & (x < 550)] < 398).all()


def test_batches_of_bodies_equal_the_attributes_of_bodies(to_flag: Drive) -> None:
    arena = Arena(TASKS["wall"].replaced(collide=True), [3])
    physics = arena._physics
    room = physics.rooms[0][0]
    (ground,) = (body for body in room.space.bodies if body.body_type == pymunk.Body.STATIC)
    for tick in range(150):
        arena.step(to_flag(arena))
        places = np.array([body.position for body in room.bodies])
        speeds = np.array([body.velocity for body in room.bodies])
        assert places.tolist() == physics.place[0].tolist()
        assert speeds.tolist() == physics.velocity[0].tolist()
        assert ground.velocity == ground.position == pymunk.Vec2d(0, 0)
        if tick % 40 == 0:
            arena.rebuild()


def test_many_robots_that_pass_through_share_several_spaces() -> None:
    # 121 robots make 5 rooms; each robot moves as if it were alone.
    arena = Arena(TASKS["flag"].replaced(robots=121), [0])
    assert [len(room.bodies) for room in arena._physics.rooms[0]] == [25, 25, 25, 25, 21]
    start = arena.position
    for _ in range(10):
        arena.step(np.concatenate([np.ones((1, 121, 1)), np.zeros((1, 121, 1))], -1))
    way = np.stack([np.cos(arena.heading_rad), np.sin(arena.heading_rad)], -1)
    assert arena.position == pytest.approx(start + 10 * way)


@pytest.mark.parametrize(
    ("before", "after"), [((3, 400), (1, 400)), ((400, 797), (400, 799)), ((400, 390), (400, 410))]
)
def test_a_body_that_was_pressed_through_a_wall_is_put_back(
    before: tuple[float, float], after: tuple[float, float]
) -> None:
    physics = Physics(TASKS["wall"].replaced(robots=2, collide=True), 1)
    place = np.array([[after, (600.0, 600.0)]], dtype=float)
    physics.rebuild(place, np.full((1, 2, 2), 0.5))
    physics._hold_back(np.array([[before, (590.0, 600.0)]], dtype=float))
    assert physics.position.tolist() == [[list(before), [600.5, 600.5]]]
    assert physics.rooms[0][0].bodies[0].position == before
