"""Run folders whose files were changed: told as damage, by name, whatever the change."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import neatq_torch as nq
from neatq_envs.processes import ProcessEnded
from neatq_torch.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from neatq_torch.json_text import parse_json
from neatq_trainers.saved import restoring

RELEASED = Path(__file__).parents[1] / "data" / "release-0.2.0"
Edit = Callable[[dict[str, Any]], object]
pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture
def arena(tmp_path: Path) -> Path:
    return Path(shutil.copytree(RELEASED / "arena", tmp_path / "arena"))


@pytest.fixture
def gymnasium(tmp_path: Path) -> Path:
    return Path(shutil.copytree(RELEASED / "gymnasium", tmp_path / "gymnasium"))


def edited(folder: Path, edit: Edit) -> None:
    """Change what the checkpoint holds, with right checksums and digest."""
    path = folder / "checkpoint.npz"
    state = load_checkpoint(path)
    edit(state)
    schema = nq.load_run(folder).config.world.schema
    save_checkpoint(path, state, observation_schema=schema)


def run_of(state: dict[str, Any]) -> dict[str, Any]:
    return state["runs"][0]


def test_a_run_that_selected_by_novelty_is_refused(arena: Path) -> None:
    path = arena / "config.json"
    config = json.loads(path.read_text())
    assert config["population"]["novelty"] is None  # as runs of 0.2.0 have it
    assert nq.load_run(arena).config.population is not None
    config["population"]["novelty"] = 0.5
    path.write_text(json.dumps(config))
    with pytest.raises(ValueError, match=r"population\.novelty: .* version 0\.2\.0"):
        _ = nq.load_run(arena).config


EDITS: dict[str, Edit] = {
    "no runs": lambda state: state.pop("runs"),
    "empty runs": lambda state: state.update(runs=[]),
    "two runs": lambda state: state["runs"].append(state["runs"][0]),
    "no tick": lambda state: run_of(state).pop("tick"),
    "a tick before the first": lambda state: run_of(state).update(tick=-1),
    "done is a text": lambda state: state["done"].update(ticks="160"),
    "a flat track": lambda state: state.update(track=np.zeros(5, np.float32)),
    "facts of nothing": lambda state: state.update(facts={"value_range": [0]}),
    "no weights": lambda state: run_of(state).pop("weight"),
    "weights of fewer": lambda state: run_of(state).update(weight=run_of(state)["weight"][:-1]),
    "no genomes": lambda state: run_of(state)["populations"][0].pop("genomes"),
    "half of the genes": lambda state: run_of(state)["populations"][0]["genomes"].update(
        link_source=np.arange(3, dtype=np.int32)
    ),
    "no random numbers": lambda state: run_of(state)["populations"][0]["rng"].update(state=None),
    "no world": lambda state: run_of(state).pop("world"),
    "headings of fewer": lambda state: run_of(state)["world"].update(heading_rad=np.zeros((1, 2))),
    "flags of float16": lambda state: run_of(state)["world"].update(
        flag=np.zeros((1, 2), np.float16)
    ),
    "exploration for two arenas": lambda state: run_of(state)["policy"]["exploration"].update(
        held=np.zeros((2, 3), np.int64)
    ),
}


@pytest.mark.parametrize("name", EDITS)
def test_a_checkpoint_that_does_not_fit_the_run_is_damaged(arena: Path, name: str) -> None:
    edited(arena, EDITS[name])
    with pytest.raises(CheckpointError, match=r"checkpoint\.npz: (damaged|not)"):
        nq.resume(arena, ticks=320, workers=1)


def test_a_checkpoint_that_was_only_written_anew_goes_on(arena: Path) -> None:
    edited(arena, lambda state: None)
    assert nq.resume(arena, ticks=320, workers=1).metrics()["tick"].tolist() == [100, 200, 300]


BROKEN = {
    "nothing": "",
    "a list": "[1]",
    "nested": "[" * 100_000,
    "nested objects": '{"a":' * 900 + "1" + "}" * 900,
    "a key twice": '{"task": "wall", "task": "flag"}',
    "5000 digits": '{"seed": ' + "9" * 5000 + "}",
    "no text": "\udcff",
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_damaged_configuration_is_told(arena: Path, name: str) -> None:
    (arena / "config.json").write_bytes(BROKEN[name].encode(errors="surrogateescape"))
    with pytest.raises(CheckpointError, match=r"config\.json: altered or damaged"):
        nq.load_run(arena)


@pytest.mark.parametrize(
    ("name", "text"),
    [("seed", "1e400"), ("seed", "NaN"), ("seed", "true"), ("world", '["x"]'), ("ticks", "-5")],
)
def test_an_impossible_value_in_a_configuration_is_told(arena: Path, name: str, text: str) -> None:
    values = (arena / "config.json").read_text()
    values = values.replace(f'"{name}": ', f'"{name}": {text}, "x": ', 1)
    (arena / "config.json").write_text(values)
    with pytest.raises(CheckpointError, match=r"config\.json: altered or damaged"):
        nq.load_run(arena)


@pytest.mark.parametrize("name", BROKEN)
def test_damaged_results_and_scalings_are_told(gymnasium: Path, name: str) -> None:
    for file in ("result.json", "scaling.json"):
        (gymnasium / file).write_bytes(BROKEN[name].encode(errors="surrogateescape"))
    with pytest.raises(CheckpointError, match=r"result\.json: altered or damaged"):
        nq.load_run(gymnasium).result()
    with pytest.raises(CheckpointError, match=r"scaling\.json: altered or damaged"):
        nq.load_policy(gymnasium)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("inf"), float("nan")])
def test_a_scale_that_is_none_is_told(gymnasium: Path, scale: float) -> None:
    path = gymnasium / "scaling.json"
    values = parse_json(path.read_bytes())
    values["observation"]["scale"][1] = scale
    path.write_text(json.dumps(values))
    with pytest.raises(CheckpointError, match=r"scaling\.json: .*positive scale"):
        nq.load_policy(gymnasium)


@pytest.mark.parametrize("error", [ProcessEnded("killed"), OSError("full"), MemoryError()])
def test_what_is_no_fault_of_a_checkpoint_is_not_called_so(error: Exception) -> None:
    with pytest.raises(type(error)), restoring():
        raise error
