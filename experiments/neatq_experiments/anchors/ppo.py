"""PPO of TorchRL (Schulman et al. 2017), in the arena and on Gymnasium tasks.

In the arena the whole team is one network, as in examples/ppo.py. On Gymnasium tasks some
environments run side by side; observations are scaled as for arms, and rewards are divided by a
tenth of the range of returns that random play has shown. Values are bootstrapped over time limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from neatq_envs.episodes import episode_seed
from neatq_envs.gymnasium_rows import make_rows
from neatq_envs.gymnasium_task import Interface
from neatq_envs.random_play import EnvFacts
from neatq_envs.torchrl_rows import GymnasiumRows
from neatq_experiments.anchors.anchor import AnchorConfig, Trial
from neatq_experiments.anchors.team import HIDDEN, Bounds, batches_of, train_team
from neatq_trainers.worlds import ArenaConfig, GymnasiumConfig, facts_of

REWARD_SHARE = 0.1
"""Of the range of returns: what a reward is divided by."""


class Choice(torch.distributions.Categorical):
    """One of some actions, as a number from 0 in single precision [.., 1]."""

    def sample(self, sample_shape: Any = ()) -> Tensor:
        """Draw actions."""
        return super().sample(torch.Size(sample_shape)).unsqueeze(-1).float()

    def log_prob(self, value: Tensor) -> Tensor:
        """Of actions [.., 1]: [..]."""
        return super().log_prob(value.squeeze(-1))


def _orthogonal(inputs: int, outputs: int, gain: float) -> MLP:
    """A network with orthogonal weights, those of the last layer by another gain."""
    network = MLP(
        in_features=inputs, out_features=outputs, num_cells=HIDDEN, activation_class=nn.Tanh
    )
    layers = [layer for layer in network if isinstance(layer, nn.Linear)]
    for layer in layers:
        nn.init.orthogonal_(layer.weight, gain if layer is layers[-1] else 2**0.5)
        nn.init.zeros_(layer.bias)
    return network


class Trainer:
    """Actor, critic and their updates.

    Args:
        settings: As `ppo_settings` gives them.
        inputs: Numbers in an observation.
        bounds: Of actions in a box.
        choices: How many; None in a box.
        batches: In the whole run.

    Attributes:
        network: The actor without its distribution.
        actor: Draws actions.
    """

    def __init__(
        self,
        settings: Mapping[str, Any],
        inputs: int,
        *,
        bounds: Bounds,
        choices: int | None = None,
        batches: int,
    ) -> None:
        self._settings, self._batches, self._done = settings, batches, 0
        outputs = len(bounds[0]) if choices is None else choices
        self.network = _orthogonal(inputs, outputs, 0.01)
        drawn: dict[str, Any] = {"return_log_prob": True}
        if choices is None:
            low, high = (torch.as_tensor(np.array(bound, np.float32)) for bound in bounds)
            policy = nn.Sequential(self.network, AddStateIndependentNormalScale(outputs))
            module = TensorDictModule(policy, ["observation"], ["loc", "scale"])
            drawn |= {"in_keys": ["loc", "scale"], "distribution_class": TanhNormal}
            drawn["distribution_kwargs"] = {"low": low, "high": high}
        else:
            module = TensorDictModule(self.network, ["observation"], ["logits"])
            drawn |= {"in_keys": ["logits"], "distribution_class": Choice}
        self.actor = ProbabilisticActor(module, **drawn)
        critic = ValueOperator(_orthogonal(inputs, 1, 1.0), in_keys=["observation"])
        own = self._settings
        self._advantage = GAE(gamma=own["discount"], lmbda=own["gae_lambda"], value_network=critic)
        self._loss = ClipPPOLoss(
            self.actor,
            critic,
            clip_epsilon=own["clip"],
            entropy_coeff=own["entropy"],
            critic_coeff=own["critic"],
            loss_critic_type="l2",
            normalize_advantage=True,
        )
        self._optimizer = torch.optim.Adam(
            self._loss.parameters(), lr=own["learning_rate"], eps=1e-5
        )

    def update(self, batch: TensorDictBase) -> None:
        """Learn from a batch [arenas, slots, ticks]."""
        own = self._settings
        if own["anneal"]:
            left = 1 - self._done / self._batches
            self._optimizer.param_groups[0]["lr"] = own["learning_rate"] * left
        self._done += 1
        for _ in range(own["epochs"]):
            with torch.no_grad():
                data = self._advantage(batch).reshape(-1)
            for rows in torch.randperm(len(data)).split(own["minibatch"]):
                parts = self._loss(data[rows])
                total = parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]
                self._optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(self._loss.parameters(), own["most_norm"])
                self._optimizer.step()


class ActingActor:
    """The actor on a Gymnasium task without exploration; see `Pupil`."""

    def __init__(self, network: nn.Module, interface: Interface, facts: EnvFacts) -> None:
        self.network, self._scaling = network, facts.scaling
        self._choices, self._bounds = interface.choices, interface.bounds

    @torch.no_grad()
    def act(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Actions [rows, actions] of observations [rows, inputs]."""
        output = self.network(torch.from_numpy(self._scaling(observation)))
        if self._choices is not None:
            return output.argmax(-1, keepdim=True).numpy().astype(np.float64)
        low, high = (np.array(bound) for bound in self._bounds)
        return low + (output.tanh().double().numpy() + 1) / 2 * (high - low)

    def state(self) -> Any:
        """A copy of the weights."""
        return deepcopy(self.network.state_dict())

    def load(self, state: Any) -> None:
        """Act as in a `state`."""
        self.network.load_state_dict(state)


