"""Networks of neat-python against neat-python, on genomes that it made itself."""

from __future__ import annotations

import builtins
import copy
import json
import math
import pickle
import subprocess
from pathlib import Path
from typing import Any

import neat
import neat.activations
import neat.aggregations
import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from neat.export import export_network_json
from neat.innovation import InnovationTracker

from neatq_torch.genome import GenomeError
from neatq_torch.interop import load_neat_python, to_onnx
from neatq_torch.interop.neat_python_network import (
    NEAT_PYTHON_ACTIVATIONS,
    NEAT_PYTHON_AGGREGATIONS,
    NeatPythonNetwork,
    NeatPythonNode,
)
from neatq_torch.network import Evaluation, GenomeNetwork

CONFIG = Path(__file__).with_name("data") / "neat_python.cfg"
PLAIN: dict[str, Any] = {"activation_options": ["sigmoid", "tanh", "relu", "identity"]}
PLAIN |= {"aggregation_options": ["sum", "mean"]}

pytestmark = pytest.mark.filterwarnings("ignore:.*utcnow:DeprecationWarning")  # in neat.export


def config_of(*, recurrent: bool = False, **changes: Any) -> Any:
    parts = neat.DefaultGenome, neat.DefaultReproduction, neat.DefaultSpeciesSet
    config = neat.Config(*parts, neat.DefaultStagnation, str(CONFIG))
    config.genome_config.feed_forward = not recurrent
    for name, value in changes.items():
        setattr(config.genome_config, name, value)
    config.genome_config.innovation_tracker = InnovationTracker()
    return config


def grown(config: Any, mutations: int) -> Any:
    genome = neat.DefaultGenome(1)
    genome.configure_new(config.genome_config)
    for _ in range(mutations):
        genome.mutate(config.genome_config)
    return genome


def network_of(genome: Any, config: Any) -> Any:
    forward = config.genome_config.feed_forward
    return (neat.nn.FeedForwardNetwork if forward else neat.nn.RecurrentNetwork).create(
        genome, config
    )


def observed(seed: int, steps: int = 6) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(steps, 3))


def their_outputs(network: Any, observations: np.ndarray) -> np.ndarray:
    """[steps, outputs]; examples in which neat-python's numbers overflow are no examples."""
    try:
        outputs = np.array([list(network.activate(one)) for one in observations.tolist()])
    except OverflowError:
        assume(False)
        raise
    assume(np.isfinite(outputs).all() and np.abs(outputs).max() < 1e6)
    return outputs


def our_outputs(network: Any, observations: np.ndarray) -> np.ndarray:
    state, outputs = network.initial_state(), []
    with torch.no_grad():
        for observation in torch.from_numpy(observations):
            output, state = network.step(observation.to(network.weight.dtype), state)
            outputs.append(output.numpy())
    return np.stack(outputs)


cases = given(
    random=st.random_module(),
    mutations=st.integers(0, 25),
    recurrent=st.booleans(),
    seed=st.integers(0, 1000),
)


@settings(max_examples=100)
@cases
def test_a_genome_of_any_kind_computes_what_it_does_in_neat_python(
    random: Any, mutations: int, recurrent: bool, seed: int
) -> None:
    config, observations = config_of(recurrent=recurrent), observed(seed)
    genome = grown(config, mutations)
    wanted = their_outputs(network_of(genome, config), observations)
    network = load_neat_python(genome, config=config)
    assert network.recurrent == recurrent
    found = our_outputs(network, observations)
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)


@settings(max_examples=40)
@cases
def test_its_json_export_gives_the_same_network_as_the_genome(
    random: Any, mutations: int, recurrent: bool, seed: int
) -> None:
    config, observations = config_of(recurrent=recurrent), observed(seed)
    theirs = network_of(grown(config, mutations), config)
    text = export_network_json(theirs)
    wanted = their_outputs(theirs, observations)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pathlib.Path.read_bytes", lambda path: text.encode())
        patch.setattr("neatq_torch.interop.extras.find_spec", lambda name: None)
        network = load_neat_python("winner.json")  # without neat-python
    found = our_outputs(network, observations)
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)


