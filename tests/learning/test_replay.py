"""What is remembered of transitions, and what networks learn from it before they act."""

from __future__ import annotations

import io
import logging
from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict

from neatq_torch.checkpoint import load_checkpoint, save_checkpoint
from neatq_torch.genome import Genome, initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    DiscreteHeads,
    ReplayConfig,
    ReplayLearner,
    TDConfig,
    TDLearner,
    WireFittingLoss,
)
from neatq_torch.learning.memory import TransitionMemory, over_horizon
from neatq_torch.learning.replay import rehearse
from neatq_torch.network import PopulationNetwork


def transitions(rewards: Sequence[float], *, genome_id: int = 7) -> TensorDict:
    """Transitions [1, ticks], told apart by their rewards."""
    reward = torch.tensor(rewards).view(1, -1, 1)
    never = torch.zeros(1, len(rewards), 1, dtype=torch.bool)
    following = {"observation": reward + 0.5, "reward": reward, "terminated": never}
    batch = {
        "observation": reward.clone(),
        "action": torch.zeros(1, len(rewards), 1),
        "genome_id": torch.full((1, len(rewards), 1), genome_id),
        "next": following,
    }
    return TensorDict(batch, (1, len(rewards)))


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def drawn(memory: TransitionMemory, size: int = 200, seed: int = 0) -> list[float]:
    return memory.sample(size, generator(seed)).get(("next", "reward")).flatten().tolist()


def test_the_latest_transitions_are_kept_and_drawn_alike() -> None:
    memory = TransitionMemory(4)
    for rewards in ([1.0, 2.0, 3.0], [4.0, 5.0], [6.0]):
        memory.extend(transitions(rewards))
    assert len(memory) == 4
    found = drawn(memory, 4000)
    assert set(found) == {3.0, 4.0, 5.0, 6.0}
    assert np.bincount(np.array(found, int))[3:] == pytest.approx([1000] * 4, abs=120)


def test_more_than_fits_at_once_leaves_the_last() -> None:
    memory = TransitionMemory(3)
    memory.extend(transitions([1.0, 2.0, 3.0, 4.0, 5.0]))
    assert set(drawn(memory)) == {3.0, 4.0, 5.0}


def test_rows_of_a_transition_stay_together() -> None:
    memory = TransitionMemory(100)
    memory.extend(transitions([1.0, 2.0, 3.0]))
    sample = memory.sample(50, generator())
    assert torch.equal(sample["observation"], sample["next", "reward"])
    assert torch.equal(sample["next", "observation"], sample["next", "reward"] + 0.5)


def test_idle_rows_are_not_remembered() -> None:
    memory = TransitionMemory(10)
    memory.extend(transitions([1.0, 2.0], genome_id=-1))
    assert len(memory) == 0
    batch = transitions([3.0, 4.0])
    batch["genome_id"][0, 0] = -1
    memory.extend(batch)
    assert set(drawn(memory)) == {4.0}


def test_remembering_says_nothing() -> None:
    said = io.StringIO()
    handler = logging.StreamHandler(said)
    logger = logging.getLogger("torchrl")
    logger.addHandler(handler)
    try:
        memory = TransitionMemory(2)
        memory.extend(transitions([1.0, 2.0, 3.0]))
        memory.sample(2, generator())
    finally:
        logger.removeHandler(handler)
    assert said.getvalue() == ""


def test_an_empty_memory_says_so() -> None:
    with pytest.raises(ValueError, match="expected stored transitions"):
        TransitionMemory(5).sample(1, generator())
    with pytest.raises(ValueError, match="capacity: expected at least 1"):
        TransitionMemory(0)


@pytest.mark.parametrize("ticks", [0, 3, 4, 7, 8, 10])
def test_a_restored_memory_draws_and_forgets_alike(ticks: int, tmp_path: object) -> None:
    memory, again = TransitionMemory(4), TransitionMemory(4)
    for number in range(ticks):
        memory.extend(transitions([float(number)]))
    path = f"{tmp_path}/checkpoint"
    save_checkpoint(path, memory.state_dict(), observation_schema="")
    again.load_state_dict(load_checkpoint(path))
    for number in range(20, 23):
        assert len(again) == len(memory)
        if len(memory):
            assert drawn(again, seed=number) == drawn(memory, seed=number)
        memory.extend(transitions([float(number)]))
        again.extend(transitions([float(number)]))


STATES, GAMMA = 4, 0.9


def chain() -> TransitionMemory:
    """All transitions of a line of states: right is +1 and ends at 1, left is -1."""
    memory = TransitionMemory(100)
    for state, action in product(range(STATES), (0, 1)):
        following = state + 1 if action else max(state - 1, 0)
        over = torch.tensor([following == STATES])
        now = {
            "observation": torch.eye(STATES)[state],
            "action": torch.tensor([float(action)]),
            "genome_id": torch.tensor([1]),
            "next": {
                "observation": torch.eye(STATES)[min(following, STATES - 1)],
                "reward": over.float(),
                "terminated": over,
            },
        }
        memory.extend(TensorDict(now, ()).unsqueeze(0))
    return memory


