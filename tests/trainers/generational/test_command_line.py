"""The command on Gymnasium tasks: what it says, what it refuses, what it leaves behind."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from PIL import Image

from neatq_torch.checkpoint import CheckpointError
from neatq_torch.genome import GenomeError, load_genome
from neatq_trainers.cli import main
from neatq_trainers.generational import load_policy
from neatq_trainers.generational.config import preset
from neatq_trainers.generational.folder import (
    ANIMATION,
    PICTURE,
    RESULT,
    SCALING,
    GenerationalFolder,
)
from neatq_trainers.generational.loop import try_champions
from neatq_trainers.generational.report import draw_curves, write_report
from neatq_trainers.generational.team import open_team
from neatq_trainers.report import read_metrics
from neatq_trainers.run_files import CHAMPION, CHECKPOINT, CONFIG, CURVES, METRICS

Say = Callable[..., tuple[int, str, str]]
Done = Callable[[str], Path]
SHORT = ["--generations", "2", "--population", "6", "--episodes", "1", "--workers", "1"]
SHORT += ["--evaluation.episodes", "2", "--evaluation.test-episodes", "3"]


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


def words(text: str) -> str:
    return " ".join(re.sub(r"[^\x20-\x7e]", " ", text).split())


def test_a_task_is_trained_at_once(neatq: Say, toy: str) -> None:
    status, out, error = neatq("train", "--task", f"{toy}Walk-v0", *SHORT)
    assert (status, error) == (0, "")
    folder = Path("runs/toy_tasks-toy-Walk-v0-neat-seed0")
    wanted = [METRICS, CURVES, CHAMPION, SCALING, RESULT, PICTURE, ANIMATION]
    first, second = out.splitlines()
    assert first == f"neatq: {folder}: {', '.join(wanted)}"
    result = json.loads((folder / RESULT).read_text())["champion"]
    assert result["episodes"] == 3
    mean, error = (f"{result[name]:.1f}" for name in ("mean", "standard_error"))
    assert second.startswith(f"neatq: champion of arena 0: return {mean} ± {error} (mean and")
    assert {path.name for path in folder.iterdir()} == {*wanted, CONFIG, CHECKPOINT}
    for name in (CURVES, PICTURE, ANIMATION):
        with Image.open(folder / name) as picture:
            assert picture.size >= (300, 150)
    with Image.open(folder / ANIMATION) as film:
        # Pictures that are alike are one frame.
        assert 2 <= film.n_frames <= 20  # type: ignore[attr-defined]
    assert neatq("resume", str(folder), "--generations", "3")[0] == 0
    assert GenerationalFolder.open(folder).read().generation == 3


def test_arguments_of_the_environment_reach_it(neatq: Say, toy: str) -> None:
    task = ["--task", f"{toy}Spaces-v0", "--env-kwargs", "acts=matrix", "max_episode_steps=3"]
    for arm, outputs in (("neat", 6), ("neatq", 3 * 6 + 3)):
        more = [] if arm == "neat" else ["--network.candidates", "3"]
        status, _, _ = neatq("train", *task, "--arm", arm, *more, "--out", arm, *SHORT)
        assert status == 0
        assert load_genome(f"{arm}/{CHAMPION}").output_ids.size == outputs
        assert GenerationalFolder.open(Path(arm)).read().steps.tolist() == [2 * 6 * 3]


def test_the_help_shows_the_options_of_this_trainer(neatq: Say) -> None:
    for arm in ("neat", "neatq", "qnetwork"):
        status, out, _ = neatq("train", "--task", "gym:CartPole-v1", "--arm", arm, "--help")
        text = words(out)
        assert status == 0
        found = re.search(r"--episodes INT .*?\(default: (\d+)\)", text)
        assert found, text
        assert int(found[1]) == preset("gym:CartPole-v1", arm).episodes
        assert "--scenario" not in text


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["--task", "gym:CartPol-v1"], "knows no 'CartPol-v1'.*did you mean CartPole-v1"),
        (["--task", "gym:"], "task: expected gym: and an id"),
        (["--task", "gym:CartPole-v1", "--arm", "rtneat"], "neat, neatq, qnetwork .*'rtneat'"),
        (["--task", "gym:CartPole-v1", "--env-kwargs", "x"], "expected name=value.*'x'"),
        (["--task", "gym:CartPole-v1", "--env-kwargs", "x=1"], "cannot be made with"),
        (["--task", "gym:CartPole-v1", "--population", "1"], "population: .* at least 2, got 1"),
        (["--task", "gym:CartPole-v1", "--generations", "0"], "generations: .* at least 1, got 0"),
        (["--task", "gym:CartPole-v1", "--workers", "0"], "workers: expected at least 1, got 0"),
        (["--task", "gym:Blackjack-v1"], "observes Tuple"),
        (["--task", "TOYEndless-v0"], "did not end in 5000 steps.*max_episode_steps=1000"),
        (["--task", "TOYBroken-v0"], r"episode 0 with seed \d+, after 2 steps: ZeroDivisionError"),
        (
            ["--task", "gym:Pendulum-v1", "--arm", "neatq", "--network.candidates", "1"],
            "network.candidates: expected at least 2, got 1",
        ),
        (
            ["--task", "gym:Pendulum-v1", "--arm", "qnetwork", "--learning.rule", "none"],
            "learning.rule: qnetwork without learning",
        ),
        (
            ["--task", "gym:CartPole-v1", "--arm", "neatq", "--learning.rule", "wire_fitting"],
            "learning.rule: .*CartPole-v1 has 2 actions to choose from.*needs a box of actions",
        ),
        (
            ["--task", "gym:CartPole-v1", "--arm", "neat", "--pretraining.steps", "5"],
            "pretraining.steps: expected 0 with learning.rule none, got 5",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_bad_input_is_answered_in_one_line(
    neatq: Say, toy: str, arguments: list[str], pattern: str
) -> None:
    status, out, error = neatq("train", *(one.replace("TOY", toy) for one in arguments))
    assert (status in (1, 2), out) == (True, "")
    assert re.fullmatch(rf"neatq: error: .*{pattern}.*\n", error), error
    assert not os.listdir()


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        (["--learning.value-range", "3", "1"], "value_range: expected two numbers, the smaller"),
        (["--pretraining.steps", "-1"], "pretraining.steps: expected at least 0, got -1"),
        (["--pretraining.batch", "0"], "pretraining.batch: expected at least 1, got 0"),
        (
            ["--pretraining.learning-rate", "0"],
            r"pretraining.learning_rate: expected a finite number above 0, got 0",
        ),
        (
            ["--arm", "neatq", "--pretraining.steps", "5", "--pretraining.transitions", "7"],
            r"pretraining.transitions: expected at least one for each of \d+ genomes, got 7",
        ),
        (["--learning.epsilon", "2"], r"learning.epsilon: expected a number in \[0, 1\], got 2"),
        (["--learning.max-hold-steps", "0"], "learning.max_hold_steps: expected at least 1, got 0"),
        (["--network.candidates", "0"], "network.candidates: expected at least 1, got 0"),
        (["--network.activation", "cubic"], "network.activation: expected one of identity"),
        (["--evaluation.every", "0"], "evaluation.every: expected at least 1, got 0"),
        (["--evolution.survival-share", "3"], r"survival_share must lie in \[0, 1\], not 3"),
        (["--ticks", "3"], "Unrecognized options: --ticks"),
    ],
)
def test_a_bad_value_of_an_option_is_named(neatq: Say, options: list[str], pattern: str) -> None:
    status, out, error = neatq("train", "--task", "gym:CartPole-v1", *options)
    assert (status, out) == (2, "")
    assert re.search(pattern, words(error)), error
    assert "Traceback" not in error
    assert not os.listdir()


@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_environment_that_fails_in_mid_run_leaves_a_run_that_goes_on(
    neatq: Say, toy: str, workers: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails after so many episodes of a process, and not in a new one."""
    broken = importlib.import_module("toy_tasks").Broken
    monkeypatch.setattr(broken, "ended", 0)
    task = ["--task", f"{toy}Broken-v0", "--env-kwargs", "after=70", "how=nan"]
    options = [*task, *SHORT, "--generations", "30", "--out", "run", "--workers", workers]
    status, _, error = neatq("train", *options)
    assert status == 1
    wanted = (
        r"neatq: error: toy_tasks:toy/Broken-v0: genome \d+ failed in episode 0 with seed \d+, "
        r"after 3 steps: expected finite numbers, got observation \[nan, 0.0\], reward .*; "
        r"go on with: neatq resume run\n"
    )
    assert re.fullmatch(wanted, error), error
    before = GenerationalFolder.open(Path("run")).read().generation
    assert 0 < before < 30
    lines = (Path("run") / METRICS).read_text().splitlines()
    assert len(lines) == before + 1
    if workers == "1":
        monkeypatch.setattr(broken, "ended", -10_000)
        assert neatq("resume", "run", "--workers", "1")[0] == 0
        assert GenerationalFolder.open(Path("run")).read().generation == 30


