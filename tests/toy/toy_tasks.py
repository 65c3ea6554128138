"""Small environments; `toy_tasks:toy/Walk-v0` and so on, once this folder is in the path."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

SPACES: dict[str, spaces.Space[Any]] = {
    "box": spaces.Box(-1, 1, (2,)),
    "matrix": spaces.Box(-1, 1, (2, 3)),
    "endless box": spaces.Box(-np.inf, np.inf, (2,)),
    "huge": spaces.Box(-1, 1, (100, 100)),
    "image": spaces.Box(0, 255, (8, 8, 3), np.uint8),
    "choice": spaces.Discrete(3, start=5),
    "dict": spaces.Dict({"a": spaces.Discrete(2)}),
    "tuple": spaces.Tuple((spaces.Discrete(2),)),
    "text": spaces.Text(5),
    "many": spaces.MultiDiscrete([2, 2]),
    "binary": spaces.MultiBinary(3),
}


class Walk(gymnasium.Env[np.ndarray, np.ndarray]):
    """Stay near 0: place x in [-1, 1] at first, x += 0.2 a; reward -|x|; beyond 2 it ends.

    The long axis has no bounds and has 3 + 10 x.
    """

    steps: ClassVar[int] = 0
    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012
    observation_space = spaces.Box(np.array([-2, -np.inf]), np.array([2, np.inf]), (2,), np.float64)
    action_space = spaces.Box(-1, 1, (1,))

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode

    def render(self) -> np.ndarray:
        picture = np.zeros((200, 400, 3), np.uint8)
        picture[:, int(np.clip(200 + 90 * self.x, 0, 399))] = 255
        return picture

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-1, 1)
        return self._seen(), {}

    def step(self, action: np.ndarray) -> Any:
        type(self).steps += 1
        assert self.action_space.contains(action)
        self.x += 0.2 * float(action[0])
        return self._seen(), -abs(self.x), abs(self.x) > 2, False, {}

    def _seen(self) -> np.ndarray:
        return np.array([self.x, 3 + 10 * self.x])


class Ends(gymnasium.Env[Any, Any]):
    """Reward 1 at every step; after some steps it ends, for good or by time."""

    observation_space = spaces.Discrete(2)
    action_space = spaces.Discrete(2)

    def __init__(self, steps: int = 1, by: str = "terminated") -> None:
        self.length, self.by = steps, by

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.count = 0
        return 0, {}

    def step(self, action: int) -> Any:
        self.count += 1
        over = self.count >= self.length
        by_time = self.by == "truncated"
        return 1, 1.0, over and not by_time, over and by_time, {}


class EndsInBox(Ends):
    """The same with a number to choose, which changes nothing."""

    action_space = spaces.Box(-1, 3, (1,))


class Broken(Walk):
    """Breaks at the given step of the episodes with an odd seed, once more than `after` ended."""

    ended: ClassVar[int] = 0

    def __init__(
        self, how: str = "raise", step: int = 3, after: int = 0, render_mode: str | None = None
    ) -> None:
        super().__init__(render_mode)
        self.how, self.break_step, self.after = how, step, after

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.odd, self.count = bool(seed) and seed % 2 == 1, 0
        type(self).ended += 1
        return super().reset(seed=seed)

    def step(self, action: np.ndarray) -> Any:
        self.count += 1
        seen, reward, *rest = super().step(action)
        if self.count == self.break_step and self.odd and type(self).ended > self.after:
            if self.how == "raise":
                raise ZeroDivisionError("the world ended")
            if self.how == "nan":
                seen = np.array([np.nan, 0.0])
            if self.how == "reward":
                reward = math.inf
        return (seen, reward, *rest)


class Carrying(Walk):
    """Begins where the episode before ended; no seed covers that."""

    x = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        before = self.x
        super().reset(seed=seed)
        self.x += 0.1 * before
        return self._seen(), {}


class Dicing(Walk):
    """Takes its chance from nobody's seed."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return super().reset(seed=None)


class Spaces(gymnasium.Env[Any, Any]):
    """Has whatever spaces one asks for."""

    def __init__(self, observes: str = "box", acts: str = "choice") -> None:
        self.observation_space, self.action_space = SPACES[observes], SPACES[acts]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        assert self.action_space.contains(action), action
        return self.observation_space.sample(), 0.0, False, False, {}


LENGTHS = {Walk: 20, Ends: None, EndsInBox: None, Broken: 20, Carrying: 20, Dicing: 20, Spaces: 5}
for kind, length in LENGTHS.items():
    entry: Any = kind
    gymnasium.register(f"toy/{kind.__name__}-v0", entry, max_episode_steps=length)
gymnasium.register("toy/Endless-v0", "toy_tasks:Spaces")