def known_values() -> np.ndarray:
    """Q* [states, actions]."""
    best = GAMMA ** np.arange(STATES - 1, -1, -1)
    return np.stack([GAMMA * np.append(best[0], best[:-1]), best], -1)


def linear(robots: int, seed: int = 0) -> list[Genome]:
    rng = np.random.default_rng(seed)
    settings = {"rng": rng, "bias": False, "activation": "identity"}
    return [
        initial_genome(STATES, 2, genome_id=i + 1, **settings)  # pyright: ignore[reportArgumentType]
        for i in range(robots)
    ]


def trained(
    genomes: Sequence[Genome],
    shape: tuple[int, int],
    seeds: Sequence[int],
    *,
    steps: int = 200,
    config: TDConfig | None = None,
) -> PopulationNetwork:
    network = PopulationNetwork(genomes, shape=shape)
    settings = config or TDConfig(learning_rate=0.05, optimizer="adam")
    delayed = settings.target_tau is not None
    loss = CandidateTDLoss(CandidateValue(network, DiscreteHeads(2)), delay_value=delayed)
    loss.make_value_estimator(gamma=GAMMA)
    generators = [generator(seed) for seed in seeds]
    memories, learner = [chain() for _ in seeds], TDLearner(network, loss, settings)
    rehearse(learner, memories, generators, range(len(seeds)), steps=steps, batch=16)
    return network


@pytest.mark.parametrize("target_tau", [None, 0.2])
def test_every_network_finds_the_known_values_of_a_chain(target_tau: float | None) -> None:
    config = TDConfig(learning_rate=0.02, target_tau=target_tau)
    network = trained(linear(3), (1, 3), [0], steps=700, config=config)
    values = network(torch.eye(STATES).expand(1, 3, STATES, STATES))[0].detach().numpy()
    for found in values:
        np.testing.assert_allclose(found, known_values(), atol=0.02)


def test_what_is_learnt_does_not_depend_on_how_networks_are_dealt_out() -> None:
    genomes = linear(5)
    whole = trained(genomes, (1, 5), [3])
    parts = [trained(genomes[:2], (1, 2), [3]), trained(genomes[2:], (1, 3), [3])]
    found = [genome for part in parts for genome in part.genomes()]
    for one, two in zip(whole.genomes(), found, strict=True):
        assert one.link_weight.tobytes() == two.link_weight.tobytes()


def test_arenas_learn_from_their_own_memories_as_if_alone() -> None:
    genomes = linear(4)
    both = trained(genomes, (2, 2), [3, 8])
    for arena, seed in enumerate((3, 8)):
        alone = trained(genomes[2 * arena : 2 * arena + 2], (1, 2), [seed]).genomes()
        beside = both.genomes()[2 * arena : 2 * arena + 2]
        for one, two in zip(alone, beside, strict=True):
            assert one.link_weight.tobytes() == two.link_weight.tobytes()
    assert trained(genomes[:2], (1, 2), [8]).weight[0, 0] != both.weight[0, 0]


def test_arenas_may_share_memories() -> None:
    """Arenas 0 and 2 of one robot each are the arena of both, 1 is one of its own."""
    genomes = linear(3)
    network = PopulationNetwork(genomes, shape=(3, 1))
    loss = CandidateTDLoss(CandidateValue(network, DiscreteHeads(2)))
    loss.make_value_estimator(gamma=GAMMA)
    settings = TDConfig(learning_rate=0.05, optimizer="adam")
    generators, memories = [generator(3), generator(8)], [chain(), chain()]
    learner = TDLearner(network, loss, settings)
    rehearse(learner, memories, generators, [0, 1, 0], steps=200, batch=16)
    alone = trained([genomes[0], genomes[2]], (1, 2), [3]).genomes()
    alone.insert(1, trained(genomes[1:2], (1, 1), [8]).genome(0))
    for one, two in zip(alone, network.genomes(), strict=True):
        assert one.link_weight.tobytes() == two.link_weight.tobytes()


def test_continuous_actions_are_learnt_from_by_wire_fitting() -> None:
    """The reward of action a is 1 - 1.5 (a - 0.8)^2, stored by others."""
    heads = CandidateHeads(3, [0.0], [1.0])
    rng = np.random.default_rng(0)
    genome = initial_genome(1, heads.outputs, rng=rng, genome_id=1)
    network = PopulationNetwork([genome], shape=(1, 1))
    stored = transitions([0.0] * 500)
    stored["action"] = torch.rand(1, 500, 1, generator=generator())
    stored["next", "reward"] = 1 - 1.5 * (stored["action"] - 0.8).square()
    memory = TransitionMemory(500)
    memory.extend(stored)
    loss = WireFittingLoss(CandidateValue(network, heads, propose=True))
    loss.make_value_estimator(gamma=0.0)
    settings = TDConfig(learning_rate=0.05, optimizer="adam")
    learner = TDLearner(network, loss, settings)
    error = rehearse(learner, [memory], [generator(1)], [0], steps=300, batch=64)
    candidates, values = heads(network(torch.zeros(1, 1, 1)))
    assert candidates[0, 0, values.argmax(), 0].item() == pytest.approx(0.8, abs=0.1)
    assert error.item() < 0.005