@settings(max_examples=60)
@cases
def test_its_genome_of_ours_computes_the_same_in_both_evaluations(
    random: Any, mutations: int, recurrent: bool, seed: int
) -> None:
    config, observations = config_of(recurrent=recurrent, **PLAIN), observed(seed)
    genome = grown(config, mutations)
    wanted = their_outputs(network_of(genome, config), observations)
    ours = load_neat_python(genome, config=config).genome(genome_id=3, observation_schema="x")
    assert (ours.genome_id, ours.observation_schema) == (3, "x")
    evaluations: tuple[Evaluation, ...] = ("settle", "synchronous") if recurrent else ("settle",)
    for evaluation in evaluations:
        network = GenomeNetwork(ours, evaluation=evaluation)
        found = our_outputs(network, observations)
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5 * (1 + np.abs(wanted).max()))


@pytest.mark.parametrize("name", NEAT_PYTHON_ACTIVATIONS)
def test_each_activation_is_that_of_neat_python_far_out_too(name: str) -> None:
    theirs = neat.activations.ActivationFunctionSet().get(name)
    z = [-200.0, -13.0, -3.5, -1.0, -0.3, -1e-9, 0.0, 1e-9, 0.2, 1.0, 2.9, 13.0, 200.0]
    found = NEAT_PYTHON_ACTIVATIONS[name](torch.tensor(z, dtype=torch.float64, requires_grad=True))
    np.testing.assert_allclose(found.detach(), [theirs(one) for one in z], rtol=1e-9, atol=1e-12)
    tensor = torch.tensor(z, dtype=torch.float64, requires_grad=True)
    NEAT_PYTHON_ACTIVATIONS[name](tensor).sum().backward()
    assert tensor.grad is not None
    assert tensor.grad.isfinite().all()


@given(st.lists(st.sampled_from([-2.0, -1.5, 0.0, 0.5, 1.5, 2.0, 3.0]), min_size=1, max_size=6))
def test_each_aggregation_is_that_of_neat_python(values: list[float]) -> None:
    functions = neat.aggregations.AggregationFunctionSet()
    assert set(NEAT_PYTHON_AGGREGATIONS) == set(functions.functions)
    for name, ours in NEAT_PYTHON_AGGREGATIONS.items():
        found = ours(torch.tensor(values, dtype=torch.float64)).item()
        assert math.isclose(found, functions.get(name)(values), abs_tol=1e-12), name


def test_all_activations_of_neat_python_are_known() -> None:
    known = neat.activations.ActivationFunctionSet().functions
    assert set(NEAT_PYTHON_ACTIVATIONS) == set(known)


def small(*, recurrent: bool, **changes: Any) -> NeatPythonNetwork:
    """Inputs -1 and -2; output 0 of -1 and hidden 5, which product has no links; output 1 of none.

    Hidden 5: 0.5 + 2 * 1 = 2.5. Output 0: 0.1 + 3 * (2 x + 1.5 * 2.5).
    """
    hidden = NeatPythonNode(5, "identity", "product", 0.5, 2.0, ())
    output = NeatPythonNode(0, "identity", "sum", 0.1, 3.0, ((-1, 2.0), (5, 1.5)))
    return NeatPythonNetwork(
        [-1, -2], [0, 1], [hidden, output._replace(**changes)], recurrent=recurrent
    )


def test_a_small_network_by_hand() -> None:
    x = torch.tensor([[1.0, 9.0], [2.0, 9.0]], dtype=torch.float64)
    forward = [[0.1 + 3 * (2 + 3.75), 0.0], [0.1 + 3 * (4 + 3.75), 0.0]]
    network = small(recurrent=False)
    np.testing.assert_allclose(network(x).detach(), forward, rtol=1e-12)
    np.testing.assert_allclose(GenomeNetwork(network.genome())(x.float()).detach(), forward, 1e-6)
    late = small(recurrent=True)
    first, state = late.step(x, late.initial_state((2,)))
    np.testing.assert_allclose(first.detach(), [[6.1, 0.0], [12.1, 0.0]], rtol=1e-12)
    np.testing.assert_allclose(late.step(x, state)[0].detach(), forward, rtol=1e-12)
    assert "recurrent, 2 inputs, 2 outputs, 2 links" in repr(late)


