"""What `import neatq_torch as nq` gives: names that are there, explained, and imported late."""

from __future__ import annotations

import ast
import builtins
import doctest
import inspect
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import neatq_torch as nq
from neatq_envs.scenario import TASKS
from neatq_envs.torchrl_env import ArenaEnv

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"neatq_torch": "", "neatq_envs": "envs", "neatq_trainers": "trainers"}
OWN = {"CorridorEnv", "MyConfig", "MyPopulation", "make_mine"}
"""What a user has written, in examples."""
GIVEN = {"Genome", "Replacement"}
"""What others make, so that an example uses one without its name."""
LONG = {"compare", "load_policy", "load_run", "resume", "train"}
"""Examples that call one of these are read, not run: `tests/test_examples.py` runs such."""


def example_of(name: str) -> list[doctest.Example]:
    text = inspect.getdoc(getattr(nq, name)) or ""
    return doctest.DocTestParser().get_examples(text.partition("Example:")[2])


def namespace() -> dict[str, Any]:
    """What an example may take as given: a team in the arena, and everything public."""
    env = ArenaEnv(TASKS["flag"], arenas=1, seed=0)
    heads = nq.CandidateHeads(3, [-1.0, -0.2], [1.0, 0.2])
    slots, inputs = env.batch_size[1], env.observation_spec["observation"].shape[-1]
    population = nq.RtNEAT.start(
        nq.RtNEATConfig(),
        slots=slots,
        inputs=inputs,
        outputs=heads.outputs,
        rng=np.random.default_rng(0),
    )
    given = {name: getattr(nq, name) for name in nq.__all__}
    given |= {"torch": torch, "np": np, "gymnasium": gymnasium, "dataclass": dataclass}
    given |= {"env": env, "heads": heads, "population": population}
    given["network"] = nq.PopulationNetwork(population.genomes, shape=(1, slots))
    return given | {"genome": population.genomes[0], "__name__": "__main__"}


def test_there_are_few_names_in_order() -> None:
    assert list(nq.__all__) == sorted(set(nq.__all__))
    assert 30 <= len(nq.__all__) <= 40
    assert set(nq.__all__) <= set(dir(nq))


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'neatq_torch' has no attribute 'nothing'"):
        _ = nq.nothing  # type: ignore[attr-defined]


def test_type_checkers_see_the_same_names() -> None:
    tree = ast.parse((ROOT / "neatq_torch" / "__init__.py").read_text())
    (checking,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.asname: (node.module, alias.name)
        for node in checking.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == {name: (home, name) for name, home in nq._HOME_OF.items()}


@pytest.mark.parametrize("name", nq.__all__)
def test_every_name_has_an_example_whose_names_are_there(name: str) -> None:
    known = {*nq.__all__, *dir(builtins), *OWN, "torch", "np", "gymnasium", "dataclass"}
    known |= {"env", "heads", "population", "network", "genome"}
    lines = example_of(name)
    assert lines, f"{name}: no Example: in its docstring"
    tree = ast.parse("".join(line.source for line in lines))
    used = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    made = {node.id for node in used if isinstance(node.ctx, ast.Store)}
    made |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    made |= {getattr(node, "name", None) for node in ast.walk(tree)}
    assert {node.id for node in used} - known - made == set()
    assert name in {node.id for node in used} | GIVEN


@pytest.mark.parametrize("name", nq.__all__)
def test_short_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines, given = example_of(name), namespace()
    words = {
        node.id
        for line in lines
        for node in ast.walk(ast.parse(line.source))
        if isinstance(node, ast.Name)
    }
    if words & (LONG | OWN):
        pytest.skip("reads only")
    monkeypatch.chdir(tmp_path)
    nq.save_genome(given["genome"], "champion.json")
    test = doctest.DocTest(lines, given, name, None, None, None)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    said: list[str] = []
    runner.run(test, out=said.append)
    assert not runner.failures, "".join(said)


def test_importing_it_imports_nothing_else() -> None:
    code = (
        "import sys, neatq_torch\n"
        "heavy = {'torch', 'torchrl', 'numpy', 'gymnasium', 'neatq_envs', 'neatq_trainers'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_nobody_imports_everything() -> None:
    """`from neatq_torch import *` would load all that is imported late."""
    files = [path for path in ROOT.glob("*/**/*.py") if ".venv" not in path.parts]
    starred = [
        f"{path}:{node.lineno}"
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and any(one.name == "*" for one in node.names)
        if (node.module or "").startswith("neatq")
    ]
    assert not starred


@pytest.mark.parametrize("other", ["neatq_envs", "neatq_trainers"])
def test_two_copies_of_the_project_are_not_mixed(tmp_path: Path, other: str) -> None:
    """As when one is installed, and Python was started in the folder of the other."""
    for name in ("here", "there"):
        for package, folder in PACKAGES.items():
            own = tmp_path / name / folder / package
            own.mkdir(parents=True)
            (own / "__init__.py").touch()
        shutil.copy(ROOT / "neatq_torch" / "__init__.py", tmp_path / name / "neatq_torch")
    wrong = tmp_path / "there" / PACKAGES[other]
    right = [tmp_path / "here" / folder for folder in PACKAGES.values()]
    for paths, words in ((right, ""), ([wrong, *right], "two copies of the project are mixed")):
        path = [str(one) for one in paths if other not in words]
        if words:  # the folder of this package alone comes first
            path = [str(right[0]), *path]
        code = f"import sys; sys.path[:0] = {path}; import neatq_torch"
        command = [sys.executable, "-S", "-c", code]
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, cwd=tmp_path, env={}
        )
        assert bool(done.returncode) == bool(words), done.stderr
        assert words in done.stderr
        if words:
            assert f"neatq_torch comes from {tmp_path / 'here'}, but {other} from" in done.stderr
