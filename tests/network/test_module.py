"""What PyTorch's users expect of a module: its parameters, what it saves, says and refuses."""

from __future__ import annotations

import copy
import io
import pickle
import warnings
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor

from neatq_torch.genome import (
    Genome,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    initial_genome,
    mutate,
)
from neatq_torch.kinds import ConfigError
from neatq_torch.network import Evaluation, GenomeNetwork, PopulationNetwork

GROWTH = MutationConfig(add_node_prob=0.5, add_link_prob=0.5, toggle_enable_prob=0.3)
FORWARD = MutationConfig(
    add_node_prob=0.5, add_link_prob=0.5, toggle_enable_prob=0.3, recurrent_link_prob=0.0
)


def grown(seed: int, config: MutationConfig = FORWARD, mutations: int = 15) -> Genome:
    rng = np.random.default_rng(seed)
    genome = initial_genome(3, 2, rng=rng, genome_id=seed)
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(mutations):
        genome = mutate(genome, config, ledger, rng)
    return genome


def echo() -> Genome:
    """One input, one output that reads itself: y(t) = x(t) + y(t - 1) / 2."""
    genome = initial_genome(1, 1, rng=np.random.default_rng(0), activation="identity", bias=False)
    return genome.replaced(
        link_innovation=np.array([1, 2]),
        link_source=np.array([1, 2]),
        link_target=np.array([2, 2]),
        link_weight=np.array([1.0, 0.5]),
        link_enabled=np.ones(2, bool),
        link_recurrent=np.array([False, True]),
    )


# --- parameters -----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("evaluation", ["settle", "synchronous"])
def test_the_parameters_of_one_genome_are_its_enabled_links(
    seed: int, evaluation: Evaluation
) -> None:
    genome = grown(seed, GROWTH)
    network = GenomeNetwork(genome, evaluation=evaluation)
    links = int(genome.link_enabled.sum())
    assert sum(weight.numel() for weight in network.parameters()) == links
    assert f"links={links}" in repr(network)
    wide = PopulationNetwork([genome], evaluation=evaluation)
    x = torch.rand(4, 3, requires_grad=True)
    for own, other in zip(two_steps(network, x), two_steps(wide, x[None]), strict=True):
        assert torch.equal(own, other[0][..., : own.shape[-1]])  # the others are spare
    assert network.weight.grad is not None
    assert wide.weight.grad is not None
    mine, others = network.weight.grad, wide.weight.grad
    assert sorted(mine[mine != 0].tolist()) == sorted(others[others != 0].tolist())
    assert network.genome().to_json() == genome.to_json()
    double = copy.deepcopy(network).double()
    for own, other in zip(two_steps(network, x), two_steps(double, x.double()), strict=True):
        torch.testing.assert_close(own.double(), other, rtol=1e-4, atol=1e-5)


def two_steps(network: PopulationNetwork, x: Tensor) -> list[Tensor]:
    """Outputs and state of the second call, and the gradient of the observation."""
    x = x.detach().requires_grad_()
    state = network.initial_state(x.shape[len(network.shape) : -1])
    output, state = network.step(x, network.step(x, state)[1])
    (output.sum() + state.sum()).backward()
    assert x.grad is not None
    return [output.detach(), state.detach(), x.grad]


def test_one_genome_can_be_replaced_by_one_of_more_links_or_of_fewer() -> None:
    network, x = GenomeNetwork(grown(1)), torch.rand(4, 3)
    weight = network.weight
    for genome in (grown(2, mutations=40), grown(3, mutations=0)):
        network.replace(0, genome)
        assert network.weight is weight
        assert weight.numel() == int(genome.link_enabled.sum())
        assert torch.equal(network(x), GenomeNetwork(genome)(x))
        assert network.genome().to_json() == genome.to_json()


def test_what_it_is_can_be_read() -> None:
    assert repr(GenomeNetwork(echo())) == (
        "GenomeNetwork(inputs=1, outputs=1, hidden=0, links=2, evaluation='settle', recurrent=True)"
    )
    first, second = grown(0, mutations=0), grown(1, mutations=0)
    second = second.replaced(link_enabled=np.arange(8) > 0)
    assert repr(PopulationNetwork([first, second], shape=(1, 2))) == (
        "PopulationNetwork(shape=(1, 2), inputs=3, outputs=2, hidden=0, links=7..8, "
        "evaluation='settle', recurrent=False)"
    )


# --- saving ---------------------------------------------------------------------------------------