def test_it_is_an_ordinary_module(tmp_path: Path) -> None:
    network = small(recurrent=False)
    x = torch.rand(4, 3, 2)
    assert network(x).dtype == torch.float32
    assert network(x).shape == (4, 3, 2)
    assert network.float()(x).dtype == torch.float32
    assert network(torch.ones(2, dtype=torch.int64)).shape == (2,)
    network(x)[..., 0].sum().backward()
    assert all(one.grad is not None and one.grad.abs().sum() > 0 for one in network.parameters())
    assert torch.equal(copy.deepcopy(network)(x), network(x))
    exported = torch.export.export(network, (x,)).module()
    torch.testing.assert_close(exported(x), network(x))
    for wrong in (torch.rand(4, 3), torch.rand(())):
        with pytest.raises(ValueError, match=r"an observation of shape \[\*batch, 2\], got \["):
            network(wrong)
    with pytest.raises(ValueError, match=r"a state of shape \[\*batch, 2\], got \[4, 3, 1\]"):
        small(recurrent=True).step(x, torch.zeros(4, 3, 1))


def test_it_can_be_written_as_onnx(tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    network = small(recurrent=True, activation="sigmoid")
    to_onnx(network, tmp_path / "network.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "network.onnx")
    x, state = np.random.default_rng(0).normal(size=(5, 2)), np.zeros((5, 2))
    output, state = session.run(None, {"observation": x, "state": state})
    wanted = network.step(torch.from_numpy(x), network.initial_state((5,)))
    np.testing.assert_allclose(output, wanted[0].detach(), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(state, wanted[1].detach(), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"activation": "mine"}, "node 0: the activation 'mine' is none of neat-python's own"),
        ({"aggregation": "mine"}, "node 0: the aggregation 'mine' is none of neat-python's own"),
        ({"key": 5}, "node 5 occurs more than once"),
        ({"key": -1}, "node -1 occurs more than once"),
        ({"links": ((7, 1.0),)}, "node 0 reads node 7, which is not evaluated before it"),
        ({"links": ((0, 1.0),)}, "node 0 reads node 0, which is not evaluated before it"),
        ({"links": ((-1, 1.0), (-1, 2.0))}, "two links lead from -1 to 0"),
    ],
)
def test_what_is_no_network_of_neat_python_is_refused_by_name(
    changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(GenomeError, match=words):
        small(recurrent=False, **changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"activation": "sin"}, "node 0: the activation 'sin' is none of a genome's"),
        ({"aggregation": "max"}, "node 0: the aggregation 'max' of 2 links is no sum"),
    ],
)
def test_what_a_genome_cannot_say_is_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(GenomeError, match=words):
        small(recurrent=False, **changes).genome()


def test_an_aggregation_of_few_links_is_a_sum_or_a_mean() -> None:
    x = torch.tensor([1.0, 9.0], dtype=torch.float64)
    median = small(recurrent=False, aggregation="median")
    found = GenomeNetwork(median.genome())(x.float())[0].item()
    assert found == pytest.approx(0.1 + 3 * (2 + 3.75) / 2, rel=1e-6)
    single = small(recurrent=False, aggregation="maxabs", links=((-1, 2.0),))
    assert GenomeNetwork(single.genome())(x.float())[0].item() == pytest.approx(6.1, rel=1e-6)


@pytest.fixture
def winner() -> tuple[Any, Any]:
    config = config_of(**PLAIN)
    return grown(config, 6), config


def test_pickles_of_genomes_and_networks_are_read(winner: tuple[Any, Any], tmp_path: Path) -> None:
    genome, config = winner
    theirs, path = network_of(genome, config), tmp_path / "winner.pickle"
    wanted = load_neat_python(theirs)(torch.ones(3))
    path.write_bytes(pickle.dumps(genome))
    assert torch.equal(load_neat_python(path, config=config)(torch.ones(3)), wanted)
    assert torch.equal(load_neat_python(str(path), config=CONFIG)(torch.ones(3)), wanted)
    path.write_bytes(pickle.dumps(theirs))
    assert torch.equal(load_neat_python(path)(torch.ones(3)), wanted)


