"""The compiled path against torch operations, and the bits that it must keep."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch._subclasses import FakeTensorMode
from torch.func import functional_call, grad, jvp, vmap

from neatq_torch.genome import (
    ACTIVATIONS,
    Genome,
    InnovationLedger,
    MutationConfig,
    initial_genome,
    mutate,
)
from neatq_torch.network import Evaluation, GenomeNetwork, PopulationNetwork, compiled, kernels
from neatq_torch.network.plan import compile_genome

# Many tests look at one call of a recurrent network, on purpose.
pytestmark = pytest.mark.filterwarnings("ignore:these networks keep a state")

GROWTH = MutationConfig(
    add_node_prob=0.4, add_link_prob=0.8, recurrent_link_prob=0.4, toggle_enable_prob=0.3
)
FORWARD = MutationConfig(add_node_prob=0.4, add_link_prob=0.8, recurrent_link_prob=0.0)


def grown(
    seed: int,
    mutations: int = 12,
    inputs: int = 5,
    outputs: int = 3,
    config: MutationConfig = GROWTH,
) -> Genome:
    """A genome after many structural mutations, with a random activation at each node."""
    rng = np.random.default_rng(seed)
    genome = initial_genome(inputs, outputs, rng=rng, genome_id=seed)
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(mutations):
        genome = mutate(genome, config, ledger, rng)
    activation = rng.integers(len(ACTIVATIONS), size=genome.node_id.size)
    return genome.replaced(node_activation=activation)


def rand(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def two_calls(network: PopulationNetwork, batch: Sequence[int]) -> list[Tensor]:
    """Outputs and states of two calls, and all gradients of a weighted sum of them."""
    dtype = network.weight.dtype
    first, second = rand(2, *network.shape, *batch, network.inputs).to(dtype)
    state = rand(*network.shape, *batch, network.state_size, seed=1).to(dtype)
    for tensor in (first, second, state):
        tensor.requires_grad_()
    network.weight.grad = None
    output, kept = network.step(first, state)
    output_2, kept_2 = network.step(second, kept)
    total = network.weight.sum() * 0 + first.sum() * 0 + second.sum() * 0 + state.sum() * 0
    for number, result in enumerate((output, output_2, kept_2)):
        total = total + (result * rand(*result.shape, seed=2 + number).to(dtype)).sum()
    total.backward()
    gradients = [tensor.grad for tensor in (network.weight, first, second, state)]
    return [t.detach() for t in (output, output_2, kept, kept_2, *gradients) if t is not None]


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    networks=st.integers(1, 4),
    mutations=st.integers(0, 25),
    outputs=st.sampled_from([1, 3, 9]),
    batch=st.sampled_from([(), (1,), (3,), (2, 17), (131,), (0,)]),
    evaluation=st.sampled_from(["settle", "synchronous"]),
)
def test_both_paths_give_the_same_outputs_states_and_gradients(
    seed: int,
    networks: int,
    mutations: int,
    outputs: int,
    batch: tuple[int, ...],
    evaluation: Evaluation,
) -> None:
    genomes = [grown(seed + i, mutations + i, outputs=outputs) for i in range(networks)]
    network = PopulationNetwork(genomes, evaluation=evaluation)
    found = two_calls(network, batch)
    wanted = two_calls(copy.deepcopy(network).double(), batch)
    for ours, torchs in zip(found, wanted, strict=True):
        scale = float(torchs.abs().max()) if torchs.numel() else 0.0
        torch.testing.assert_close(ours.double(), torchs, rtol=1e-3, atol=1e-5 * (1 + scale))


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), batch=st.sampled_from([(), (3,), (41,), (131,)]))
def test_a_network_gives_the_same_bits_in_any_company(seed: int, batch: tuple[int, ...]) -> None:
    genomes = [grown(seed + i, 3 * i, config=FORWARD) for i in range(5)]
    x, weighting = rand(*batch, 5, seed=seed), rand(*batch, 3, seed=seed + 1)
    results = []
    for company in ([2], [2, 0], [0, 1, 2], [4, 3, 1, 2, 0, 1]):
        network, place = PopulationNetwork([genomes[i] for i in company]), company.index(2)
        observation = rand(len(company), *batch, 5, seed=seed + 2)
        observation[place] = x
        observation.requires_grad_()
        output = network(observation)
        (output * weighting).sum().backward()
        assert network.weight.grad is not None
        assert observation.grad is not None
        links = network.weight[place] != 0
        gradients = network.weight.grad[place][links], observation.grad[place]
        results.append([output[place].detach(), *gradients])
    for result in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], result, strict=True))


@pytest.mark.parametrize("outputs", [2, 20])
def test_an_observation_gives_the_same_bits_in_any_batch(outputs: int) -> None:
    network = PopulationNetwork([grown(i, outputs=outputs) for i in range(4)])
    x, state = rand(4, 300, 5), rand(4, 300, network.state_size, seed=1)
    whole = network.step(x, state)
    for part in (slice(0, 1), slice(7, 8), slice(100, 290), slice(299, 300)):
        some = network.step(x[:, part], state[:, part])
        assert all(torch.equal(a[:, part], b) for a, b in zip(whole, some, strict=True))
    single = network.step(x[:, 5], state[:, 5])
    assert all(torch.equal(a[:, 5], b) for a, b in zip(whole, single, strict=True))


def test_calling_with_and_without_gradients_gives_the_same_bits() -> None:
    network = PopulationNetwork([grown(i) for i in range(3)])
    x, state = rand(3, 7, 5), network.initial_state((7,))
    with torch.no_grad():
        silent = network.step(x, state)
    assert all(torch.equal(a, b) for a, b in zip(silent, network.step(x, state), strict=True))


@pytest.mark.parametrize("name", ACTIVATIONS)
@pytest.mark.parametrize("batch", [1, 64])
def test_activations_are_accurate_over_the_whole_range(name: str, batch: int) -> None:
    genome = initial_genome(
        1, 1, rng=np.random.default_rng(0), bias=False, activation=name
    ).with_weights(np.ones(1))
    x = torch.cat([torch.linspace(-12, 12, 60 * batch), torch.tensor([0.0, 1e-30, 1e30, -1e30])])
    x = x[: len(x) // batch * batch].view(-1, batch)
    network = PopulationNetwork([genome] * len(x))
    y = network(x.unsqueeze(-1)).squeeze(-1).detach().double()
    wanted = {
        "identity": lambda x: x,
        "sigmoid": torch.sigmoid,
        "steep_sigmoid": lambda x: torch.sigmoid(4.9 * x),
        "tanh": torch.tanh,
        "relu": torch.relu,
    }[name](x.double())
    torch.testing.assert_close(
        y, wanted, rtol=2e-7 if name in ("identity", "relu") else 0, atol=4e-7
    )
    if name not in ("identity", "relu"):
        assert float(y.max()) <= 1
        assert float(y.min()) >= -1


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_nan_passes_through_every_activation(name: str) -> None:
    genome = initial_genome(1, 1, rng=np.random.default_rng(0), activation=name)
    for batch in (1, 40):
        assert GenomeNetwork(genome)(torch.full((batch, 1), torch.nan)).isnan().all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_weight_without_link_is_neither_read_nor_changed(dtype: torch.dtype) -> None:
    rng = np.random.default_rng(0)
    genome = initial_genome(3, 9, rng=rng).replaced(link_enabled=np.arange(36) % 3 > 0)
    network, x = PopulationNetwork([genome]).to(dtype), rand(1, 6, 3).to(dtype)
    links = compile_genome(genome, "settle").column.tolist()
    spare = sorted({*range(network.weight.shape[1])} - {*links})
    wanted = network(x).detach()
    with torch.no_grad():
        network.weight[:, spare] = torch.nan
    for rows in (x, x[:, :1]):
        output = network(rows)
        assert torch.equal(output, wanted[:, : rows.shape[1]])
        network.weight.grad = None
        output.sum().backward()
        assert network.weight.grad is not None
        assert int((network.weight.grad != 0).sum()) == 24


def test_second_derivatives_equal_those_in_double() -> None:
    genome = grown(3).replaced(node_activation=np.full(grown(3).node_id.size, 3))

    def second(network: GenomeNetwork) -> list[Tensor]:
        weight = network.weight
        x = rand(6, 5).to(weight.dtype).requires_grad_()
        (slope,) = torch.autograd.grad(network(x).square().sum(), x, create_graph=True)
        return list(torch.autograd.grad(slope.square().sum(), (weight, x)))

    pairs = zip(second(GenomeNetwork(genome)), second(GenomeNetwork(genome).double()), strict=True)
    for single, double in pairs:
        torch.testing.assert_close(single.double(), double, rtol=1e-3, atol=1e-3)


@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch.func.jvp
def test_transforms_see_torch_operations(monkeypatch: pytest.MonkeyPatch) -> None:
    network = GenomeNetwork(grown(5, config=FORWARD))
    parameters, x = dict(network.named_parameters()), rand(6, 5)
    wanted = network(x).detach()
    (slope,) = torch.autograd.grad(network(x).sum(), network.weight)

    def call(weights: Mapping[str, Tensor], x: Tensor) -> Tensor:
        result = functional_call(network, dict(weights), (x,))
        assert isinstance(result, Tensor)
        return result

    observed = x.clone().requires_grad_()
    (by_input,) = torch.autograd.grad(network(observed).sum(), observed)

    def refuse(*_: object) -> None:
        raise AssertionError("the compiled path was taken")

    monkeypatch.setattr(compiled, "evaluate", refuse)
    torch.testing.assert_close(vmap(call, (None, 0))(parameters, x), wanted)
    found = grad(lambda weights: call(weights, x).sum())(parameters)
    torch.testing.assert_close(found["weight"], slope)
    tangent = torch.ones_like(x)
    primal, change = jvp(lambda x: call(parameters, x), (x,), (tangent,))[:2]
    torch.testing.assert_close(primal, wanted)
    torch.testing.assert_close(change.sum(), by_input.sum())
    with FakeTensorMode(allow_non_fake_inputs=True) as mode:
        assert network(mode.from_tensor(x)).shape == (6, 3)


def test_gradients_of_many_outputs_at_once_equal_those_one_by_one() -> None:
    network = GenomeNetwork(grown(5, config=FORWARD))
    x = rand(5).requires_grad_()
    output = network(x)
    rows = [torch.autograd.grad(output[i], x, retain_graph=True)[0] for i in range(3)]
    (together,) = torch.autograd.grad(output, x, torch.eye(3), is_grads_batched=True)
    torch.testing.assert_close(together, torch.stack(rows))


def test_float32_on_the_cpu_takes_the_compiled_path(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    for name in ("forward", "backward"):
        kernel = getattr(kernels, name)

        def spy(*args: object, name: str = name, kernel: object = kernel) -> None:
            calls.append(name)
            assert callable(kernel)
            kernel(*args)

        monkeypatch.setattr(kernels, name, spy)
    network = PopulationNetwork([grown(1), grown(2)])
    network(rand(2, 5)).sum().backward()
    network(rand(2, 4, 5))
    copy.deepcopy(network)(rand(2, 4, 5))
    assert calls == ["forward", "backward", "forward", "forward"]
    copy.deepcopy(network).double()(rand(2, 5).double()).sum().backward()
    assert len(calls) == 4


def test_other_weights_may_be_called_but_not_of_another_shape() -> None:
    network = PopulationNetwork([grown(1), grown(2)])
    x, twice = rand(2, 4, 5), {"weight": network.weight.detach() * 2}
    other = copy.deepcopy(network)
    with torch.no_grad():
        other.weight.mul_(2)
    assert torch.equal(functional_call(network, twice, (x,)), other(x))
    spread = network.weight.detach()[:1].expand(2, -1)
    same = functional_call(network, {"weight": spread}, (x,))
    assert torch.equal(same, functional_call(network, {"weight": spread.contiguous()}, (x,)))
    with pytest.raises(ValueError, match="expected weights of shape"):
        functional_call(network, {"weight": network.weight[:, :-1]}, (x,))


def test_replacing_is_refused_before_the_gradient_of_foreign_weights_too() -> None:
    network = PopulationNetwork([grown(1), grown(2)])
    foreign = {"weight": network.weight.detach().clone().requires_grad_()}
    output = functional_call(network, foreign, (rand(2, 4, 5),))
    network.replace(0, grown(3, 0))
    with pytest.raises(RuntimeError, match="inplace operation"):
        output.sum().backward()


def test_observations_need_not_be_contiguous() -> None:
    network = PopulationNetwork([grown(1), grown(2)], shape=(1, 2))
    x = rand(5, 7, 2, 1).permute(3, 2, 1, 0)
    assert torch.equal(network(x), network(x.contiguous()))


def test_only_wanted_gradients_are_given() -> None:
    network = PopulationNetwork([grown(1), grown(2)]).requires_grad_(False)
    x = rand(2, 4, 5).requires_grad_()
    network(x).sum().backward()
    assert x.grad is not None
    assert network.weight.grad is None