@pytest.mark.parametrize(
    ("name", "damage", "pattern"),
    [
        (CHECKPOINT, lambda content: content[:-100], "truncated or altered"),
        (METRICS, lambda content: content[:-10], "altered"),
        (CONFIG, lambda content: content.replace(b'"seed": 1', b'"seed": 2'), "not the config"),
        (CONFIG, lambda content: content.replace(b'"episodes": 2', b'"episodes": 0'), "damaged"),
    ],
)
def test_a_damaged_run_is_refused_and_nothing_of_it_changes(
    neatq: Say, done: Done, name: str, damage: Callable[[bytes], bytes], pattern: str
) -> None:
    run = Path(shutil.copytree(done("neat"), "run"))
    (run / name).write_bytes(damage((run / name).read_bytes()))
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    status, out, error = neatq("resume", "run", "--generations", "9")
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: run/{re.escape(name)}: .*{pattern}.*\n", error), error
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_lengths_of_another_kind_of_run_are_refused(neatq: Say, done: Done) -> None:
    for length, pattern in (
        (["--ticks", "9"], "ticks: .*its length is --generations"),
        (["--generations", "2"], "generations: the run in .* has 4 already, got 2"),
        (["--generations", "0"], "generations: .*got 0"),
    ):
        status, _, error = neatq("resume", str(done("neat")), *length)
        assert status == 2
        assert re.fullmatch(f"neatq: error: {pattern}.*\n", error), error


