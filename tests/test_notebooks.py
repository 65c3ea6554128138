"""Every notebook runs from its first cell to its last."""

from __future__ import annotations

import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))
CELL_LIMIT_SECONDS = 300


@pytest.mark.xfail(reason="the first notebook is not written yet", strict=True)
def test_there_is_a_notebook_to_run() -> None:
    assert NOTEBOOKS


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
    client.execute()
    cells = [cell for cell in content.cells if cell.cell_type == "code" and cell.source.strip()]
    assert cells, f"{notebook.name} holds no code"
    assert all(cell.execution_count for cell in cells)
