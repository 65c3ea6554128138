"""The command on Gymnasium tasks: what it says, what it refuses, what it leaves behind."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from PIL import Image

from neatq_envs.episodes import EVALUATION, episode_seeds
from neatq_envs.random_play import look_around
from neatq_torch.checkpoint import load_checkpoint
from neatq_torch.genome import Genome, load_genome
from neatq_trainers import report
from neatq_trainers.arms import preset
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import (
    CHAMPION,
    CHECKPOINT,
    CONFIG,
    CURVES,
    FILM,
    METRICS,
    PICTURE,
    RESULT,
    SCALING,
    load_run,
)
from neatq_trainers.policy import make_policy
from neatq_trainers.report import draw_curves, write_report
from neatq_trainers.train import resume, start, train

Say = Callable[..., tuple[int, str, str]]
Tiny = Callable[..., RunConfig]
SHORT = ["--generations", "2", "--world.slots", "6", "--workers", "1"]
SHORT += ["--world.episodes", "2", "--world.test-episodes", "3"]
NEAT = ["--arm", "neat", "--population.episodes", "1"]


@pytest.fixture(scope="module")
def done(tiny_walk: Tiny, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished tiny run of `neat`; do not write into it."""
    return start(tiny_walk("neat"), tmp_path_factory.mktemp("done") / "run").path


def lengths(folder: Path | str) -> dict[str, int]:
    """How long the run in a folder is, by unit."""
    return load_checkpoint(Path(folder) / CHECKPOINT)["done"]


def test_a_task_is_trained_at_once(neatq: Say, toy: str) -> None:
    status, out, error = neatq("train", "--task", f"{toy}Walk-v0", *NEAT, *SHORT)
    assert (status, error) == (0, "")
    folder = Path("runs/toy_tasks-toy-Walk-v0-neat-seed0")
    wanted = [METRICS, CURVES, CHAMPION, SCALING, RESULT, PICTURE, FILM]
    first, second = out.splitlines()
    assert first == f"neatq: {folder}: {', '.join(wanted)}"
    result = json.loads((folder / RESULT).read_text())["champion"]
    assert result["episodes"] == 3
    mean, error = (f"{result[name]:.1f}" for name in ("mean", "standard_error"))
    assert second.startswith(f"neatq: champion of arena 0: return {mean} ± {error} (mean and")
    assert {path.name for path in folder.iterdir()} == {*wanted, CONFIG, CHECKPOINT}
    for name in (CURVES, PICTURE, FILM):
        with Image.open(folder / name) as picture:
            assert picture.size >= (300, 150)
    with Image.open(folder / FILM) as film:
        # Pictures that are alike are one frame.
        assert 2 <= film.n_frames <= 20  # type: ignore[attr-defined]
    assert neatq("resume", str(folder), "--generations", "3")[0] == 0
    assert lengths(folder)["generations"] == 3


@pytest.mark.parametrize("arm", ["neat", "rtneat", "neatq"])
def test_a_run_is_as_long_as_its_steps(neatq: Say, toy: str, arm: str) -> None:
    task = ["--task", f"{toy}Walk-v0", "--arm", arm, "--out", arm, "--world.test-episodes", "3"]
    assert neatq("train", *task, "--steps=500", "--world.slots", "6")[0] == 0
    assert 500 <= lengths(arm)["steps"] < 1000
    assert neatq("resume", arm, "--steps", "1000")[0] == 0
    assert 1000 <= lengths(arm)["steps"] < 1500


