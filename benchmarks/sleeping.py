"""An environment that takes as long as it is told, and no work."""

from __future__ import annotations

import time
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box


class Sleeping(gymnasium.Env[np.ndarray, np.ndarray]):
    """Every step takes so many seconds, in which it sleeps; an episode has 1000 steps."""

    observation_space = Box(0.0, 1.0, (4,), np.float32)
    action_space = Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds = seconds

    def reset(self, **_: Any) -> tuple[np.ndarray, dict[str, Any]]:
        return np.zeros(4, np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if self.seconds:
            time.sleep(self.seconds)
        return np.zeros(4, np.float32), 0.0, False, False, {}


gymnasium.register(
    "Sleeping-v0",
    "benchmarks.sleeping:Sleeping",
    max_episode_steps=1000,
    disable_env_checker=True,
    order_enforce=False,
)
