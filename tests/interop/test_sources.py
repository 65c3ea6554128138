"""A network as C and as Python against the torch module, on genomes of every kind."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from neatq_torch.genome import (
    ACTIVATIONS,
    Genome,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    initial_genome,
    mutate,
)
from neatq_torch.interop import to_c, to_python
from neatq_torch.interop.c_source import C_FORMULAS
from neatq_torch.interop.python_source import PYTHON_FORMULAS
from neatq_torch.kinds import ConfigError
from neatq_torch.network import Evaluation, GenomeNetwork

COMPILER = None if sys.platform == "win32" else shutil.which("gcc") or shutil.which("cc")
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-pedantic"]
GROWTH = MutationConfig(
    add_node_prob=0.4, add_link_prob=0.8, recurrent_link_prob=0.4, toggle_enable_prob=0.3
)
Numbers = Sequence[float]
Step = Callable[[Numbers, Numbers], tuple[Numbers, Numbers]]


def grown(seed: int, mutations: int = 12, outputs: int = 3) -> Genome:
    """A genome after many structural mutations, with a random activation at each node."""
    rng = np.random.default_rng(seed)
    genome = initial_genome(4, outputs, rng=rng, genome_id=seed, bias=bool(seed % 3))
    ledger = InnovationLedger.for_genomes([genome])
    for _ in range(mutations):
        genome = mutate(genome, GROWTH, ledger, rng)
    activation = rng.integers(len(ACTIVATIONS), size=genome.node_id.size)
    return genome.replaced(node_activation=activation)


def compiled(text: str, folder: Path, name: str = "network") -> Any:
    """The header in a library, without a warning."""
    header, source, library = (folder / f"{name}.{end}" for end in ("h", "c", "so"))
    header.write_text(text)
    arguments = "const float *o, float *s, float *y" if "float *state" in text else ""
    call = f"{name}_step(o, s, y);" if arguments else f"(void)s; {name}_step(o, y);"
    source.write_text(
        f'#include "{name}.h"\n#include "{name}.h"\n'
        f"void step(const float *o, float *s, float *y);\n"
        f"void step(const float *o, float *s, float *y) {{ {call} }}\n"
    )
    assert COMPILER is not None
    command = [COMPILER, *FLAGS, "-Werror", "-shared", "-fPIC", str(source), "-lm", "-o"]
    done = subprocess.run([*command, str(library)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library))


def c_steps(text: str, folder: Path, steps: np.ndarray, outputs: int) -> np.ndarray:
    """Outputs [steps, outputs] of the header in consecutive calls."""
    library, state = compiled(text, folder), np.zeros(100, np.float32)
    found = np.zeros((len(steps), outputs), np.float32)
    pointer = np.ctypeslib.ndpointer(np.float32)
    library.step.argtypes = [pointer] * 3
    for observation, output in zip(steps, found, strict=True):
        library.step(np.ascontiguousarray(observation), state, output)
    return found


def python_steps(text: str, steps: np.ndarray) -> np.ndarray:
    """Outputs [steps, outputs] of the Python source in consecutive calls."""
    own: dict[str, Any] = {}
    exec(text, own)
    state, found = (0.0,) * own["STATE"], []
    for observation in steps:
        output, state = own["step"](observation.tolist(), state)
        found.append(output)
    return np.array(found)


def torch_steps(network: GenomeNetwork, steps: np.ndarray) -> np.ndarray:
    state, found = network.initial_state(), []
    with torch.no_grad():
        for observation in torch.from_numpy(steps).to(network.weight.dtype):
            output, state = network.step(observation, state)
            found.append(output.numpy())
    return np.stack(found)


def observations(seed: int, steps: int = 8) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(steps, 4)).astype(np.float32)


cases = given(
    seed=st.integers(0, 10**6),
    mutations=st.integers(0, 20),
    outputs=st.sampled_from([1, 3]),
    evaluation=st.sampled_from(["settle", "synchronous"]),
)
once = [HealthCheck.function_scoped_fixture]


@settings(max_examples=60)
@cases
def test_python_source_computes_what_the_network_does(
    seed: int, mutations: int, outputs: int, evaluation: Evaluation
) -> None:
    genome, steps = grown(seed, mutations, outputs), observations(seed)
    wanted = torch_steps(GenomeNetwork(genome, evaluation=evaluation).double(), steps)
    found = python_steps(to_python(genome, evaluation=evaluation), steps)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@settings(max_examples=20, suppress_health_check=once)
@cases
def test_the_c_header_computes_what_the_network_does(
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    mutations: int,
    outputs: int,
    evaluation: Evaluation,
) -> None:
    genome, steps = grown(seed, mutations, outputs), observations(seed)
    wanted = torch_steps(GenomeNetwork(genome, evaluation=evaluation), steps)
    text = to_c(genome, evaluation=evaluation)
    found = c_steps(text, tmp_path_factory.mktemp("c"), steps, outputs)
    # Single precision: to 1e-6 of the size of the numbers that are added up on the way.
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6 * (1 + np.abs(wanted).max()))


def test_every_activation_has_a_formula_in_both_languages() -> None:
    assert set(C_FORMULAS) == set(PYTHON_FORMULAS) == set(ACTIVATIONS)


def small() -> Genome:
    """One input, a bias and an output that remembers itself: relu(2 x + 0.5 - 0.25 y')."""
    fields: dict[str, Any] = {
        "node_id": [1, 2, 3],
        "node_kind": [NodeKind.INPUT, NodeKind.BIAS, NodeKind.OUTPUT],
        "node_activation": [0, 0, ACTIVATIONS.index("relu")],
        "link_innovation": [1, 2, 3, 4],
        "link_source": [1, 2, 3, 1],
        "link_target": [3, 3, 3, 3],
        "link_weight": [2.0, 0.5, -0.25, 9.0],
        "link_enabled": [True, True, True, False],
        "link_recurrent": [False, False, True, True],
    }
    return Genome(genome_id=7, observation_schema="a */ \\ \n\u00fc", **fields)


STEPS = np.array([[1.0], [3.0], [-5.0]], np.float32)
BY_HAND = [[2.5], [2 * 3 + 0.5 - 0.25 * 2.5], [0.0]]
SCALED_BY_HAND = [[4 * 1 + 0.5], [2 * 3 + 0.5 - 0.25 * 4.5], [0.0]]
"""With (x + 1) / 1 within 3: the network reads 2, 3 and -3."""


def test_python_source_of_a_small_network_by_hand() -> None:
    assert python_steps(to_python(small()), STEPS).tolist() == BY_HAND
    scaled = to_python(small(), scaling=([-1.0], [1.0], 3.0))
    assert python_steps(scaled, STEPS).tolist() == SCALED_BY_HAND
    own: dict[str, Any] = {}
    exec(to_python(small()), own)
    assert own["step"]([1.0]) == ([2.5], [2.5])
    with pytest.raises(ValueError, match="expected 1 inputs and a state of 1"):
        own["step"]([1.0, 2.0])


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_the_c_header_of_a_small_network_by_hand(tmp_path: Path) -> None:
    assert c_steps(to_c(small()), tmp_path, STEPS, 1).tolist() == BY_HAND
    (tmp_path / "scaled").mkdir()
    scaled = to_c(small(), scaling=([-1.0], [1.0], 3.0))
    assert c_steps(scaled, tmp_path / "scaled", STEPS, 1).tolist() == SCALED_BY_HAND


def test_a_forward_and_a_recurrent_link_between_the_same_nodes_both_count() -> None:
    twice = small().replaced(
        link_source=[1, 1, 3, 2],
        link_weight=[0.5, 0.25, 9.0, 9.0],
        link_enabled=[True, True, False, False],
        link_recurrent=[False, True, True, False],
    )
    late = python_steps(to_python(twice), STEPS).tolist()
    assert late == [[0.5], [0.5 * 3 + 0.25 * 1], [0.0]]
    at_once = python_steps(to_python(twice, evaluation="synchronous"), STEPS).tolist()
    assert at_once == [[0.75], [0.75 * 3], [0.0]]


def test_tables_of_whole_numbers_are_as_small_as_they_can_be() -> None:
    for inputs, kind in ((200, "unsigned char"), (300, "unsigned short")):
        genome = initial_genome(inputs, 1, rng=np.random.default_rng(0))
        assert f"static const {kind} source[{inputs + 1}]" in to_c(genome)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_a_network_without_links_compiles_without_a_warning(tmp_path: Path) -> None:
    genome = small().replaced(
        link_enabled=[False] * 4, node_activation=[0, 0, ACTIVATIONS.index("identity")]
    )
    assert c_steps(to_c(genome), tmp_path, STEPS, 1).tolist() == [[0.0]] * 3
    assert python_steps(to_python(genome), STEPS).tolist() == [[0.0]] * 3


def test_the_sources_say_what_they_take_and_give() -> None:
    comment = ["The output is a force.\nIn newtons."]
    for text in (to_c(small(), comment=comment), to_python(small(), comment=comment)):
        assert text.isascii()
        assert "1 inputs, 1 outputs, 1 nodes," in text
        assert "3 links and a state of 1 numbers; genome 7." in text
        assert "The output is a force." in text
        assert "In newtons." in text
    assert "#define NETWORK_STATE 1" in to_c(small())
    assert "A call takes 16 bytes of stack." in to_c(small())


def test_two_networks_stand_beside_each_other_under_their_names() -> None:
    text = to_c(small(), name="left_leg")
    assert "void left_leg_step(" in text
    assert "#ifndef LEFT_LEG_H" in text
    for name in ("", "3legs", "left leg", "a(", "ü"):
        with pytest.raises(ConfigError, match="name: expected letters, digits"):
            to_c(small(), name=name)


@pytest.mark.parametrize("write", [to_c, to_python])
def test_a_scaling_that_does_not_fit_is_refused(write: Callable[..., str]) -> None:
    with pytest.raises(ConfigError, match=r"each of the 1 inputs, got shapes \(2,\) and \(1,\)"):
        write(small(), scaling=([0.0, 0.0], [1.0], 10.0))
    with pytest.raises(ConfigError, match="finite scales other than 0"):
        write(small(), scaling=([0.0], [1e-60], 10.0))


def test_an_evaluation_that_does_not_exist_is_refused() -> None:
    other: Any = "sync"
    genome = initial_genome(2, 1, rng=np.random.default_rng(0))
    for make in (to_c, to_python):
        with pytest.raises(ConfigError, match="expected 'settle' or 'synchronous'; got 'sync'"):
            make(genome, evaluation=other)