def train_ppo(config: AnchorConfig, seed: int) -> dict[str, Any]:
    """Train for the length of a run, to the end of the batch in which it is reached.

    Returns:
        Columns of metrics in the arena; on a Gymnasium task what it came to, see `Trial.result`.
    """
    if isinstance(config.world, ArenaConfig):
        return train_team(config, seed, _team_trainer)
    torch.manual_seed(seed)
    return _train_rows(config, config.world, seed)


def _team_trainer(
    settings: Mapping[str, Any], inputs: int, bounds: Bounds, batches: int
) -> Trainer:
    return Trainer(settings, inputs, bounds=bounds, batches=batches)


def _train_rows(config: AnchorConfig, world: GymnasiumConfig, seed: int) -> dict[str, Any]:
    """On a Gymnasium task."""
    facts = facts_of(world, config.settings["discount"])
    assert facts is not None
    rows, interface = make_rows(world.task, renewed=facts.renewed)
    free, _ = make_rows(world.task, renewed=facts.renewed)
    count, own = config.settings["rows"], config.settings["batch_steps"]
    # An arena each, so that each has episodes of its own.
    seeds = [episode_seed(seed, 0, row) for row in range(count)]
    env = GymnasiumRows(
        rows, interface, facts.scaling, shape=(count, 1), seeds=seeds, name=world.id
    )
    steps, batches = 0, -(-config.length[1] // (count * own))
    trainer = Trainer(
        config.settings,
        interface.inputs,
        bounds=interface.bounds,
        choices=interface.choices,
        batches=batches,
    )
    trial = Trial(config, seed, free, ActingActor(trainer.network, interface, facts))
    sums = np.zeros(count)
    low, high = facts.value_range
    for batch in batches_of(env, trainer.actor, own, batches):
        _count_returns(batch, sums, trial)
        batch["next", "reward"] /= REWARD_SHARE * (high - low)
        trainer.update(batch)
        steps += count * own
        if trial.due(steps):
            trial.look(steps)
    result = trial.result(steps, interface.inputs)
    for one in (rows, free):
        one.close()
    return result


def _count_returns(batch: TensorDictBase, sums: NDArray[np.float64], trial: Trial) -> None:
    """Tell of the episodes that end in a batch; `sums` are those of episodes under way [rows]."""
    following: Any = batch.get("next")
    reward = following.get("reward")[:, 0, :, 0].double().numpy()
    done = following.get("done")[:, 0, :, 0].numpy()
    for now, over in zip(reward.T, done.T, strict=True):
        sums += now
        for value in sums[over]:
            trial.over(float(value))
        sums[over] = 0