def changed(genome: Genome) -> dict[str, Genome]:
    """Genomes of as many links, none of which means what it does in `genome`."""
    hidden = genome.node_kind == NodeKind.HIDDEN
    assert hidden.any()
    code = np.where(hidden, (genome.node_activation + 1) % 5, genome.node_activation)
    ids = np.where(hidden, genome.node_id + 100, genome.node_id)
    renamed = dict(zip(genome.node_id, ids, strict=True))
    return {
        "activation": genome.replaced(node_activation=code),
        "nodes": genome.replaced(
            node_id=ids,
            link_source=np.array([renamed[one] for one in genome.link_source]),
            link_target=np.array([renamed[one] for one in genome.link_target]),
        ),
    }


@pytest.mark.parametrize("what", ["activation", "nodes", "links", "evaluation"])
def test_weights_of_another_graph_are_refused_and_nothing_is_changed(what: str) -> None:
    genome = grown(1)
    network = GenomeNetwork(genome)
    evaluation: Evaluation = "synchronous" if what == "evaluation" else "settle"
    other = genome
    if what == "links":  # as many of them: another one is disabled
        enabled = np.ones(8, bool)
        genome, other = (
            grown(0, mutations=0).replaced(
                link_enabled=np.where(np.arange(8) == off, False, enabled)
            )
            for off in (2, 5)
        )
        network = GenomeNetwork(genome)
    elif what in ("activation", "nodes"):
        other = changed(genome)[what]
    foreign = GenomeNetwork(other, evaluation=evaluation)
    assert foreign.weight.shape == network.weight.shape
    with torch.no_grad():
        foreign.weight.add_(1)
    before = network.weight.clone()
    for strict in (True, False):
        with pytest.raises(RuntimeError, match=r"expected the weights of this graph, GenomeNetw"):
            network.load_state_dict(foreign.state_dict(), strict=strict)
    assert torch.equal(network.weight, before)
    around, theirs = torch.nn.Sequential(network), torch.nn.Sequential(foreign)
    with pytest.raises(RuntimeError, match="got another graph: other nodes, enabled links"):
        around.load_state_dict(theirs.state_dict())


def test_a_population_names_the_slots_that_do_not_fit() -> None:
    network = PopulationNetwork([grown(1), grown(2), grown(3)])
    with pytest.raises(RuntimeError, match=r"got other graphs in the slots \[1, 2\]"):
        other = PopulationNetwork([grown(1), grown(3), grown(2)])
        network.load_state_dict(other.state_dict())
    with pytest.raises(RuntimeError, match="got those of 2 networks"):
        network.load_state_dict(PopulationNetwork([grown(1), grown(2)]).state_dict())


def test_weights_of_the_same_graphs_are_taken_whatever_the_spare_columns() -> None:
    network = PopulationNetwork([grown(1), grown(2, mutations=60)])
    network.replace(1, grown(3))
    small = PopulationNetwork([grown(1).replaced(genome_id=77), grown(3)])
    assert small.weight.shape[1] < network.weight.shape[1]
    with torch.no_grad():
        network.weight.mul_(2)
    x = torch.rand(2, 5, 3)
    for one, other in ((small, network), (network, small)):
        with torch.no_grad():
            one.weight.zero_()
        one.load_state_dict(other.state_dict())
        torch.testing.assert_close(one(x), other(x))
        with torch.no_grad():
            one.weight.mul_(3)


@pytest.mark.parametrize("network", [GenomeNetwork(grown(4)), PopulationNetwork([grown(4)] * 2)])
def test_it_survives_every_way_of_copying_and_saving(network: PopulationNetwork) -> None:
    x = torch.rand(*network.shape, 6, 3)
    wanted = network(x)
    file = io.BytesIO()
    torch.save(network.state_dict(), file)
    file.seek(0)
    state = torch.load(file, weights_only=True)
    assert all(isinstance(value, Tensor) for value in state.values())
    again = copy.deepcopy(network)
    with torch.no_grad():
        again.weight.zero_()
    again.load_state_dict(state)
    assert torch.equal(again(x), wanted)
    assert torch.equal(copy.deepcopy(network)(x), wanted)
    assert torch.equal(pickle.loads(pickle.dumps(network))(x), wanted)
    with pytest.raises(RuntimeError, match="Missing key"):
        again.load_state_dict({"weight": state["weight"]})
    again.load_state_dict({"weight": state["weight"]}, strict=False)


def test_what_was_exported_can_be_saved(tmp_path: Any) -> None:
    network, x = GenomeNetwork(grown(4)), torch.rand(4, 3)
    torch.export.save(torch.export.export(network, (x,)), tmp_path / "network.pt2")
    again = torch.export.load(tmp_path / "network.pt2").module()
    torch.testing.assert_close(again(x), network(x))


# --- memory ---------------------------------------------------------------------------------------


def test_a_call_that_forgets_says_so_and_one_with_a_state_does_not() -> None:
    network = GenomeNetwork(echo())
    with pytest.warns(UserWarning, match=r"begins anew: call step\(.* or stateful\(\)") as seen:
        network(torch.ones(1))
    assert seen[0].filename == __file__
    network(torch.ones(2, 1), network.initial_state((2,)))
    network.step(torch.ones(1), network.initial_state())
    GenomeNetwork(grown(1))(torch.ones(3))


