"""The worlds of robots, walls and a flag: plain numpy in, plain numpy out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from neatq_envs.flags import ArenaFlags
from neatq_envs.physics import Physics
from neatq_envs.rewards import Rewards, flag_distance
from neatq_envs.scenario import REWARD_DIMENSIONS, Scenario, ScenarioError
from neatq_envs.sensors import IGNORE_ABOVE, Senses
from neatq_torch.jit import cached_njit

# Random numbers of one arena, of [seed, index here]. Flags have their own, so that their places do
# not depend on how often robots respawn.
_STREAMS = ("spawn_generators", "flag_generators")
_WORLD_ARRAYS = ("heading_rad", "age_ticks", "observation", "reward", "reward_vector", "distance")


class Arena:
    """Steps several arenas of one scenario together; none influences another.

    One tick: headings turn, robots move along their *new* headings as far as walls let them,
    rewards are given, ages grow, the flag may move (or the other of two may count), robots sense.
    Arena i of a run over many seeds is, bit for bit, the arena of a run over seed i alone.

    All arrays are replaced as a whole and never written in place: what was handed out stays.

    Attributes:
        heading_rad: float64 [arenas, robots], in (-pi, pi], counterclockwise from the x axis.
        age_ticks: int64 [arenas, robots], ticks since the robot's life began.
        distance: float64 [arenas, robots] to the flag that counts, units.
        observation: float32 [arenas, robots, observations] in [0, 1]. After `respawn`, robots
            that were not respawned keep what they sensed at the end of the last tick.
        reward: float64 [arenas, robots], of the last tick, for learning, in [0, 1].
        reward_vector: float64 [arenas, robots, dimensions], of the last tick, for evolution.
        tick: ticks since all worlds were made, by the constructor or `reset`.
    """

    def __init__(self, scenario: Scenario, seeds: Sequence[int]) -> None:
        if not seeds:
            raise ValueError("seeds: expected one for each arena, got none")
        self.seeds = tuple(int(seed) for seed in seeds)
        self._obey(scenario)
        # The bounds are single precision, as the actions of networks are.
        low, high = self.schema.action_bounds(scenario)
        self._bounds = low.astype(np.float64), high.astype(np.float64)
        self._generators = {
            name: [np.random.default_rng([seed, stream]) for seed in self.seeds]
            for stream, name in enumerate(_STREAMS)
        }
        self._flags = ArenaFlags(scenario, self._generators["flag_generators"])
        self.tick, self._began = 0, np.zeros(len(seeds), dtype=np.int64)
        self.age_ticks = np.zeros(self.shape, dtype=np.int64)
        self.heading_rad = self.reward = np.zeros(self.shape)
        self.reward_vector = np.zeros((*self.shape, len(REWARD_DIMENSIONS)))
        self.observation = np.zeros((*self.shape, len(self.schema.observations)), np.float32)
        self.reset()

    def _obey(self, scenario: Scenario) -> None:
        """Make everything of a scenario but its flags."""
        self.scenario = scenario
        self._senses, self._rewards = Senses(scenario), Rewards(scenario)
        self.schema = self._senses.schema
        self._physics = Physics(scenario, len(self.seeds))
        self._spawn_centres = np.array([(spawn.x, spawn.y) for spawn in scenario.spawns])
        self._jitters = np.array([spawn.jitter for spawn in scenario.spawns])

    @property
    def shape(self) -> tuple[int, int]:
        """Arenas, robots in each."""
        return len(self.seeds), self.scenario.robots

    @property
    def position(self) -> np.ndarray:
        """Positions, float64 [arenas, robots, 2], units; y points up."""
        return self._physics.position

    @property
    def flag(self) -> np.ndarray:
        """Places of the flags, of two the one that counts, float64 [arenas, 2], units."""
        return self._flags.place

    @property
    def truncated(self) -> np.ndarray:
        """Whether lives have lasted `lifetime_ticks`, bool [arenas, robots]."""
        lifetime = self.scenario.lifetime_ticks
        return (self.age_ticks >= lifetime) & bool(lifetime)

    def reset(self) -> None:
        """Make new worlds; random numbers go on where the old worlds left them."""
        self.tick = 0
        self.renew(np.ones(len(self.seeds), dtype=bool))

    def renew(self, arenas: np.ndarray, seeds: Sequence[int | None] | None = None) -> None:
        """Make new worlds for some arenas; the others are not touched.

        Args:
            arenas: bool [arenas], which.
            seeds: one for each arena, of which those of `arenas` count; where it is None, random
                numbers go on where the old world left them.
        """
        for arena in np.flatnonzero(arenas).tolist():
            if seeds is not None and (seed := seeds[arena]) is not None:
                self.seeds = (*self.seeds[:arena], int(seed), *self.seeds[arena + 1 :])
                for stream, name in enumerate(_STREAMS):
                    self._generators[name][arena] = np.random.default_rng([int(seed), stream])
        self._began = np.where(arenas, self.tick, self._began)
        self._flags.begin(arenas)
        everyone = np.repeat(arenas[:, None], self.scenario.robots, axis=1)
        drawn, heading_rad = self._draw_spawns(everyone)
        place = np.where(everyone[..., None], drawn, self._physics.place)
        velocity = np.where(everyone[..., None], 0.0, self._physics.velocity)
        self._physics.rebuild(place, velocity, arenas)
        self._begin_lives(everyone, heading_rad)
        if self.scenario.first_lives == "spread":
            lifetime, robots = self.scenario.lifetime_ticks, self.scenario.robots
            ages = np.arange(robots) * lifetime // robots
            self.age_ticks = np.where(everyone, ages, self.age_ticks)

    def respawn(self, mask: np.ndarray) -> None:
        """Begin new lives for the robots of `mask`, bool [arenas, robots]; the world goes on."""
        if mask.shape != self.shape or mask.dtype != bool:
            words = f"{list(self.shape)}, got {mask.dtype} {list(mask.shape)}"
            raise ValueError(f"mask: expected bool [arenas, robots] = {words}")
        if not mask.any():
            return
        place, heading_rad = self._draw_spawns(mask)
        self._physics.teleport(mask, place)
        self._begin_lives(mask, heading_rad)

    def _begin_lives(self, mask: np.ndarray, heading_rad: np.ndarray) -> None:
        self.heading_rad = np.where(mask, heading_rad, self.heading_rad)
        self.age_ticks = np.where(mask, 0, self.age_ticks)
        self.reward = np.where(mask, 0.0, self.reward)
        self.reward_vector = np.where(mask[..., None], 0.0, self.reward_vector)
        self.distance = flag_distance(self.position, self.flag)
        fresh = self._sense(directions(self.heading_rad))
        self.observation = np.where(mask[..., None], fresh, self.observation)

    def step(self, actions: np.ndarray) -> None:
        """Let one tick pass.

        Args:
            actions: [arenas, robots, actions] in physical units (`schema.action_bounds`);
                clipped to the bounds.

        Raises:
            ValueError: of a wrong shape, or naming the robot whose action is not finite.
        """
        wanted = (*self.shape, len(self.schema.actions))
        if actions.shape != wanted:
            words = f"{list(wanted)}, got {list(actions.shape)}"
            raise ValueError(f"actions: expected [arenas, robots, actions] = {words}")
        actions = np.array(actions, dtype=np.float64, order="C")
        finite, heading_rad, speed = steer(actions, self.heading_rad, *self._bounds)
        if not finite:
            arena, robot, action = np.argwhere(~np.isfinite(actions))[0].tolist()
            raise ValueError(
                f"action {self.schema.actions[action]} of robot {robot} in arena {arena} is "
                f"{actions[arena, robot, action]}; expected a finite number"
            )
        self.heading_rad, ahead = heading_rad, directions(heading_rad)
        self._physics.move(speed[..., None] * ahead)
        self.reward_vector, self.reward, self.distance = self._rewards.after_move(
            speed, self.position, self.flag, before=self.distance
        )
        self.age_ticks = self.age_ticks + 1
        self.tick += 1
        if self._flags.update(self.tick - self._began):
            self.distance = flag_distance(self.position, self.flag)
        ignore = actions[..., 3] > IGNORE_ABOVE if actions.shape[-1] > 3 else None
        self.observation = self._sense(ahead, self.reward, ignore)

    def change(self, scenario: Scenario) -> None:
        """Let the worlds go on in another scenario, which may differ in `CHANGEABLE` alone.

        Robots whose middle a wall covers, or whose lives are longer than they may be now, begin new
        lives. The others sense the change with the next tick.

        Raises:
            ScenarioError: it differs in more; nothing has changed then.
        """
        self.scenario.refuse_change(scenario)
        place, velocity = self._physics.place, self._physics.velocity
        self._obey(scenario)
        self._physics.rebuild(place, velocity)
        self._flags.change(scenario, self.tick - self._began)
        self.distance = flag_distance(self.position, self.flag)
        covered = scenario.in_wall(*np.moveaxis(self.position, -1, 0))
        self.respawn(covered | self.truncated)

    def rebuild(self) -> None:
        """Build the physics anew from the arrays, as a restored run does.

        A run continues bit for bit from `world_state` only if it rebuilds at that tick, too:
        physics holds contacts that no array shows.
        """
        self._physics.rebuild(self._physics.place, self._physics.velocity)

    def world_state(self) -> dict[str, Any]:
        """All that the worlds are: a nested dict of numpy arrays and JSON values."""
        return {
            "scenario": self.scenario.to_dict(),
            "seeds": list(self.seeds),
            "tick": self.tick,
            "began": self._began.copy(),
            "place": self._physics.place.copy(),
            "velocity": self._physics.velocity.copy(),
            "flag": self.flag.copy(),
            **{
                name: [rng.bit_generator.state for rng in generators]
                for name, generators in self._generators.items()
            },
            **{name: getattr(self, name).copy() for name in _WORLD_ARRAYS},
        }

    def load_world_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a `world_state` of as many arenas, in its scenario; see `change`.

        Raises:
            ScenarioError: the state's scenario differs in more than may change, or its arenas are
                of another number.
        """
        # Read, not compared as it is: a state may be older than a key of scenarios.
        scenario = Scenario.from_dict(state["scenario"])
        self.scenario.refuse_change(scenario)
        if scenario != self.scenario:
            self._obey(scenario)
            self._flags.change(scenario, self._began)
        if len(state["seeds"]) != len(self.seeds):
            words = f"the state has {len(state['seeds'])} arenas, this has {len(self.seeds)}"
            raise ScenarioError(words)
        self.seeds, self.tick = tuple(state["seeds"]), state["tick"]
        self._began = np.array(state.get("began", np.zeros(len(self.seeds))), dtype=np.int64)
        for name in _WORLD_ARRAYS:
            setattr(self, name, np.array(state[name], dtype=getattr(self, name).dtype))
        self._flags.place = np.array(state["flag"])
        for name, generators in self._generators.items():
            for rng, stored in zip(generators, state[name], strict=True):
                rng.bit_generator.state = stored
        self._physics.rebuild(np.array(state["place"]), np.array(state["velocity"]))

    def __getstate__(self) -> dict[str, Any]:
        """What copies and pickles hold; see `rebuild`, which is why the original rebuilds, too."""
        self.rebuild()
        return self.world_state()

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Be an arena that goes on, bit for bit, like the one that was copied."""
        self.__init__(Scenario.from_dict(state["scenario"]), state["seeds"])
        self.load_world_state(state)

    def _sense(
        self,
        ahead: np.ndarray,
        reward: np.ndarray | None = None,
        ignore: np.ndarray | None = None,
    ) -> np.ndarray:
        flag, second = self._flags.sensed
        return self._senses.sense(self.position, ahead, flag, ignore, second, reward)

    def _draw_spawns(self, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places [arenas, robots, 2] and headings [arenas, robots], drawn where masked."""
        place, heading = np.zeros((*self.shape, 2)), np.zeros(self.shape)
        for arena, rng in enumerate(self._generators["spawn_generators"]):
            robots = np.flatnonzero(mask[arena])
            if not len(robots):
                continue
            spawn = robots % len(self._jitters)
            jitter = self._jitters[spawn, None]
            offset = rng.integers(-jitter, np.maximum(jitter, 1), size=(len(robots), 2))
            place[arena, robots] = self._spawn_centres[spawn] + offset
            heading[arena, robots] = np.radians(rng.integers(0, 360, size=len(robots)))
        heading = np.where(heading > np.pi, heading - 2 * np.pi, heading)
        return place, heading