def test_of_a_checkpoint_the_fittest_genome_is_read(
    winner: tuple[Any, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    genome, config = winner
    saver = neat.Checkpointer(1, filename_prefix=f"{tmp_path}/checkpoint-")
    other = grown(config, 1)
    for fitnesses in ((None, None), (1.0, 2.0)):
        other.fitness, genome.fitness = fitnesses
        saver.save_checkpoint(config, {1: other, 2: genome}, None, 7)
        if fitnesses[0] is None:
            with pytest.raises(GenomeError, match="no genome in the checkpoint has a fitness"):
                load_neat_python(tmp_path / "checkpoint-7")
    found = load_neat_python(tmp_path / "checkpoint-7")(torch.ones(3))
    assert torch.equal(found, load_neat_python(genome, config=config)(torch.ones(3)))


class Harmful:
    """What a pickle of somebody else may be."""

    def __reduce__(self) -> Any:
        return subprocess.getoutput, ("touch harmed",)


def test_a_pickle_runs_nothing_that_is_not_neat_pythons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "winner.pickle"
    # The last one reaches for os through a module of neat-python's that imports it.
    by_dots = b"\x80\x04\x8c\x0bneat.config\x8c\x09os.system\x93."
    harmful = [pickle.dumps(Harmful()), pickle.dumps(builtins.eval), by_dots]
    for data in harmful:
        path.write_bytes(data)
        with pytest.raises(GenomeError, match=r"winner.pickle: .*holds (subprocess|builtins|neat)"):
            load_neat_python(path)
    assert not (tmp_path / "harmed").exists()


def test_functions_of_a_users_own_are_refused_by_name(winner: tuple[Any, Any]) -> None:
    genome, config = winner
    config.genome_config.add_activation("wave", lambda z: z)
    genome.nodes[0].activation = "wave"
    with pytest.raises(GenomeError, match=r"node 0: the activation '.*lambda.*' is none of neat"):
        load_neat_python(genome, config=config)


def exported(**changes: Any) -> dict[str, Any]:
    config = config_of(**PLAIN)
    data = json.loads(export_network_json(network_of(grown(config, 3), config)))
    return data | changes


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "expected a JSON export, a pickle or a checkpoint of neat-python"),
        (b"[" * 100_000, "expected a JSON export, a pickle or a checkpoint of neat-python"),
        (b'{"nodes": NaN}', "expected a JSON export"),
        (b"\x80\x04nothing", "damaged, or no pickle of neat-python: "),
        (b"\x1f\x8bnothing", "damaged, or no pickle of neat-python: "),
        (exported(network_type="ctrnn"), "'ctrnn' cannot be carried: networks here have neither"),
        (exported(network_type="iznn"), "'iznn' cannot be carried"),
        (exported(format_version="2.0"), "expected version 1 of the format, got '2.0'"),
        (exported(nodes=[]), r"the link from -?\d to \d leads nowhere"),
        (exported(topology={}), "missing required field `input_keys`"),
    ],
)
def test_another_file_is_refused_with_its_name(data: Any, words: str, tmp_path: Path) -> None:
    path = tmp_path / "winner.json"
    path.write_bytes(data if isinstance(data, bytes) else json.dumps(data).encode())
    with pytest.raises(GenomeError, match=f"winner.json: .*{words}"):
        load_neat_python(path)


def test_a_custom_function_of_an_export_is_refused(tmp_path: Path) -> None:
    data = exported()
    data["nodes"][0]["activation"] = {"name": "sigmoid", "custom": True}
    (tmp_path / "winner.json").write_text(json.dumps(data))
    with pytest.raises(GenomeError, match=r"the activation 'sigmoid \(custom\)' is none of neat"):
        load_neat_python(tmp_path / "winner.json")


def test_what_is_given_wrongly_is_said(
    winner: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(GenomeError, match=r"expected config=, a neat\.Config or the path"):
        load_neat_python(winner[0])
    with pytest.raises(GenomeError, match="got dict"):
        load_neat_python({})
    with pytest.raises(OSError, match="nowhere"):
        load_neat_python("nowhere.json")
    monkeypatch.setattr("neatq_torch.interop.extras.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match="needs neat: pip install 'neat-python'"):
        load_neat_python(winner[0], config=winner[1])
