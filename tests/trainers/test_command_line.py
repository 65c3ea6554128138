"""Bad input: exit status 2, words that help, no traceback, nothing lost."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import multiprocessing
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import tyro

from neatq_envs import TASKS
from neatq_torch.checkpoint import load_checkpoint
from neatq_torch.evolution import population_kinds
from neatq_torch.learning import learner_kinds
from neatq_trainers import train as trainer
from neatq_trainers.arms import ARMS, preset
from neatq_trainers.cli import main
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHECKPOINT, CONFIG, METRICS, load_run
from neatq_trainers.options import options_of, with_options
from neatq_trainers.train import start

Say = Callable[..., tuple[int, str, str]]
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def done(tiny: Callable[..., RunConfig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("done") / "run"
    start(tiny("rtneat", ticks=100), folder)
    return folder


def words(text: str) -> str:
    """The words of a text that may stand in a box."""
    return " ".join(re.sub(r"[^\x20-\x7e]", " ", text).split())


CART_POLE = ["--task", "gym:CartPole-v1"]


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (
            ["train", "--task", "nope"],
            "task: expected flag, moving, wall, .*switch, behind,.* got 'nope' .*worlds.md",
        ),
        (["train", "--arm", "nope"], "arm: expected one of rtneat, .* got 'nope' .*arms.md"),
        (
            ["train", "--population", "nope"],
            "population: expected one of rtneat, .* 'nope' .*arms.md",
        ),
        (["train", "--learner", "nope"], "learner: expected one of none, td, .* got 'nope'"),
        (["train", "--learner", "no_such:one"], "learner: no_such:one: No module .*PYTHONPATH"),
        (["train", "--task"], "--task: expected one argument"),
        (["train", "--task", "none.json"], "none.json: cannot be read: No such file"),
        (["train", "--ticks", "-5"], "ticks: expected at least 1 or None, got -5"),
        (["train", "--ticks", "0"], "ticks: expected at least 1 or None, got 0"),
        (["train", "--steps", "5"], "steps: the length of a run on wall is given in ticks"),
        (
            ["train", *CART_POLE, "--ticks", "5"],
            "ticks: the length of a run on gym:CartPole-v1 is given in steps or generations",
        ),
        (
            ["train", *CART_POLE, "--steps", "5", "--generations", "5"],
            "expected one length, steps or generations; got steps and generations",
        ),
        (["train", "--seed", "-1"], "seed: expected at least 0, got -1"),
        (["train", "--arenas", "0"], "arenas: expected at least 1, got 0"),
        (["train", "--workers", "0"], "workers: expected at least 1, got 0"),
        (["train", "--batch-ticks", "0"], "batch_ticks: expected at least 1 or None, got 0"),
        (["train", "--env-kwargs", "robots"], "env_kwargs: expected name=value.* got 'robots'"),
        (["train", "--env-kwargs", "robots=1"], "robots: expected at least 2, got 1"),
        (["train", "--env-kwargs", "robots=0"], "robots: expected a whole number .* got 0"),
        (["train", "--env-kwargs", "robot=5"], 'unknown key "robot".*robots'),
        (["train", "--env-kwargs", "lifetime_ticks=-3"], "lifetime_ticks: .* from 0 to .*, got -3"),
        (
            ["train", "--env-kwargs", "max_speed=NaN"],
            "max_speed: expected a number .finite. from .*, got nan",
        ),
        (["train", "--robots", "9"], "robots: .* expected --env-kwargs robots=VALUE"),
        (["train", "--scenario.robots", "9"], "robots: .* expected --env-kwargs robots=VALUE"),
        (["train", "--network.candidates", "0"], "network.candidates: expected at least 1, got 0"),
        (
            ["train", "--arm", "replay", "--network.candidates", "1"],
            "network.candidates: expected at least 2, got 1",
        ),
        (
            ["train", "--network.candidates", "5"],
            "network.candidates: expected 1, got 5; where a critic judges",
        ),
        (
            ["train", "--arm", "rtneat", "--learner", "td"],
            "network.candidates: expected at least 2, got 1",
        ),
        (["train", "--network.value-range", "3", "1"], "network.value_range: .* smaller first"),
        (
            ["train", "--network.activation", "cubic"],
            "network.activation: expected one of ident",
        ),
        (["train", "--learner.epsilon", "2"], r"learner.epsilon: expected \[0, 1\], got 2"),
        (
            ["train", "--learner.learning-rate", "nan"],
            r"learner.learning_rate: expected \[0, inf\), got nan",
        ),
        (["train", "--learner.max-hold-ticks", "0"], "learner.max_hold_ticks: .* least 1, got 0"),
        (
            ["train", "--population.minimum-life-ticks", "0"],
            "population.minimum_life_ticks: expected at least 1, got 0",
        ),
        (
            ["train", "--population.reproduction.mutation.add-node-prob", "3"],
            r"population.reproduction.mutation.add_node_prob: .*\[0, 1\], got 3.0",
        ),
        (
            ["train", *CART_POLE, "--arm", "neat", "--population.survival-share", "3"],
            r"population.survival_share: expected \[0, 1\], got 3",
        ),
        (["train", *CART_POLE, "--world.every", "0"], "world.every: expected at least 1, got 0"),
        (["train", *CART_POLE, "--world.slots", "1"], "world.slots: expected at least 2, got 1"),
        (
            ["train", "--arm", "neat", "--env-kwargs", "lifetime_ticks=0"],
            "lifetime_ticks: expected above 0, got 0",
        ),
        (["train", "--arm", "qnetwork", "--learner", "none"], "learner: a fixed population with"),
        (
            ["train", "--arm", "qlearning", "--learner", "td"],
            "learner: the arm qlearning has no ne",
        ),
        (["train", "--learner", "table"], "learner: a table knows no genome"),
        (
            ["train", "--arm", "neat+q", "--population", "rtneat", "--learner.anneal"],
            "learner.anneal: expected lives of a number of episodes",
        ),
        (["train", *CART_POLE, "--arm", "qlearning"], "arm: qlearning does not run on gym:.*qnet"),
        (["train", "--task", "CartPole-v1"], r"got 'CartPole-v1'; did you mean gym:CartPole-v1\?"),
        (["resume", "nowhere"], "nowhere: no run; there is no"),
        (["list", "arms"], "list: expected no arguments, got arms"),
        (
            ["trian"],
            "expected one of train, resume, play, export, .*, info; got 'trian'; see neatq --help",
        ),
    ],
)
def test_bad_input_is_answered_in_one_line(neatq: Say, arguments: list[str], pattern: str) -> None:
    status, out, error = neatq(*arguments)
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: .*{pattern}.*\n", error), error
    assert not os.listdir()


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (
            ["--arm", "rtneat", "--learner.epsilon", "0.1"],
            "learner.epsilon: .* the learner of the arm rtneat on wall is none; known to td",
        ),
        (
            ["--arm", "rtneat", "--population.elite-members", "0.1"],
            "population.elite_members: .* is rtneat; known to neat",
        ),
        (["--arm", "rtneat", "--network.value-range", "0", "1"], "network.value_range: .* no outp"),
        (["--arm", "qlearning", "--network.candidates", "3"], "network.candidates: .* no networks"),
        (
            ["--arm", "qlearning", "--network.no-double-activation"],
            "network.double_activation: .* no networks",
        ),
        ([*CART_POLE, "--network.candidates", "3"], "network.candidates: .* has 2 actions to choo"),
        ([*CART_POLE, "--learner.noise", "0.2"], "learner.noise: .* which have no noise"),
        ([*CART_POLE, "--network.value-range", "0", "1"], "network.value_range: .* the critic has"),
        (
            ["--task", "gym:Pendulum-v1", "--learner.epsilon", "0.2"],
            "learner.epsilon: .* by learner.noise",
        ),
        ([*CART_POLE, "--learner", "td", "--learner.wires"], "learner.wires: .* a box of actions"),
        (
            [*CART_POLE, "--population.minimum-life-ticks", "9"],
            "population.minimum_life_ticks: .* is set",
        ),
        (
            ["--arm", "neat", "--population.start-hidden", "9"],
            "population.start_hidden: .* minimal",
        ),
        (
            ["--population.reproduction.mutation.weight-replace-prob", "0.2"],
            "population.reproduction.mutation.weight_replace_prob: .* weight_scheme is opennero",
        ),
    ],
)
def test_an_option_without_effect_is_refused_with_the_reason(
    neatq: Say, arguments: list[str], pattern: str
) -> None:
    status, out, error = neatq("train", *arguments)
    assert (status, out) == (2, "")
    name, _, reason = pattern.partition(": .* ")
    assert re.fullmatch(rf"neatq: error: {name}: it has no effect here: .*{reason}.*\n", error)
    assert not os.listdir()


def test_from_python_a_setting_without_effect_is_refused_as_well(tmp_path: Path) -> None:
    settings = {"network.candidates": 3}
    with pytest.raises(ValueError, match=r"network\.candidates: it has no effect here: .* 2 act"):
        trainer.train("gym:CartPole-v1", "neat", settings=settings, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_option_to_which_another_one_gives_effect_is_taken(
    neatq: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[RunConfig] = []

    def listen(config: RunConfig, *_: object, **__: object) -> None:
        taken.append(config)
        raise KeyboardInterrupt

    monkeypatch.setattr(trainer, "start", listen)
    mutation = "--population.reproduction.mutation"
    options = [f"{mutation}.weight-scheme", "uniform", f"{mutation}.weight-replace-prob", "0.25"]
    assert neatq("train", *options)[0] == 130
    assert taken[0].population.reproduction.mutation.weight_replace_prob == 0.25


@pytest.mark.parametrize(
    ("option", "value", "pattern"),
    [
        ("ticks", "abc", "--ticks: .* invalid literal .* 'abc'"),
        ("logger", "paper", "invalid choice 'paper'"),
        ("tick", "5", "Unrecognized options: --tick.*Perhaps you meant.*--ticks"),
        ("world.id", "x", "Unrecognized options: --world.id"),
    ],
)
def test_what_is_no_value_of_an_option_is_named(
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
        ({"name": "x", "robots": 0}, "robots: expected .* from 1 to .*, got 0"),
        ({"name": "x", "lifetime_ticks": -1}, "lifetime_ticks: expected .* from 0 to .*, got -1"),
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
        (CHECKPOINT, lambda content: content[:-100], "truncated, altered or damaged"),
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
    for ticks, pattern in (("50", "has 1[0-9]+ already, got 50"), ("-1", "or None, got -1")):
        status, _, error = neatq("resume", str(done), "--ticks", ticks)
        assert status == 2
        assert re.fullmatch(f"neatq: error: ticks: .*{pattern}.*\n", error), error


def test_help_explains_every_command(neatq: Say) -> None:
    for arguments, wanted in (
        (["--help"], "neatq train"),
        (["-h"], "neatq resume"),
        (["resume", "--help"], "Go on with a run"),
        (["train", "--help"], "Train a population"),
        (["train", "--task", "gym:CartPole-v1", "--help"], "--world.test-episodes"),
    ):
        status, out, error = neatq(*arguments)
        assert (status, error) == (0, "")
        assert wanted in out


@cache
def help_of(task: str, arm: str) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as end:
        main(["train", "--task", task, "--arm", arm, "--help"])
    assert not end.value.code
    return words(out.getvalue())


EVERYWHERE = [
    (task, arm)
    for task in ("flag", "gym:CartPole-v1", "gym:Pendulum-v1")
    for arm in ARMS
    if not (ARMS[arm].arena_only and task.startswith("gym:"))
]


@pytest.mark.parametrize(("task", "arm"), EVERYWHERE)
def test_the_help_of_train_has_few_options(task: str, arm: str) -> None:
    head, _, rest = help_of(task, arm).partition(" options ")
    first = ("task", "arm", "population", "learner", "env-kwargs")
    for option in first:
        assert f"--{option} N" in head
    names = set(re.findall(r"(?<!\S)--[a-z][a-z.-]*", rest))
    assert len(first) + len(names) <= 76


def test_an_option_that_the_help_leaves_out_is_heard() -> None:
    option = "population.reproduction.mutation.split_tries"
    assert option not in help_of("flag", "rtneat").replace("-", "_").partition(" options ")[2]
    default = preset("flag", "rtneat")
    options = tyro.cli(options_of(default, [option]), args=[f"--{option}", "30"])
    changed = default.changed({option: 30})
    assert with_options(default, options) == changed != default


@pytest.mark.parametrize(("task", "arm"), EVERYWHERE)
def test_every_option_has_the_text_of_its_setting(task: str, arm: str) -> None:
    """Between the name of an option and its default there are at least two words."""
    rest = help_of(task, arm).partition(" options ")[2]
    for text in re.findall(r"(?<!\S)--(\S+ .*?)\(default: ", rest):
        own = re.sub(r"--\S+|\{.*?\}|\b(?:INT|FLOAT|STR|PATH)\b|[|]", " ", f"--{text}")
        assert len(own.split()) >= 2, text


def test_the_help_of_train_shows_the_defaults_of_the_chosen_arm() -> None:
    for task, arm in EVERYWHERE:
        learner = preset(task, arm).learner
        found = re.search(
            r"--learner\.learning-rate FLOAT .*?\(default: ([0-9.]+)\)", help_of(task, arm)
        )
        assert bool(found) == hasattr(learner, "learning_rate")
        assert found is None or float(found[1]) == learner.learning_rate


def test_other_kinds_than_the_arms_are_chosen_by_name(neatq: Say) -> None:
    for part, kind, wanted in (
        ("population", "fixed", "--population.episodes"),
        ("learner", "td", "--learner.trace-decay"),
    ):
        status, out, _ = neatq("train", f"--{part}={kind}", "--help")
        assert status == 0
        assert wanted in out


OWN = """
from dataclasses import dataclass
from neatq_torch.learning import TDConfig, TDLearner, learner_kinds, register_learner

