"""How outputs are read, how a candidate is taken, and what a newborn starts with."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_torch.genome import initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    CandidateValue,
    DiscreteHeads,
    EpsilonGreedy,
    Heads,
)
from neatq_torch.network import PopulationNetwork


def test_outputs_are_k_actions_then_k_values() -> None:
    heads = CandidateHeads(2, [-1.0, 0.0], [1.0, 10.0])
    candidates, values = heads(torch.tensor([0.0, 0.5, 1.0, 0.1, 0.7, 0.3]))
    torch.testing.assert_close(candidates, torch.tensor([[-1.0, 5.0], [1.0, 1.0]]))
    torch.testing.assert_close(values, torch.tensor([0.7, 0.3]))
    assert heads.outputs == 6


def test_a_single_candidate_needs_no_value_output() -> None:
    heads = CandidateHeads(1, [-1.0], [1.0])
    candidates, values = heads(torch.tensor([[0.25]]))
    assert heads.outputs == 1
    assert candidates.tolist() == [[[-0.5]]]
    assert values.tolist() == [[0.0]]


def test_outputs_beyond_the_unit_range_are_clipped_to_the_bounds() -> None:
    candidates, _ = CandidateHeads(1, [-1.0], [1.0])(torch.tensor([7.0]))
    assert candidates.item() == 1.0


def test_discrete_actions_are_numbers_and_every_output_is_a_value() -> None:
    heads = DiscreteHeads(3)
    candidates, values = heads(torch.tensor([[0.1, 0.7, -2.0]]))
    assert heads.outputs == heads.candidates == 3
    assert candidates.tolist() == [[[0.0], [1.0], [2.0]]]
    torch.testing.assert_close(values, torch.tensor([[0.1, 0.7, -2.0]]))


def test_values_are_scaled_to_their_range_and_actions_are_not() -> None:
    output = torch.tensor([0.25, 0.5, 0.0, 1.0])
    candidates, values = CandidateHeads(2, [0.0], [1.0], value_range=(-100.0, 20.0))(output)
    assert candidates.flatten().tolist() == [0.25, 0.5]
    assert values.tolist() == [-100.0, 20.0]
    discrete = DiscreteHeads(4, value_range=(-100.0, 20.0))
    assert discrete.values(output).tolist() == [-70.0, -40.0, -100.0, 20.0]


@pytest.mark.parametrize("heads", [CandidateHeads(2, [0.0], [1.0]), DiscreteHeads(4)])
def test_values_of_the_plain_range_are_the_outputs_themselves(heads: Heads) -> None:
    output = torch.rand(5, 4)
    assert heads.values(output).untyped_storage().data_ptr() == output.untyped_storage().data_ptr()


@pytest.mark.parametrize("bounds", [(1.0, 1.0), (0.0, np.inf), (2.0, -2.0), (np.nan, 1.0)])
def test_value_ranges_that_hold_nothing_are_refused(bounds: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="value_range: expected finite low < high"):
        DiscreteHeads(2, value_range=bounds)


def test_a_policy_with_discrete_actions_takes_the_best_and_knows_its_value() -> None:
    genome = initial_genome(1, 3, rng=np.random.default_rng(0), bias=False, activation="identity")
    genome = genome.with_weights([0.1, 0.4, -0.2])
    network = PopulationNetwork([genome], shape=(1, 1))
    heads = DiscreteHeads(3, value_range=(-1.0, 9.0))
    tick = TensorDict({"observation": torch.tensor([[[2.0]]])}, (1, 1))
    CandidatePolicy(network, heads, greedy((1, 1), epsilon=0.0))(tick)
    assert tick["candidate_index"].tolist() == [[1]]
    assert tick["action"].tolist() == [[[1.0]]]
    torch.testing.assert_close(tick["chosen_action_value"], torch.tensor([[[7.0]]]))
    found = CandidateValue(network, heads)(tick.select("observation"))
    torch.testing.assert_close(found["action_value"], torch.tensor([[[1.0, 7.0, -5.0]]]))


def test_heads_that_do_not_fit_the_network_are_refused() -> None:
    genome = initial_genome(3, 4, rng=np.random.default_rng(0))
    network = PopulationNetwork([genome], shape=(1, 1))
    with pytest.raises(ValueError, match="2 candidates of 2 actions need 6 network outputs"):
        heads = CandidateHeads(2, [0.0, 0.0], [1.0, 1.0])
        CandidatePolicy(network, heads, EpsilonGreedy((1, 1), seeds=[0]))


def greedy(shape: tuple[int, int], **settings: float) -> EpsilonGreedy:
    seeds = range(shape[0])
    return EpsilonGreedy(shape, seeds=seeds, **settings)  # pyright: ignore[reportArgumentType]


def test_without_exploration_the_best_candidate_is_taken_and_of_equals_the_first() -> None:
    values = torch.tensor([[[0.1, 0.9, 0.3], [0.5, 0.5, 0.5]]])
    assert greedy((1, 2), epsilon=0.0)(values).tolist() == [[1, 0]]
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert greedy((1, 2), epsilon=1.0)(values).tolist() == [[1, 0]]


def test_without_epsilon_not_even_the_smallest_chance_explores() -> None:
    explore, values = greedy((1, 2), epsilon=0.0), torch.tensor([[[0.1, 0.9], [0.9, 0.1]]])
    explore(values)
    explore._chance.zero_()
    assert [explore(values).tolist() for _ in range(20)] == [[[1, 0]]] * 20


def test_heads_without_a_candidate_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1 candidate, got 0"):
        CandidateHeads(0, [0.0], [1.0])


def test_exploration_takes_all_candidates_alike_at_the_rate_epsilon() -> None:
    explore, values = greedy((4, 50), epsilon=0.2), torch.zeros(4, 50, 5)
    values[..., 0] = 1.0
    taken = torch.stack([explore(values) for _ in range(500)])
    shares = torch.bincount(taken.flatten(), minlength=5) / taken.numel()
    # 100,000 draws: the standard error of a share of 0.04 is 0.0006.
    assert shares[1:].tolist() == pytest.approx([0.04] * 4, abs=0.0025)


def test_held_exploration_lasts_n_ticks_with_probability_one_over_n_times_n_plus_one() -> None:
    explore, values = greedy((1, 200), epsilon=0.05, max_hold_ticks=30), torch.zeros(1, 200, 2)
    lengths, before = [], torch.zeros(200, dtype=torch.long)
    for _ in range(1500):
        explore(values)
        until = explore.until_tick[0].clone()
        started = until != before
        lengths += (until[started] - explore.tick + 1).tolist()
        before = until
    counts = np.bincount(lengths, minlength=31)
    longer = counts[2:].sum()
    assert counts[2] / longer == pytest.approx((1 / 6) / (1 / 2), abs=0.03)
    assert counts[3] / longer == pytest.approx((1 / 12) / (1 / 2), abs=0.03)
    assert counts[30] / longer == pytest.approx((1 / 30) / (1 / 2), abs=0.02)
    assert max(lengths) == 30


def test_a_run_takes_the_same_candidate_until_it_ends() -> None:
    explore, values = greedy((1, 1), epsilon=0.5, max_hold_ticks=10), torch.zeros(1, 1, 9)
    held = None
    for _ in range(300):
        running = explore.until_tick.item() > explore.tick
        taken = explore(values).item()
        if running:
            assert taken == held
        held = taken


def test_an_arena_explores_in_the_same_way_whatever_stands_beside_it() -> None:
    values = torch.zeros(3, 4, 7)
    together = EpsilonGreedy((3, 4), seeds=[5, 6, 7], epsilon=0.7, max_hold_ticks=5)
    alone = EpsilonGreedy((1, 4), seeds=[6], epsilon=0.7, max_hold_ticks=5)
    for _ in range(100):
        assert torch.equal(together(values)[1:2], alone(values[1:2]))


def test_a_newborn_ends_the_run_of_its_predecessor() -> None:
    explore = greedy((1, 2), epsilon=1.0, max_hold_ticks=100)
    for _ in range(20):
        explore(torch.zeros(1, 2, 3))
    explore.until_tick.fill_(27)
    explore.reset(torch.tensor([[True, False]]))
    assert explore.until_tick.tolist() == [[0, 27]]


def recurrent_policy(*, genome_ids: tuple[int, int] = (0, 0), **settings: Any) -> CandidatePolicy:
    genome = initial_genome(1, 1, rng=np.random.default_rng(0), bias=False)
    genome = genome.replaced(
        link_innovation=np.array([1, 2]),
        link_source=np.array([1, 2]),
        link_target=np.array([2, 2]),
        link_weight=np.array([1.0, 2.0]),
        link_enabled=np.ones(2, bool),
        link_recurrent=np.array([False, True]),
    )
    genomes = [genome.replaced(genome_id=one) for one in genome_ids]
    network = PopulationNetwork(genomes, shape=(1, 2))
    heads = CandidateHeads(1, [0.0], [1.0])
    exploration = greedy((1, 2), epsilon=0.0)
    return CandidatePolicy(network, heads, exploration, **settings)


def test_the_policy_keeps_recurrent_state_and_a_newborn_starts_without() -> None:
    policy = recurrent_policy()
    rows = TensorDict({"observation": torch.ones(1, 2, 1)}, (1, 2))
    first = policy(rows.clone())
    second = policy(rows.clone())
    assert not torch.equal(first["action"], second["action"])
    assert torch.equal(second["network_state"], first["next", "network_state"])
    policy.reset(torch.tensor([[True, False]]))
    third = policy(rows.clone())
    assert torch.equal(third["action"][0, 0], first["action"][0, 0])
    assert not torch.equal(third["action"][0, 1], first["action"][0, 1])
    assert third["genome_id"].tolist() == [[[0], [0]]]


def test_a_policy_that_forgets_starts_afresh_where_an_episode_begins() -> None:
    policy = recurrent_policy(forgets=True)
    policy.exploration.until_tick.fill_(9)
    rows = TensorDict({"observation": torch.ones(1, 2, 1)}, (1, 2))
    ticks = [policy(rows.clone().set("step_count", torch.tensor([[[0], [1]]])))]
    assert policy.exploration.until_tick.tolist() == [[0, 9]]
    for step in (1, 0):
        ticks.append(policy(rows.clone().set("step_count", torch.tensor([[[step], [2]]]))))
    assert not torch.equal(ticks[1]["action"][0, 0], ticks[0]["action"][0, 0])
    assert torch.equal(ticks[2]["action"][0, 0], ticks[0]["action"][0, 0])
    assert not ticks[2]["network_state"][0, 0].any()
    assert ticks[2]["network_state"][0, 1].any()


@pytest.mark.parametrize("double", [False, True])
def test_a_second_activation_with_the_observation_before_moves_the_state_alone(
    double: bool,
) -> None:
    policy = recurrent_policy(double_activation=double)
    first, second = (
        policy(TensorDict({"observation": torch.full((1, 2, 1), value)}, (1, 2)))
        for value in (0.5, 1.0)
    )

    def activated(observation: float, state: float) -> float:
        return 1 / (1 + np.exp(-(observation + 2 * state)))

    state = activated(0.5, 0.0)
    assert first["action"][0, 0].item() == pytest.approx(state)
    state = activated(0.0, state) if double else state  # nothing was observed before
    assert first["next", "network_state"][0, 0, 0].item() == pytest.approx(state)
    state = activated(1.0, state)
    assert second["action"][0, 0].item() == pytest.approx(state)
    state = activated(0.5, state) if double else state
    assert second["next", "network_state"][0, 0, 0].item() == pytest.approx(state)


def test_slots_that_do_not_live_act_for_nobody() -> None:
    policy = recurrent_policy(genome_ids=(3, 4))
    tick = TensorDict({"observation": torch.ones(1, 2, 1)}, (1, 2))
    assert policy(tick.clone())["genome_id"].tolist() == [[[3], [4]]]
    tick["living"] = torch.tensor([[[True], [False]]])
    assert policy(tick)["genome_id"].tolist() == [[[3], [-1]]]
    assert policy.network.genome_id.tolist() == [[3, 4]]


def test_a_policy_goes_on_from_its_state_and_modules_around_it_get_torchs_own() -> None:
    policy, again = recurrent_policy(double_activation=True), recurrent_policy()
    rows = TensorDict({"observation": torch.ones(1, 2, 1)}, (1, 2))
    policy(rows.clone())
    again.double_activation = True
    again.load_state_dict(policy.state_dict())
    assert torch.equal(again(rows.clone())["action"], policy(rows.clone())["action"])
    assert torch.equal(again.memory, policy.memory)
    around = torch.nn.ModuleList([policy]).state_dict()
    assert list(around) == ["0.network.weight", "0.network._extra_state"]


def test_an_exploration_begun_anew_is_a_new_one() -> None:
    values, settings = torch.zeros(2, 3, 7), {"epsilon": 0.6, "max_hold_ticks": 5}
    explore = EpsilonGreedy((2, 3), seeds=[5, 6], **settings)  # pyright: ignore[reportArgumentType]
    fresh = EpsilonGreedy((2, 3), seeds=[8, 9], **settings)  # pyright: ignore[reportArgumentType]
    for _ in range(100):
        explore(values)
    explore.begin([8, 9])
    for _ in range(100):
        assert torch.equal(explore(values), fresh(values))


def test_a_slot_with_a_seed_of_its_own_explores_as_the_only_one_of_an_arena() -> None:
    values, settings = torch.zeros(2, 3, 7), {"epsilon": 0.6, "max_hold_ticks": 5}
    explore = EpsilonGreedy((2, 3), seeds=[0, 1], **settings)  # pyright: ignore[reportArgumentType]
    seeds = [[5, 2**63 + 11, 7], [7, 0, 123456789]]
    explore.begin(seeds)
    flat = EpsilonGreedy((6, 1), seeds=[*seeds[0], *seeds[1]], **settings)  # pyright: ignore[reportArgumentType]
    for _ in range(150):
        assert torch.equal(explore(values).flatten(), flat(values.view(6, 1, 7)).flatten())
    assert torch.equal(explore.until_tick.flatten(), flat.until_tick.flatten())


@pytest.mark.parametrize("seeds", [[1], [1, 2, 3], [[1, 2, 3]], [[1, 2], [3, 4]], [[1], [2, 3, 4]]])
def test_seeds_for_other_slots_are_refused(seeds: list[int] | list[list[int]]) -> None:
    explore = EpsilonGreedy((2, 3), seeds=[0, 1])
    with pytest.raises(ValueError, match="expected one seed for each arena of"):
        explore.begin(seeds)


def test_what_was_done_keeps_the_name_of_who_did_it_after_a_replacement() -> None:
    rng = np.random.default_rng(0)
    old, new = (initial_genome(2, 6, rng=rng, genome_id=number) for number in (1, 2))
    network = PopulationNetwork([old], shape=(1, 1))
    policy = CandidatePolicy(network, CandidateHeads(2, [0.0] * 2, [1.0] * 2), greedy((1, 1)))
    done = policy(TensorDict({"observation": torch.zeros(1, 1, 2)}, [1, 1]))
    network.replace(0, new)
    assert done["genome_id"].item() == 1
