"""Rules of the house that no other tool checks."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = ("neatq_torch", "envs/neatq_envs", "trainers/neatq_trainers")
PACKAGES = (*LIBRARY, "experiments/neatq_experiments")
TOP_LEVEL = {"neatq_torch", "neatq_envs", "neatq_trainers", "neatq_experiments"}
VAGUE_NAMES = {"utils", "util", "common", "helpers", "helper", "misc"}
MAX_FILE_LINES = 450
MAX_FUNCTION_LINES = 60
MAX_ARGUMENTS = 9
MAX_LIBRARY_LINES = 30_650
KEYWORDS = {"train", "compare"}
"""Functions of the public face with an argument for each option of their commands."""
TASK_WORDS = {"start", "observe", "step", "play"}
"""What modules of tasks are called with: each is a world of its own."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def package_files() -> list[Path]:
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def functions(path: Path) -> Iterator[Function]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, Function):
            yield node


def argument_count(function: Function) -> int:
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return len([a for a in named if a.arg not in ("self", "cls")])


def where(path: Path, node: Function) -> str:
    return f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"


def test_each_package_holds_python_files() -> None:
    for package in PACKAGES:
        assert (ROOT / package / "__init__.py").is_file(), f"{package} is not a package"


def test_no_file_or_folder_has_a_vague_name() -> None:
    vague = [
        str(path.relative_to(ROOT))
        for path in package_files()
        if VAGUE_NAMES & {path.stem, path.parent.name}
    ]
    assert not vague, f"name these after what they do: {vague}"


@pytest.mark.parametrize("folder", ["envs", "trainers", "experiments"])
def test_plain_folders_hold_one_package_and_no_module(folder: str) -> None:
    stray = [path.name for path in (ROOT / folder).glob("*.py")]
    assert not stray, f"{folder}/ is a folder, not a package; found {stray}"


def test_files_stay_short() -> None:
    long = {
        str(path.relative_to(ROOT)): lines
        for path in package_files()
        if (lines := len(path.read_text(encoding="utf-8").splitlines())) > MAX_FILE_LINES
    }
    assert not long, f"more than {MAX_FILE_LINES} lines: {long}"


def test_functions_stay_short() -> None:
    long = [
        f"{where(path, node)}: {lines} lines"
        for path in package_files()
        for node in functions(path)
        if (lines := (node.end_lineno or node.lineno) - node.lineno + 1) > MAX_FUNCTION_LINES
    ]
    assert not long, f"more than {MAX_FUNCTION_LINES} lines: {long}"


def test_functions_take_few_arguments() -> None:
    wide = [
        f"{where(path, node)}: {argument_count(node)} arguments"
        for path in package_files()
        for node in functions(path)
        if argument_count(node) > MAX_ARGUMENTS and node.name not in KEYWORDS
    ]
    assert not wide, f"more than {MAX_ARGUMENTS} arguments: {wide}"


def defined_names(path: Path) -> Iterator[str]:
    """What a module defines at its top: classes, functions, types and constants, private or not."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, Function | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            parts = (one for target in targets for one in ast.walk(target))
            yield from (one.id for one in parts if isinstance(one, ast.Name))


def test_no_name_stands_for_two_things() -> None:
    modules: dict[str, set[str]] = {}
    for path in package_files():
        for name in defined_names(path):
            modules.setdefault(name, set()).add(str(path.relative_to(ROOT)))
    twice = {
        name: sorted(paths)
        for name, paths in modules.items()
        if len(paths) > 1 and not name.startswith("__") and name not in TASK_WORDS
    }
    assert not twice, f"call one of each by another name, or import it: {twice}"


def test_a_robot_or_genome_is_in_a_slot_and_nowhere_else() -> None:
    other = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for package in ("neatq_torch/evolution", "neatq_torch/learning", "trainers/neatq_trainers")
        for path in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Name | ast.arg)
        and (node.id if isinstance(node, ast.Name) else node.arg) in ("place", "places")
    ]
    assert not other, f"expected slot or slots; got place or places: {other}"


def test_the_library_and_its_trainers_stay_small() -> None:
    files = [path for package in LIBRARY for path in (ROOT / package).rglob("*.py")]
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)
    assert lines <= MAX_LIBRARY_LINES, f"{lines} lines; take something out first"


@pytest.mark.parametrize("package", ["neatq_torch.genome", "neatq_torch.evolution", "neatq_envs"])
def test_importing_the_package_does_not_load_torch(package: str) -> None:
    folder = ROOT / ("envs" if package == "neatq_envs" else ".") / package.replace(".", "/")
    modules = [f"{package}.{path.stem}" for path in sorted(folder.glob("[!_]*.py"))]
    wanted = [name for name in modules if not name.startswith("neatq_envs.torchrl")]
    assert wanted, f"{package} holds no module yet"
    code = (
        f"import sys, {', '.join([package, *wanted])}\n"
        "print(sorted({'torch', 'torchrl', 'tensordict'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]", f"{package} loads {done.stdout.strip()}"


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """File names in a wheel that was built from a copy of the project with stray files in it."""
    copy = tmp_path_factory.mktemp("project")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    for package in PACKAGES:
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, copy / package, ignore=ignore)
    for stray in ("envs/stray.py", "trainers/stray.py", "experiments/stray.py", "stray.py"):
        (copy / stray).write_text("raise RuntimeError('a stray file was packaged')\n")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel"]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = (copy / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_the_wheel_installs_four_names_and_no_stray_file(wheel_names: list[str]) -> None:
    top_level = {name.split("/")[0] for name in wheel_names if ".dist-info/" not in name}
    assert top_level == TOP_LEVEL


def test_the_wheel_holds_every_file_of_the_packages(wheel_names: list[str]) -> None:
    wanted = {
        path.relative_to(ROOT / Path(package).parent).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert wanted <= set(wheel_names)
