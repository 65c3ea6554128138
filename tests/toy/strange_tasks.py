"""Environments that misbehave; `strange_tasks:strange/Whole-v0` and so on."""

from __future__ import annotations

import copy
import os
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.spaces import utils

ACTIONS: dict[str, spaces.Space[Any]] = {
    "bits": spaces.Box(0, 1, (8,), np.int8),
    "signed": spaces.Box(-3, 3, (2,), np.int64),
    "bytes": spaces.Box(0, 255, (1,), np.uint8),
    "truth": spaces.Box(0, 1, (2,), np.bool_),  # type: ignore[arg-type]
    "float": spaces.Box(-1, 1, (), np.float64),
    "shifted": spaces.Discrete(3, start=-4),
    "one": spaces.Discrete(1),
    "point": spaces.Box(2, 2, (3,)),
    "many": spaces.MultiDiscrete([2, 5]),
    "binary": spaces.MultiBinary(3),
    "dict": spaces.Dict({"gear": spaces.Discrete(3, start=1), "wheel": spaces.Box(-1, 1, (2,))}),
    "tuple": spaces.Tuple((spaces.MultiBinary(2), spaces.Box(0, 5, (1,), np.int32))),
    "vast": spaces.Box(-(2**62), 2**62, (1,), np.int64),
    "choices": spaces.Discrete(513),
    "crowd": spaces.MultiBinary(513),
    "wide": spaces.Box(-1e308, 1e308, (1,), np.float64),
}
OBSERVATIONS: dict[str, spaces.Space[Any]] = {
    "box": spaces.Box(-np.inf, np.inf, (2, 2)),
    "choice": spaces.Discrete(3, start=5),
    "many": spaces.MultiDiscrete([2, 3], start=[0, 7]),
    "binary": spaces.MultiBinary(3),
    "dict": spaces.Dict({"place": spaces.Box(-1, 1, (2,)), "gear": spaces.Discrete(3, start=1)}),
    "tuple": spaces.Tuple((spaces.Discrete(2), spaces.Box(0, 1, (2, 2)))),
    "screen": spaces.Box(0, 255, (84, 84, 3), np.uint8),
    "floats": spaces.Box(0, 1, (84, 84, 4)),
    "seen": spaces.Dict({"camera": spaces.Box(0, 255, (64, 64, 3), np.uint8)}),
    "tiles": spaces.Box(0, 255, (7, 7, 3), np.uint8),
    "long": spaces.Discrete(1000),
}


class Plain(gymnasium.Env[Any, Any]):
    """Five steps in spaces of one's choice; asserts that actions are what `sample()` gives.

    The reward is the mean of all numbers of the action.
    """

    def __init__(self, acts: str = "bits", observes: str = "box") -> None:
        own = copy.deepcopy((ACTIONS[acts], OBSERVATIONS[observes]))  # each draws by itself
        self.action_space, self.observation_space = own

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.count = 0
        self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        self.count += 1
        same_type(action, self.action_space.sample())
        assert self.action_space.contains(action), action
        flat: Any = utils.flatten(self.action_space, action)
        return self.observation_space.sample(), float(np.mean(flat)), self.count == 5, False, {}


def same_type(action: Any, sample: Any) -> None:
    """Assert that an action has the types, shapes and dtypes of a sample."""
    assert type(action) is type(sample), (action, sample)
    if isinstance(sample, dict):
        assert list(action) == list(sample)
        for key in sample:
            same_type(action[key], sample[key])
    elif isinstance(sample, tuple):
        for one, other in zip(action, sample, strict=True):
            same_type(one, other)
    else:
        assert (action.dtype, action.shape) == (sample.dtype, sample.shape)


class Strange(gymnasium.Env[Any, Any]):
    """Does something strange at a step of every episode (0: at its reset), from a total on.

    Args:
        how: What.
        when: At which step.
        after: Resets before which nothing happens.
    """

    resets = opened = 0
    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012
    observation_space = spaces.Box(-np.inf, np.inf, (2,))
    action_space: spaces.Space[Any] = spaces.Box(-1, 1, (1,))

    def __init__(
        self, how: str = "", when: int = 2, after: int = 0, render_mode: str | None = None
    ) -> None:
        self.how, self.when, self.after, self.render_mode = how, when, after, render_mode
        if how == "exit when made":
            sys.exit(4)
        if how == "goes elsewhere when made":
            os.chdir(".." if Path.cwd().name == "here" else ".")
        type(self).opened += 1

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        type(self).resets += 1
        if self.how == "small seeds" and seed is not None:
            np.int32(seed)
        self.count, self.seed = 0, seed
        seen = self.np_random.uniform(-1, 1, 2)
        if self._now and self.how == "exit":
            sys.exit(4)
        if self._now and self.how == "no tuple":
            return seen
        return self._seen(seen), {}

    def step(self, action: Any) -> Any:
        self.count += 1
        if self.how == "goes elsewhere" and Path.cwd().name == "here":
            os.chdir("..")
        seen, reward, over = self.np_random.uniform(-1, 1, 2), -float(action[0] ** 2), False
        if not self._now:
            return seen, reward, self.count == 5, False, {}
        if self.how == "exit":
            sys.exit("no licence")
        if self.how == "die":
            os._exit(7)
        if self.how == "raise":
            raise ZeroDivisionError("the world ended")
        if self.how == "four":
            return seen, reward, over, {}
        if self.how == "another action space":
            self.action_space, over = spaces.Discrete(2), True
        rewards: dict[str, Any] = {"array": np.array([reward]), "large": 1e300, "vast": -1e308}
        rewards |= {"nan": np.nan, "none": None, "two": np.ones(2), "text": "much"}
        return self._seen(seen), rewards.get(self.how, reward), over, False, {}

    @property
    def _now(self) -> bool:
        return self.count == self.when and type(self).resets > self.after

    def _seen(self, seen: Any) -> Any:
        if not self._now:
            return seen
        wrong: dict[str, Any] = {"huge": seen * [1, 1e200], "inf": np.array([np.inf, 0])}
        wrong |= {"short": seen[:1], "column": seen[:, None], "words": np.array(["a", "b"])}
        return wrong.get(self.how, seen)

    def render(self) -> Any:
        if self.how == "render raises":
            raise RuntimeError("no GL context")
        if self.how == "render exits":
            sys.exit(1)
        return None if self.how == "render none" else np.zeros((10, 10, 3), np.uint8)

    def close(self) -> None:
        if self.how == "close raises":
            raise OSError("already gone")
        type(self).opened -= 1


for kind, steps in ((Plain, None), (Strange, 20)):
    entry: Any = kind
    gymnasium.register(f"strange/{kind.__name__}-v0", entry, max_episode_steps=steps)
gymnasium.register("strange/Bare-v0", "strange_tasks:Strange")