@dataclass(frozen=True, kw_only=True)
class SlowConfig(TDConfig):
    \"\"\"Learns slowly.

    Attributes:
        slowness: By which its learning rate is divided.
    \"\"\"

    slowness: float = 2.0

register_learner("slow", SlowConfig, learner_kinds.maker_of(TDConfig()))
"""


def test_a_learner_of_ones_own_is_found_by_its_module_and_its_run_goes_on(tmp_path: Path) -> None:
    """Each command in a process of its own, which knows of the learner only by that module."""
    (tmp_path / "own_learner.py").write_text(OWN)
    size = ["--env-kwargs", "robots=5", "lifetime_ticks=50", "--ticks", "40", "--out", "run"]
    own = ["--learner", "own_learner:slow", "--learner.slowness", "3"]
    status, out, error = in_copied_process(tmp_path, "train", *own, *size)
    assert (status, error) == (0, ""), error
    assert json.loads((tmp_path / "run" / CONFIG).read_text())["learner"]["slowness"] == 3
    status, out, error = in_copied_process(tmp_path, "resume", "run", "--ticks", "80")
    assert (status, error) == (0, ""), error
    assert out.startswith("neatq: run: metrics.csv")


def in_copied_process(folder: Path, *arguments: str) -> tuple[int, str, str]:
    """Likewise, in a process that does not take seconds to begin, where the system has that."""
    process = multiprocessing.get_context("spawn").Process(target=command, args=(folder, arguments))
    process.start()
    process.join()
    out, error = ((folder / name).read_text() for name in ("stdout", "stderr"))
    return process.exitcode or 0, out, error


def command(folder: Path, arguments: tuple[str, ...]) -> None:
    """Run the command with a folder as the one where its user is."""
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    to = contextlib.redirect_stdout, contextlib.redirect_stderr
    with open("stdout", "w") as out, open("stderr", "w") as error, to[0](out), to[1](error):
        sys.exit(main(arguments))


def in_new_process(folder: Path, *arguments: str) -> tuple[int, str, str]:
    """Run the command in a folder, from which modules can be imported; as `neatq` fixture."""
    paths = os.pathsep.join([str(folder), *sys.path])
    done = subprocess.run(
        [sys.executable, "-m", "neatq_trainers.cli", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def test_keys_of_the_scenario_are_given_as_json(
    neatq: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[RunConfig] = []
    monkeypatch.setattr(trainer, "start", lambda config, *_, **__: taken.append(config) or 1 / 0)
    wall = 'walls=[{"x": 300, "y": 400, "width": 200, "height": 4}]'
    kwargs = ["robots=30", "lifetime_ticks=500", wall]
    more = ['reward_weights={"stick_together": 1}']
    with pytest.raises(ZeroDivisionError):
        neatq("train", "--arm", "rtneat", "--env-kwargs", *kwargs, "--env-kwargs", *more)
    (config,) = taken
    scenario = config.world.scenario  # type: ignore[union-attr]
    assert (scenario.robots, scenario.lifetime_ticks, scenario.walls[0].width) == (30, 500, 200)
    assert scenario.reward_weights == {"stick_together": 1}
    assert config.population.minimum_life_ticks == 500


def test_ctrl_c_says_how_to_go_on(neatq: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(config: RunConfig, folder: Path, **_: object) -> None:
        folder.mkdir(parents=True)
        (folder / CHECKPOINT).touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(trainer, "start", interrupted)
    status, out, error = neatq("train", "--out", "my run")
    assert (status, out) == (130, "")
    assert error == "neatq: stopped; go on with: neatq resume 'my run'\n"


def test_the_list_names_everything(neatq: Say) -> None:
    status, out, error = neatq("list")
    assert (status, error) == (0, "")
    for name in (*ARMS, *TASKS, *population_kinds, *learner_kinds, "gym:ID"):
        assert re.search(rf"^  {re.escape(name)} +[\w\"].{{15,}}$", out, re.MULTILINE), name
    titles = re.findall(r"^(\w+) \((docs/\w+.md)\):$", out, re.MULTILINE)
    assert [title for title, _ in titles] == ["tasks", "arms", "populations", "learners"]
    assert all((ROOT / page).is_file() for _, page in titles)


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from neatq_trainers.cli import main; main(['--help'])\n"
        "print(sorted({'torch', 'numpy', 'gymnasium', 'tyro'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("[]\n")


def test_without_arguments_it_says_what_it_can_do(neatq: Say) -> None:
    status, out, error = neatq()
    assert (status, error) == (2, "")
    assert out.startswith("usage: neatq")


def test_a_run_says_what_it_wrote_and_nothing_else_when_there_is_no_terminal(
    tmp_path: Path,
) -> None:
    world = ["--env-kwargs", "robots=5", "lifetime_ticks=50"]
    options = [*world, "--ticks", "100", "--seed", "3"]
    status, out, error = in_new_process(tmp_path, "train", "--arm", "described", *options)
    assert (status, error) == (0, "")
    wanted = "metrics.csv, curves.png, arena.png, team.gif, champion.json, champion.png"
    assert out == f"neatq: runs/wall-described-seed3: {wanted}\n"
    run = load_run(tmp_path / "runs" / "wall-described-seed3")
    assert load_checkpoint(run.path / CHECKPOINT)["done"]["ticks"] >= 100
