"""`neatq export`: what is written acts as the champion does in its run."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch

from neatq_envs.gymnasium_task import Interface
from neatq_envs.random_play import ObservationScaling
from neatq_torch.genome import Genome, load_genome, save_genome
from neatq_torch.learning import CandidateHeads, DiscreteHeads, Heads
from neatq_torch.network import GenomeNetwork
from neatq_trainers.cli import main
from neatq_trainers.config import RunConfig
from neatq_trainers.export import what_is_lost, what_it_gives
from neatq_trainers.folder import CHAMPION
from neatq_trainers.policy import ChampionPolicy, load_policy
from neatq_trainers.train import start

Tiny = Callable[..., RunConfig]
pytestmark = pytest.mark.usefixtures("without_pictures")


def recurrent(genome: Genome) -> Genome:
    """With one recurrent link more, from the first output to itself."""
    kept = ~(genome.link_recurrent & (genome.link_source == genome.link_target))
    end = genome.output_ids[0]
    new = {"link_innovation": 9_999, "link_source": end, "link_target": end, "link_weight": -0.7}
    new |= {"link_enabled": True, "link_recurrent": True}
    return genome.replaced(
        **{name: np.append(getattr(genome, name)[kept], value) for name, value in new.items()}
    )


@pytest.fixture(scope="module")
def runs(
    tiny: Tiny, tiny_walk: Tiny, tmp_path_factory: pytest.TempPathFactory, without_pictures: None
) -> dict[str, Path]:
    """Finished tiny runs whose champions remember."""
    choices = {"observes": "choice", "acts": "choice"}
    configs = {
        "walk": tiny_walk("described", generations=2),
        "one": tiny_walk("neatq", generations=2),
        "choices": tiny_walk("neat", "Spaces-v0", env_kwargs=choices, generations=1),
        "twice": tiny("committed"),
    }
    folder = tmp_path_factory.mktemp("runs")
    for name, config in configs.items():
        start(config, folder / name)
        champion = folder / name / CHAMPION
        save_genome(recurrent(load_genome(champion)), champion)
    return {name: folder / name for name in configs}


def observations(policy: ChampionPolicy, steps: int) -> np.ndarray:
    """Flat observations [steps, inputs], in a box at times far from what was ever seen."""
    rng = np.random.default_rng(5)
    space = None if policy.interface is None else policy.interface.observation
    if space is not None and space.shape == ():
        return np.eye(policy.network.inputs, dtype=np.float32)[rng.integers(0, 3, steps)]
    if space is None:  # far out, candidates are worth the same, up to rounding
        return rng.random((steps, policy.network.inputs), np.float32)
    return (5 * rng.normal(size=(steps, policy.network.inputs))).astype(np.float32)


def own(interface: Interface | None, flat: np.ndarray) -> Any:
    """An observation as the environment gives it."""
    if interface is not None and interface.observation.shape == ():
        return int(flat.argmax()) + int(interface.observation.start)  # type: ignore[attr-defined]
    return flat


@pytest.mark.parametrize("name", ["walk", "choices", "twice"])
def test_the_onnx_file_acts_as_the_policy_over_many_steps(
    runs: dict[str, Path], name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "champion.onnx"
    assert main(["export", str(runs[name]), "--onnx", str(path)]) == 0
    assert capsys.readouterr().out.startswith(f"neatq: {path}\nneatq: The champion of ")
    session, policy = onnxruntime.InferenceSession(path), load_policy(runs[name])
    assert isinstance(policy, ChampionPolicy)
    assert "observation: " in session.get_modelmeta().custom_metadata_map["neatq"]
    assert [one.name for one in session.get_outputs()] == ["action", "next_state"]
    assert all(isinstance(one.shape[0], str) for one in session.get_inputs())  # any batch
    size = session.get_inputs()[1].shape[1]
    state, seen = np.zeros((1, size), np.float32), observations(policy, 40)
    different = set()
    for flat in seen:
        found = session.run(None, {"observation": flat[None], "state": state})
        action, state = (np.asarray(one) for one in found)
        wanted = policy(own(policy.interface, flat))
        assert action[0].shape == np.shape(wanted)
        np.testing.assert_allclose(action[0], wanted, rtol=1e-5, atol=1e-5)
        different.add(action[0].tobytes())
    assert len(different) > 1


def by_comment(heads: Heads, outputs: np.ndarray) -> list[float]:
    """The action as the comment of the sources says that it is read."""
    assert isinstance(heads, CandidateHeads)
    count, low = heads.actions, heads.low.numpy()
    values = outputs[count * heads.candidates :]
    best = int(values.argmax()) if len(values) else 0
    unit = outputs[count * best : count * (best + 1)].clip(0, 1)
    return (low + heads.span.numpy() * unit).tolist()


@pytest.mark.parametrize("name", ["walk", "one"])
def test_the_sources_take_raw_observations_and_say_how_actions_are_read(
    runs: dict[str, Path], tmp_path: Path, name: str
) -> None:
    header, source = tmp_path / "my pilot.h", tmp_path / "pilot.py"
    command = ["export", str(runs[name] / CHAMPION), "--c", str(header), "--python", str(source)]
    assert main(command) == 0
    text = header.read_text()
    assert "static inline void my_pilot_step(" in text
    assert "static const float offset[" in text
    policy = load_policy(runs[name])
    assert isinstance(policy, ChampionPolicy)
    for line in what_it_gives(policy.heads, 0):
        assert line in " ".join(one.lstrip("/# ") for one in text.splitlines())
        assert line in " ".join(one.lstrip("/# ") for one in source.read_text().splitlines())
    code: dict[str, Any] = {}
    exec(source.read_text(), code)
    state = (0.0,) * code["STATE"]
    for flat in observations(policy, 30):
        output, state = code["step"](flat.tolist(), state)
        wanted = policy(flat)
        np.testing.assert_allclose(by_comment(policy.heads, np.array(output)), wanted, atol=1e-5)


def test_a_synchronous_network_that_acts_twice_is_told(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    assert main(["export", str(runs["twice"]), "--python", str(tmp_path / "a.py")]) == 0
    code: dict[str, Any] = {}
    text = (tmp_path / "a.py").read_text()
    assert "Twice a tick: after each call, call it with the observation before" in text
    exec(text, code)
    policy = load_policy(runs["twice"])
    assert isinstance(policy, ChampionPolicy)
    state, before = (0.0,) * code["STATE"], [0.0] * code["INPUTS"]
    for flat in observations(policy, 30):
        output, state = code["step"](flat.tolist(), state)
        _, state = code["step"](before, state)
        before = flat.tolist()
        wanted = policy(flat)
        np.testing.assert_allclose(by_comment(policy.heads, np.array(output)), wanted, atol=1e-5)


def test_a_genome_alone_is_written_as_the_bare_network(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    shutil.copy(runs["walk"] / CHAMPION, tmp_path / "alone.json")
    files = {end: tmp_path / f"3.{end}" for end in ("onnx", "h", "dot")}
    command = ["export", str(tmp_path / "alone.json"), "--onnx", str(files["onnx"])]
    assert main([*command, "--c", str(files["h"]), "--dot", str(files["dot"])]) == 0
    assert "network_3_step(" in files["h"].read_text()
    assert "offset" not in files["h"].read_text()
    assert files["dot"].read_text().startswith("digraph")
    network = GenomeNetwork(load_genome(tmp_path / "alone.json"))
    session, x = onnxruntime.InferenceSession(files["onnx"]), torch.rand(2, network.inputs)
    state = network.initial_state((2,))
    given = {"observation": x.numpy(), "state": state.numpy()}
    output, _ = session.run(["output", "next_state"], given)
    wanted = network.step(x, state)[0].detach()
    torch.testing.assert_close(torch.as_tensor(output), wanted, atol=1e-6, rtol=1e-6)


def test_choices_are_told_with_the_number_of_the_first() -> None:
    says = "action: k where output[k] is greatest, of equal ones the first."
    assert what_it_gives(DiscreteHeads(2), 0) == [says]
    assert what_it_gives(DiscreteHeads(2), -3)[0].startswith("action: k + -3 where")
    (single,) = what_it_gives(CandidateHeads(1, [-1.0], [2.0]), 0)
    assert single.endswith("clipped to [0, 1], low [-1.0], high [2.0].")
    (small,) = what_it_gives(CandidateHeads(1, [-1e-8, 0.0], [1e-8, 1234567.0]), 0)
    assert small.endswith("low [-1e-08, 0.0], high [1e-08, 1234567.0].")


def test_observations_that_differ_less_than_single_precision_can_tell_are_told() -> None:
    offset, scale = np.array([0.0, 1e9, 50.0]), np.array([1.0, 1e6, 1.0])
    assert what_is_lost(None) == what_is_lost(ObservationScaling(offset, scale)) == []
    (line,) = what_is_lost(ObservationScaling(offset, np.array([1.0, 0.5, 1.0])))
    assert "too little for single precision: only Python" in line


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["{run}"], "expected at least one of --onnx, --c, --python, --dot and --html FILE"),
        (["{tmp}", "--c", "{tmp}/a.h"], "no run"),
        (["{tmp}/nothing.json", "--c", "{tmp}/a.h"], "no run"),
        (["{run}/config.json", "--c", "{tmp}/a.h"], "expected a neatq-genome of version 1"),
        (["{run}", "--c", "{tmp}/nowhere/a.h"], "nowhere/a.h: No such file or directory"),
    ],
)
def test_what_cannot_be_exported_is_said_in_one_line(
    runs: dict[str, Path],
    command: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    filled = [one.format(run=runs["walk"], tmp=tmp_path) for one in command]
    assert main(["export", *filled]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_without_onnx_the_extra_is_named(
    runs: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("neatq_torch.interop.extras.find_spec", lambda name: None)
    assert main(["export", str(runs["walk"]), "--onnx", str(tmp_path / "a.onnx")]) == 2
    assert "to_onnx needs onnx: pip install 'neatq_torch[onnx]'" in capsys.readouterr().err


def test_a_table_has_no_network_to_export(
    tiny: Tiny, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start(tiny("qlearning", ticks=40), tmp_path / "run")
    assert main(["export", str(tmp_path / "run"), "--c", str(tmp_path / "a.h")]) == 2
    assert "qlearning has a table and no network to export" in capsys.readouterr().err