def test_a_bar_counts_steps_within_generations(
    tiny_walk: Tiny,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("neatq_trainers.callbacks.BAR_SECONDS", 0)
    run = start(tiny_walk("neat", steps=500), tmp_path / "run")
    bar = capsys.readouterr().err
    shown = [int(done) for done in re.findall(r"(\d+)/\d+ \[", bar)]
    by_generation = run.metrics()["steps"].astype(int).tolist()
    assert shown == sorted(shown)
    assert {*shown} - {0, *by_generation}
    assert f"100%|██████████| {by_generation[-1]}/{by_generation[-1]} [" in bar.splitlines()[-1]
    assert re.search(r"steps/s, best [-\d.]+, champion [-\d.]+\]", bar)


def test_arguments_of_the_environment_reach_it(neatq: Say, toy: str) -> None:
    task = ["--task", f"{toy}Spaces-v0", "--env-kwargs", "acts=matrix", "max_episode_steps=3"]
    for arm, outputs in (("neat", 6), ("neat+q", 3 * 6 + 3)):
        more = [] if arm == "neat" else ["--network.candidates", "3"]
        options = [*task, "--arm", arm, "--population.episodes", "1", *more, *SHORT]
        assert neatq("train", *options, "--out", arm)[0] == 0
        assert load_genome(f"{arm}/{CHAMPION}").output_ids.size == outputs
        assert lengths(arm)["steps"] == 2 * 6 * 3


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["gym:CartPol-v1"], "knows no 'CartPol-v1'.*did you mean CartPole-v1"),
        (["gym:"], "task: expected gym: and an id"),
        (["gym:no_such_module:X-v0"], "No module named 'no_such_module'.*PYTHONPATH"),
        (["gym:CartPole-v1", "--env-kwargs", "x"], "expected name=value.*'x'"),
        (["gym:CartPole-v1", "--env-kwargs", "x=1"], "cannot be made with"),
        (["TOYSpaces-v0", "--env-kwargs", "observes=text"], "observes Text"),
        (["TOYEndless-v0"], "did not end in 500 steps.*max_episode_steps=1000"),
        (["TOYBroken-v0"], r"episode 0 with seed \d+, after 2 steps: ZeroDivisionError"),
        (
            ["gym:Pendulum-v1", "--arm", "neat+q", "--network.candidates", "1"],
            "network.candidates: expected at least 2, got 1",
        ),
        (["gym:Pendulum-v1", "--learner", "table"], "learner: a table knows no genome"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_bad_input_is_answered_in_one_line(
    neatq: Say, toy: str, arguments: list[str], pattern: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("neatq_envs.random_play.MOST_STEPS", 500)  # 5000 take seconds
    status, out, error = neatq("train", "--task", *(one.replace("TOY", toy) for one in arguments))
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: .*{pattern}.*\n", error), error
    assert not os.listdir()


@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_environment_that_fails_in_mid_run_leaves_a_run_that_goes_on(
    neatq: Say, toy: str, workers: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails after so many episodes of a process, and not in a new one."""
    broken = importlib.import_module("toy_tasks").Broken
    monkeypatch.setattr(broken, "ended", 0)
    task = ["--task", f"{toy}Broken-v0", "--env-kwargs", "after=70", "how=nan"]
    options = [*task, *NEAT, *SHORT, "--generations", "30", "--out", "run", "--workers", workers]
    status, _, error = neatq("train", *options)
    assert status == 2
    wanted = (
        r"neatq: error: toy_tasks:toy/Broken-v0: .*\d+.* failed in episode 0 with seed \d+, "
        r"after 3 steps: observation\[0\] is nan; expected a finite number .*; "
        r"go on with: neatq resume run\n"
    )
    assert re.fullmatch(wanted, error), error
    if workers == "1":
        monkeypatch.setattr(broken, "ended", -10_000)
        assert neatq("resume", "run", "--workers", "1")[0] == 0
        assert lengths("run")["generations"] == 30
        assert len((Path("run") / METRICS).read_text().splitlines()) == 31


@pytest.mark.parametrize(
    ("name", "damage", "pattern"),
    [
        (CHECKPOINT, lambda content: content[:-100], "truncated, altered or damaged"),
        (METRICS, lambda content: content[:-10], "altered"),
        (CONFIG, lambda content: content.replace(b'"seed": 1', b'"seed": 2'), "not the config"),
        (CONFIG, lambda content: content.replace(b'"episodes": 2', b'"episodes": 0'), "damaged"),
    ],
)
def test_a_damaged_run_is_refused_and_nothing_of_it_changes(
    neatq: Say, done: Path, name: str, damage: Callable[[bytes], bytes], pattern: str
) -> None:
    run = Path(shutil.copytree(done, "run"))
    (run / name).write_bytes(damage((run / name).read_bytes()))
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    status, out, error = neatq("resume", "run", "--generations", "9")
    assert (status, out) == (2, "")
    assert re.fullmatch(rf"neatq: error: run/{re.escape(name)}: .*{pattern}.*\n", error), error
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_lengths_of_another_kind_of_run_are_refused(neatq: Say, done: Path) -> None:
    for length, pattern in (
        (["--ticks", "9"], "ticks: .*is given in steps or generations"),
        (["--generations", "2"], "generations: the run in .* has 4 already, got 2"),
        (["--generations", "0"], "generations: .*got 0"),
    ):
        status, _, error = neatq("resume", str(done), *length)
        assert status == 2
        assert re.fullmatch(f"neatq: error: {pattern}.*\n", error), error


def test_an_existing_run_is_not_overwritten(neatq: Say, done: Path, toy: str) -> None:
    status, _, error = neatq("train", "--task", f"{toy}Walk-v0", "--out", str(done))
    assert status == 2
    assert error.endswith(f"go on with the run in it: neatq resume {done}\n")


def play(config: RunConfig, genome: Genome, seed: int) -> float:
    """The return of an episode, by the policy that a user gets, in a plain environment."""
    task = config.world.task  # type: ignore[union-attr]
    policy = make_policy(config, genome, look_around(task, 0.99))
    env = task.make()
    observation, _ = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        total += float(reward)
        over = terminated or truncated
    return total


@pytest.mark.usefixtures("without_pictures")
def test_the_champion_is_the_best_that_was_evaluated(tiny_walk: Tiny, tmp_path: Path) -> None:
    config = tiny_walk("neat", generations=6)
    run = start(config, tmp_path / "run")
    rows = run.metrics()
    evaluated = dict(zip(rows["generation"], rows["evaluated_return"], strict=True))
    known = {int(n): value for n, value in evaluated.items() if not np.isnan(value)}
    assert [*known] == [1, 2, 4, 6]
    assert rows["champion_return"][-1] == max(known.values())
    seeds = episode_seeds(config.seed, 0, 3, purpose=EVALUATION)
    by_hand = np.mean([play(config, run.champion(), int(seed)) for seed in seeds])
    assert float(f"{by_hand:.6g}") == max(known.values())


@pytest.mark.usefixtures("without_pictures")
def test_the_fittest_of_the_last_generation_are_looked_at_and_a_longer_run_knows_nothing_of_it(
    tiny_walk: Tiny, tmp_path: Path
) -> None:
    often, seldom = ({"world.every": every, "arenas": 2} for every in (1, 100))
    known = start(tiny_walk("neat", generations=4, **often), tmp_path / "often").metrics()
    short = start(tiny_walk("neat", generations=4, **seldom), tmp_path / "short")
    result = short.result()
    assert result is not None
    for arena, tested in enumerate(result["arenas"]):
        at = (known["arena"] == arena) & np.isin(known["generation"], (1, 4))
        evaluated = known["evaluated_return"][at]
        assert tested["generation"] == (1, 4)[int(evaluated.argmax())]
        assert float(f"{tested['evaluated_return']:.6g}") == evaluated.max()
    assert any(one["generation"] == 4 for one in result["arenas"])
    resumed = resume(short.path, generations=6)
    whole = start(tiny_walk("neat", generations=6, **seldom), tmp_path / "whole")
    assert resumed.result() == whole.result()
    for name in (METRICS, CHAMPION):
        assert (resumed.path / name).read_bytes() == (whole.path / name).read_bytes()


@pytest.mark.usefixtures("without_pictures")
def test_a_run_that_ends_within_a_generation_may_have_its_champion_of_that_moment(
    tiny_walk: Tiny, tmp_path: Path
) -> None:
    seldom = {"world.every": 100, "population.minimum_life_episodes": 7, "seed": 1}
    run = start(tiny_walk("rtneat", steps=3_500, **seldom), tmp_path / "run")
    evaluated = run.metrics()["evaluated_return"]
    (first,) = evaluated[~np.isnan(evaluated)]
    result = run.result()
    assert result is not None
    score = result["champion"]["evaluated_return"]
    assert score > first + 1e-3
    seeds = episode_seeds(run.config.seed, 0, 3, purpose=EVALUATION)
    assert score == np.mean([play(run.config, run.champion(), int(seed)) for seed in seeds])
    resumed = resume(run.path, steps=5_000)
    whole = start(tiny_walk("rtneat", steps=5_000, **seldom), tmp_path / "whole")
    assert resumed.result() == whole.result()


@pytest.mark.usefixtures("without_pictures")
def test_neat_learns_cart_pole_in_a_few_generations(tmp_path: Path) -> None:
    settings = {"world.slots": 40, "population.episodes": 1}
    run = train("gym:CartPole-v1", "neat", generations=5, settings=settings, out=tmp_path / "run")
    result = run.result()
    assert result is not None
    assert (result["champion"]["mean"], result["champion"]["standard_error"]) == (500, 0)


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("task", ["Hopper-v5", "HalfCheetah-v5"])
def test_a_run_of_mujoco_goes_on_as_if_it_had_not_stopped(
    task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)  # MuJoCo writes MUJOCO_LOG.TXT where it is
    few = {"population.episodes": 1, "world.slots": 4, "world.evaluated": 1}
    few |= {"world.episodes": 1, "world.test_episodes": 1}
    short = {"max_episode_steps": 20}
    config = preset(f"gym:{task}", "neat", env_kwargs=short, length={"steps": 150}).changed(few)
    whole = start(config, tmp_path / "whole")
    begun = start(config.changed({"steps": 10}), tmp_path / "run")
    run = resume(begun.path, steps=150, workers=1)
    assert run.metrics()["steps"][-1] >= 150 > begun.metrics()["steps"][0]
    assert (run.path / METRICS).read_text() == (whole.path / METRICS).read_text()


def test_without_a_display_one_process_draws_two_films_of_mujoco(tmp_path: Path) -> None:
    """MuJoCo's renderer for displays kills the process when it is asked again."""
    pytest.importorskip("mujoco")
    script = """
        from neatq_trainers.arms import preset
        from neatq_trainers.train import start
        for number in range(2):
            kwargs = {"max_episode_steps": 5}
            config = preset("gym:Hopper-v5", "neat", env_kwargs=kwargs, length={"generations": 1})
            few = {"population.episodes": 1, "world.slots": 4, "world.test_episodes": 1}
            start(config.changed({**few, "world.episodes": 1}), str(number))
    """
    hidden = {"DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"}
    own = {name: value for name, value in os.environ.items() if name not in hidden}
    command = [sys.executable, "-c", textwrap.dedent(script)]
    subprocess.run(command, cwd=tmp_path, env=own, check=True, capture_output=True)


def test_a_film_draws_little_more_than_it_keeps(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twenty steps, four frames at most: 0, 1, 2, 3, then every second, every fourth, ..."""
    walk = sys.modules["toy_tasks"].Walk
    at: list[int] = []

    def step(env: Any, action: Any) -> Any:
        env.count = getattr(env, "count", 0) + 1
        return env._seen(), 0.0, False, env.count == 20, {}

    def render(env: Any) -> np.ndarray:
        at.append(getattr(env, "count", 0))
        return np.full((2, 2, 3), at[-1], np.uint8)

    monkeypatch.setattr(walk, "step", step)
    monkeypatch.setattr(walk, "render", render)
    monkeypatch.setattr(report, "MOST_FRAMES", 4)
    run = load_run(done)
    champion = run.champion()
    assert champion is not None
    frames = report.film(run, make_policy(run.config, champion, run.facts()))
    assert at == [0, 1, 2, 3, 4, 6, 8, 12, 16]
    assert [int(frame.max()) for frame in frames] == [0, 8, 16]


def test_q_values_of_random_play_have_a_range_by_hand(toy: str) -> None:
    """Reward 1 for three steps, discount 0.5: returns 1.75, 1.5 and 1; the margin is a tenth."""
    config = preset(f"{toy}Ends-v0", "neatq", env_kwargs={"steps": 3, "max_episode_steps": 3})
    low, high = look_around(config.world.task, 0.5).value_range  # type: ignore[union-attr]
    assert (low, high) == pytest.approx((1 - 0.075, 1.75 + 0.075))


def test_the_curves_show_champion_best_and_mean(done: Path) -> None:
    (axes,) = draw_curves(load_run(done).metrics(), "title").axes
    labels = [line.get_label() for line in axes.get_lines()]
    assert len(labels) == 3
    (champion,) = (line for line in axes.get_lines() if "champion" in str(line.get_label()))
    steps = load_run(done).metrics()["steps"].tolist()
    assert len(steps) == 4
    assert np.asarray(champion.get_xdata()).tolist() == steps
    assert axes.get_xlabel() == "steps of all in an arena"


def test_the_curves_of_several_arenas_are_means_at_the_same_steps() -> None:
    """Arena 0 has rows at 10, 20 and 40 steps, arena 1 at 15 and 30."""
    columns = {
        "arena": [0, 1, 0, 1, 0],
        "steps": [10, 15, 20, 30, 40],
        "mean_fitness": [1, 2, 3, 4, 5],
        "best_fitness": [1, 2, 3, 4, 5],
        "champion_return": [10, 0, 20, 2, 30],
    }
    metrics = {name: np.array(values, float) for name, values in columns.items()}
    (axes,) = draw_curves(metrics, "title").axes
    (champion,) = (line for line in axes.get_lines() if "champion" in str(line.get_label()))
    assert np.asarray(champion.get_xdata()).tolist() == [15, 20, 30]
    assert np.asarray(champion.get_ydata()).tolist() == [5, 10, 11]


def test_a_report_without_pygame_leaves_the_animation_out(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Path(shutil.copytree(done, tmp_path / "run"))

    def missing(_: object) -> None:
        raise gymnasium.error.DependencyNotInstalled("pygame is not installed")

    monkeypatch.setattr(sys.modules["toy_tasks"].Walk, "render", missing)
    (run / FILM).unlink(missing_ok=True)
    (note,) = write_report(load_run(run))
    assert note == "champion.gif: left out: pygame is not installed"
    assert (run / CURVES).is_file()
    assert not (run / FILM).exists()


def test_the_command_trains_with_parsimony_and_goes_on(neatq: Say, toy: str) -> None:
    arm = ["--task", f"{toy}Walk-v0", "--arm", "neat", "--world.slots", "20", "--world.every", "1"]
    share = ["--population.parsimony", "0.5", "--workers", "1", "--out", "run"]
    assert neatq("train", *arm, *share, "--generations", "6")[0] == 0
    assert load_run("run").config.population.parsimony == 0.5
    assert neatq("resume", "run", "--workers", "1", "--generations", "12")[0] == 0
    run = load_run("run")
    metrics, champion = run.metrics(), run.champion()
    best = metrics["evaluated_return"].max()
    assert metrics["champion_return"][-1] >= best - 0.5 * abs(best)
    founders = 3  # links: from two inputs and the bias
    assert champion.link_enabled.sum() < founders
