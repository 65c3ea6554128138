"""Networks against a per-node oracle in pure Python, and the life of their places."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from neatq_torch.genome import (
    ACTIVATIONS,
    Genome,
    GenomeError,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    initial_genome,
    mutate,
)
from neatq_torch.network import Evaluation, PopulationNetwork
from neatq_torch.network.plan import compile_genome

Values = dict[int, float]

# Many tests look at one call of a recurrent network, on purpose.
pytestmark = pytest.mark.filterwarnings("ignore:these networks keep a state")

GROWTH = MutationConfig(
    add_node_prob=0.4, add_link_prob=0.8, recurrent_link_prob=0.4, toggle_enable_prob=0.3
)


def grown(seed: int, mutations: int, inputs: int = 3, outputs: int = 2) -> Genome:
    """A genome after many structural mutations, with a random activation at each node."""
    rng = np.random.default_rng(seed)
    genome = initial_genome(inputs, outputs, rng=rng, genome_id=seed)
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(mutations):
        genome = mutate(genome, GROWTH, ledger, rng)
    activation = rng.integers(len(ACTIVATIONS), size=genome.node_id.size)
    return genome.replaced(node_activation=activation)


def sigmoid(x: float) -> float:
    return 1 / (1 + math.exp(-x))


FUNCTIONS: dict[str, tuple[Callable[[float], float], Callable[[float, float], float]]] = {
    "identity": (lambda x: x, lambda x, y: 1.0),
    "sigmoid": (sigmoid, lambda x, y: y * (1 - y)),
    "steep_sigmoid": (lambda x: sigmoid(4.9 * x), lambda x, y: 4.9 * y * (1 - y)),
    "tanh": (math.tanh, lambda x, y: 1 - y * y),
    "relu": (lambda x: max(x, 0.0), lambda x, y: float(x > 0)),
}


class Oracle:
    """One network, node by node in Python floats: values, and gradients by the chain rule."""

    def __init__(self, genome: Genome, evaluation: Evaluation) -> None:
        self.genome = genome
        self.kind = dict(zip(genome.node_id.tolist(), genome.node_kind.tolist(), strict=True))
        names = [ACTIVATIONS[code] for code in genome.node_activation]
        self.function = dict(zip(genome.node_id.tolist(), names, strict=True))
        self.into: dict[int, list[tuple[int, int, bool]]] = {node: [] for node in self.kind}
        for link in np.flatnonzero(genome.link_enabled).tolist():
            source, target = int(genome.link_source[link]), int(genome.link_target[link])
            sensor = self.kind[source] in (NodeKind.INPUT, NodeKind.BIAS)
            delayed = bool(genome.link_recurrent[link]) and evaluation == "settle"
            if evaluation == "synchronous":
                delayed = not sensor
            self.into[target].append((link, source, delayed))

    def call(self, x: Sequence[float], before: Mapping[int, float]) -> tuple[Values, Values]:
        """Values and sums of all nodes for observations `x` and the values of the call before."""
        values = dict(zip(self.genome.input_ids.tolist(), x, strict=True))
        values |= {node: 1.0 for node, kind in self.kind.items() if kind == NodeKind.BIAS}
        sums: Values = {}

        def value(node: int) -> float:
            if node not in values:
                sums[node] = sum(
                    float(self.genome.link_weight[link])
                    * (before.get(source, 0.0) if delayed else value(source))
                    for link, source, delayed in self.into[node]
                )
                values[node] = FUNCTIONS[self.function[node]][0](sums[node])
            return values[node]

        for node in self.kind:
            value(node)
        return values, sums

    def gradient(
        self, values: Values, sums: Values, before: Mapping[int, float], seeds: Values
    ) -> list[float]:
        """Derivative of sum(seed * output) with respect to each link's weight, in one call."""
        gradient = [0.0] * self.genome.link_weight.size

        def push(node: int, amount: float) -> None:
            # One path at a time: slow, and plainly the chain rule.
            if node not in sums:
                return
            amount *= FUNCTIONS[self.function[node]][1](sums[node], values[node])
            for link, source, delayed in self.into[node]:
                gradient[link] += amount * (before.get(source, 0.0) if delayed else values[source])
                if not delayed:
                    push(source, amount * float(self.genome.link_weight[link]))

        for node, seed in seeds.items():
            push(node, seed)
        return gradient