def test_the_stateful_form_goes_on_from_call_to_call_until_it_is_reset() -> None:
    network = GenomeNetwork(echo()).stateful()
    assert [network(torch.ones(1)).item() for _ in range(3)] == [1.0, 1.5, 1.75]
    network.reset()
    assert [network([1.0]).item() for _ in range(2)] == [1.0, 1.5]
    with pytest.raises(
        ValueError, match=r"a batch \[\] of observations.*got \[2\]; call reset\(\)"
    ):
        network(torch.ones(2, 1))


def test_a_batch_is_reset_where_an_episode_begins() -> None:
    network = PopulationNetwork([echo(), echo()]).stateful()
    x = torch.ones(2, 3, 1)
    network(x)
    network(x)
    begins = torch.tensor([[True, False, False], [False, False, True]])
    network.reset(begins)
    assert network(x)[..., 0].tolist() == [[1.0, 1.75, 1.75], [1.75, 1.75, 1.0]]
    with pytest.raises(ValueError, match=r"bools of shape \[2, 3\], got torch.bool of shape \[3\]"):
        network.reset(torch.tensor([True, False, True]))


def test_the_stateful_form_goes_on_where_a_newborn_keeps_more_than_all_before() -> None:
    plain = echo().replaced(link_enabled=np.array([True, False]))
    network = PopulationNetwork([plain, plain])
    running = network.stateful()
    assert running(torch.ones(2, 1)).flatten().tolist() == [1.0, 1.0]
    network.replace(0, echo())
    assert running(torch.ones(2, 1)).flatten().tolist() == [1.0, 1.0]
    assert running(torch.ones(2, 1)).flatten().tolist() == [1.5, 1.0]


def test_gradients_of_the_stateful_form_are_those_of_the_latest_call() -> None:
    network = GenomeNetwork(echo())
    running = network.stateful()
    assert [name for name, _ in running.named_parameters()] == ["network.weight"]
    running(torch.ones(1))
    running(torch.ones(1)).sum().backward()
    assert network.weight.grad is not None
    assert network.weight.grad.tolist() == [[1.0, 1.0]]  # x and y(t - 1), which is 1
    saved = copy.deepcopy(running)
    assert saved(torch.ones(1)).item() == running(torch.ones(1)).item() == 1.75


# --- what it reads --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "values", [np.ones((2, 3)), np.ones((2, 3), np.int8), [[1.0] * 3] * 2, torch.ones(2, 3).bool()]
)
def test_observations_of_other_kinds_are_cast(values: Any) -> None:
    network = GenomeNetwork(grown(2))
    output = network(values)
    assert output.dtype == torch.float32
    assert torch.equal(output, network(torch.ones(2, 3)))
    double = copy.deepcopy(network).double()(torch.ones(2, 3))
    assert double.dtype == torch.float64
    assert torch.equal(network.step(values, np.zeros((2, 0)))[0], output)


def test_a_gradient_reaches_an_observation_of_another_dtype() -> None:
    x = torch.rand(3, dtype=torch.float64, requires_grad=True)
    GenomeNetwork(grown(2))(x).sum().backward()
    assert x.grad is not None
    assert x.grad.dtype == torch.float64


@pytest.mark.parametrize("shape", [(), (4,), (3, 4), (0,)])
def test_a_wrong_width_names_the_shape_that_was_passed(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError) as error:
        GenomeNetwork(grown(2))(torch.zeros(shape))
    assert str(error.value) == f"expected an observation of shape [*batch, 3], got {list(shape)}"
    with pytest.raises(ValueError, match=r"\[2, \*batch, 3\], got \[3\]"):
        PopulationNetwork([grown(2)] * 2)(torch.zeros(3))
    with pytest.raises(ValueError, match=r"of real numbers, got torch.complex64"):
        GenomeNetwork(grown(2))(torch.zeros(3, dtype=torch.complex64))


@pytest.mark.parametrize(
    "state", [torch.zeros(3, 4, 1), torch.zeros(4, 1), torch.zeros(4, 3, 2), torch.zeros(4, 3)]
)
def test_a_state_of_another_shape_is_refused_with_both_shapes(state: Tensor) -> None:
    network, x = GenomeNetwork(echo()), torch.zeros(4, 3, 1)
    words = (
        f"of shape [4, 3, 1], for an observation of shape [4, 3, 1]; got {state.dtype} of shape "
    )
    for call in (network, network.step):
        with pytest.raises(ValueError) as error:
            call(x, state)
        assert f"{words}{list(state.shape)}. initial_state" in str(error.value)


