"""Compiled functions where nothing can be written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="its user folders are found otherwise")
ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "neatq_torch",
    "envs/neatq_envs",
    "trainers/neatq_trainers",
    "experiments/neatq_experiments",
)
PROGRAM = """
import subprocess, sys
import neatq_torch.genome.rules, neatq_envs.mountain_car
from neatq_torch.genome.heredity import node_levels
import numpy as np
print(node_levels(np.array([0, 1]), np.array([1, 2]), 3).tolist())
assert neatq_torch.genome.rules.__file__.startswith(sys.argv[1])
if len(sys.argv) == 2:  # as a worker, once more
    subprocess.run([sys.executable, __file__, sys.argv[1], "worker"], check=True)
"""


@pytest.fixture
def locked(tmp_path: Path) -> dict[str, str]:
    """An environment in which nothing can be kept, not even by root: folders that are files."""
    for name in PACKAGES:
        package = ROOT / name
        ignored = shutil.ignore_patterns("__pycache__")
        copy = shutil.copytree(package, tmp_path / package.name, ignore=ignored)
        for folder in {path.parent for path in copy.rglob("*.py")}:
            (folder / "__pycache__").write_text("")
    names = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "NEATQ_COMPILES_IN_EACH_PROCESS")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    nowhere = os.devnull
    return environment | {"PYTHONPATH": str(tmp_path), "HOME": nowhere, "USERPROFILE": nowhere}


def test_without_a_place_to_write_all_works_and_one_warning_names_the_variable(
    locked: dict[str, str], tmp_path: Path
) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, "-B", str(tmp_path / "program.py"), str(tmp_path)]
    done = subprocess.run(command, env=locked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n") == ["[0, 1, 2]", "[0, 1, 2]", ""]
    assert done.stderr.count("Warning") == done.stderr.count("NUMBA_CACHE_DIR") == 1


def test_with_a_place_nothing_is_said_and_all_is_kept_there(
    locked: dict[str, str], tmp_path: Path
) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, "-B", str(tmp_path / "program.py"), str(tmp_path), "alone"]
    environment = locked | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert list((tmp_path / "kept").rglob("*.nbc"))


def test_what_two_processes_compile_never_has_the_same_number() -> None:
    code = (
        "import neatq_torch.jit\nfrom numba import njit\n@njit\ndef one():\n    return 1\none()\n"
    )
    code += "print(one.overloads[()].fndesc.uid)"
    command = [sys.executable, "-c", code]
    first, second = (subprocess.run(command, capture_output=True, check=True) for _ in range(2))
    assert first.stdout != second.stdout