def test_recurrent_networks_begin_every_transition_without_state() -> None:
    genome = initial_genome(1, 2, rng=np.random.default_rng(0), bias=False, genome_id=1)
    genome = genome.replaced(
        link_innovation=np.array([1, 2, 3]),
        link_source=np.array([1, 1, 2]),
        link_target=np.array([2, 3, 2]),
        link_weight=np.array([0.5, -0.5, 0.7]),
        link_enabled=np.ones(3, bool),
        link_recurrent=np.array([False, False, True]),
    )
    network = PopulationNetwork([genome], shape=(1, 1))
    loss = CandidateTDLoss(CandidateValue(network, DiscreteHeads(2)))
    loss.make_value_estimator(gamma=0.0)
    memory = TransitionMemory(5)
    memory.extend(transitions([1.0, 1.0]))
    learner = TDLearner(network, loss, TDConfig(learning_rate=0.1))
    rehearse(learner, [memory], [generator()], [0], steps=3, batch=2)
    learnt = network.genome(0).link_weight
    assert learnt[0] != np.float32(0.5)
    assert learnt[2] == np.float32(0.7)  # its input was 0


def test_what_cannot_be_learnt_from_is_refused() -> None:
    heads = CandidateHeads(2, [0.0], [1.0])
    genome = initial_genome(1, heads.outputs, rng=np.random.default_rng(0))
    network = PopulationNetwork([genome], shape=(1, 1))
    learner = TDLearner(network, CandidateTDLoss(CandidateValue(network, heads)), ReplayConfig())
    with pytest.raises(ValueError, match="use a WireFittingLoss"):
        ReplayLearner(learner, lambda _: learner.loss, ReplayConfig(), [0])


def test_rewards_are_summed_over_a_horizon_until_the_life_or_the_batch_ends() -> None:
    batch = transitions([1.0, 10.0, 100.0, 1000.0, 10_000.0])
    batch["next", "done"] = torch.tensor([False, False, True, False, False]).view(1, -1, 1)
    batch["next", "terminated"] = batch.get(("next", "done")).clone()
    ahead = over_horizon(batch, 2, 0.5)
    # r_t + r_{t+1} / 2, but the life is over after the third and the batch after the fifth.
    assert ahead.get(("next", "reward")).flatten().tolist() == [6.0, 60.0, 100.0, 6000.0, 10_000.0]
    assert ahead.get("steps_to_next_obs").flatten().tolist() == [2, 2, 1, 2, 1]
    assert ahead.get(("next", "terminated")).flatten().tolist() == [False, True, True, False, False]
    expected = [10.5, 100.5, 100.5, 10_000.5, 10_000.5]
    assert ahead.get(("next", "observation")).flatten().tolist() == expected
    assert torch.equal(ahead.get("observation"), batch.get("observation"))


def test_a_horizon_of_one_tick_changes_nothing() -> None:
    batch = transitions([1.0, 2.0, 3.0])
    batch["next", "done"] = torch.zeros(1, 3, 1, dtype=torch.bool)
    ahead = over_horizon(batch, 1, 0.9)
    for name in ("observation", "reward", "terminated"):
        assert torch.equal(ahead.get(("next", name)), batch.get(("next", name)))


@pytest.mark.parametrize("ended", [True, False])
def test_no_reward_reaches_from_idle_ticks_or_another_genome_into_a_life(ended: bool) -> None:
    batch = transitions([1.0, 10.0, 100.0, 1000.0, 10_000.0])
    batch["genome_id"][0, :, 0] = torch.tensor([7, 7, -1, -1, 8])
    batch["next", "done"] = torch.tensor([False, ended, False, False, False]).view(1, -1, 1)
    ahead = over_horizon(batch, 5, 0.5)
    memory = TransitionMemory(10)
    memory.extend(ahead)
    assert set(drawn(memory)) == {1.0 + 5.0, 10.0, 10_000.0}
    assert ahead.get("steps_to_next_obs").flatten().tolist() == [2, 1, 2, 1, 1]


@given(data=st.data(), ticks=st.integers(1, 9), every=st.integers(1, 4))
def test_a_horizon_sums_what_a_loop_sums(data: st.DataObject, ticks: int, every: int) -> None:
    length = data.draw(st.integers(1, 7))
    done = data.draw(st.lists(st.booleans(), min_size=length, max_size=length))
    rewards = [float(3**tick) for tick in range(length)]
    batch = transitions(rewards)
    batch["next", "done"] = torch.tensor(done).view(1, -1, 1)
    ahead = over_horizon(batch, ticks, 0.5, keep_every=every)
    assert ahead.shape == (1, len(range(0, length, every)))
    for place, start in enumerate(range(0, length, every)):
        total, tick = rewards[start], start
        while not done[tick] and tick + 1 < min(length, start + ticks):
            tick += 1
            total += 0.5 ** (tick - start) * rewards[tick]
        assert ahead.get(("next", "reward"))[0, place].item() == pytest.approx(total)
        assert ahead.get("steps_to_next_obs")[0, place].item() == tick - start + 1
