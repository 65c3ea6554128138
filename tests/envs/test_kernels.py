"""What numba compiles and keeps on disk must not go stale, and must be exact."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
from types import ModuleType
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

import neatq_envs
import neatq_torch.genome

MODULES = [
    importlib.import_module(f"{package.__name__}.{entry.name}")
    for package in (neatq_envs, neatq_torch.genome)
    for entry in pkgutil.iter_modules(package.__path__)
]
KERNELS = [
    pytest.param(module, kernel, id=f"{module.__name__}.{name}")
    for module in MODULES
    for name, kernel in vars(module).items()
    if isinstance(kernel, Dispatcher) and kernel.__module__ == module.__name__
]


def made_in(module: ModuleType) -> set[str]:
    """Return the names that a file gives to its own functions and constants."""
    names = set()
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
    return names


@pytest.mark.parametrize(("module", "kernel"), KERNELS)
def test_a_kernel_depends_on_its_own_file_alone(module: ModuleType, kernel: Any) -> None:
    # numba compiles a kernel anew when its file has changed, and looks at no other file: what
    # other files define must come as an argument.
    for name in kernel.py_func.__code__.co_names:
        value = vars(module).get(name)
        if value is not None and not isinstance(value, ModuleType | type):
            assert name in made_in(module), f"{name} comes from another file"


@pytest.mark.parametrize(("module", "kernel"), KERNELS)
def test_a_kernel_is_exact_and_kept_on_disk(module: ModuleType, kernel: Any) -> None:
    assert not kernel.targetoptions.get("fastmath") and not kernel.targetoptions.get("parallel")
    assert kernel.stats.cache_path is not None, "compile with cache=True"
