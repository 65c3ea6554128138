"""The tuned settings: complete, and each makes its model on its task."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import nn

from neatq_envs.gymnasium_task import Interface
from neatq_experiments.anchors.anchor import anchor_config
from neatq_experiments.anchors.sb3 import Model, TrainingRows
from neatq_experiments.anchors.settings import DEFAULTS, TUNED, settings_of
from neatq_trainers.worlds import GymnasiumConfig

CHOICES = {"CartPole-v1": (4, 2), "Acrobot-v1": (6, 3), "LunarLander-v3": (8, 4)}
BOXES = {
    "Pendulum-v1": (3, 1),
    "MountainCarContinuous-v0": (2, 1),
    "LunarLanderContinuous-v3": (8, 2),
    "Hopper-v4": (11, 3),
    "HalfCheetah-v4": (17, 6),
}
OWN_NAMES = {
    "LunarLanderContinuous-v3": ("LunarLander-v3", {"continuous": True}),
    "Hopper-v4": ("Hopper-v5", {}),
    "HalfCheetah-v4": ("HalfCheetah-v5", {}),
}
"""What Gymnasium calls a task that the zoo calls otherwise."""


class Still:
    """Rows of a task that are never stepped: what simulates it need not be installed."""

    def __init__(self, name: str) -> None:
        inputs, outputs = (CHOICES | BOXES)[name]
        one = np.ones(outputs, np.float32)
        action = spaces.Discrete(outputs) if name in CHOICES else spaces.Box(-one, one)
        self.interface = Interface(spaces.Box(-1, 1, (inputs,)), action)


def tuned(algorithm: str, name: str) -> tuple[Mapping[str, Any], str]:
    """The settings of a task that the zoo knows by a name, and where they come from."""
    own, kwargs = OWN_NAMES.get(name, (name, {}))
    return settings_of(algorithm, GymnasiumConfig(id=own, kwargs=kwargs))


def model(algorithm: str, name: str) -> Model:
    settings = tuned(algorithm, name)[0]
    rows: Any = Still(name)
    env = TrainingRows(rows, settings.get("n_envs", 1), 0, "it")
    small = {} if algorithm == "ppo" else {"buffer_size": 10}
    return Model(algorithm, {**settings, **small}, env, 0)


def numbers(*layers: int) -> int:
    """Weights and biases of a network with these layers."""
    return sum((before + 1) * after for before, after in pairwise(layers))


def test_the_table_is_complete() -> None:
    assert set(TUNED["ppo"]) == {*CHOICES, *BOXES}
    assert set(TUNED["dqn"]) == {*CHOICES}
    for algorithm in ("sac", "td3"):
        assert set(TUNED[algorithm]) == {*BOXES}


@pytest.mark.parametrize(
    ("algorithm", "name"), [(one, name) for one, names in TUNED.items() for name in names]
)
def test_tuned_settings_make_a_model_that_acts(algorithm: str, name: str) -> None:
    settings, source = tuned(algorithm, name)
    assert source == f"RL Zoo 2.9.2: {algorithm}.yml, {name}"
    made = model(algorithm, name)
    inputs, outputs = (CHOICES | BOXES)[name]
    assert made.own.get_env().num_envs == settings.get("n_envs", 1)
    assert (made.own.get_vec_normalize_env() is not None) == settings.get("normalize", False)
    assert made.act(np.zeros((5, inputs))).shape == (5, 1 if name in CHOICES else outputs)
    known = {"ppo": [64, 64], "dqn": [64, 64], "sac": [256, 256], "td3": [400, 300]}
    hidden = settings.get("policy_kwargs", {}).get("net_arch", known[algorithm])
    sizes = inputs, *(hidden["pi"] if isinstance(hidden, dict) else hidden), outputs
    assert sum(one.numel() for one in made.network.parameters()) == numbers(*sizes)


def test_what_acts_is_the_network_that_is_counted() -> None:
    seen = np.linspace(-1, 1, 15).reshape(5, 3)
    for algorithm in ("sac", "td3", "ppo"):
        made = model(algorithm, "Pendulum-v1")
        output = made.network(torch.from_numpy(seen).float()).detach().numpy()
        expected = output.clip(-1, 1) if algorithm == "ppo" else output
        expected = np.tanh(output) if algorithm == "sac" else expected
        assert made.act(seen) == pytest.approx(expected, abs=1e-5)
    dqn = model("dqn", "CartPole-v1")
    values = dqn.network(torch.ones(1, 4))
    assert dqn.act(np.ones((1, 4))) == [[values.argmax().item()]]
    assert numbers(4, 64, 64, 2) == 4610


def test_settings_are_read_as_the_zoo_means_them() -> None:
    ppo = model("ppo", "CartPole-v1").own
    assert [ppo.lr_schedule(left) for left in (1.0, 0.5, 0.0)] == pytest.approx([1e-3, 5e-4, 0])
    assert ppo.clip_range(0.5) == pytest.approx(0.1)
    hopper = model("ppo", "Hopper-v4").own
    assert isinstance(hopper.policy.mlp_extractor.policy_net[1], nn.ReLU)
    assert hopper.get_vec_normalize_env().gamma == 0.999
    td3 = model("td3", "MountainCarContinuous-v0").own
    assert "OrnsteinUhlenbeck" in repr(td3.action_noise)
    sac = model("sac", "LunarLanderContinuous-v3").own
    assert sac.lr_schedule(0.5) == pytest.approx(3.65e-4)
    assert (sac.ent_coef, sac.learning_starts) == ("auto", 10_000)


def test_a_state_holds_weights_and_statistics_of_observations() -> None:
    made, other = model("ppo", "Acrobot-v1"), model("ppo", "Acrobot-v1")
    scaling: Any = made.own.get_vec_normalize_env()
    scaling.obs_rms.update(np.arange(60.0).reshape(10, 6))
    with torch.no_grad():
        next(made.network.parameters()).add_(1)
    kept, seen = made.state(), np.arange(30.0).reshape(5, 6)
    wanted = made.act(seen)
    mean = scaling.obs_rms.mean.copy()
    scaling.obs_rms.update(np.zeros((50, 6)))  # what was kept stays as it was
    other.load(kept)
    theirs: Any = other.own.get_vec_normalize_env()
    assert np.array_equal(theirs.obs_rms.mean, mean)
    assert np.array_equal(other.act(seen), wanted)


def test_a_task_that_the_zoo_does_not_know_has_defaults() -> None:
    config = anchor_config("gym:FrozenLake-v1", "sb3-ppo")
    assert (config.settings, config.source) == ({}, DEFAULTS)
    plain = settings_of("sac", GymnasiumConfig(id="LunarLander-v3"))  # without continuous=true
    assert plain == ({}, DEFAULTS)
