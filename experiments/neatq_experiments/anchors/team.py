"""Anchors in the arena: the whole team acts as one network, and one trainer learns from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from neatq_envs.torchrl_env import ArenaEnv
from neatq_experiments.anchors.anchor import AnchorConfig
from neatq_torch.learning.novelty import ExplorerReward
from neatq_trainers.folder import Columns
from neatq_trainers.rows import ROW_TICKS
from neatq_trainers.worlds import ArenaConfig

HIDDEN = (64, 64)
"""Units of every network of an anchor of TorchRL; networks share nothing."""
Bounds = tuple[Any, Any]
"""Least and largest actions [actions]."""


class TeamTrainer(Protocol):
    """An actor, and what it learns by."""

    @property
    def actor(self) -> TensorDictModuleBase:
        """Draws actions of observations."""
        ...

    def update(self, batch: TensorDictBase) -> None:
        """Learn from a batch [arenas, slots, ticks]."""
        ...


MakeTrainer = Callable[[Mapping[str, Any], int, Bounds, int], TeamTrainer]
"""Called with settings, how many numbers an observation has, bounds, and batches of the run."""


def batches_of(
    env: EnvBase, actor: TensorDictModuleBase, steps: int, number: int
) -> Iterator[TensorDictBase]:
    """A number of batches of so many steps [arenas, slots, steps], each with the actor as it is."""
    frames = env.batch_size.numel() * steps
    asked: dict[str, Any] = {"frames_per_batch": frames, "total_frames": frames * number}
    collector = Collector(
        env, actor, auto_register_policy_transforms=False, use_buffers=False, **asked
    )
    yield from collector
    collector.shutdown()


def train_team(config: AnchorConfig, seed: int, make: MakeTrainer) -> Columns:
    """Train in the arena for the length of a run, to the end of the batch in which it is reached.

    With a setting `novelty` the reward learnt from is an explorer's with that share of the new.

    Returns:
        Columns of metrics, a row for every 100 ticks.
    """
    assert isinstance(config.world, ArenaConfig)
    torch.manual_seed(seed)
    own, env = config.settings, ArenaEnv(config.world.scenario, seed=seed)
    bounds = env.arena.schema.action_bounds(env.scenario)
    number = -(-config.length[1] // own["batch_steps"])
    trainer = make(own, len(env.arena.schema.observations), bounds, number)
    explorer = ExplorerReward(own["novelty"]) if "novelty" in own else None
    distances = list[Tensor]()  # of each tick [robots]
    for batch in batches_of(env, trainer.actor, own["batch_steps"], number):
        distances += batch["next", "distance"][0, ..., 0].unbind(1)
        robots = torch.arange(batch.shape[1]).view(1, -1, 1, 1)
        batch["genome_id"] = robots.expand(*batch.shape, 1)  # of whom a life's ticks are
        if explorer is not None:
            batch["next", "reward"] = explorer.of(batch[0]).unsqueeze(0)
        trainer.update(batch)
    return _columns(torch.stack(distances).double().numpy())


def _columns(distance: np.ndarray) -> Columns:
    """Rows of metrics of distances [ticks, robots], as `DistanceRow` has them; nobody is born."""
    number = len(distance) // ROW_TICKS
    unknown = np.full(number, np.nan)
    names = "eligible_mean_distance", "newborn_mean_distance", "champion_distance"
    rows = distance[: number * ROW_TICKS].reshape(number, ROW_TICKS, -1)
    return {
        "arena": np.zeros(number),
        "tick": ROW_TICKS * np.arange(1.0, number + 1),
        "min_distance": rows[:, -1].min(1),
        "mean_distance": rows.mean((1, 2)),
        "births": np.zeros(number),
        **dict.fromkeys(names, unknown),
    }
