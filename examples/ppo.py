"""PPO of TorchRL on the arena, as a script to copy: `python examples/ppo.py --help`.

Fifty robots that share one network: what an ordinary trainer makes of the world in which
`neatq train` evolves fifty networks.
"""

from statistics import fmean
from typing import Any

import torch
import tyro
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from neatq_envs import ArenaEnv, find_scenario

BATCH_TICKS, EPOCHS, MINIBATCH = 100, 4, 1000


def main(*, task: str = "flag", steps: int = 10_000, seed: int = 0) -> float:
    """Train for ticks; returns the mean distance to the flag over the last tenth, in units."""
    torch.manual_seed(seed)
    env = ArenaEnv(find_scenario(task, changes={"reward": "progress"}), seed=seed)
    actor, critic = networks(env)
    # A life is truncated, never terminated: GAE goes on with the value of its last observation.
    advantage = GAE(gamma=0.97, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.001)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)
    frames, batches = env.batch_size.numel() * BATCH_TICKS, -(-steps // BATCH_TICKS)
    asked: dict[str, Any] = {"frames_per_batch": frames, "total_frames": frames * batches}
    collector = Collector(env, actor, auto_register_policy_transforms=False, **asked)
    distances = list[float]()
    for number, batch in enumerate(collector, 1):
        distances.append(batch["next", "distance"].mean().item())
        for _ in range(EPOCHS):
            with torch.no_grad():
                data = advantage(batch).reshape(-1)
            for rows in torch.randperm(len(data)).split(MINIBATCH):
                parts = loss(data[rows])
                total = parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]
                optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        if number % 10 == 0:  # a whole life
            print(f"tick {number * BATCH_TICKS:6d}  mean distance {fmean(distances[-10:]):5.1f}")
    collector.shutdown()
    return fmean(distances[-max(1, batches // 10) :])


def networks(env: ArenaEnv) -> tuple[ProbabilisticActor, ValueOperator]:
    """Return actor and critic, which all robots share."""
    low, high = (torch.from_numpy(bound) for bound in env.arena.schema.action_bounds(env.scenario))
    seen = env.observation_spec["observation"].shape[-1]
    size: dict[str, Any] = {"in_features": seen, "num_cells": [64, 64], "activation_class": nn.Tanh}
    policy = nn.Sequential(MLP(out_features=2 * len(low), **size), NormalParamExtractor())
    module = TensorDictModule(policy, ["observation"], ["loc", "scale"])
    drawn: dict[str, Any] = {"distribution_class": TanhNormal, "return_log_prob": True}
    drawn["distribution_kwargs"] = {"low": low, "high": high}
    actor = ProbabilisticActor(module, in_keys=["loc", "scale"], **drawn)
    return actor, ValueOperator(MLP(out_features=1, **size), in_keys=["observation"])


if __name__ == "__main__":
    torch.set_num_threads(1)
    print(f"mean distance over the last tenth: {tyro.cli(main):.1f}")
