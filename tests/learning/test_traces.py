"""Q(lambda) with traces: by hand, against TD(0) and the forward view, and to a known Q*."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.genome import Genome, InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    DiscreteHeads,
    Heads,
    TDConfig,
    TDLearner,
    TraceConfig,
    TraceLearner,
)
from neatq_torch.network import PopulationNetwork


def linear(weights: list[list[float]], genome_id: int = 0) -> Genome:
    """Identity outputs, one for each row of weights [actions, inputs], without a bias."""
    values = np.array(weights, np.float32)
    genome = initial_genome(
        values.shape[1],
        values.shape[0],
        rng=np.random.default_rng(0),
        bias=False,
        activation="identity",
        genome_id=genome_id,
    )
    return genome.with_weights(values.ravel())


def grown(genome_id: int, seed: int, *, recurrent: float = 0.0, size: int = 4) -> Genome:
    """Three inputs, two sigmoid outputs, and what mutations have added."""
    rng = np.random.default_rng(seed)
    genome = initial_genome(3, 2, rng=rng, genome_id=genome_id)
    ledger = InnovationLedger.for_genomes([genome])
    config = MutationConfig(add_node_prob=0.8, add_link_prob=0.9, recurrent_link_prob=recurrent)
    for _ in range(size):
        genome = mutate(genome, config, ledger, rng)
    return genome.replaced(genome_id=genome_id)


def tick(
    network: PopulationNetwork,
    state: torch.Tensor,
    action: torch.Tensor,
    reward: torch.Tensor,
    following: torch.Tensor,
    *,
    terminated: bool = False,
    truncated: bool = False,
) -> TensorDict:
    """One transition of every network: states [1, n, inputs], actions and rewards [1, n]."""
    shape = (*network.shape, 1)
    over = torch.full((*shape, 1), terminated)
    batch = {
        "observation": state.unsqueeze(-2),
        "candidate_index": action.unsqueeze(-1),
        "genome_id": network.genome_id[..., None, None].clone(),
        "next": {
            "observation": following.unsqueeze(-2),
            "reward": reward[..., None, None],
            "terminated": over,
            "done": over | truncated,
        },
    }
    return TensorDict(batch, shape)


def one(
    network: PopulationNetwork, s: list[float], a: int, r: float, to: list[float]
) -> TensorDict:
    """One transition of one network."""
    return tick(
        network,
        torch.tensor([[s]]),
        torch.tensor([[a]]),
        torch.tensor([[r]]),
        torch.tensor([[to]]),
    )


def random_tick(network: PopulationNetwork, seed: int) -> TensorDict:
    rng = torch.Generator().manual_seed(seed)
    shape, inputs = network.shape, network.inputs
    return tick(
        network,
        torch.rand(*shape, inputs, generator=rng),
        torch.randint(network.outputs, shape, generator=rng),
        torch.rand(shape, generator=rng),
        torch.rand(*shape, inputs, generator=rng),
    )


def weights_of(network: PopulationNetwork, index: int = 0) -> list[float]:
    return network.genome(index).link_weight.tolist()


def one_link(**settings: float) -> tuple[PopulationNetwork, TraceLearner]:
    """Q(s, 0) = 2 s and Q(s, 1) = s."""
    network = PopulationNetwork([linear([[2.0], [1.0]])], shape=(1, 1))
    config = TraceConfig(learning_rate=0.1, discount=0.9, trace_decay=0.5)
    config = TraceConfig(**{**vars(config), **settings})
    return network, TraceLearner(network, DiscreteHeads(2), config)


def test_two_greedy_ticks_by_hand() -> None:
    network, learner = one_link()
    error = learner.update(one(network, [1.0], 0, 1.0, [3.0]))
    # delta = 1 + 0.9 * 6 - 2 = 4.4; e = (1, 0); w0 = 2 + 0.1 * 4.4
    assert weights_of(network) == pytest.approx([2.44, 1.0])
    assert error.item() == pytest.approx(4.4**2, rel=1e-5)
    learner.update(one(network, [3.0], 0, 0.0, [1.0]))
    # delta = 0.9 * 2.44 - 7.32 = -5.124; e = 0.45 * 1 + 3 = 3.45; w0 = 2.44 - 0.5124 * 3.45
    assert learner.trace[0, :2].tolist() == pytest.approx([3.45, 0.0])
    assert weights_of(network) == pytest.approx([2.44 - 0.5124 * 3.45, 1.0], rel=1e-5)


def test_an_exploratory_action_gets_no_credit_onto_what_came_before() -> None:
    network, learner = one_link()
    learner.update(one(network, [1.0], 0, 1.0, [3.0]))
    learner.update(one(network, [3.0], 1, 0.0, [1.0]))
    # delta = 0.9 * 2.44 - 3 = -0.804; the trace of weight 0 is cut, that of weight 1 begins.
    assert weights_of(network) == pytest.approx([2.44, 1.0 - 0.0804 * 3.0], rel=1e-5)
    learner.update(one(network, [1.0], 0, 0.0, [0.0]))
    # delta = -2.44; e = (1, 0.45 * 3): what followed the exploratory action is its own.
    assert weights_of(network) == pytest.approx([2.44 - 0.244, 0.7588 - 0.244 * 1.35], rel=1e-5)


def test_of_equally_good_actions_each_is_greedy() -> None:
    network, learner = one_link()
    learner.update(one(network, [1.0], 0, 1.0, [0.0]))
    learner.update(one(network, [0.0], 1, 0.0, [0.0]))
    assert learner.trace[0, :2].tolist() == pytest.approx([0.45, 0.0])


@pytest.mark.parametrize("terminated", [True, False])
def test_the_end_of_an_episode_clears_the_trace_and_bootstraps_if_it_is_one_of_time(
    terminated: bool,
) -> None:
    network, learner = one_link()
    end = one(network, [1.0], 0, 1.0, [3.0])
    end["next", "done"] = torch.ones(1, 1, 1, 1, dtype=torch.bool)
    end["next", "terminated"] = torch.full((1, 1, 1, 1), terminated)
    learner.update(end)
    delta = 1 - 2 if terminated else 1 + 0.9 * 6 - 2
    assert weights_of(network) == pytest.approx([2 + 0.1 * delta, 1.0])
    assert not learner.trace.any()


def test_learning_rates_are_in_units_of_the_outputs() -> None:
    network = PopulationNetwork([linear([[0.5], [0.25]])], shape=(1, 1))
    learner = TraceLearner(network, DiscreteHeads(2, value_range=(-100.0, 0.0)), TraceConfig())
    error = learner.update(one(network, [1.0], 0, -1.0, [1.2]))
    # Q(s, 0) = -50, max Q(s') = -40: delta = -1 - 40 + 50 = 9, which is 0.09 of the range.
    assert error.item() == pytest.approx(81.0, rel=1e-5)
    assert weights_of(network) == pytest.approx([0.5 + 0.1 * 0.09, 0.25], rel=1e-5)


@pytest.mark.parametrize("recurrent", [0.0, 1.0])
@pytest.mark.parametrize("heads", [DiscreteHeads(2), CandidateHeads(2, [0.0], [1.0])])
def test_without_decay_it_is_the_td_learner_with_plain_steps(
    heads: Heads, recurrent: float
) -> None:
    rng = np.random.default_rng(0)
    genomes = [grown(i, seed=i, recurrent=recurrent) for i in range(1, 6)]
    if isinstance(heads, CandidateHeads):
        genomes = [initial_genome(3, 4, rng=rng, genome_id=i) for i in range(1, 6)]
    ours, theirs = (PopulationNetwork(genomes, shape=(1, 5)) for _ in range(2))
    loss = CandidateTDLoss(CandidateValue(theirs, heads))
    loss.make_value_estimator(gamma=0.9)
    plain = TDLearner(theirs, loss, TDConfig(learning_rate=0.3))
    config = TraceConfig(learning_rate=0.3, discount=0.9, trace_decay=0.0)
    traces = TraceLearner(ours, heads, config)
    for seed in range(4):
        batch = random_tick(ours, seed)
        batch["candidate_index"] %= 2
        batch["network_state"] = torch.rand(1, 5, 1, ours.state_size)
        batch["next", "network_state"] = torch.rand(1, 5, 1, ours.state_size)
        batch["next", "terminated"][0, seed % 5] = batch["next", "done"][0, seed % 5] = True
        errors = [learner.update(batch.clone()) for learner in (traces, plain)]
        torch.testing.assert_close(errors[0], errors[1])
    torch.testing.assert_close(ours.weight, theirs.weight, rtol=1e-5, atol=1e-6)


def test_small_steps_add_up_to_those_of_the_forward_view() -> None:
    """With frozen weights traces are lambda-returns over greedy actions (Sutton & Barto 1998)."""
    network = PopulationNetwork([grown(1, seed=3)], shape=(1, 1))
    heads, gamma, decay, rate = DiscreteHeads(2), 0.9, 0.7, 1.0
    learner = TraceLearner(
        network, heads, TraceConfig(learning_rate=rate, discount=gamma, trace_decay=decay)
    )
    rng = torch.Generator().manual_seed(5)
    states = torch.rand(9, 1, 1, 3, generator=rng)
    rewards = torch.rand(8, generator=rng).tolist()
    frozen, total = network.weight.detach().clone(), torch.zeros_like(network.weight)
    values = torch.stack([network(state)[0, 0] for state in states])
    actions = values.argmax(-1).tolist()[:8]
    actions[4] = 1 - actions[4]  # explored
    for t, action in enumerate(actions):
        last = t == 7
        step = tick(
            network,
            states[t],
            torch.tensor([[action]]),
            torch.tensor([[rewards[t]]]),
            states[t + 1],
            terminated=last,
        )
        learner.update(step)
        with torch.no_grad():
            total += network.weight - frozen
            network.weight.copy_(frozen)
    values = torch.stack([network(state)[0, 0] for state in states])
    best = values.max(-1).values.tolist()
    expected = torch.zeros_like(total)
    for t, action in enumerate(actions):
        (gradient,) = torch.autograd.grad(values[t, action], network.weight, retain_graph=True)
        returns = lambda_return(t, rewards, best, gamma, decay, cut=4)
        expected += rate * (returns - values[t, action].item()) * gradient
    torch.testing.assert_close(total, expected, rtol=1e-4, atol=1e-5)


def lambda_return(
    start: int, rewards: list[float], best: list[float], gamma: float, decay: float, *, cut: int
) -> float:
    """Mean of the n-step returns, up to the first exploratory action after the start or the end."""
    end = len(rewards)
    last = cut if start < cut else end
    total = 0.0
    for upto in range(start + 1, last + 1):
        n = upto - start
        gains = sum(gamma**i * rewards[start + i] for i in range(n))
        bootstrap = 0.0 if upto == end else gamma**n * best[upto]
        total += decay ** (n - 1) * (1.0 if upto == last else 1 - decay) * (gains + bootstrap)
    return total


def test_traces_do_not_depend_on_the_neighbours_in_any_bit() -> None:
    genomes = [grown(i, seed=i, size=2 + i) for i in range(1, 8)]
    crowd = PopulationNetwork(genomes, shape=(1, 7))
    alone = PopulationNetwork(genomes[3:4], shape=(1, 1))
    config = TraceConfig(learning_rate=0.3, discount=0.9, trace_decay=0.8)
    many = TraceLearner(crowd, DiscreteHeads(2), config)
    single = TraceLearner(alone, DiscreteHeads(2), config)
    for seed in range(20):
        batch = random_tick(crowd, seed)
        many.update(batch)
        single.update(batch[:, 3:4].clone())
    assert crowd.genome(3).link_weight.tobytes() == alone.genome(0).link_weight.tobytes()
    assert alone.genome(0).link_weight.tobytes() != genomes[3].link_weight.tobytes()


def test_several_ticks_in_a_batch_are_learnt_one_by_one() -> None:
    genomes = [grown(i, seed=i) for i in range(1, 4)]
    together, stepwise = (PopulationNetwork(genomes, shape=(1, 3)) for _ in range(2))
    ticks = [random_tick(together, seed) for seed in range(6)]
    batch = torch.cat(ticks, -1)  # pyright: ignore[reportArgumentType, reportCallIssue]
    TraceLearner(together, DiscreteHeads(2)).update(batch)  # pyright: ignore[reportArgumentType]
    learner = TraceLearner(stepwise, DiscreteHeads(2))
    for batch in ticks:
        learner.update(batch)
    assert torch.equal(together.weight, stepwise.weight)


def test_transitions_of_another_genome_change_neither_weights_nor_traces() -> None:
    network = PopulationNetwork([grown(i, seed=i) for i in range(1, 4)], shape=(1, 3))
    learner = TraceLearner(network, DiscreteHeads(2))
    learner.update(random_tick(network, 0))
    weight, trace = network.weight.detach().clone(), learner.trace.clone()
    idle = random_tick(network, 1)
    idle["genome_id"][0, 1] = -1
    idle["next", "done"][0, 1] = True
    error = learner.update(idle)
    assert torch.equal(network.weight[1], weight[1])
    assert torch.equal(learner.trace[1], trace[1])
    assert error[0, 1] == 0
    assert (network.weight != weight).any(1).tolist() == [True, False, True]


def test_a_step_that_is_not_finite_is_not_taken_and_clears_the_trace() -> None:
    network = PopulationNetwork([grown(i, seed=i) for i in range(1, 3)], shape=(1, 2))
    learner = TraceLearner(network, DiscreteHeads(2))
    learner.update(random_tick(network, 0))
    weight = network.weight.detach().clone()
    batch = random_tick(network, 1)
    batch["next", "reward"][0, 0] = torch.inf
    learner.update(batch)
    assert torch.equal(network.weight[0], weight[0])
    assert not learner.trace[0].any()
    assert not torch.equal(network.weight[1], weight[1])
    learner.update(random_tick(network, 2))
    assert not torch.equal(network.weight[0], weight[0])
    assert torch.isfinite(network.weight).all()


def test_a_newborn_inherits_no_trace_and_may_need_more_columns() -> None:
    network = PopulationNetwork([grown(i, seed=i) for i in range(1, 3)], shape=(1, 2))
    learner = TraceLearner(network, DiscreteHeads(2))
    learner.update(random_tick(network, 0))
    columns, trace = network.weight.shape[1], learner.trace.clone()
    newborn = grown(9, seed=9, size=60)
    network.replace(1, newborn)
    assert network.weight.shape[1] > columns
    learner.reset(torch.tensor([[False, True]]))
    assert torch.equal(learner.trace[0, :columns], trace[0])
    assert not learner.trace[1].any()
    batch = random_tick(network, 1)
    learner.update(batch)
    fresh = PopulationNetwork([newborn], shape=(1, 1))
    TraceLearner(fresh, DiscreteHeads(2)).update(batch[:, 1:].clone())
    assert network.genome(1).link_weight.tobytes() == fresh.genome(0).link_weight.tobytes()


def test_a_restored_learner_goes_on_bit_for_bit() -> None:
    genomes = [grown(i, seed=i) for i in range(1, 3)]
    network = PopulationNetwork(genomes, shape=(1, 2))
    learner = TraceLearner(network, DiscreteHeads(2))
    learner.learning_rate[1] = 0.02
    learner.update(random_tick(network, 0))
    again = PopulationNetwork(genomes, shape=(1, 2))
    again.load_weights(network.weight.detach())
    restored = TraceLearner(again, DiscreteHeads(2))
    restored.load_state_dict({name: value.clone() for name, value in learner.state_dict().items()})
    for seed in range(1, 4):
        learner.update(random_tick(network, seed))
        restored.update(random_tick(again, seed))
    assert torch.equal(network.weight, again.weight)
    assert torch.equal(learner.trace, restored.trace)


def test_it_finds_the_known_values_of_a_chain() -> None:
    """Right costs 1 and ends beyond the third state; left costs 1 and leads back to the first."""
    genome = linear([[0.0] * 3] * 2)
    network = PopulationNetwork([genome], shape=(1, 1))
    learner = TraceLearner(
        network, DiscreteHeads(2), TraceConfig(learning_rate=0.1, discount=1.0, trace_decay=0.6)
    )
    rng, states = np.random.default_rng(0), torch.eye(3)[:, None, None]
    for _ in range(400):
        state = int(rng.integers(3))
        for _ in range(50):
            values = network(states[state])[0, 0]
            action = int(rng.integers(2)) if rng.random() < 0.5 else int(values.argmax())
            following = state + 1 if action == 1 else 0
            step = tick(
                network,
                states[state],
                torch.tensor([[action]]),
                torch.tensor([[-1.0]]),
                states[min(following, 2)],
                terminated=following == 3,
            )
            learner.update(step)
            state = following
            if state == 3:
                break
    # Q*(s, right) = -(3 - s), Q*(s, left) = -1 - 3.
    expected = [-4.0, -4.0, -4.0, -3.0, -2.0, -1.0]
    assert weights_of(network) == pytest.approx(expected, abs=0.05)


def test_the_learning_rate_falls_with_the_episodes_of_each_robot() -> None:
    genomes = [grown(i, seed=i) for i in range(1, 4)]
    falling, plain = (PopulationNetwork(genomes, shape=(1, 3)) for _ in range(2))
    config = TraceConfig(learning_rate=0.3, anneal=True)
    learner = TraceLearner(falling, DiscreteHeads(2), config, episodes=7)
    constant = TraceLearner(plain, DiscreteHeads(2), TraceConfig(learning_rate=0.3))
    for seed, episodes in enumerate([(0, 0, 0), (0, 3, 7), (1, 6, 7)]):
        batch = random_tick(falling, seed)
        episode = torch.tensor(episodes)
        batch["episode"] = episode.view(1, 3, 1, 1)
        learner.update(batch)
        constant.learning_rate = (0.3 * (1 - episode.double() / 7)).float()
        constant.update(batch)
        assert torch.equal(learner.learning_rate, constant.learning_rate)
        assert torch.equal(falling.weight, plain.weight)


@pytest.mark.parametrize("anneal", [False, True])
def test_a_learner_whose_robots_are_all_newborn_is_a_fresh_one(anneal: bool) -> None:
    genomes = [grown(i, seed=i, size=3 * i) for i in range(1, 4)]
    used = PopulationNetwork([grown(i, seed=i) for i in range(4, 7)], shape=(1, 3))
    config = TraceConfig(learning_rate=0.3, discount=0.9, anneal=anneal)
    learner = TraceLearner(used, DiscreteHeads(2), config, episodes=5)

    def learn(learner: TraceLearner, seed: int, episode: int) -> None:
        batch = random_tick(learner.network, seed)
        batch["episode"] = torch.full((1, 3, 1, 1), episode)
        learner.update(batch)

    for seed in range(3):
        learn(learner, seed, 4)
    for slot, genome in enumerate(genomes):
        used.replace(slot, genome)
    learner.reset(torch.ones(1, 3, dtype=torch.bool))
    own = PopulationNetwork(genomes, shape=(1, 3))
    fresh = TraceLearner(own, DiscreteHeads(2), config, episodes=5)
    assert torch.equal(learner.learning_rate, fresh.learning_rate)
    assert not learner.trace.any()
    for seed in range(3, 6):
        learn(learner, seed, seed - 3)
        learn(fresh, seed, seed - 3)
        for one, two in zip(used.genomes(), fresh.network.genomes(), strict=True):
            assert one.link_weight.tobytes() == two.link_weight.tobytes()


def test_a_single_candidate_is_refused() -> None:
    network = PopulationNetwork([linear([[1.0]])], shape=(1, 1))
    with pytest.raises(ValueError, match="expected at least 2 candidates"):
        TraceLearner(network, CandidateHeads(1, [0.0], [1.0]))
