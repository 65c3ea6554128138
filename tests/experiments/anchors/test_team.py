"""Anchors that learn as a team in the arena: what they learn from, and that they do."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_experiments.anchors.anchor import AnchorConfig, anchor_config
from neatq_experiments.anchors.run import trainer_of
from neatq_experiments.anchors.sac import SACTrainer
from neatq_experiments.anchors.sac_settings import sac_settings
from neatq_experiments.anchors.team import train_team
from neatq_torch.kinds import ConfigError
from neatq_torch.learning.novelty import ExplorerReward
from neatq_trainers.folder import Columns

SMALL = {"robots": 6, "lifetime_ticks": 40}
BOUNDS = np.array([-2.0, -0.5]), np.array([2.0, 0.5])


def config(name: str, task: str = "flag", *, ticks: int = 200, **changes: Any) -> AnchorConfig:
    """A short run of few robots, with other settings."""
    own = anchor_config(task, name, SMALL).changed({"ticks": ticks})
    return replace(own, settings={**own.settings, **changes})


def columns(config: AnchorConfig, seed: int = 3) -> Columns:
    return trainer_of(config)(config, seed)


class Recorder(SACTrainer):
    """Learns nothing, and keeps the batches."""

    def update(self, batch: TensorDictBase) -> None:
        self.batches = [*getattr(self, "batches", []), batch.clone()]


def recorded(config: AnchorConfig) -> tuple[Any, Columns]:
    """All that a team went through [1, robots, ticks], batch behind batch, and its metrics."""
    kept = list[Recorder]()

    def make(settings: Any, inputs: int, bounds: Any, batches: int) -> Recorder:
        kept.append(Recorder(settings, inputs, bounds))
        return kept[0]

    found = train_team(config, 3, make)
    return torch.cat(kept[0].batches, -1), found


def trainer(**changes: Any) -> SACTrainer:
    """A trainer of three observations and two actions."""
    torch.manual_seed(0)
    return SACTrainer({**sac_settings()["settings"], "warmup": 1, **changes}, 3, BOUNDS)


def lived(actor: Any, ticks: int = 25, **ends: bool) -> Any:
    """What four robots went through who see always the same; the reward is 1 for all they do."""
    shape = (1, 4, ticks)
    seen = TensorDict({"observation": torch.full((*shape, 3), 0.5)}, shape)
    ones = torch.ones(*shape, 1)
    flags = {name: ones.bool() & ends.get(name, False) for name in ("terminated", "truncated")}
    done = flags["terminated"] | flags["truncated"]
    following = TensorDict({**seen, **flags, "done": done, "reward": ones}, shape)
    with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
        return actor(seen).update({"next": following, "genome_id": ones.long()})


def kept_by(trainer: SACTrainer) -> Any:
    """All transitions that a trainer remembers."""
    return trainer.memory[:]


def targets(trainer: SACTrainer, worth: float) -> Any:
    """What values learn [transitions] where all that follows has one worth."""
    loss: Any = trainer.loss
    with torch.no_grad():
        loss.target_qvalue_network_params.apply_(lambda one: one.zero_())
        loss.target_qvalue_network_params["module", "network", "4", "bias"].fill_(worth)
        loss.log_alpha.fill_(-30.0)
        return loss._compute_target_v2(kept_by(trainer))


@pytest.mark.parametrize(
    ("task", "name", "pattern"),
    [
        ("gym:CartPole-v1", "sac", "sac does not run on gym:CartPole-v1: .* sb3-sac runs on Gymn"),
        ("gym:Pendulum-v1", "sac-novelty", "sac-novelty does not .* visits to places, which only"),
        ("gym:Pendulum-v1", "ppo-novelty", "ppo-novelty does not run on gym:Pendulum-v1: its rew"),
    ],
)
def test_what_knows_the_arena_alone_is_refused_elsewhere(
    task: str, name: str, pattern: str
) -> None:
    with pytest.raises(ConfigError, match=pattern):
        anchor_config(task, name)


@pytest.mark.parametrize("name", ["sac", "sac-novelty", "ppo-novelty"])
def test_the_same_seed_gives_the_same_run(name: str) -> None:
    fast: dict[str, Any] = {"epochs": 1}
    if name.startswith("sac"):
        fast = {"warmup": 100, "updates_per_tick": 0.1}
    own = config(name, ticks=100, **fast)
    one = columns(own)
    assert one["tick"].tolist() == [100]
    np.testing.assert_equal(columns(own), one)
    assert not np.array_equal(columns(own, seed=4)["mean_distance"], one["mean_distance"])


def test_anchors_share_the_world_and_differ_in_what_they_learn_from() -> None:
    plain, new = config("sac"), config("sac-novelty")
    assert plain.world == new.world == config("ppo").world
    assert {**plain.settings, "novelty": 0.5} == new.settings
    assert config("ppo-novelty").settings == {**config("ppo").settings, "novelty": 0.5}
    plain_batch, plain_rows = recorded(plain)
    new_batch, new_rows = recorded(new)
    np.testing.assert_equal(new_rows, plain_rows)
    assert torch.equal(new_batch["action"], plain_batch["action"])
    explorer, steps = ExplorerReward(0.5), plain.settings["batch_steps"]
    expected = torch.cat([explorer.of(batch) for batch in plain_batch[0].split(steps, -1)], -2)
    assert torch.equal(new_batch["next", "reward"][0], expected)
    assert (expected - plain_batch["next", "reward"][0]).abs().mean() > 0.1


@pytest.mark.parametrize("steps", [20, 30, 100, 250])
def test_rows_are_of_every_hundredth_tick_however_long_batches_are(steps: int) -> None:
    batch, rows = recorded(config("sac", batch_steps=steps))
    ticks = batch.shape[-1]
    assert ticks == -(-200 // steps) * steps
    distance = batch["next", "distance"][0, :, :200, 0].double()
    np.testing.assert_allclose(rows["mean_distance"], distance.mean(0).view(2, 100).mean(1))
    np.testing.assert_allclose(rows["min_distance"], distance[:, 99::100].min(0).values)


def test_a_life_goes_on_behind_its_last_tick_with_what_was_seen_there() -> None:
    batch, _ = recorded(config("sac", ticks=100))
    ends = batch["next", "truncated"][0, ..., 0].nonzero().tolist()
    # Six robots whose lives of 40 ticks are spread: ages of 0, 6, 13, 20, 26, 33 in the beginning.
    assert ends == [
        [robot, end]
        for robot, age in enumerate((0, 6, 13, 20, 26, 33))
        for end in range(39 - age, 100, 40)
    ]
    assert not batch["next", "terminated"].any()
    last = batch[0, 0, 39]
    own = trainer(horizon=5, warmup=10_000)
    own.update(batch)
    kept = kept_by(own).view(6, 100)
    assert kept["steps_to_next_obs"][0, 34:42, 0].tolist() == [5, 5, 4, 3, 2, 1, 5, 5]
    for tick in range(35, 40):
        assert torch.equal(kept["next", "observation"][0, tick], last["next", "observation"])
    first = batch[0, 0, 40]["observation"]
    assert not torch.equal(first, last["next", "observation"])
    assert not kept["next", "terminated"].any()


def test_values_are_bootstrapped_over_truncations_and_not_over_terminations() -> None:
    found = dict[str, list[float]]()
    for end in ("terminated", "truncated"):
        own = trainer(discount=0.8, warmup=10_000)
        own.update(lived(own.actor, ticks=1, **{end: True}))
        found[end] = targets(own, 5.0).tolist()
    assert found["terminated"] == [1] * 4
    assert found["truncated"] == pytest.approx([1 + 0.8 * 5] * 4)


def test_a_value_over_a_horizon_is_discounted_by_its_ticks() -> None:
    own = trainer(discount=0.5, horizon=3, warmup=10_000)
    own.update(lived(own.actor, ticks=10))
    reward = kept_by(own)["next", "reward"].view(4, 10)
    assert reward[0].tolist() == [1.75] * 8 + [1.5, 1.0]
    target = targets(own, 8.0).view(4, 10)
    assert target[0].tolist() == pytest.approx([2.75] * 8 + [3.5, 5.0])


def test_sac_finds_what_is_rewarded_and_stays_as_random_as_it_should() -> None:
    own, span = trainer(discount=0.0, learning_rate=0.03, minibatch=64), [2.0, 0.5]
    loss: Any = own.loss
    assert loss.target_entropy.item() == pytest.approx(math.log(2) + math.log(0.5) - 2)
    begun = loss(lived(own.actor)[0])["entropy"].item()
    for _ in range(8):
        batch = lived(own.actor)
        shares = batch["action"] / torch.tensor(span)
        assert (shares.abs() <= 1).all()
        batch["next", "reward"] = 4 - (shares - 0.6).square().sum(-1, keepdim=True)
        own.update(batch)
    shares = lived(own.actor, ticks=200)["action"].flatten(0, 2) / torch.tensor(span)
    assert shares.mean(0).tolist() == pytest.approx([0.6, 0.6], abs=0.1)
    assert begun > 0
    assert loss(kept_by(own))["entropy"].item() == pytest.approx(loss.target_entropy, abs=1)


def test_values_read_actions_as_shares_of_their_range() -> None:
    own = trainer()
    loss: Any = own.loss
    value = loss.qvalue_network.module
    seen = torch.zeros(5, 3)
    top = value(seen, torch.tensor([[2.0, 0.5]]).expand(5, 2))
    assert torch.equal(top, value.network(torch.cat([seen, torch.ones(5, 2)], -1)))


def test_remembering_what_a_team_did_is_not_told(capsys: pytest.CaptureFixture[str]) -> None:
    said = list[str]()
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("torchrl")
    logger.addHandler(handler)
    try:
        own = trainer(warmup=10_000)
        own.update(lived(own.actor))
    finally:
        logger.removeHandler(handler)
    assert said == [] and len(own.memory) == 100
    assert capsys.readouterr().err == ""
