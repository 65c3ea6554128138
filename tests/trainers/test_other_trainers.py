"""Ordinary trainers learn in the arena: TorchRL's PPO with the team, Stable-Baselines3 with one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.wrappers import RescaleAction

import neatq_trainers.ppo
from neatq_envs.robot import RobotEnv
from neatq_envs.scenario import TASKS
from neatq_envs.torchrl import ArenaEnv
from neatq_trainers.ppo import main, networks


@pytest.mark.slow
def test_ppo_brings_the_team_to_the_flag(capsys: pytest.CaptureFixture[str]) -> None:
    torch.manual_seed(3)
    env = ArenaEnv(TASKS["flag"], seed=3)
    with torch.no_grad():
        life = env.rollout(1000, networks(env)[0], break_when_any_done=False)
    untrained = life["next", "distance"].mean().item()
    assert untrained > 120  # standing at the spawn is 141 away
    main(steps=2000, seed=3)
    lives = [float(line.split()[4]) for line in capsys.readouterr().out.splitlines()]
    assert len(lives) == 2
    assert lives[1] < 60 < untrained / 2


def test_ppo_does_the_same_again_with_the_same_seed() -> None:
    assert main(steps=200, seed=1) == main(steps=200, seed=1) != main(steps=200, seed=2)


def test_the_ppo_script_fits_on_a_page() -> None:
    assert len(Path(neatq_trainers.ppo.__file__).read_text().splitlines()) <= 100


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
