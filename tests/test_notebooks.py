"""Every notebook runs from its first cell to its last, on what everybody may import."""

from __future__ import annotations

import ast
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

import neatq_envs
import neatq_torch
import neatq_torch.interop

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
FACE = {
    "neatq_torch": neatq_torch.__all__,
    "neatq_torch.interop": neatq_torch.interop.__all__,
    "neatq_envs": neatq_envs.__all__,
}
MOST_NAMES = 40
CELL_LIMIT_SECONDS = 120
SHORTER = {
    "look_at_a_run": ("ticks=6000", "ticks=1500"),
    "what_learning_does": ("TICKS = 8000", "TICKS = 3000"),
    "who_teaches_whom": ("TICKS, LIFE = 12_000, 1_000", "TICKS, LIFE = 3_000, 1_000"),
}
"""Lengths of runs that take most of the time, unless NEATQ_NOTEBOOKS=full asks for all of it."""


def kernel_environment() -> dict[str, str]:
    """This process's environment: same packages, one thread, and no run chosen by the user."""
    environment = {name: value for name, value in os.environ.items() if name != "NEATQ_RUN"}
    packages = os.pathsep.join(str(Path(folder).resolve()) for folder in sys.path if folder)
    return environment | {"PYTHONPATH": packages, "OMP_NUM_THREADS": "1"}


def code_of(path: Path) -> str:
    """A script, or the code of a notebook without what only IPython understands."""
    if path.suffix == ".py":
        return path.read_text(encoding="utf-8")
    cells = nbformat.read(path, as_version=nbformat.NO_CONVERT).cells
    lines = [line for one in cells if one.cell_type == "code" for line in one.source.splitlines()]
    return "\n".join(line for line in lines if not line.startswith("%"))


def hidden_imports(code: str) -> list[str]:
    """What code imports of this project beside its public face."""
    hidden = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            hidden += [one.name for one in node.names if one.name not in FACE]
        elif isinstance(node, ast.ImportFrom):
            home = node.module or ""
            names = [one.name for one in node.names if one.name not in FACE.get(home, ())]
            hidden += [f"{home}: {name}" for name in names]
    return [one for one in hidden if one.startswith("neatq_")]


def test_there_is_a_notebook_to_run() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", [*NOTEBOOKS, *EXAMPLES], ids=lambda path: path.name)
def test_what_is_there_to_copy_imports_the_public_face_only(path: Path) -> None:
    assert not hidden_imports(code_of(path))


def test_an_import_from_within_is_found() -> None:
    code = "import neatq_torch as nq, neatq_trainers\nfrom neatq_envs import ArenaEnv, arena"
    assert hidden_imports(code) == ["neatq_trainers", "neatq_envs: arena"]


def test_the_public_face_stays_small() -> None:
    assert len(neatq_torch.__all__) <= MOST_NAMES


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_is_valid_and_was_saved_without_outputs(notebook: Path) -> None:
    content = nbformat.read(notebook, as_version=nbformat.NO_CONVERT)
    nbformat.validate(content)
    cells = [cell for cell in content.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)


def shorten(content: Any, name: str) -> None:
    """Make the run of a notebook shorter, and nothing else."""
    if name not in SHORTER or os.environ.get("NEATQ_NOTEBOOKS") == "full":
        return
    (cell,) = (one for one in content.cells if SHORTER[name][0] in one.source)
    cell.source = cell.source.replace(*SHORTER[name])


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_runs_to_its_end(notebook: Path, tmp_path: Path) -> None:
    folder = tmp_path / "notebooks"
    shutil.copytree(notebook.parent, folder, ignore=shutil.ignore_patterns(".ipynb_checkpoints"))
    content = nbformat.read(folder / notebook.name, as_version=4)
    shorten(content, notebook.stem)
    client = NotebookClient(
        content,
        timeout=CELL_LIMIT_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute(env=kernel_environment())
    cells = [cell for cell in content.cells if cell.cell_type == "code" and cell.source.strip()]
    assert cells, f"{notebook.name} holds no code"
    assert all(cell.execution_count for cell in cells)
    pictures = [output for cell in cells for output in cell.outputs if "image/png" in str(output)]
    assert pictures, f"{notebook.name} shows no picture"
