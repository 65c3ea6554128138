"""An ordinary trainer learns in the arena: PPO of Stable-Baselines3 with one robot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.wrappers import RescaleAction

from neatq_envs.robot import RobotEnv


def robot() -> Any:
    """One robot with actions in [-1, 1], as trainers that explore with unit variance want it."""
    low, high = np.float32(-1), np.float32(1)
    return RescaleAction(RobotEnv("flag", reward="progress"), low, high)


def distance(model: Any) -> float:
    """Return the mean distance to the flag over a life, in units."""
    env = robot()
    seen, _ = env.reset(seed=100)
    torch.manual_seed(0)
    distances, over = [], False
    while not over:
        seen, _, _, over, info = env.step(model.predict(seen)[0])
        distances.append(info["distance"])
    return float(np.mean(distances))


@pytest.mark.slow
def test_stable_baselines3_brings_a_robot_to_the_flag() -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.env_util import make_vec_env

    check_env(robot())
    envs = make_vec_env(robot, n_envs=16, seed=0)
    sizes: dict[str, Any] = {"n_steps": 256, "batch_size": 512, "learning_rate": 1e-3}
    model = PPO("MlpPolicy", envs, gamma=0.97, seed=0, device="cpu", **sizes)
    untrained = distance(model)
    model.learn(40_000)
    assert untrained > 120
    assert distance(model) < 40