@cached_njit()
def steer(
    actions: np.ndarray, heading_rad: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[bool, np.ndarray, np.ndarray]:
    """Whether all actions are finite, and the headings in (-pi, pi] and speeds they lead to.

    Actions are float64 [arenas, robots, actions]: speed in units per tick, turn in rad (less than
    one round), others; clipped to `low` and `high` [actions]. The others are [arenas, robots].
    """
    finite = True
    heading, speed = np.empty_like(heading_rad), np.empty_like(heading_rad)
    for arena in range(len(actions)):
        for robot in range(len(actions[arena])):
            for action in range(len(low)):
                finite &= math.isfinite(actions[arena, robot, action])
            speed[arena, robot] = min(max(actions[arena, robot, 0], low[0]), high[0])
            angle = heading_rad[arena, robot]
            angle += min(max(actions[arena, robot, 1], low[1]), high[1])
            if angle > math.pi:  # less than one turn away: no precision is lost
                angle -= 2 * math.pi
            elif angle <= -math.pi:
                angle += 2 * math.pi
            heading[arena, robot] = angle
    return finite, heading, speed


def directions(heading_rad: np.ndarray) -> np.ndarray:
    """Cosine and sine of headings [arenas, robots], float64 [arenas, robots, 2]."""
    return np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)
