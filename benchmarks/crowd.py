"""1,000 robots in one arena beside 50 in one: what a robot costs in a tick of `Arena.step`.

"roaming": robots that walked about in random directions before; random actions. "crowded": all
have been driven to one place and keep pushing there. Task `wall`, where robots pass through each
other as in every run; with "colliding" they do not, which the goal leaves open. CPU time.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.measure import in_rounds
from benchmarks.result import Line, compare, times_at_most
from neatq_envs.arena import Arena
from neatq_envs.scenario import TASKS

FEW, MANY = 50, 1000
PLACE = np.array([250.0, 300.0])
APPROACH_TICKS = 400

Drive = Callable[[Arena, np.random.Generator], np.ndarray]


def run(quick: bool) -> list[Line]:
    """Measure roaming and crowded robots."""
    rounds = 3 if quick else 9
    return [
        _line(f"a robot, {name}{', colliding' * collide}", drive, collide, rounds)
        for collide in (False, True)
        for name, drive in (("roaming", _anywhere), ("crowded", _to_one_place))
    ]


def _line(what: str, drive: Drive, collide: bool, rounds: int) -> Line:
    actions = {
        str(robots): _robot_tick(_arena(robots, drive, collide), drive) for robots in (FEW, MANY)
    }
    samples = in_rounds(actions, rounds=rounds)
    return compare(
        f"{what}, {MANY:,} in one arena",
        samples[str(MANY)] * 1e6,
        f"{FEW} in one arena",
        samples[str(FEW)] * 1e6,
        unit="us",
        goal=None if collide else times_at_most(2),
    )


def _arena(robots: int, drive: Drive, collide: bool) -> Arena:
    """An arena whose robots have walked for a while."""
    arena = Arena(TASKS["wall"].replaced(robots=robots, collide=collide), [0])
    rng = np.random.default_rng(0)
    for _ in range(APPROACH_TICKS):
        arena.step(drive(arena, rng))
    return arena


def _robot_tick(arena: Arena, drive: Drive) -> Callable[[], float]:
    """CPU seconds of a robot and tick; choosing the actions does not count."""
    rng = np.random.default_rng(1)
    ticks = 20 * MANY // arena.shape[1]

    def seconds() -> float:
        total = 0.0
        for _ in range(ticks):
            actions = drive(arena, rng)
            begin = time.process_time()
            arena.step(actions)
            total += time.process_time() - begin
        return total / ticks / arena.shape[1]

    return seconds


def _anywhere(arena: Arena, rng: np.random.Generator) -> np.ndarray:
    """Forwards, with small turns: robots spread over the field."""
    turn = arena.scenario.max_turn_rad
    speed = rng.uniform(0.5 * arena.scenario.max_speed, arena.scenario.max_speed, arena.shape)
    return np.stack([speed, rng.uniform(-turn, turn, arena.shape)], -1).astype(np.float32)


def _to_one_place(arena: Arena, _: np.random.Generator) -> np.ndarray:
    way = PLACE - arena.position
    turn = np.arctan2(way[..., 1], way[..., 0]) - arena.heading_rad
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    most = arena.scenario.max_turn_rad
    speed = np.minimum(arena.scenario.max_speed, np.hypot(way[..., 0], way[..., 1]))
    speed = np.where(np.abs(turn) > np.pi / 2, 0.0, speed)
    return np.stack([speed, np.clip(turn, -most, most)], -1).astype(np.float32)
