"""Tuned settings of Stable-Baselines3's algorithms, as RL Baselines3 Zoo has them.

Source: RL Baselines3 Zoo 2.9.2 (Raffin 2020, https://github.com/DLR-RM/rl-baselines3-zoo, MIT
licence), the files rl_zoo3/hyperparams/ppo.yml, sac.yml, td3.yml and dqn.yml, without n_timesteps
(a comparison gives all arms the same) and without policy (always MlpPolicy). The zoo knows Hopper
and HalfCheetah as v4; these settings are taken for v5, too. It calls LunarLander-v3 with
`continuous=true` LunarLanderContinuous-v3.

Names are those of the algorithms, and some of the zoo's own: `n_envs` environments side by side,
`normalize` observations and rewards (VecNormalize), `noise_type` and `noise_std` of the actions.
"lin_X" is a number that falls from X to 0 over the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from neatq_trainers.worlds import GymnasiumConfig

ZOO = "RL Zoo 2.9.2"
DEFAULTS = "defaults of Stable-Baselines3"
"""What is said of settings where the zoo has none for a task."""
_OLDER = {"Hopper-v5": "Hopper-v4", "HalfCheetah-v5": "HalfCheetah-v4"}

TUNED: dict[str, dict[str, dict[str, Any]]] = {
    "ppo": {
        "CartPole-v1": {
            "n_envs": 8,
            "n_steps": 32,
            "batch_size": 256,
            "gae_lambda": 0.8,
            "gamma": 0.98,
            "n_epochs": 20,
            "ent_coef": 0.0,
            "learning_rate": "lin_0.001",
            "clip_range": "lin_0.2",
        },
        "Acrobot-v1": {
            "normalize": True,
            "n_envs": 16,
            "n_steps": 256,
            "gae_lambda": 0.94,
            "gamma": 0.99,
            "n_epochs": 4,
            "ent_coef": 0.0,
        },
        "LunarLander-v3": {
            "n_envs": 16,
            "n_steps": 1024,
            "batch_size": 64,
            "gae_lambda": 0.98,
            "gamma": 0.999,
            "n_epochs": 4,
            "ent_coef": 0.01,
        },
        "LunarLanderContinuous-v3": {
            "n_envs": 16,
            "n_steps": 1024,
            "batch_size": 64,
            "gae_lambda": 0.98,
            "gamma": 0.999,
            "n_epochs": 4,
            "ent_coef": 0.01,
        },
        "Pendulum-v1": {
            "n_envs": 4,
            "n_steps": 1024,
            "gae_lambda": 0.95,
            "gamma": 0.9,
            "n_epochs": 10,
            "ent_coef": 0.0,
            "learning_rate": 0.001,
            "clip_range": 0.2,
            "use_sde": True,
            "sde_sample_freq": 4,
        },
        "MountainCarContinuous-v0": {
            "normalize": True,
            "n_envs": 1,
            "batch_size": 256,
            "n_steps": 8,
            "gamma": 0.9999,
            "learning_rate": 7.77e-05,
            "ent_coef": 0.00429,
            "clip_range": 0.1,
            "n_epochs": 10,
            "gae_lambda": 0.9,
            "max_grad_norm": 5,
            "vf_coef": 0.19,
            "use_sde": True,
            "policy_kwargs": {"log_std_init": -3.29, "ortho_init": False},
        },
        "Hopper-v4": {
            "normalize": True,
            "n_envs": 1,
            "batch_size": 32,
            "n_steps": 512,
            "gamma": 0.999,
            "learning_rate": 9.80828e-05,
            "ent_coef": 0.00229519,
            "clip_range": 0.2,
            "n_epochs": 5,
            "gae_lambda": 0.99,
            "max_grad_norm": 0.7,
            "vf_coef": 0.835671,
            "policy_kwargs": {
                "log_std_init": -2,
                "ortho_init": False,
                "activation_fn": "relu",
                "net_arch": {"pi": [256, 256], "vf": [256, 256]},
            },
        },
        "HalfCheetah-v4": {
            "normalize": True,
            "n_envs": 1,
            "batch_size": 64,
            "n_steps": 512,
            "gamma": 0.98,
            "learning_rate": 2.0633e-05,
            "ent_coef": 0.000401762,
            "clip_range": 0.1,
            "n_epochs": 20,
            "gae_lambda": 0.92,
            "max_grad_norm": 0.8,
            "vf_coef": 0.58096,
            "policy_kwargs": {
                "log_std_init": -2,
                "ortho_init": False,
                "activation_fn": "relu",
                "net_arch": {"pi": [256, 256], "vf": [256, 256]},
            },
        },
    },
    "sac": {
        "LunarLanderContinuous-v3": {
            "batch_size": 256,
            "learning_rate": "lin_7.3e-4",
            "buffer_size": 1000000,
            "ent_coef": "auto",
            "gamma": 0.99,
            "tau": 0.01,
            "train_freq": 1,
            "gradient_steps": 1,
            "learning_starts": 10000,
            "policy_kwargs": {"net_arch": [400, 300]},
        },
        "Pendulum-v1": {"learning_rate": 0.001},
        "MountainCarContinuous-v0": {
            "learning_rate": 0.0003,
            "buffer_size": 50000,
            "batch_size": 512,
            "ent_coef": 0.1,
            "train_freq": 32,
            "gradient_steps": 32,
            "gamma": 0.9999,
            "tau": 0.01,
            "learning_starts": 0,
            "use_sde": True,
            "policy_kwargs": {"log_std_init": -3.67, "net_arch": [64, 64], "use_expln": True},
        },
        "Hopper-v4": {"learning_starts": 10000},
        "HalfCheetah-v4": {"learning_starts": 10000},
    },
    "td3": {
        "LunarLanderContinuous-v3": {
            "gamma": 0.98,
            "buffer_size": 200000,
            "learning_starts": 10000,
            "noise_type": "normal",
            "noise_std": 0.1,
            "gradient_steps": 1,
            "train_freq": 1,
            "learning_rate": 0.001,
            "policy_kwargs": {"net_arch": [400, 300]},
        },
        "Pendulum-v1": {
            "gamma": 0.98,
            "buffer_size": 200000,
            "learning_starts": 10000,
            "noise_type": "normal",
            "noise_std": 0.1,
            "gradient_steps": 1,
            "train_freq": 1,
            "learning_rate": 0.001,
            "policy_kwargs": {"net_arch": [400, 300]},
        },
        "MountainCarContinuous-v0": {
            "noise_type": "ornstein-uhlenbeck",
            "noise_std": 0.5,
            "gradient_steps": 1,
            "train_freq": 1,
            "learning_rate": 0.001,
            "batch_size": 256,
            "policy_kwargs": {"net_arch": [400, 300]},
        },
        "Hopper-v4": {
            "learning_starts": 10000,
            "noise_type": "normal",
            "noise_std": 0.1,
            "train_freq": 1,
            "gradient_steps": 1,
            "learning_rate": 0.001,
            "batch_size": 256,
            "policy_kwargs": {"net_arch": [400, 300]},
        },
        "HalfCheetah-v4": {
            "learning_starts": 10000,
            "noise_type": "normal",
            "noise_std": 0.1,
            "train_freq": 1,
            "gradient_steps": 1,
            "learning_rate": 0.001,
            "batch_size": 256,
            "policy_kwargs": {"net_arch": [400, 300]},
        },
    },
    "dqn": {
        "CartPole-v1": {
            "learning_rate": 0.0023,
            "batch_size": 64,
            "buffer_size": 100000,
            "learning_starts": 1000,
            "gamma": 0.99,
            "target_update_interval": 10,
            "train_freq": 256,
            "gradient_steps": 128,
            "exploration_fraction": 0.16,
            "exploration_final_eps": 0.04,
            "policy_kwargs": {"net_arch": [256, 256]},
        },
        "Acrobot-v1": {
            "learning_rate": 0.00063,
            "batch_size": 128,
            "buffer_size": 50000,
            "learning_starts": 0,
            "gamma": 0.99,
            "target_update_interval": 250,
            "train_freq": 4,
            "gradient_steps": -1,
            "exploration_fraction": 0.12,
            "exploration_final_eps": 0.1,
            "policy_kwargs": {"net_arch": [256, 256]},
        },
        "LunarLander-v3": {
            "learning_rate": 0.00063,
            "batch_size": 128,
            "buffer_size": 50000,
            "learning_starts": 0,
            "gamma": 0.99,
            "target_update_interval": 250,
            "train_freq": 4,
            "gradient_steps": -1,
            "exploration_fraction": 0.12,
            "exploration_final_eps": 0.1,
            "policy_kwargs": {"net_arch": [256, 256]},
        },
    },
}
"""By algorithm and the zoo's name of a task."""


def settings_of(algorithm: str, world: GymnasiumConfig) -> tuple[Mapping[str, Any], str]:
    """The settings of an algorithm on a task, and where they come from."""
    name = world.id
    if name == "LunarLander-v3" and world.kwargs.get("continuous"):
        name = "LunarLanderContinuous-v3"
    name = _OLDER.get(name, name)
    tuned = TUNED[algorithm].get(name)
    if tuned is None:
        return {}, DEFAULTS
    return tuned, f"{ZOO}: {algorithm}.yml, {name}"
