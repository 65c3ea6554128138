"""Learners by name: what each setting does, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.genome import initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    CandidateTDLoss,
    DiscreteHeads,
    EpsilonGreedy,
    Heads,
    Learner,
    LearnerParts,
    NoLearningConfig,
    ReplayConfig,
    ReplayLearner,
    TableConfig,
    TableLearner,
    TDConfig,
    TDLearner,
    TraceConfig,
    WireFittingLoss,
    learner_kinds,
    register_learner,
)
from neatq_torch.learning.learner import NoLearning
from neatq_torch.network import PopulationNetwork

HEADS = CandidateHeads(3, [0.0], [1.0])
REPLAY = ReplayConfig(updates=2, newborn_updates=2, size=4, horizon=3, keep_every=2, capacity=8)


def made(config: object, heads: Heads = HEADS, inputs: int = 2) -> Learner:
    """A learner of two arenas with two robots each."""
    rng = np.random.default_rng(0)
    genomes = [initial_genome(inputs, heads.outputs, rng=rng, genome_id=i + 1) for i in range(4)]
    network = PopulationNetwork(genomes, shape=(2, 2))
    parts = LearnerParts(network, heads, (2, 2), range(3, 5), episodes=2)
    return learner_kinds.maker_of(config)(config, parts)


def batch_of(seed: int, heads: Heads = HEADS) -> TensorDict:
    rng, shape = torch.Generator().manual_seed(seed), (2, 2, 6)
    never = torch.zeros(*shape, 1, dtype=torch.bool)
    index = torch.randint(heads.candidates, shape, generator=rng)
    following = {
        "observation": torch.rand(*shape, 2, generator=rng),
        "reward": torch.rand(*shape, 1, generator=rng),
        "done": never,
        "terminated": never.clone(),
    }
    now = {
        "observation": torch.rand(*shape, 2, generator=rng),
        "action": torch.rand(*shape, 1, generator=rng),
        "candidate_index": index,
        "genome_id": torch.arange(1, 5).view(2, 2, 1, 1).expand(*shape, 1).clone(),
        "episode": torch.ones(*shape, 1, dtype=torch.long),
        "next": following,
    }
    return TensorDict(now, shape)


def learnt(config: object) -> torch.Tensor:
    """Weights after three batches, between which one robot is born."""
    learner = made(config)
    for seed in range(3):
        learner.update(batch_of(seed))
        learner.reset(torch.tensor([[False, False], [seed == 1, False]]))
    own: Any = learner.learner if isinstance(learner, ReplayLearner) else learner
    return own.network.weight.detach()


@pytest.mark.parametrize(
    ("config", "changes"),
    [
        (TDConfig(), {"learning_rate": 0.2}),
        (TDConfig(), {"optimizer": "adam"}),
        (TDConfig(), {"target_tau": 0.5}),
        (TDConfig(), {"discount": 0.5}),
        (TDConfig(), {"normalize_return": False}),
        (TDConfig(), {"trace_decay": 0.5}),
        (TDConfig(), {"wires": True}),
        (REPLAY, {"learning_rate": 0.2}),
        (REPLAY, {"optimizer": "adam"}),
        (REPLAY, {"target_tau": 0.5}),
        (REPLAY, {"discount": 0.5}),
        (REPLAY, {"normalize_return": False}),
        (REPLAY, {"updates": 3}),
        (REPLAY, {"newborn_updates": 0}),
        (REPLAY, {"size": 5}),
        (REPLAY, {"horizon": 1}),
        (REPLAY, {"keep_every": 1}),
        (REPLAY, {"capacity": 5}),
        (TraceConfig(), {"learning_rate": 0.2}),
        (TraceConfig(), {"discount": 0.5}),
        (TraceConfig(), {"trace_decay": 0.1}),
        (TraceConfig(), {"anneal": True}),
    ],
)
def test_every_setting_changes_what_is_learnt(config: Any, changes: dict[str, Any]) -> None:
    other = replace(config, **changes)
    assert torch.equal(learnt(other), learnt(other))
    assert not torch.equal(learnt(other), learnt(config))


@pytest.mark.parametrize("changes", [{"learning_rate": 0.1}, {"discount": 0.0}])
def test_every_setting_changes_the_table(changes: dict[str, float]) -> None:
    tables = []
    for config in (TableConfig(), TableConfig(**changes)):
        learner = made(config)
        assert isinstance(learner, TableLearner)
        batch = batch_of(0)
        batch["observation"] = torch.zeros_like(batch["observation"])
        batch["next", "observation"] = torch.zeros_like(batch["observation"])
        learner.update(batch)
        tables.append(learner.values)
    assert not np.array_equal(*tables)


def test_a_table_acts_within_the_bounds_of_the_heads_as_often_at_random_as_it_should() -> None:
    heads = CandidateHeads(2, [-2.0, 0.0], [2.0, 1.0])
    learner = made(TableConfig(epsilon=0.3), heads)
    assert isinstance(learner, TableLearner)
    assert learner.low.tolist() == [-2.0, 0.0]
    assert learner.high.tolist() == [2.0, 1.0]
    rows = TensorDict({"observation": torch.zeros(2, 2, 2)}, (2, 2))
    drawn = torch.cat([learner.policy(rows.clone())["action"].view(4, 2) for _ in range(500)])
    at_random = (drawn[:, 1].remainder(0.5) != 0).double().mean()
    assert at_random.item() == pytest.approx(0.3, abs=0.04)


def test_arenas_draw_from_their_own_seeds_whatever_stands_beside() -> None:
    both = made(REPLAY)
    assert isinstance(both, ReplayLearner)
    network = both.learner.network
    alone = PopulationNetwork(network.genomes()[2:], shape=(1, 2))
    one = learner_kinds.maker_of(REPLAY)(REPLAY, LearnerParts(alone, HEADS, (1, 2), [4]))
    both.update(batch_of(0))
    one.update(batch_of(0)[1:])
    assert torch.equal(network.weight[2:], alone.weight)


@pytest.mark.parametrize("name", list(learner_kinds))
def test_names_and_configurations_belong_together(name: str) -> None:
    config = learner_kinds.config(name)()
    assert learner_kinds.name_of(config) == name
    learner = made(config, CandidateHeads(1, [0.0], [1.0]) if name == "critic" else HEADS)
    learner.load_state_dict(learner.state_dict())


def test_discrete_actions_are_learnt_by_their_number_and_others_by_wires() -> None:
    discrete, losses = DiscreteHeads(3), []
    for config in (TDConfig(), TDConfig(wires=True), ReplayConfig()):
        for heads in (discrete, HEADS):
            learner = made(config, heads)
            own = learner.learner if isinstance(learner, ReplayLearner) else learner
            assert isinstance(own, TDLearner)
            losses.append(type(own.loss))
    plain, wires = CandidateTDLoss, WireFittingLoss
    assert losses == [plain, plain, plain, wires, plain, wires]


def test_replay_finds_the_way_along_a_chain_by_discrete_actions() -> None:
    """Right (1) leads on and earns 1 at the end, left (0) leads back."""
    states, gamma = 4, 0.9
    config = ReplayConfig(
        learning_rate=0.05,
        optimizer="adam",
        discount=gamma,
        normalize_return=False,
        updates=8,
        newborn_updates=300,
        keep_every=1,
        horizon=1,
    )
    rng = np.random.default_rng(0)
    genomes = [
        initial_genome(states, 2, rng=rng, bias=False, activation="identity", genome_id=i)
        for i in range(2)
    ]
    heads, network = DiscreteHeads(2), PopulationNetwork(genomes, shape=(1, 2))
    learner = learner_kinds.maker_of(config)(config, LearnerParts(network, heads, (1, 2), [0]))
    policy = CandidatePolicy(network, heads, EpsilonGreedy((1, 2), seeds=[0], epsilon=0.5))
    at, seen = torch.zeros(1, 2, dtype=torch.long), torch.eye(states)
    for _ in range(60):
        ticks = []
        for _ in range(10):
            tick = TensorDict({"observation": seen[at]}, (1, 2))
            with torch.no_grad():
                policy(tick)
            right = tick["action"].squeeze(-1) > 0.5
            at = torch.where(right, at + 1, (at - 1).clamp_min(0))
            over = at == states
            tick["next"] = {
                "observation": seen[at.clamp_max(states - 1)],
                "reward": over.float().unsqueeze(-1),
                "terminated": over.unsqueeze(-1),
                "done": over.unsqueeze(-1),
            }
            ticks.append(tick)
            at = at.masked_fill(over, 0)
        learner.update(cast(TensorDict, TensorDict.stack(ticks, -1)))
    best = gamma ** np.arange(states - 1, -1, -1)
    known = np.stack([gamma * np.append(best[0], best[:-1]), best], -1)
    for found in network(seen.expand(1, 2, states, states))[0].detach().numpy():
        np.testing.assert_allclose(found, known, atol=0.1)
    network.replace(1, genomes[1])
    learner.reset(torch.tensor([[False, True]]))  # taught before its first tick
    found = network(seen.expand(1, 2, states, states))[0, 1].detach().numpy()
    np.testing.assert_allclose(found, known, atol=0.1)


def test_a_learner_of_ones_own_has_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class Settings:
        pass

    def make(_: Settings, parts: LearnerParts) -> NoLearning:
        return NoLearning(parts.networks())

    with pytest.raises(ValueError, match=r"a configuration of one of none, td, .*Settings"):
        learner_kinds.name_of(Settings())
    monkeypatch.setattr(learner_kinds, "_kinds", dict(learner_kinds._kinds))
    register_learner("mine", Settings, make)
    register_learner("mine", Settings, make)
    assert learner_kinds.config("mine") is Settings
    assert isinstance(made(Settings()), NoLearning)
    for name, taken in (("mine", int), ("other", Settings), ("td", Settings), ("x", TDConfig)):
        with pytest.raises(ValueError, match="is taken; choose another"):
            register_learner(name, taken, make)


def test_what_cannot_be_made_says_why() -> None:
    with pytest.raises(
        ValueError, match=r"one of none, td, replay, critic, traces, table, .* got 'x"
    ):
        learner_kinds.config("xcs")
    with pytest.raises(ValueError, match="expected networks to learn with, got none"):
        learner_kinds.maker_of(TDConfig())(TDConfig(), LearnerParts(None, HEADS, (1, 1), [0]))
    with pytest.raises(ValueError, match="expected CandidateHeads, got DiscreteHeads"):
        learner_kinds.maker_of(TableConfig())(
            TableConfig(), LearnerParts(None, DiscreteHeads(2), (1, 1), [0])
        )


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (TDConfig, {"learning_rate": float("nan")}),
        (TDConfig, {"target_tau": 0.0}),
        (TDConfig, {"optimizer": "newton"}),
        (TDConfig, {"discount": 1.1}),
        (TDConfig, {"trace_decay": -0.1}),
        (TDConfig, {"epsilon": 2.0}),
        (TDConfig, {"max_hold_ticks": 0}),
        (TDConfig, {"inheritance": "mosaic"}),
        (ReplayConfig, {"updates": 0}),
        (ReplayConfig, {"newborn_updates": -1}),
        (ReplayConfig, {"size": 0}),
        (ReplayConfig, {"horizon": 0}),
        (ReplayConfig, {"keep_every": 0}),
        (ReplayConfig, {"capacity": 0}),
        (TraceConfig, {"learning_rate": float("inf")}),
        (TraceConfig, {"max_hold_ticks": 0}),
        (TableConfig, {"discount": -1.0}),
        (TableConfig, {"epsilon": 1.5}),
    ],
)
def test_bad_settings_are_named(kind: type, settings: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(settings))}: "):
        kind(**settings)


def test_a_rate_falls_over_the_episodes_of_a_life_or_not_at_all() -> None:
    network = PopulationNetwork([initial_genome(2, 6, rng=np.random.default_rng(0))], shape=(1, 1))
    with pytest.raises(ValueError, match="anneal: expected lives of a number of episodes"):
        learner_kinds.maker_of(TraceConfig())(
            TraceConfig(anneal=True), LearnerParts(network, HEADS, (1, 1), [0])
        )


def test_without_learning_nothing_is_explored_or_inherited() -> None:
    assert not vars(NoLearningConfig())
    assert made(NoLearningConfig()).update(batch_of(0)).isnan().all()