def test_an_existing_run_is_not_overwritten(neatq: Say, done: Done, toy: str) -> None:
    status, _, error = neatq("train", "--task", f"{toy}Walk-v0", "--out", str(done("neat")))
    assert status == 2
    assert error.endswith(f"go on with the run in it: neatq resume {done('neat')}\n")


@pytest.mark.parametrize("arm", ["neat", "neatq", "qnetwork"])
def test_a_loaded_champion_does_in_a_plain_environment_what_it_did_in_the_test(
    done: Done, arm: str
) -> None:
    run = GenerationalFolder.open(done(arm)).read()
    with open_team(run.config, run.surroundings, 1) as team:
        tested = try_champions(run, team)
    result = json.loads((done(arm) / RESULT).read_text())["champion"]
    assert result["mean"] == tested.mean()
    policy = load_policy(done(arm))
    env = gymnasium.make(run.config.environment.id)
    returns = []
    for episode in range(5):
        seed = np.random.SeedSequence([1, 2, 0, episode]).generate_state(1)[0]
        observation, _ = env.reset(seed=int(seed))
        policy.reset()
        returns.append(0.0)
        over = False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(policy(observation))
            returns[-1] += float(reward)
            over = terminated or truncated
    assert returns == tested[0].tolist()


@pytest.mark.parametrize("name", [CONFIG, SCALING, CHAMPION])
def test_a_champion_without_one_of_its_files_is_refused(
    done: Done, tmp_path: Path, name: str
) -> None:
    run = Path(shutil.copytree(done("neat"), tmp_path / "run"))
    (run / name).write_text("{}")
    with pytest.raises((CheckpointError, GenomeError, ValueError)):
        load_policy(run)
    (run / name).unlink()
    with pytest.raises(CheckpointError, match=f"{name}: there is no such file"):
        load_policy(run)


def test_the_curves_show_champion_best_and_mean(done: Done) -> None:
    (axes,) = draw_curves(read_metrics(done("neat")), "title").axes
    labels = [line.get_label() for line in axes.get_lines()]
    assert len(labels) == 3
    (champion,) = (line for line in axes.get_lines() if "champion" in str(line.get_label()))
    assert np.asarray(champion.get_xdata()).tolist() == [16, 32, 48, 64]


def test_a_report_without_pygame_leaves_the_animation_out(
    done: Done, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Path(shutil.copytree(done("neat"), tmp_path / "run"))

    def missing(_: object) -> None:
        raise gymnasium.error.DependencyNotInstalled("pygame is not installed")

    monkeypatch.setattr(sys.modules["toy_tasks"].Walk, "render", missing)
    (run / ANIMATION).unlink(missing_ok=True)
    (note,) = write_report(GenerationalFolder.open(run))
    assert note == "champion.gif: left out: pygame is not installed"
    assert (run / CURVES).is_file()
    assert not (run / ANIMATION).exists()