def link_gradient(network: PopulationNetwork, index: int, evaluation: Evaluation) -> np.ndarray:
    """The gradient of each enabled link of a genome."""
    assert network.weight.grad is not None
    plan = compile_genome(network.genome(index), evaluation)
    return network.weight.grad[index].numpy()[plan.column]


def compare_with_oracle(genomes: Sequence[Genome], evaluation: Evaluation) -> PopulationNetwork:
    """Compare outputs and gradients of the third call, whose state comes from the two before."""
    network = PopulationNetwork(genomes, evaluation=evaluation).double()
    rng = np.random.default_rng(len(genomes))
    observations, seed = (
        rng.normal(size=(3, len(genomes), network.inputs)),
        rng.normal(size=(len(genomes), 2)),
    )
    state, last = network.initial_state(), np.empty(0)
    for observation in observations:
        network.weight.grad = None
        output, state = network.step(torch.from_numpy(observation), state.detach())
        (output * torch.from_numpy(seed)).sum().backward()
        last = output.detach().numpy()
    for index, genome in enumerate(genomes):
        oracle, before, after = Oracle(genome, evaluation), {}, ({}, {})
        for observation in observations:
            before = after[0]
            after = oracle.call(observation[index].tolist(), before)
        outputs = genome.output_ids.tolist()
        np.testing.assert_allclose(last[index], [after[0][n] for n in outputs], atol=1e-12)
        wanted = oracle.gradient(*after, before, dict(zip(outputs, seed[index], strict=True)))
        found = link_gradient(network, index, evaluation)
        wanted = np.array(wanted)[genome.link_enabled]
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)
    return network


@settings(max_examples=60)
@given(
    seeds=st.lists(st.integers(0, 10**6), min_size=1, max_size=4, unique=True),
    mutations=st.integers(0, 25),
    evaluation=st.sampled_from(["settle", "synchronous"]),
)
def test_outputs_state_and_gradients_equal_the_oracle(
    seeds: list[int], mutations: int, evaluation: Evaluation
) -> None:
    compare_with_oracle([grown(seed, mutations) for seed in seeds], evaluation)


@pytest.mark.parametrize("evaluation", ["settle", "synchronous"])
def test_any_two_links_that_the_rules_allow_have_a_weight_each(evaluation: Evaluation) -> None:
    genomes = compare_with_oracle(every_pair_of_links(), evaluation).genomes()
    # Of 48 links 1128 pairs; 182 of them with a forward link to itself, 6 more are cycles of two.
    assert len(genomes) == 940
    for one in genomes:
        assert one.link_weight.tolist() == [0.5, 0.25]


def every_pair_of_links() -> list[Genome]:
    """A genome for each two links between an input, a bias, two outputs and two hidden nodes."""
    kinds = np.array([0, 1, 2, 2, 3, 3])
    assert [NodeKind(kind).name for kind in kinds[[0, 1, 2, 4]]] == [
        *("INPUT", "BIAS", "OUTPUT", "HIDDEN")
    ]
    ends = itertools.product(range(1, 7), range(3, 7), (False, True))
    base, genomes = initial_genome(1, 2, rng=np.random.default_rng(0)), []
    for pair in itertools.combinations(ends, 2):
        source, target, recurrent = zip(*pair, strict=True)
        with contextlib.suppress(GenomeError):  # a cycle of forward links
            genomes.append(
                base.replaced(
                    node_id=np.arange(1, 7),
                    node_kind=kinds,
                    node_activation=np.array([0, 0, 3, 1, 2, 3]),
                    link_innovation=np.array([1, 2]),
                    link_source=np.array(source),
                    link_target=np.array(target),
                    link_weight=np.array([0.5, 0.25]),
                    link_enabled=np.ones(2, bool),
                    link_recurrent=np.array(recurrent),
                )
            )
    return genomes


