"""Fields on which robots train: they live, die and begin anew, in all arenas at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from neatq_envs.checks import ScenarioError, require
from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import NERO_ACTIONS, OBSERVATIONS, NeroScenario, Stage
from neatq_envs.nero.state import (
    BRAIN,
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
Enemies = tuple[TeamBrains, int] | None
"""Who is against an arena: networks, and how many robots. None: arenas 2 k and 2 k + 1 are against
each other, on one field."""


class Rounds(Protocol):
    """Draws round after round who is against whom.

    Attributes:
        ticks: Of a round.
    """

    ticks: int

    @property
    def lineup(self) -> Sequence[Enemies]:
        """The enemies of each arena in this round."""
        ...

    def reset(self) -> None:
        """Begin with the first round."""

    def advance(self, tick: int, tally: np.ndarray) -> None:
        """Begin the next round, after a tick; `tally` as `TrainingField` has it."""

    def state(self) -> dict[str, Any]:
        """All that it is: a nested dict of numpy arrays and JSON values."""
        ...

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`."""


class TrainingField:
    """Arenas [arenas] of learning robots [robots], and whoever is against them.

    Learners are team 0; where two arenas share a field, those of the second one are team 1. Enemies
    of a team that does not learn begin anew where they die, as learners do.

    Args:
        stages: fields one after the other, of as many robots that sense the same; the last one
            has no end.
        seeds: one for each arena.
        enemies: those of every arena, the same all the time; None: turrets alone.
        rounds: draws the enemies, in place of `enemies`; all lives end with a round.

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
        tally: hits scored and damage taken by each arena in this round (without rounds: so far),
            int64 [arenas, 2].
        trail: if somebody made it a list, the poses and the shots of everybody on the first field,
            tick by tick, see `Field`.
        bounds: the least and the greatest action, float32 [actions], in physical units.
    """

    def __init__(
        self,
        stages: Sequence[Stage],
        seeds: Sequence[int],
        enemies: tuple[TeamBrains, int] | None = None,
        rounds: Rounds | None = None,
    ) -> None:
        self.stages, self.seeds = tuple(stages), tuple(seeds)
        self._ends = np.cumsum([stage.ticks for stage in self.stages[:-1]])
        self._enemies, self._rounds = enemies or (no_brains(), 0), rounds
        self.shape = len(self.seeds), self.stages[0].scenario.robots
        self.bounds = action_bounds(self.stages[0].scenario)
        self.trail: list[tuple[np.ndarray, np.ndarray]] | None = None
        self.reset()

    def reset(self) -> None:
        """Make all worlds new, of their seeds."""
        self._rngs = [np.random.default_rng([seed, _STREAM]) for seed in self.seeds]
        self.tick = 0
        self.age_ticks = np.zeros(self.shape, np.int64)
        self.tally = np.zeros((len(self.seeds), 2), np.int64)
        if self._rounds is not None:
            self._rounds.reset()
        self._stage = -1
        self._enter(0)
        self._begin_all()
        self._end(np.zeros(self.shape, bool))
        self._look()

    def _enter(self, stage: int) -> None:
        """Make the fields of a stage and of a round; nobody stands on them yet."""
        self.scenario = self.stages[stage].scenario
        if stage != self._stage:
            self._stage, self.weights = stage, self.scenario.weights()
        self._ground, self._law = walls_of(self.scenario), law_of(self.scenario)
        arenas, robots = self.shape
        lineup = [self._enemies] * arenas if self._rounds is None else self._rounds.lineup
        self.fields: list[Field] = []
        self._brains, self._arenas = [], []
        for arena, enemies in enumerate(lineup):
            if enemies is None and arena % 2:
                continue  # it is on the field of the arena before
            brains, count = enemies or (no_brains(), 0)
            bare = robots if enemies else 2 * robots
            field = make_field(self.scenario, [robots, count if enemies else robots])
            field.control[:bare] = GIVEN
            self.fields.append(field)
            self._brains.append(_of_enemies(brains, bare, count, len(self.scenario.turrets)))
            self._arenas.append(slice(arena, arena + bare // robots))
        self.reward_vector = np.zeros((*self.shape, 6))
        self.reward = np.zeros(self.shape)

    def _worlds(self) -> Iterator[tuple[Field, slice, np.random.Generator]]:
        """Fields, the arenas whose learners are there, and their chance."""
        for field, arenas in zip(self.fields, self._arenas, strict=True):
            yield field, arenas, self._rngs[arenas.start]

    def respawn(self, mask: np.ndarray) -> None:
        """Begin the lives of a mask, bool [arenas, robots], anew.

        The others keep what they observed at the end of the last tick.
        """
        for field, arenas, rng in self._worlds():
            self._begin(field, np.flatnonzero(_robots_of(mask, arenas)), rng)
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
        clipped = np.clip(actions.astype(np.float64), *self.bounds)
        dead = np.zeros(self.shape, bool)
        for (field, arenas, rng), brains in zip(self._worlds(), self._brains, strict=True):
            own = _robots_of(clipped, arenas)
            given = np.zeros((len(field.team), 4))
            given[: len(own), : own.shape[-1]] = own
            kernels.tick(field, self._ground, self._law, brains, given, rng)
            _robots_of(dead, arenas)[:] = self._fallen(field)[: len(own)]
        if self.trail is not None:
            self.trail.append((self.fields[0].pose.copy(), self.fields[0].shot.copy()))
        self.tick += 1
        self.age_ticks = self.age_ticks + 1
        before = self.measures
        self._end(dead)
        self._look()
        self._reward(before)
        self.tally += self.measures[..., :2].sum(1).astype(np.int64)
        if self._raise_enemies():  # whoever shot one is not blamed for where it begins anew
            self._look()
        self._go_on()

    def _go_on(self) -> None:
        """Begin the next stage or round if it is time.

        All lives are over then, and what they came to is still to be told.
        """
        next_round = self._rounds is not None and self.tick % self._rounds.ticks == 0
        next_stage = bool(self.tick in self._ends)
        if not (next_round or next_stage):
            return
        if self._rounds is not None and next_round:
            self._rounds.advance(self.tick, self.tally)
            self.tally = np.zeros_like(self.tally)
        kept = {name: getattr(self, name) for name in _SAID}
        self._enter(self._stage + next_stage)
        self._begin_all()
        for name, value in kept.items():
            setattr(self, name, value)
        self.truncated = ~self.terminated

    def _begin_all(self) -> None:
        for field, _, rng in self._worlds():
            self._begin(field, np.flatnonzero(field.control != TURRET), rng)

    def _fallen(self, field: Field) -> np.ndarray:
        return field.damage >= self._law.hit_points

    def _begin(self, field: Field, robots: np.ndarray, rng: np.random.Generator) -> None:
        """Put robots at their spawns with headings, ready to act."""
        spawn_robots(field, robots, self.scenario, rng)
        degrees = rng.integers(0, 360, size=len(robots))
        field.pose[robots, 2] = np.radians(degrees) - math.pi
        field.begun[robots] = True

    def _raise_enemies(self) -> bool:
        """Let dead enemies begin anew; whether there were any."""
        found = False
        for field, _, rng in self._worlds():
            fallen = np.flatnonzero(self._fallen(field) & (field.control == BRAIN))
            if len(fallen):
                self._begin(field, fallen, rng)
                found = True
        return found

    def _end(self, dead: np.ndarray) -> None:
        lifetime = self.scenario.lifetime_ticks
        self.terminated = dead
        old = self.age_ticks >= lifetime if lifetime else np.zeros(self.shape, bool)
        self.truncated = old & ~dead

    def _look(self, *, push: bool = True) -> None:
        size = OBSERVATIONS[self.scenario.sensors]
        self.observation = np.zeros((*self.shape, size), np.float32)
        self.measures = np.zeros((*self.shape, len(MEASURES)))
        self.pose = np.zeros((*self.shape, 3))
        for field, arenas, _ in self._worlds():
            seen, measured, pose = (
                _robots_of(one, arenas) for one in (self.observation, self.measures, self.pose)
            )
            pose[:] = field.pose[: len(pose)]
            if push:  # robots out of walls
                kernels.correct(field, self._ground)
            kernels.find_centres(field)
            kernels.look(field, self._ground, self._law, len(seen), seen)
            _measure(field, len(measured), measured)

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

    def change(self, scenario: NeroScenario) -> None:
        """Let the present stage go on in another scenario: it may differ in `CHANGEABLE_NERO`.

        Robots who have taken more hits than it allows, or lived longer, begin new lives; whom a
        wall covers it pushes out. The others sense the change with the next tick.

        Raises:
            ScenarioError: it differs in more; nothing has changed then.
        """
        self.scenario.refuse_change(scenario)
        fields, brains, seen = self.fields, self._brains, self.observation
        if scenario.reward_weights != self.scenario.reward_weights:
            self.weights = scenario.weights()
        stage = replace(self.stages[self._stage], scenario=scenario)
        self.stages = (*self.stages[: self._stage], stage, *self.stages[self._stage + 1 :])
        self._enter(self._stage)
        dead = np.zeros(self.shape, bool)
        for field, before in zip(self.fields, fields, strict=True):
            robots = np.flatnonzero(field.control != TURRET)  # which stand first
            for name in set(_OF_FIELDS) - {"flag"}:
                getattr(field, name)[robots] = getattr(before, name)[robots]
            field.shot[robots] = -1  # a turret may be gone
        for own, before in zip(self._brains, brains, strict=True):
            _load(own, _OF_BRAINS, before._asdict())
        self._raise_enemies()
        for field, arenas, _ in self._worlds():
            own = _robots_of(dead, arenas)
            own[:] = self._fallen(field)[: len(own)]
        self._end(dead)
        self._look()
        self.observation = seen
        self.respawn(self.terminated | self.truncated)

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
            "tally": self.tally.copy(),
            "rounds": None if self._rounds is None else self._rounds.state(),
        }

    def load_world_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a `world_state` of as many arenas, in its stages; see `change`.

        Raises:
            ScenarioError: the state's stages differ in more than may change, or its arenas are of
                another number.
        """
        stages = [Stage.from_dict(one) for one in state["stages"]]
        if len(state["seeds"]) != len(self.seeds) or len(stages) != len(self.stages):
            raise ScenarioError(
                f"the state is of {len(state['seeds'])} arenas of {len(stages)} stages, this has "
                f"{len(self.seeds)} of {len(self.stages)}"
            )
        for own, saved in zip(self.stages, stages, strict=True):
            own.scenario.refuse_change(saved.scenario)
            require(own.ticks == saved.ticks, "stages: the state's have other lengths")
        self.stages = tuple(stages)
        if self._rounds is not None:
            self._rounds.load_state(state["rounds"])
        self._enter(state["stage"])
        self.weights, self.tally = np.array(state["weights"]), np.array(state["tally"])
        self.seeds, self.tick = tuple(state["seeds"]), state["tick"]
        for rng, saved in zip(self._rngs, state["generators"], strict=True):
            rng.bit_generator.state = saved
        for field, brains, *saved in zip(
            self.fields, self._brains, state["fields"], state["enemies"], strict=True
        ):
            _load(field, _OF_FIELDS, saved[0])
            _load(brains, _OF_BRAINS, saved[1])
        self._end(np.zeros(self.shape, bool))
        self._look(push=False)
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


def _robots_of(values: np.ndarray, arenas: slice) -> np.ndarray:
    """A view of values [arenas, robots, ...]: those of some arenas, [robots of all, ...]."""
    return values[arenas].reshape(-1, *values.shape[2:])


def _of_enemies(brains: TeamBrains, bare: int, count: int, turrets: int) -> TeamBrains:
    """Networks of enemies behind `bare` robots that have none, with values of their own."""
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
