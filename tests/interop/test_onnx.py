"""Networks in ONNX Runtime and through torch.export and torch.compile, against themselves."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import Tensor, nn

from neatq_torch.genome import Genome, InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.interop import to_onnx
from neatq_torch.network import GenomeNetwork, PopulationNetwork

RECURRENT = MutationConfig(add_node_prob=0.3, add_link_prob=0.9, recurrent_link_prob=0.5)
FORWARD = MutationConfig(add_node_prob=0.3, add_link_prob=0.9, recurrent_link_prob=0.0)
FORMS = ["feed-forward", "recurrent", "synchronous"]


def genome_of(config: MutationConfig) -> Genome:
    rng = np.random.default_rng(4)
    genome = initial_genome(3, 2, rng=rng)
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(12):
        genome = mutate(genome, config, ledger, rng)
    return genome


@pytest.fixture(params=FORMS)
def network(request: pytest.FixtureRequest) -> GenomeNetwork:
    form = request.param
    genome = genome_of(RECURRENT if form == "recurrent" else FORWARD)
    network = GenomeNetwork(genome, evaluation="synchronous" if form == "synchronous" else "settle")
    assert bool(network.state_size) == (form != "feed-forward")
    return network


def session_of(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options)


def test_an_onnx_file_computes_what_the_network_does_over_many_steps_and_for_any_batch(
    network: GenomeNetwork, tmp_path: Path
) -> None:
    before = copy.deepcopy(network.state_dict())
    to_onnx(network, tmp_path / "network.onnx")
    assert network.training
    assert all(torch.equal(before[name], value) for name, value in network.state_dict().items())
    onnx.checker.check_model(tmp_path / "network.onnx")
    session = session_of(tmp_path / "network.onnx")
    names = ["observation", "state"] if network.state_size else ["observation"]
    assert [one.name for one in session.get_inputs()] == names
    assert [one.name for one in session.get_outputs()] == ["output", "next_state"][: len(names)]
    for batch, steps in ((1, 2), (7, 40), (0, 1)):
        generator = torch.Generator().manual_seed(batch)
        theirs = ours = network.initial_state((batch,))
        for _ in range(steps):
            observation = torch.randn(batch, 3, generator=generator)
            given = {"observation": observation.numpy(), "state": theirs.numpy()}
            found = session.run(None, {name: given[name] for name in names})
            with torch.no_grad():
                wanted, ours = network.step(observation, ours)
            torch.testing.assert_close(torch.as_tensor(found[0]), wanted, atol=1e-6, rtol=1e-6)
            if network.state_size:
                theirs = torch.as_tensor(found[1])
                torch.testing.assert_close(theirs, ours, atol=1e-6, rtol=1e-6)


def test_an_onnx_file_has_the_precision_and_the_texts_that_it_was_given(tmp_path: Path) -> None:
    network = GenomeNetwork(genome_of(FORWARD)).double()
    path = tmp_path / "network.onnx"
    to_onnx(network, path, output_name="value", metadata={"task": "flag"})
    session, observation = session_of(path), torch.rand(3, 3, dtype=torch.float64)
    assert session.get_modelmeta().custom_metadata_map == {"task": "flag"}
    assert session.get_outputs()[0].name == "value"
    (found,) = session.run(None, {"observation": observation.numpy()})
    wanted = network(observation).detach()
    torch.testing.assert_close(torch.as_tensor(found), wanted, rtol=1e-12, atol=0.0)


def test_what_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    population = PopulationNetwork([genome_of(FORWARD)] * 2)
    for wrong in (population, nn.Linear(2, 2)):
        with pytest.raises(TypeError, match=f"GenomeNetwork.*got {type(wrong).__name__}"):
            to_onnx(wrong, tmp_path / "network.onnx")  # pyright: ignore[reportArgumentType]
    monkeypatch.setattr("neatq_torch.interop.extras.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"onnx: pip install 'neatq_torch\[onnx\]'"):
        to_onnx(GenomeNetwork(genome_of(FORWARD)), tmp_path / "network.onnx")
    assert not list(tmp_path.iterdir())


class Step(nn.Module):
    """A network's step as the call that torch.export and torch.compile see."""

    def __init__(self, network: GenomeNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, observation: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return self.network.step(observation, observation[..., :0] if state is None else state)


def check_over_steps(exported: Callable[..., Any], network: GenomeNetwork) -> None:
    """Five steps of another batch than the one that was exported."""
    theirs = ours = network.initial_state((5,))
    for number in range(5):
        observation = torch.randn(5, 3, generator=torch.Generator().manual_seed(number))
        found, theirs = exported(*((observation, theirs) if network.state_size else (observation,)))
        wanted, ours = network.step(observation, ours)
        torch.testing.assert_close(found, wanted, atol=1e-6, rtol=1e-6)
        torch.testing.assert_close(theirs, ours, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.filterwarnings("ignore:.*LeafSpec:FutureWarning")  # torch's own, while it saves
def test_an_exported_program_is_saved_and_loaded_and_takes_any_batch(
    network: GenomeNetwork, strict: bool, tmp_path: Path
) -> None:
    given = (torch.zeros(3, 3), network.initial_state((3,)))[: 1 + bool(network.state_size)]
    shapes = ({0: torch.export.Dim("rows")},) * len(given)
    program = torch.export.export(Step(network), given, dynamic_shapes=shapes, strict=strict)
    torch.export.save(program, tmp_path / "network.pt2")
    check_over_steps(torch.export.load(tmp_path / "network.pt2").module(), network)


@pytest.mark.filterwarnings("ignore:The .grad attribute")  # dynamo looks at it
def test_it_compiles_as_one_graph_for_any_batch(network: GenomeNetwork) -> None:
    torch.compiler.reset()
    compiled = torch.compile(Step(network), backend="eager", fullgraph=True, dynamic=True)
    check_over_steps(compiled, network)
    (compiled(torch.rand(2, 3), network.initial_state((2,)))[0].sum()).backward()
    assert network.weight.grad is not None
