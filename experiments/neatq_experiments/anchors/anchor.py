"""An anchor: another algorithm on a task of a comparison, and how it is judged there.

It is judged as the arms are. Forty times in a run its policy acts without exploration on the
held-out episodes on which arms are evaluated; the best one so far is the champion, and is tested on
the episodes that nobody has seen. All these episodes have the seeds that they have for arms.
"""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from neatq_envs.episodes import EVALUATION, TEST, EpisodeRows, Starts, episode_seeds
from neatq_envs.gymnasium_rows import EnvRows, interface_of
from neatq_experiments.anchors.ppo_settings import ppo_settings
from neatq_experiments.anchors.sac_settings import sac_settings
from neatq_experiments.anchors.settings import settings_of
from neatq_experiments.forward import forward_us
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset
from neatq_trainers.config import LENGTHS, Length
from neatq_trainers.nero.nero_world import NeroConfig
from neatq_trainers.worlds import ArenaConfig, EnvConfig, GymnasiumConfig

EVALUATIONS = 40
"""In a run, evenly over its steps."""
RECENT = 100
"""Episodes of training whose mean return is told."""
SB3, NOVELTY = "sb3-", "-novelty"
"""Which begin and end the names of anchors."""
EXPLORER_SHARE = 0.5
"""Of the new in the reward of anchors that explore, as of the explorers of `neatq`."""
_BOXES, _CHOICES = ("sb3-sac", "sb3-td3"), ("sb3-dqn",)
"""The anchors that know one kind of actions only."""
_OF_ARMS = ("slots", "every", "evaluated")
"""Settings of worlds that are about genomes."""


@dataclass(frozen=True, kw_only=True)
class AnchorConfig:
    """A whole run of an anchor.

    Attributes:
        task: What the world is called.
        arm: Which anchor.
        world: The world.
        settings: Of the algorithm; what is left out is its library's default.
        source: Where the settings come from.
        ticks: Length in the arena.
        steps: Length on a Gymnasium task, of all environments together.
    """

    task: str
    arm: str
    world: ArenaConfig | GymnasiumConfig
    settings: Mapping[str, Any]
    source: str
    ticks: int | None = None
    steps: int | None = None

    @property
    def length(self) -> tuple[Length, int]:
        """The unit of the run's length, and how many of them."""
        return ("ticks", self.ticks) if self.ticks else ("steps", self.steps or 1)

    def changed(self, changes: Mapping[str, Any]) -> AnchorConfig:
        """A configuration of another length.

        Raises:
            ConfigError: If it is one in generations.
        """
        if changes.get("generations"):
            raise ConfigError(f"generations: {self.arm} has none; give the length in steps")
        return replace(self, **{unit: changes[unit] for unit in LENGTHS[:2] if unit in changes})

    def to_dict(self) -> dict[str, Any]:
        """JSON values that say all that counts in a run but its length."""
        world = msgspec.to_builtins(self.world)
        world = {name: one for name, one in world.items() if name not in _OF_ARMS}
        return {"anchor": self.arm, "world": world, "settings": dict(self.settings)}


def anchor_config(
    task: str, name: str, env_kwargs: Mapping[str, Any] | None = None
) -> AnchorConfig:
    """The configuration of an anchor on a task, with the task's whole length.

    Args:
        task: As `preset` takes it.
        name: One of `ANCHORS`.
        env_kwargs: As of `preset`.

    Raises:
        ConfigError: If there is no such task, the anchor does not run there, or its library is not
            installed.
        TaskError: If the environment cannot be used.
    """
    arm = preset(task, "neatq", env_kwargs=env_kwargs)  # whose world it shares
    world = arm.world
    if isinstance(world, EnvConfig | NeroConfig):
        raise ConfigError(f"arm: {name} does not run on {task}: anchors know the arena and gym:ID")
    own: dict[str, Any] = {"task": task, "arm": name, "world": world}
    if isinstance(world, ArenaConfig):
        if name.startswith(SB3):
            words = "it knows Gymnasium tasks (gym:ID) only; ppo and sac run in the arena"
            raise ConfigError(f"arm: {name} does not run on {task}: {words}")
        # Nobody is born: else all robots would begin anew whenever a moving flag moves.
        own["world"] = replace(world, scenario=world.scenario.replaced(first_lives="spread"))
        return AnchorConfig(**own, ticks=arm.ticks, **_in_arena(name))
    _refuse_elsewhere(task, name)
    _refuse_missing(name)
    choices = interface_of(world.task).choices
    _refuse_misfit(task, name, choices)
    if not name.startswith(SB3):
        return AnchorConfig(**own, **ppo_settings("box" if choices is None else "choices"))
    settings, source = settings_of(name.removeprefix(SB3), world)
    return AnchorConfig(**own, settings=settings, source=source)


def _in_arena(name: str) -> dict[str, Any]:
    """The settings of an anchor in the arena, and where they come from."""
    known = ppo_settings("arena") if name.startswith("ppo") else sac_settings()
    if name.endswith(NOVELTY):
        known["settings"] = {**known["settings"], "novelty": EXPLORER_SHARE}
    return known