def test_absent_and_disabled_links_have_no_weight_and_no_gradient() -> None:
    genome = initial_genome(3, 2, rng=np.random.default_rng(0))
    enabled = np.array([True, True, False, True] * 2)
    network = PopulationNetwork([genome.replaced(link_enabled=enabled)])
    network(torch.ones(1, 3)).sum().backward()
    assert network.weight.grad is not None
    assert int((network.weight.grad != 0).sum()) == 6
    assert int((network.weight != 0).sum()) <= 6


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), mutations=st.integers(0, 30))
def test_weights_come_back_bit_for_bit(seed: int, mutations: int) -> None:
    genomes = [grown(seed + i, mutations + i) for i in range(3)]
    network = PopulationNetwork(genomes)
    assert all(a.to_json() == b.to_json() for a, b in zip(genomes, network.genomes(), strict=True))


def test_learnt_weights_reach_the_genes_of_their_own_links() -> None:
    genome = grown(3, 20)
    network = PopulationNetwork([genome])
    learnt = genome.with_weights(np.arange(genome.link_weight.size) / 8)
    network.replace(0, learnt)
    changed = network.genome(0)
    enabled = genome.link_enabled
    np.testing.assert_array_equal(changed.link_weight[enabled], learnt.link_weight[enabled])


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), rounds=st.integers(1, 12))
def test_a_network_with_replacements_equals_one_compiled_afresh(seed: int, rounds: int) -> None:
    rng = np.random.default_rng(seed)
    genomes = [grown(seed + i, 2) for i in range(4)]
    network = PopulationNetwork(genomes)
    weight = network.weight
    for number in range(rounds):
        place = int(rng.integers(4))
        genomes[place] = grown(seed + 100 + number, int(rng.integers(40)))
        network.replace(place, genomes[place])
    assert network.weight is weight
    x = torch.from_numpy(rng.normal(size=(4, 5, 3)).astype(np.float32))
    torch.testing.assert_close(network(x), PopulationNetwork(genomes)(x), rtol=0, atol=1e-6)
    assert network.genome_id.tolist() == [genome.genome_id for genome in genomes]


def test_replacing_one_genome_leaves_all_others_bit_for_bit() -> None:
    network = PopulationNetwork([grown(i, 5) for i in range(5)])
    x = torch.rand(5, 3, generator=torch.Generator().manual_seed(1))
    before, row = network(x), network.weight[:2].clone()
    network.replace(2, grown(77, 5))
    after = network(x)
    others = [0, 1, 3, 4]
    assert torch.equal(before[others], after[others])
    assert torch.equal(row, network.weight[:2])
    assert not torch.equal(before[2], after[2])


def test_a_network_that_gives_nan_changes_no_other() -> None:
    network = PopulationNetwork([grown(i, 15) for i in range(4)])
    x = torch.rand(4, 3)
    before = network(x)
    with torch.no_grad():
        network.weight[1] = torch.nan
    after = network(x)
    assert torch.equal(before[[0, 2, 3]], after[[0, 2, 3]])
    after.sum().backward()
    assert network.weight.grad is not None
    assert torch.isfinite(network.weight.grad[[0, 2, 3]]).all()


def test_replacing_between_forward_and_backward_is_refused() -> None:
    network = PopulationNetwork([grown(i, 15) for i in range(3)])
    output = network(torch.rand(3, 3)).sum()
    network.replace(0, grown(9, 0))
    with pytest.raises(RuntimeError, match="inplace operation"):
        output.backward()


