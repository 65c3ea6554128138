"""Fields on which robots train: they live, die and begin anew, in all arenas at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from neatq_envs.checks import ScenarioError
from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import NERO_ACTIONS, OBSERVATIONS, NeroScenario, Stage
from neatq_envs.nero.state import (
    GIVEN,
    TURRET,
    Field,
    TeamBrains,
    law_of,
    make_field,
    no_brains,
    spawn_robots,
    walls_of,
)
from neatq_torch.jit import cached_njit

MEASURES: tuple[str, ...] = (
    "hits",
    "damage",
    "enemy_distance",
    "friend_distance",
    "flag_distance",
    "speed",
)
"""What is measured of each robot in each tick: hits scored and damage taken, distances to the
nearest enemy, the nearest friend and the flag in units (NaN: there is none), and its speed."""
_OF_FIELDS = tuple(name for name in Field._fields if name not in ("team", "control", "centre"))
_OF_BRAINS = ("value", "before", "active", "fired")
_SAID = "observation", "measures", "pose", "reward_vector", "reward", "terminated"
_STREAM = 8


class TrainingField:
    """Arenas [arenas] of learning robots [robots], of team 0, and whoever is against them.

    Enemies of a team that does not learn begin anew where they die, as learners do.

    Args:
        stages: fields one after the other, of as many robots that sense the same; the last one
            has no end.
        seeds: one for each arena.
        enemies: networks of the enemies of one arena, and how many there are.

    Attributes:
        scenario: the field of the present stage.
        weights: of the rewards, float64 [6]: those of the stage, until somebody changes them.
        observation: float32 [arenas, robots, observations], each in [0, 1].
        reward_vector: for evolution, float64 [arenas, robots, 6], see `_rewards`.
        reward: for learning, float64 [arenas, robots] in [0, 1].
        measures: float64 [arenas, robots, 6], see `MEASURES`.
        pose: x and y in units and headings in rad, float64 [arenas, robots, 3].
        age_ticks: of each life, int64 [arenas, robots].
        terminated: who died, bool [arenas, robots].
        truncated: whose life is over, bool [arenas, robots].
        tick: ticks since the worlds were made.
        bounds: the least and the greatest action, float32 [actions], in physical units.
    """

    def __init__(
        self,
        stages: Sequence[Stage],
        seeds: Sequence[int],
        enemies: tuple[TeamBrains, int] | None = None,
    ) -> None:
        self.stages, self.seeds = tuple(stages), tuple(seeds)
        self._ends = np.cumsum([stage.ticks for stage in self.stages[:-1]])
        self._enemies = enemies if enemies is not None else (no_brains(), 0)
        self.shape = len(self.seeds), self.stages[0].scenario.robots
        self.bounds = action_bounds(self.stages[0].scenario)
        self.reset()

    def reset(self) -> None:
        """Make all worlds new, of their seeds."""
        self._rngs = [np.random.default_rng([seed, _STREAM]) for seed in self.seeds]
        self.tick = 0
        self.age_ticks = np.zeros(self.shape, np.int64)
        self._enter(0)
        for field, rng in zip(self.fields, self._rngs, strict=True):
            self._begin(field, np.flatnonzero(field.control != TURRET), rng)
        self._end(np.zeros(self.shape, bool))
        self._look()

    def _enter(self, stage: int) -> None:
        """Make the fields of a stage; nobody stands on them yet."""
        self._stage, self.scenario = stage, self.stages[stage].scenario
        self.weights = self.scenario.weights()
        self._ground, self._law = walls_of(self.scenario), law_of(self.scenario)
        brains, count = self._enemies
        self._brains = [_of_enemies(brains, self.scenario, count) for _ in self.seeds]
        self.fields = [make_field(self.scenario, (self.shape[1], count)) for _ in self.seeds]
        for field in self.fields:
            field.control[: self.shape[1]] = GIVEN
        self.reward_vector = np.zeros((*self.shape, 6))
        self.reward = np.zeros(self.shape)

    def respawn(self, mask: np.ndarray) -> None:
        """Begin the lives of a mask, bool [arenas, robots], anew.

        The others keep what they observed at the end of the last tick.
        """
        for arena, (field, rng) in enumerate(zip(self.fields, self._rngs, strict=True)):
            self._begin(field, np.flatnonzero(mask[arena]), rng)
        self.age_ticks = np.where(mask, 0, self.age_ticks)
        self._end(np.zeros(self.shape, bool))
        before = self.observation
        self._look()
        self.observation = np.where(mask[..., None], self.observation, before)
        self.reward_vector = np.where(mask[..., None], 0.0, self.reward_vector)

    def step(self, actions: np.ndarray) -> None:
        """Let a tick pass: actions [arenas, robots, actions], clipped to their bounds.

        Raises:
            ValueError: If an action is not finite.
        """
        if not np.isfinite(actions).all():
            raise ValueError("actions: expected finite numbers, got NaN or infinity")
        given = np.zeros((*self.shape[:1], len(self.fields[0].team), 4))
        clipped = np.clip(actions.astype(np.float64), *self.bounds)
        given[:, : self.shape[1], : actions.shape[-1]] = clipped
        for arena, field in enumerate(self.fields):
            own = self._ground, self._law, self._brains[arena], given[arena], self._rngs[arena]
            kernels.tick(field, *own)
        self.tick += 1
        self.age_ticks = self.age_ticks + 1
        before = self.measures
        dead = np.stack([field.damage >= self._law.hit_points for field in self.fields])
        self._end(dead[:, : self.shape[1]])
        self._look()
        self._reward(before)
        if self._raise_enemies(dead):  # whoever shot one is not blamed for where it begins anew
            self._look()
        if self.tick in self._ends:
            self._go_on()

    def _go_on(self) -> None:
        """Begin the next stage: all lives are over, and what they came to is still to be told."""
        kept = {name: getattr(self, name) for name in _SAID}
        self._enter(self._stage + 1)
        for field, rng in zip(self.fields, self._rngs, strict=True):
            self._begin(field, np.flatnonzero(field.control != TURRET), rng)
        for name, value in kept.items():
            setattr(self, name, value)
        self.truncated = ~self.terminated

    def _begin(self, field: Field, robots: np.ndarray, rng: np.random.Generator) -> None:
        """Put robots at their spawns with headings, ready to act."""
        spawn_robots(field, robots, self.scenario, rng)
        degrees = rng.integers(0, 360, size=len(robots))
        field.pose[robots, 2] = np.radians(degrees) - math.pi
        field.begun[robots] = True

    def _raise_enemies(self, dead: np.ndarray) -> bool:
        """Let dead enemies begin anew; whether there were any."""
        found = False
        for arena, field in enumerate(self.fields):
            fallen = np.flatnonzero(dead[arena] & (field.team == 1))
            if len(fallen):
                self._begin(field, fallen, self._rngs[arena])
                found = True
        return found

    def _end(self, dead: np.ndarray) -> None:
        lifetime = self.scenario.lifetime_ticks
        self.terminated = dead
        old = self.age_ticks >= lifetime if lifetime else np.zeros(self.shape, bool)
        self.truncated = old & ~dead

    def _look(self) -> None:
        seen = OBSERVATIONS[self.scenario.sensors]
        self.observation = np.zeros((*self.shape, seen), np.float32)
        self.measures = np.zeros((*self.shape, len(MEASURES)))
        self.pose = np.stack([field.pose[: self.shape[1]] for field in self.fields])
        for arena, field in enumerate(self.fields):
            kernels.correct(field, self._ground)
            kernels.find_centres(field)
            kernels.look(field, self._ground, self._law, self.shape[1], self.observation[arena])
            _measure(field, self.shape[1], self.measures[arena])

    def _reward(self, before: np.ndarray) -> None:
        """Write the rewards of a tick.

        For evolution, as OpenNERO has them: -|speed|, minus the squared distances to the nearest
        friend, the nearest enemy and the flag, hits scored, minus damage taken; 0 of what is not
        there. For learning, the weighted mean of parts in [-1, 1], scaled to [0, 1]: 1 - 2 |speed|
        / max_speed, the way made towards friend, enemy and flag as a share of max_speed, 1 for a
        hit, -1 for damage.
        """
        hits, damage, enemy, friend, flag, speed = np.moveaxis(self.measures, -1, 0)
        away = np.nan_to_num(np.stack([friend, enemy, flag], -1))
        own = np.stack([-speed, hits, -damage], -1)
        self.reward_vector = np.concatenate([own[..., :1], -np.square(away), own[..., 1:]], axis=-1)
        gained = np.nan_to_num(before - self.measures)[..., [3, 2, 4]] / self.scenario.max_speed
        still = 1 - 2 * speed[..., None] / self.scenario.max_speed
        parts = np.concatenate([still, gained, own[..., 1:]], axis=-1).clip(-1, 1)
        self.reward = (parts @ (self.weights / max(np.abs(self.weights).sum(), 1e-12)) + 1) / 2

    def world_state(self) -> dict[str, Any]:
        """All that the worlds are: a nested dict of numpy arrays and JSON values."""
        return {
            "stages": [stage.to_dict() for stage in self.stages],
            "seeds": list(self.seeds),
            "stage": self._stage,
            "weights": self.weights.copy(),
            "tick": self.tick,
            "age_ticks": self.age_ticks.copy(),
            "observation": self.observation.copy(),
            "generators": [rng.bit_generator.state for rng in self._rngs],
            "fields": [_arrays(field, _OF_FIELDS) for field in self.fields],
            "enemies": [_arrays(brains, _OF_BRAINS) for brains in self._brains],
        }

    def load_world_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a `world_state` of equal stages and as many arenas.

        Raises:
            ScenarioError: the state is of other stages or of another number of arenas.
        """
        own = [stage.to_dict() for stage in self.stages]
        if state["stages"] != own or len(state["seeds"]) != len(self.seeds):
            raise ScenarioError(
                f"the state is of {len(state['seeds'])} arenas of {state['stages']}, this has "
                f"{len(self.seeds)} of {own}"
            )
        self._enter(state["stage"])
        self.weights = np.array(state["weights"])
        self.seeds, self.tick = tuple(state["seeds"]), state["tick"]
        for rng, saved in zip(self._rngs, state["generators"], strict=True):
            rng.bit_generator.state = saved
        for field, brains, *saved in zip(
            self.fields, self._brains, state["fields"], state["enemies"], strict=True
        ):
            _load(field, _OF_FIELDS, saved[0])
            _load(brains, _OF_BRAINS, saved[1])
        self._end(np.zeros(self.shape, bool))
        self._look()
        _load(self, ("observation", "age_ticks"), state)


