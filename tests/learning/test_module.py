"""Networks in TorchRL's own environments and collectors, beside plain loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, GymEnv, InitTracker, SerialEnv, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_torch.genome import Genome, initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    CandidateValue,
    DiscreteHeads,
    EpsilonGreedy,
    GenomeModule,
    Heads,
)
from neatq_torch.network import GenomeNetwork, PopulationNetwork

PENDULUM, CARTPOLE = "Pendulum-v1", "CartPole-v1"
STEPS = 12


def genome_of(inputs: int, outputs: int, *, recurrent: bool) -> Genome:
    """Every input leads to every output; recurrent, every output to itself too."""
    rng = np.random.default_rng(3)
    genome = initial_genome(inputs, outputs, rng=rng, bias=False)
    if not recurrent:
        return genome
    ids, links = genome.output_ids, genome.link_weight.size
    new = {
        "link_innovation": 1000 + np.arange(outputs),
        "link_source": ids,
        "link_target": ids,
        "link_weight": np.linspace(-3, 3, outputs),
        "link_enabled": np.ones(outputs, bool),
        "link_recurrent": np.ones(outputs, bool),
    }
    assert links == inputs * outputs
    old = {name: getattr(genome, name) for name in new}
    return genome.replaced(**{name: np.append(old[name], new[name]) for name in new})


def env_of(task: str, count: int | None = None) -> EnvBase:
    """One environment, or several of batch [count], short enough that episodes end."""

    def make() -> EnvBase:
        kwargs: dict[str, Any] = {"max_episode_steps": 5}
        if task == CARTPOLE:
            kwargs["categorical_action_encoding"] = True
        return GymEnv(task, **kwargs)

    return make() if count is None else SerialEnv(count, make)


def heads_of(task: str) -> Heads:
    return DiscreteHeads(2) if task == CARTPOLE else CandidateHeads(2, [-2.0], [2.0])


def network_of(task: str, *, recurrent: bool) -> GenomeNetwork:
    inputs = 4 if task == CARTPOLE else 3
    return GenomeNetwork(genome_of(inputs, heads_of(task).outputs, recurrent=recurrent))


# --- GenomeModule ---------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [None, 2])
@pytest.mark.parametrize("inside", [False, True])
def test_a_recurrent_champion_in_a_collector_equals_a_plain_loop(
    count: int | None, inside: bool
) -> None:
    network, heads = network_of(PENDULUM, recurrent=True), heads_of(PENDULUM)
    policy: Any = GenomeModule(network, heads=heads)
    if inside:  # as a part of something larger
        parts: list[Any] = [
            GenomeModule(network, out_key="output"),
            TensorDictModule(heads.best, in_keys=["output"], out_keys=["action"]),
        ]
        policy = TensorDictSequential(*parts)
    env = env_of(PENDULUM, count)
    env.set_seed(11)
    collector = Collector(
        env,
        policy,
        frames_per_batch=STEPS * (count or 1),
        total_frames=-1,
        auto_register_policy_transforms=True,
    )
    batch = next(iter(collector))
    collector.shutdown()
    acted = batch["action"] if count else batch["action"].unsqueeze(0)
    firsts = batch["observation"] if count else batch["observation"].unsqueeze(0)
    for row, seen in zip(acted, firsts, strict=True):
        torch.testing.assert_close(row, plain_loop(network, heads, seen))
    state = batch["network_state"]
    assert not state[..., [0, 5, 10], :].any()
    assert bool((state[..., [1, 2, 3, 4, 6], :] != 0).all())


def plain_loop(network: GenomeNetwork, heads: Heads, seen: Tensor) -> Tensor:
    """The actions for observations [steps, inputs] of episodes of five."""
    running, actions = network.stateful(), []
    with torch.no_grad():
        for step, one in enumerate(seen):
            if step % 5 == 0:
                running.reset()
            actions.append(heads.best(running(one)))
    return torch.stack(actions)


def test_a_rollout_needs_the_primer_and_knows_where_episodes_begin() -> None:
    network, heads = network_of(PENDULUM, recurrent=True), heads_of(PENDULUM)
    policy = GenomeModule(network, heads=heads)
    env = TransformedEnv(env_of(PENDULUM, 3), InitTracker())
    env = env.append_transform(policy.make_tensordict_primer())
    with torch.no_grad():
        rows = env.rollout(STEPS, policy, break_when_any_done=False)
    assert rows["network_state"].shape == (3, STEPS, network.state_size)
    for row in rows:
        torch.testing.assert_close(row["action"], plain_loop(network, heads, row["observation"]))
    again = policy(rows.select("observation", "network_state", "is_init"))
    torch.testing.assert_close(again["action"], rows["action"])
    torch.testing.assert_close(again["next", "network_state"], rows["next", "network_state"])


def test_a_network_without_memory_needs_neither_primer_nor_state() -> None:
    network = network_of(PENDULUM, recurrent=False)
    policy = GenomeModule(network, heads=heads_of(PENDULUM))
    assert policy.in_keys == ["observation"]
    assert policy.out_keys == ["action"]
    with torch.no_grad():
        rows = env_of(PENDULUM).rollout(4, policy)
        torch.testing.assert_close(rows["action"], policy.heads.best(network(rows["observation"])))  # type: ignore[union-attr]
    assert not dict(policy.make_tensordict_primer().primers or {})
    assert policy(observation=torch.zeros(2, 3)).shape == (2, 1)


# --- the parts of learning ------------------------------------------------------------------------


@pytest.mark.parametrize("task", [PENDULUM, CARTPOLE])
@pytest.mark.parametrize("recurrent", [False, True])
@pytest.mark.parametrize("count", [None, 3])
def test_candidates_are_taken_in_any_environment(
    task: str, recurrent: bool, count: int | None
) -> None:
    network, heads, env = network_of(task, recurrent=recurrent), heads_of(task), env_of(task, count)
    seeds = range(count or 1)
    explore = EpsilonGreedy(env.batch_size, seeds=seeds, epsilon=0.5)
    policy = CandidatePolicy(network, heads, explore)
    acting = policy
    if task == CARTPOLE:  # whose actions are numbers of shape []
        number = TensorDictModule(lambda one: one[..., 0].long(), ["action"], ["action"])
        acting = TensorDictSequential(*[policy, number])  # pyright: ignore[reportArgumentType]
    with torch.no_grad():
        rows = env.rollout(STEPS, acting, break_when_any_done=False)
        batch = env.batch_size
        assert rows["action_value"].shape == (*batch, STEPS, 2)
        assert rows["genome_id"].shape == (*batch, STEPS, 1)
        state = rows["network_state"] if recurrent else rows["observation"][..., :0]
        output, _ = network.step(rows["observation"], state)
        candidates, values = heads(output)
        torch.testing.assert_close(rows["action_value"], values)
        taken = candidates.take_along_dim(rows["candidate_index"][..., None, None], -2).squeeze(-2)
        wanted = taken[..., 0].long() if task == CARTPOLE else taken
        torch.testing.assert_close(rows["action"], wanted)
        assert (rows["candidate_index"] != values.argmax(-1)).any()
        value = CandidateValue(network, heads)(
            rows.select("observation", *["network_state"] * recurrent)
        )
        torch.testing.assert_close(value["action_value"], values)
    if recurrent:
        kept = rows["network_state"][..., 1:, :]
        assert torch.equal(kept, rows["next", "network_state"][..., :-1, :])
        policy.reset(torch.ones(batch, dtype=torch.bool))
        assert not policy.memory.any()


def test_every_environment_of_a_batch_explores_like_an_arena_of_one() -> None:
    values = torch.zeros(3, 7)
    together = EpsilonGreedy((3,), seeds=[5, 6, 7], epsilon=0.7, max_hold_ticks=5)
    rows = EpsilonGreedy((3, 1), seeds=[5, 6, 7], epsilon=0.7, max_hold_ticks=5)
    alone = EpsilonGreedy((), seeds=[6], epsilon=0.7, max_hold_ticks=5)
    deep = EpsilonGreedy((3, 2, 2), seeds=[5, 6, 7], epsilon=0.7, max_hold_ticks=5)
    flat = EpsilonGreedy((3, 4), seeds=[5, 6, 7], epsilon=0.7, max_hold_ticks=5)
    found = values[:, 0]
    for _ in range(150):
        found = together(values)
        assert torch.equal(found, rows(values.unsqueeze(1)).squeeze(1))
        assert torch.equal(found[1], alone(values[1]))
        four = flat(torch.zeros(3, 4, 7))
        assert torch.equal(deep(torch.zeros(3, 2, 2, 7)), four.view(3, 2, 2))
    assert found.any()


def test_rows_that_do_not_fit_are_refused() -> None:
    network, heads = network_of(PENDULUM, recurrent=True), heads_of(PENDULUM)
    explore = EpsilonGreedy((3,), seeds=range(3))
    with pytest.raises(ValueError, match=r"expected values of shape \[3, K\], got \[2, 4\]"):
        explore(torch.zeros(2, 4))
    policy = CandidatePolicy(network, heads, explore)
    with pytest.raises(ValueError, match=r"for each row \[3\] of the exploration.*shape \[2, 3\]"):
        policy(TensorDict({"observation": torch.zeros(2, 3)}, [2]))
    several = PopulationNetwork([genome_of(3, 4, recurrent=False)] * 2, shape=(1, 2))
    with pytest.raises(ValueError, match=r"expected exploration of shape \(1, 2\) or more.*\(3,\)"):
        CandidatePolicy(several, heads, explore)
    with pytest.raises(ValueError, match="expected one seed for each arena of"):
        EpsilonGreedy((3,), seeds=[1])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert explore(torch.tensor([[0.0, 1.0]])).tolist() == [1]


def test_where_episodes_begin_may_lack_the_last_dimension() -> None:
    policy = GenomeModule(network_of(PENDULUM, recurrent=True))
    given = {
        "observation": torch.rand(5, 3),
        "network_state": torch.ones(5, policy.module.state_size),
    }
    begins = torch.tensor([True, False, True, False, False])
    outputs = [
        policy(TensorDict({**given, "is_init": one}, [5]))["action"]
        for one in (begins, begins.unsqueeze(-1))
    ]
    assert torch.equal(*outputs)


def test_an_observation_that_is_missing_is_named() -> None:
    policy = GenomeModule(network_of(PENDULUM, recurrent=False))
    with pytest.raises(KeyError, match="observation"):
        policy(TensorDict({"seen": torch.rand(5, 3)}, [5]))


def test_a_module_that_does_not_step_is_refused() -> None:
    module: Any = torch.nn.Linear(2, 1)
    with pytest.raises(TypeError, match=r"expected a GenomeNetwork or .*, got Linear"):
        GenomeModule(module)