def test_any_batch_of_observations_gives_what_single_ones_give() -> None:
    network = PopulationNetwork([grown(i, 9) for i in range(6)], shape=(2, 3))
    x = torch.rand(2, 3, 4, 7, 3)
    whole = network(x)
    assert whole.shape == (2, 3, 4, 7, 2)
    torch.testing.assert_close(whole[:, :, 1, 2], network(x[:, :, 1, 2]))


def test_a_recurrent_link_carries_the_value_of_the_call_before() -> None:
    base = initial_genome(1, 1, rng=np.random.default_rng(0), activation="identity", bias=False)
    genome = base.replaced(
        link_innovation=np.array([1, 2]),
        link_source=np.array([1, 2]),
        link_target=np.array([2, 2]),
        link_weight=np.array([1.0, 0.5]),
        link_enabled=np.array([True, True]),
        link_recurrent=np.array([False, True]),
    )
    network = PopulationNetwork([genome])
    state, outputs = network.initial_state(), []
    for x in (1.0, 0.0, 0.0):
        output, state = network.step(torch.tensor([[x]]), state)
        outputs.append(output.item())
    assert outputs == [1.0, 0.5, 0.25]


def test_in_synchronous_evaluation_each_hidden_layer_delays_by_one_call() -> None:
    rng = np.random.default_rng(0)
    base = initial_genome(1, 1, rng=rng, activation="identity", bias=False)
    genome = base.replaced(
        node_id=np.array([1, 2, 3]),
        node_kind=np.array([NodeKind.INPUT, NodeKind.OUTPUT, NodeKind.HIDDEN]),
        node_activation=np.zeros(3),
        link_innovation=np.array([1, 2]),
        link_source=np.array([1, 3]),
        link_target=np.array([3, 2]),
        link_weight=np.ones(2),
        link_enabled=np.ones(2, bool),
        link_recurrent=np.zeros(2, bool),
    )
    outputs = {}
    for evaluation in ("settle", "synchronous"):
        network = PopulationNetwork([genome], evaluation=evaluation)
        state, seen = network.initial_state(), []
        for x in (1.0, 2.0, 3.0):
            output, state = network.step(torch.tensor([[x]]), state)
            seen.append(output.item())
        outputs[evaluation] = seen
    assert outputs == {"settle": [1.0, 2.0, 3.0], "synchronous": [0.0, 1.0, 2.0]}


def test_an_output_without_links_has_the_value_of_its_activation_at_zero() -> None:
    genome = initial_genome(2, 2, rng=np.random.default_rng(0))
    genome = genome.replaced(link_enabled=np.array([True] * 3 + [False] * 3))
    assert PopulationNetwork([genome])(torch.rand(1, 2))[0, 1].item() == 0.5


def test_bad_shapes_and_genomes_are_named() -> None:
    genome = grown(0, 0)
    network = PopulationNetwork([genome, genome])
    with pytest.raises(ValueError, match=r"\[2, \*batch, 3\], got \[2, 4\]"):
        network(torch.rand(2, 4))
    with pytest.raises(ValueError, match="genome 5 has 4 inputs and 2 outputs"):
        network.replace(0, grown(5, 0, inputs=4))
    with pytest.raises(ValueError, match="genome 0 reads the observations 'radar'"):
        network.replace(0, genome.replaced(observation_schema="radar"))
    with pytest.raises(ValueError, match="expected 6 genomes"):
        PopulationNetwork([genome], shape=(2, 3))


def test_networks_of_one_structure_keep_their_own_weights() -> None:
    first = initial_genome(2, 1, rng=np.random.default_rng(0))
    second = first.with_weights([0.5, -0.5, 0.25])
    other = second.replaced(link_enabled=[True, False, True])
    network = PopulationNetwork([first, second, other])
    observation = torch.tensor([[1.0, 1.0]] * 3)
    alone = [PopulationNetwork([one])(observation[:1]) for one in (first, second, other)]
    assert torch.equal(network(observation), torch.cat(alone))
    assert len({one.item() for one in torch.cat(alone).detach().view(-1)}) == 3