def test_a_state_of_integers_or_where_there_is_none_is_refused() -> None:
    whole = torch.zeros(2, 1, dtype=torch.long)
    with pytest.raises(ValueError, match=r"state of floats of shape \[2, 1\].*got torch.int64 of"):
        GenomeNetwork(echo()).step(torch.zeros(2, 1), whole)
    with pytest.raises(
        ValueError, match=r"\[2, 0\], as these networks keep none.*of shape \[2, 5\]"
    ):
        GenomeNetwork(grown(2)).step(torch.zeros(2, 3), torch.zeros(2, 5))
    output, kept = GenomeNetwork(echo()).step(torch.zeros(2, 1), torch.ones(2, 1).double())
    assert output.tolist() == [[0.5], [0.5]]
    assert kept.dtype == torch.float32


# --- tracing --------------------------------------------------------------------------------------


class Stepping(torch.nn.Module):
    """A network with its state in and out."""

    def __init__(self, network: PopulationNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, observation: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        return self.network.step(observation, state)


def networks() -> list[PopulationNetwork]:
    one, several = GenomeNetwork(grown(5, GROWTH)), [grown(i, GROWTH) for i in range(3)]
    return [one, PopulationNetwork(several), PopulationNetwork(several, evaluation="synchronous")]


def rows(network: PopulationNetwork, batch: int) -> tuple[Tensor, Tensor]:
    chance = torch.Generator().manual_seed(batch)
    x = torch.rand(*network.shape, batch, 3, generator=chance)
    return x, torch.rand(*network.shape, batch, network.state_size, generator=chance)


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.parametrize("grad", [False, True])
@pytest.mark.parametrize("which", range(3))
def test_a_traced_network_depends_on_its_input(which: int, grad: bool, frozen: bool) -> None:
    network = networks()[which].requires_grad_(not frozen)
    with torch.set_grad_enabled(grad):
        traced: Any = torch.jit.trace(Stepping(network), rows(network, 4))
    for batch in (4, 9):
        for found, wanted in zip(
            traced(*rows(network, batch)), network.step(*rows(network, batch)), strict=True
        ):
            torch.testing.assert_close(found, wanted)


@pytest.mark.parametrize("which", range(3))
def test_the_onnx_exporter_of_before_gives_the_same_numbers(which: int) -> None:
    network = networks()[which]
    dynamic = {name: {len(network.shape): "batch"} for name in ("x", "state", "y", "kept")}
    names: dict[str, Any] = {"input_names": ["x", "state"], "output_names": ["y", "kept"]}
    file = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # that it is the one of before
        torch.onnx.export(
            Stepping(network),
            rows(network, 4),
            file,  # pyright: ignore[reportArgumentType]
            dynamo=False,
            dynamic_axes=dynamic,
            **names,
        )
    session = onnxruntime.InferenceSession(file.getvalue())
    x, state = rows(network, 9)
    found = session.run(None, {"x": x.numpy(), "state": state.numpy()})
    for own, wanted in zip(found, network.step(x, state), strict=True):
        np.testing.assert_allclose(np.asarray(own), wanted.detach().numpy(), atol=1e-6)


@pytest.mark.parametrize("which", range(3))
def test_a_step_is_exported_and_compiled(which: int) -> None:
    stepping = Stepping(networks()[which])
    lead, batch = len(stepping.network.shape), torch.export.Dim("batch", min=2)
    program = torch.export.export(
        stepping, rows(stepping.network, 4), dynamic_shapes=({lead: batch}, {lead: batch})
    ).module()
    one_graph = isinstance(stepping.network, GenomeNetwork)
    compiled = torch.compile(stepping, backend="eager", fullgraph=one_graph)
    for call in (program, compiled):
        found, wanted = call(*rows(stepping.network, 9)), stepping(*rows(stepping.network, 9))
        torch.testing.assert_close(found, wanted)


def test_a_network_that_was_put_in_begins_without_the_memory_of_the_one_before() -> None:
    running = PopulationNetwork([echo(), echo()]).stateful()
    for _ in range(2):
        running(torch.ones(2, 3, 1))
    running.network.replace(0, echo())
    assert running(torch.ones(2, 3, 1))[..., 0].tolist() == [[1.0] * 3, [1.75] * 3]
    assert running(torch.ones(2, 3, 1))[..., 0].tolist() == [[1.5] * 3, [1.875] * 3]
    alone = GenomeNetwork(echo()).stateful()
    alone(torch.ones(1))
    alone.network.replace(0, echo())
    assert alone(torch.ones(1)).item() == 1.0


def test_an_evaluation_that_does_not_exist_is_refused() -> None:
    other: Any = "sync"
    with pytest.raises(ConfigError, match="expected 'settle' or 'synchronous'; got 'sync'"):
        GenomeNetwork(echo(), evaluation=other)
