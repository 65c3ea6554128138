"""Every notebook runs from its first cell to its last."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))
CELL_LIMIT_SECONDS = 120


def kernel_environment() -> dict[str, str]:
    """This process's environment: same packages, one thread, and no run chosen by the user."""
    environment = {name: value for name, value in os.environ.items() if name != "NEATQ_RUN"}
    packages = os.pathsep.join(str(Path(folder).resolve()) for folder in sys.path if folder)
    return environment | {"PYTHONPATH": packages, "OMP_NUM_THREADS": "1"}


def test_there_is_a_notebook_to_run() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_is_valid_and_was_saved_without_outputs(notebook: Path) -> None:
    content = nbformat.read(notebook, as_version=nbformat.NO_CONVERT)
    nbformat.validate(content)
    cells = [cell for cell in content.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_runs_to_its_end(notebook: Path, tmp_path: Path) -> None:
    folder = tmp_path / "notebooks"
    shutil.copytree(notebook.parent, folder, ignore=shutil.ignore_patterns(".ipynb_checkpoints"))
    content = nbformat.read(folder / notebook.name, as_version=4)
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
