"""Bad input: exit status 2, words that help, no traceback, nothing lost."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neatq_trainers.cli import main
from neatq_trainers.config import Arm, RunConfig, preset
from neatq_trainers.run_folder import CHECKPOINT, CONFIG, METRICS, RunFolder
from neatq_trainers.train import start

Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def neatq(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Say:
    """Run the command in an empty folder; returns status, standard output and standard error."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")

    def run(*arguments: str) -> tuple[int, str, str]:
        try:
            status = main(arguments)
        except SystemExit as end:
            status = int(end.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


@pytest.fixture(scope="module")
def done(tiny: Callable[..., RunConfig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("done") / "run"
    start(tiny("rtneat", ticks=100), folder)
    return folder


def words(text: str) -> str:
    """The words of a text that may stand in a box."""
    return " ".join(re.sub(r"[^\x20-\x7e]", " ", text).split())


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (
            ["train", "--task", "nope"],
            "task: expected flag, moving, wall, trap, maze, switch or .* got 'nope'",
        ),
        (["train", "--arm", "nope"], "arm: expected one of rtneat, .* got 'nope'"),
        (["train", "--task"], "--task: expected one argument"),
        (["train", "--task", "none.json"], "none.json: cannot be read: No such file"),
        (["train", "--ticks", "-5"], "ticks: expected at least 1, got -5"),
        (["train", "--ticks", "0"], "ticks: expected at least 1, got 0"),
        (["train", "--seed", "-1"], "seed: expected at least 0, got -1"),
        (["train", "--arenas", "0"], "arenas: expected at least 1, got 0"),
        (["train", "--batch-ticks", "0"], "batch_ticks: expected at least 1, got 0"),
        (["train", "--scenario.robots", "1"], "scenario.robots: expected at least 2, got 1"),
        (["train", "--network.candidates", "1"], "network.candidates: expected at least 2, got 1"),
        (["resume", "nowhere"], "nowhere: no run to go on with"),
        (["trian"], "expected train, resume, compare or reproduce; got 'trian'; see neatq --help"),
    ],
)
def test_bad_input_is_answered_in_one_line(neatq: Say, arguments: list[str], pattern: str) -> None:
    status, out, error = neatq(*arguments)
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: .*{pattern}.*\n", error), error
    assert not os.listdir()


@pytest.mark.parametrize(
    ("option", "value", "pattern"),
    [
        ("scenario.robots", "0", "robots: expected a whole number of at least 1, got 0"),
        ("scenario.lifetime-ticks", "-3", "lifetime_ticks: expected .* at least 0, got -3"),
        ("scenario.max-speed", "nan", "max_speed: expected a finite number, got nan"),
        (
            "learning.step.learning-rate",
            "nan",
            "learning_rate: expected a finite number of at least 0, got nan",
        ),
        (
            "learning.step.learning-rate",
            "-1",
            "learning_rate: expected a finite number of at least 0, got -1",
        ),
        ("learning.epsilon", "2", r"epsilon: expected a number in \[0, 1\], got 2"),
        ("network.candidates", "0", "candidates: expected at least 1, got 0"),
        ("network.activation", "cubic", "activation: expected one of identity, .* got 'cubic'"),
        ("evolution.minimum-life-ticks", "0", "minimum_life_ticks must be at least 1, not 0"),
        ("ticks", "abc", "--ticks: invalid literal .* 'abc'"),
        ("logger", "paper", "invalid choice 'paper'"),
        ("tick", "5", "Unrecognized options: --tick.*Perhaps you meant.*--ticks"),
    ],
)
def test_a_bad_value_of_an_option_is_named(
    neatq: Say, option: str, value: str, pattern: str
) -> None:
    status, out, error = neatq("train", f"--{option}", value)
    assert (status, out) == (2, "")
    assert re.search(pattern, words(error)), error
    assert "Traceback" not in error
    assert not os.listdir()


@pytest.mark.parametrize(
    ("content", "pattern"),
    [
        ('{"name":', "is not JSON"),
        ("[]", "expected an object"),
        ({"name": "x", "robots": 0}, "robots: expected .* at least 1, got 0"),
        ({"name": "x", "lifetime_ticks": -1}, "lifetime_ticks: expected .* at least 0, got -1"),
        ({"name": "x", "robot": 5}, 'unknown key "robot".*robots'),
        (
            {
                "name": "x",
                "spawns": [{"x": 400, "y": 300}],
                "walls": [{"x": 400, "y": 300, "width": 50, "height": 50}],
            },
            r"spawns\[0\] at \(400, 300\).* inside walls\[0\]; move",
        ),
    ],
)
def test_a_bad_scenario_file_is_named(neatq: Say, content: Any, pattern: str) -> None:
    text = content if isinstance(content, str) else json.dumps(content)
    Path("world.json").write_text(text)
    status, out, error = neatq("train", "--task", "world.json")
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: world\.json: .*{pattern}.*\n", error), error
    assert os.listdir() == ["world.json"]


def test_an_existing_run_is_not_overwritten(neatq: Say, done: Path) -> None:
    before = {path.name: path.read_bytes() for path in done.iterdir() if path.is_file()}
    status, _, error = neatq("train", "--out", str(done))
    assert status == 2
    assert error.endswith(f"go on with the run in it: neatq resume {done}\n")
    assert {path.name: path.read_bytes() for path in done.iterdir() if path.is_file()} == before


def test_a_folder_that_cannot_be_made_is_named(neatq: Say) -> None:
    Path("file").touch()
    status, _, error = neatq("train", "--out", "file/run")
    assert (status, error) == (2, "neatq: error: file/run: Not a directory\n")


@pytest.mark.parametrize(
    ("code", "reason"),
    [(errno.EACCES, "Permission denied"), (errno.ENOSPC, "No space left on device")],
)
def test_a_folder_that_cannot_be_written_is_named(
    neatq: Say, monkeypatch: pytest.MonkeyPatch, code: int, reason: str
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(code, reason)

    monkeypatch.setattr(os, "fsync", refuse)
    status, _, error = neatq("train", "--out", "run")
    config = Path("run") / CONFIG
    assert (status, error) == (2, f"neatq: error: {config}: {reason}\n")
    assert os.listdir("run") == []


@pytest.mark.parametrize(
    ("name", "damage", "pattern"),
    [
        (CHECKPOINT, lambda content: content[:-100], "truncated or altered"),
        (CHECKPOINT, lambda content: content[:500] + b"?" + content[501:], "altered"),
        (METRICS, lambda content: content[:-10], "altered"),
        (CONFIG, lambda content: content[:-10], "altered or damaged"),
        (CONFIG, lambda content: content.replace(b'"seed": 1', b'"seed": 2'), "not the config"),
    ],
)
def test_a_damaged_run_is_refused_and_nothing_of_it_changes(
    neatq: Say, done: Path, name: str, damage: Callable[[bytes], bytes], pattern: str
) -> None:
    run = Path(shutil.copytree(done, "run"))
    (run / name).write_bytes(damage((run / name).read_bytes()))
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    status, out, error = neatq("resume", "run", "--ticks", "200")
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: run/{re.escape(name)}: .*{pattern}.*\n", error), error
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_fewer_ticks_than_the_run_has_are_refused(neatq: Say, done: Path) -> None:
    for ticks, pattern in (("50", "has 1[0-9]+ already, got 50"), ("-1", "at least 1, got -1")):
        status, _, error = neatq("resume", str(done), "--ticks", ticks)
        assert status == 2
        assert re.fullmatch(f"neatq: error: ticks: .*{pattern}.*\n", error), error


def test_help_explains_every_command(neatq: Say) -> None:
    for arguments, wanted in (
        (["--help"], "neatq train"),
        (["-h"], "neatq resume"),
        (["train", "--help"], "Train a population"),
        (["resume", "--help"], "Go on with a run"),
    ):
        status, out, error = neatq(*arguments)
        assert (status, error) == (0, "")
        assert wanted in out


def test_the_help_of_train_shows_the_defaults_of_the_chosen_arm(neatq: Say) -> None:
    arms: tuple[Arm, ...] = ("neatq", "qlearning")
    for arm in arms:
        text = words(neatq("train", "--arm", arm, "--help")[1])
        found = re.search(r"--learning\.step\.learning-rate FLOAT .*?\(default: ([0-9.]+)\)", text)
        assert found, text
        assert float(found[1]) == preset("wall", arm).learning.step.learning_rate


def test_without_arguments_it_says_what_it_can_do(neatq: Say) -> None:
    status, out, error = neatq()
    assert (status, error) == (2, "")
    assert out.startswith("usage: neatq")


def test_a_run_says_what_it_wrote_and_nothing_else_when_there_is_no_terminal(
    tmp_path: Path,
) -> None:
    code = "import sys; from neatq_trainers.cli import main; sys.exit(main())"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    world = ["--scenario.robots", "5", "--scenario.lifetime-ticks", "50"]
    options = [*world, "--evolution.minimum-life-ticks", "50", "--ticks", "100", "--seed", "3"]
    done = subprocess.run(
        [sys.executable, "-c", code, "train", "--arm", "described", *options],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    wanted = "metrics.csv, curves.png, arena.png, team.gif, champion.json"
    assert done.stdout == f"neatq: runs/wall-described-seed3: {wanted}\n"
    assert RunFolder.open(tmp_path / "runs" / "wall-described-seed3").read().tick >= 100