def _refuse_elsewhere(task: str, name: str) -> None:
    """Check that an anchor runs on Gymnasium tasks."""
    begin = f"arm: {name} does not run on {task}:"
    if name.endswith(NOVELTY):
        words = "its reward counts visits to places, which only the arena has"
        raise ConfigError(f"{begin} {words}; ppo and sb3-sac run on Gymnasium tasks")
    if name == "sac":
        raise ConfigError(f"{begin} it runs in the arena only; sb3-sac runs on Gymnasium tasks")


def _refuse_missing(name: str) -> None:
    """Check that the library of an anchor is installed."""
    if not name.startswith(SB3):
        return
    try:
        importlib.import_module("stable_baselines3")
    except ImportError as error:
        words = f'{name} needs Stable-Baselines3: pip install "stable-baselines3>=2.9,<3"'
        raise ConfigError(f"arm: {words} ({error})") from error


def _refuse_misfit(task: str, name: str, choices: int | None) -> None:
    """Check that an algorithm knows such actions."""
    begin = f"arm: {name} does not run on {task}: it needs"
    if name in _BOXES and choices is not None:
        raise ConfigError(f"{begin} a box of actions, and there are {choices} to choose from")
    if name in _CHOICES and choices is None:
        raise ConfigError(f"{begin} actions to choose from, and there is a box of them")


class Pupil(Protocol):
    """A policy that is being trained."""

    @property
    def network(self) -> nn.Module:
        """What acts after training: scaled observations [inputs] to actions."""
        ...

    def act(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Actions [rows, actions] without exploration, of observations [rows, inputs]."""
        ...

    def state(self) -> Any:
        """A copy of all that `act` depends on."""
        ...

    def load(self, state: Any) -> None:
        """Act as in a `state`."""
        ...


class Trial:
    """What a run on a Gymnasium task comes to: `over` and `look` while it trains, then `result`.

    Args:
        config: Of the run.
        seed: Of the run.
        rows: Environments for evaluation and test.
        pupil: Who is judged.
    """

    def __init__(self, config: AnchorConfig, seed: int, rows: EnvRows, pupil: Pupil) -> None:
        assert isinstance(config.world, GymnasiumConfig)
        self._config, self._world, self._seed = config, config.world, seed
        self._rows, self._pupil = rows, pupil
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._episodes, self._looks = 0, 0
        self._best, self._champion = -np.inf, pupil.state()
        self._points: list[tuple[int, float, float]] = []

    def over(self, episode_return: float) -> None:
        """An episode of training is over."""
        self._recent.append(episode_return)
        self._episodes += 1

    def due(self, steps: int) -> bool:
        """Whether the next evaluation is due after so many steps."""
        return steps * EVALUATIONS >= self._config.length[1] * (self._looks + 1)

    def look(self, steps: int, *, changed: bool = True) -> None:
        """Evaluate the policy, if it has changed since, and note how far the run is."""
        self._looks = max(self._looks + 1, steps * EVALUATIONS // self._config.length[1])
        if changed or self._best == -np.inf:
            score = self._returns(EVALUATION, self._world.episodes).mean()
            if score >= self._best:
                self._best, self._champion = float(score), self._pupil.state()
        if self._recent:
            self._points.append((steps, self._best, float(np.mean(self._recent))))

    def result(self, steps: int, inputs: int) -> dict[str, Any]:
        """Test the champion, who reads so many inputs; what the run came to after all its steps.

        Raises:
            ConfigError: If the run was too short for an episode.
        """
        if not self._points:
            unit, number = self._config.length
            words = f"no episode came to its end; expected a longer run than {number} {unit}"
            raise ConfigError(f"{self._config.arm} on {self._config.task}: {words}")
        at, champion, fitness = (list(column) for column in zip(*self._points, strict=True))
        late = [mean for step, _, mean in self._points if step > 0.9 * at[-1]]
        self._pupil.load(self._champion)
        tested = self._returns(TEST, self._world.test_episodes)
        network, seen = self._pupil.network, torch.zeros(inputs)
        return {
            "generation": list(range(1, len(at) + 1)),
            "steps": at,
            "champion": champion,
            "fitness": fitness,
            "all_steps": steps,
            "episodes": self._episodes,
            "test_return": float(tested.mean()),
            "mean_fitness": float(np.mean(late)),
            "parameters": sum(one.numel() for one in network.parameters()),
            "nodes": None,
            "forward_us": forward_us(lambda: network(seen)),
        }

    def _returns(self, purpose: int, episodes: int) -> NDArray[np.float64]:
        """Returns of the policy as it is now [episodes]; all run side by side."""
        seeds = episode_seeds(self._seed, 0, episodes, purpose=purpose)
        lives = EpisodeRows(self._rows, self._world.id, "episode {}".format)
        lives.begin(Starts.given(seeds[:, None]))
        while lives.living.any():
            lives.step(self._pupil.act(lives.observation))
            lives.go_on(lives.terminated | lives.truncated)
        return lives.returns[:, 0]