def action_bounds(scenario: NeroScenario) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest action, float32 [actions], in physical units."""
    most = {"speed": scenario.max_speed, "turn": scenario.max_turn_rad}
    names = NERO_ACTIONS[scenario.sensors]
    low = np.array([-most.get(name, 0.0) for name in names], np.float32)
    return low, np.array([most.get(name, 1.0) for name in names], np.float32)


def _arrays(part: Any, names: Sequence[str]) -> dict[str, np.ndarray]:
    return {name: getattr(part, name).copy() for name in names}


def _load(part: Any, names: Sequence[str], saved: Mapping[str, Any]) -> None:
    """Write saved arrays over those of a part; ValueError if one is of another shape or type."""
    for name in names:
        own, value = getattr(part, name), np.asarray(saved[name])
        if (own.shape, own.dtype) != (value.shape, value.dtype):
            raise ValueError(f"{name}: expected {own.dtype} {own.shape}, got {value.dtype}")
        own[...] = value


def _of_enemies(brains: TeamBrains, scenario: NeroScenario, count: int) -> TeamBrains:
    """The networks of the enemies behind robots that have none, with values of their own."""
    bare, turrets = scenario.robots, len(scenario.turrets)
    rows = {"bias": 0.0, "silent": False, "candidates": 1}
    changed: dict[str, np.ndarray] = {
        name: np.concatenate(
            [np.full(bare, empty), getattr(brains, name)[:count], np.full(turrets, empty)]
        )
        for name, empty in rows.items()
    }
    for name in ("node", "output"):
        column = getattr(brains, name)
        ends = np.full(turrets, column[-1])
        changed[name] = np.concatenate([np.zeros(bare, np.int64), column[: count + 1], ends])
    changed |= {name: getattr(brains, name).copy() for name in _OF_BRAINS}
    return brains._replace(**changed)


@cached_njit()
def _measure(field: Field, robots: int, measures: np.ndarray) -> None:
    """Write `MEASURES` of the first robots, float64 [robots, 6]."""
    for robot in range(robots):
        x, y = field.pose[robot, 0], field.pose[robot, 1]
        friend, enemy = math.inf, math.inf
        for other in range(len(field.team)):
            if other == robot or not field.alive[other]:
                continue
            away = (field.pose[other, 0] - x) ** 2 + (field.pose[other, 1] - y) ** 2
            if field.team[other] == field.team[robot]:
                friend = min(friend, away)
            else:
                enemy = min(enemy, away)
        flag = (field.flag[0] - x) ** 2 + (field.flag[1] - y) ** 2
        measures[robot, 0], measures[robot, 1] = field.hits[robot], field.taken[robot]
        measures[robot, 2] = math.sqrt(enemy) if enemy < math.inf else math.nan
        measures[robot, 3] = math.sqrt(friend) if friend < math.inf else math.nan
        measures[robot, 4] = math.sqrt(flag)
        measures[robot, 5] = abs(field.speed[robot])
