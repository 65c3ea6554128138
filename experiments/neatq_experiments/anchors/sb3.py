"""Algorithms of Stable-Baselines3 on Gymnasium tasks; imported only where it is installed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import DQN, PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import nn

from neatq_envs.episodes import EpisodeRows, Starts, episode_seed
from neatq_envs.gymnasium_rows import EnvRows, make_rows
from neatq_experiments.anchors.anchor import SB3, AnchorConfig, Trial
from neatq_trainers.worlds import GymnasiumConfig, facts_of

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "td3": TD3, "dqn": DQN}
_NOISES = {"normal": NormalActionNoise, "ornstein-uhlenbeck": OrnsteinUhlenbeckActionNoise}
_FALLS = "lin_"


class TrainingRows(VecEnv):
    """Environments side by side, each with its episodes one after the other.

    Episode e of row r has the seed `episode_seed(seed, 0, e * rows + r)`.

    Attributes:
        over: Called with the return of an episode that is over.
    """

    def __init__(self, rows: EnvRows, count: int, seed: int, name: str) -> None:
        interface = rows.interface
        low, high = (np.array(bound, np.float32) for bound in interface.bounds)
        if interface.choices is None:
            action: spaces.Space[Any] = spaces.Box(low, high)
        else:
            action = spaces.Discrete(interface.choices)
        seen = spaces.Box(-np.inf, np.inf, (interface.inputs,))
        super().__init__(count, seen, action)
        self._rows, self._lives = rows, EpisodeRows(rows, name)
        self._starts = Starts(count, None, lambda r, e: episode_seed(seed, 0, e * count + r))
        self.over: Callable[[float], None] = lambda _: None

    def reset(self) -> Any:
        """Begin the first episodes; observations [rows, inputs]."""
        self._lives.begin(self._starts)
        return self._lives.observation.astype(np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next step."""
        self._actions = np.asarray(actions, np.float64).reshape(self.num_envs, -1)

    def step_wait(self) -> Any:
        """Step; rows whose episode is over begin the next one at once."""
        lives = self._lives
        lives.step(self._actions)
        reward, done = lives.reward.astype(np.float32), lives.terminated | lives.truncated
        cut_off = lives.truncated & ~lives.terminated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": bool(one)} for one in cut_off]
        if done.any():
            for row in np.flatnonzero(done).tolist():
                infos[row]["terminal_observation"] = lives.observation[row].astype(np.float32)
                self.over(float(lives.returns[row, 0]))
            lives.go_on(done)
        return lives.observation.astype(np.float32), reward, done, infos

    def close(self) -> None:
        """Close the environments."""
        self._rows.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Rows have no attributes of their own."""
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Nothing can be set."""

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Rows have no methods of their own."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False] * self.num_envs


class Model:
    """An algorithm with its settings on the environments that it trains in; see `Pupil`."""

    def __init__(self, algorithm: str, settings: Mapping[str, Any], env: VecEnv, seed: int) -> None:
        own = {key: _as_setting(one) for key, one in settings.items() if key != "n_envs"}
        if own.pop("normalize", False):
            env = VecNormalize(env, gamma=own.get("gamma", 0.99))
        if "noise_type" in own:
            ones = np.ones(env.action_space.shape or ())
            kind, deviation = _NOISES[own.pop("noise_type")], own.pop("noise_std")
            own["action_noise"] = kind(0 * ones, deviation * ones)
        kind: Any = ALGORITHMS[algorithm]
        with warnings.catch_warnings():  # some settings of the zoo have large minibatches
            warnings.filterwarnings("ignore", "You have specified a mini-batch size", UserWarning)
            self.own: Any = kind("MlpPolicy", env, seed=seed, device="cpu", **own)
        self._scaling = env if isinstance(env, VecNormalize) else None
        self.network = _acting(self.own)

    def act(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Actions [rows, actions] without exploration, of observations [rows, inputs]."""
        seen = observation.astype(np.float32)
        if self._scaling is not None:
            seen = self._scaling.normalize_obs(seen)
        return self.own.predict(seen, deterministic=True)[0].reshape(len(seen), -1)

    def state(self) -> Any:
        """A copy of all weights, and of the statistics of observations."""
        scaling = None if self._scaling is None else self._scaling.obs_rms
        return deepcopy((self.own.policy.state_dict(), scaling))

    def load(self, state: Any) -> None:
        """Act as in a `state`."""
        weights, scaling = state
        self.own.policy.load_state_dict(weights)
        if self._scaling is not None:
            self._scaling.obs_rms = scaling


def _as_setting(value: Any) -> Any:
    """A setting as Stable-Baselines3 takes it."""
    if isinstance(value, str) and value.startswith(_FALLS):
        return LinearSchedule(float(value.removeprefix(_FALLS)), 0.0, 1.0)
    if isinstance(value, Mapping):
        return {key: _as_setting(one) for key, one in value.items()}
    return nn.ReLU if value == "relu" else value


def _acting(model: Any) -> nn.Module:
    """What acts without exploration: no critic, and no scale of a distribution."""
    policy = model.policy
    if isinstance(model, PPO):
        return nn.Sequential(policy.mlp_extractor.policy_net, policy.action_net)
    if isinstance(model, SAC):
        return nn.Sequential(policy.actor.latent_pi, policy.actor.mu)
    return policy.q_net.q_net if isinstance(model, DQN) else policy.actor.mu


class _Looks(BaseCallback):
    """Evaluate the policy when it is due, before the last step.

    One that was not updated since is not evaluated again.
    """

    def __init__(self, trial: Trial, last: int) -> None:
        super().__init__()
        self._trial, self._last, self._updates = trial, last, 0

    def _on_step(self) -> bool:
        if self._trial.due(self.num_timesteps) and self.num_timesteps < self._last:
            updates = getattr(self.model, "_n_updates", 0)
            self._trial.look(self.num_timesteps, changed=updates != self._updates)
            self._updates = updates
        return True


def train_sb3(config: AnchorConfig, seed: int) -> dict[str, Any]:
    """Train an algorithm for the steps of a run, to the end of the rollout in which they are over.

    Returns:
        What it came to; see `Trial.result`.
    """
    assert isinstance(config.world, GymnasiumConfig)
    facts = facts_of(config.world, 0.99)
    assert facts is not None
    rows, _ = make_rows(config.world.task, renewed=facts.renewed)
    free, interface = make_rows(config.world.task, renewed=facts.renewed)
    env = TrainingRows(rows, config.settings.get("n_envs", 1), seed, config.world.id)
    model = Model(config.arm.removeprefix(SB3), config.settings, env, seed)
    trial = Trial(config, seed, free, model)
    env.over = trial.over
    model.own.learn(config.length[1], _Looks(trial, config.length[1]))
    steps = model.own.num_timesteps
    trial.look(steps)
    result = trial.result(steps, interface.inputs)
    env.close()
    free.close()
    return result
