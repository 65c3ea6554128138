"""Whole runs in strange environments: they end well, or with one sentence."""

from __future__ import annotations

import io
import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector.utils import concatenate, create_empty_array

from neatq_envs.episodes import TEST, episode_seeds
from neatq_envs.gymnasium_task import TaskError
from neatq_envs.machines import ThisMachine
from neatq_trainers.arms import preset
from neatq_trainers.cli import main
from neatq_trainers.folder import FILM, RESULT, SCALING, load_run
from neatq_trainers.policy import ChampionPolicy, load_policy
from neatq_trainers.train import default_folder
from neatq_trainers.worlds import GymnasiumConfig, facts_of

Say = Callable[..., tuple[int, str, str]]
GYM = "gym:strange_tasks:strange/"
EPISODES = {"neat": ["--population.episodes", "1"], "neat+q": ["--population.episodes", "2"]}
EPISODES["qnetwork"] = ["--population.episodes", "3"]
SHORT = ["--generations", "2", "--world.episodes", "2", "--world.test-episodes", "3"]


@pytest.fixture(scope="module", autouse=True)
def found() -> None:
    folder = str(Path(__file__).parents[1] / "toy")
    if folder not in sys.path:
        sys.path.insert(0, folder)


def short(task: str, arm: str = "neat", *env_kwargs: str, workers: int = 1) -> list[str]:
    """Arguments of a short run with few genomes."""
    few = [] if arm == "qnetwork" else ["--world.slots", "5"]
    options = ["--task", GYM + task, "--arm", arm, *EPISODES.get(arm, []), *SHORT, *few]
    return ["train", *options, "--workers", str(workers), "--env-kwargs", *env_kwargs]


@pytest.mark.parametrize(
    ("arm", "acts", "observes"),
    [
        ("neat", "bits", "box"),
        ("neatq", "dict", "dict"),
        ("neat+q", "many", "many"),
        ("qnetwork", "shifted", "tuple"),
        ("rtneat", "tuple", "binary"),
        ("described", "signed", "choice"),
        ("committed", "float", "dict"),
    ],
)
def test_the_champion_acts_as_in_its_test(neatq: Say, arm: str, acts: str, observes: str) -> None:
    """The environment asserts that each action is of the type that `sample()` gives."""
    status, _, error = neatq(*short("Plain-v0", arm, f"acts={acts}", f"observes={observes}"))
    assert (status, error) == (0, "")
    (folder,) = Path("runs").iterdir()
    run, policy = load_run(folder), load_policy(folder)
    result = json.loads((folder / RESULT).read_text())["champion"]
    assert isinstance(run.config.world, GymnasiumConfig) and isinstance(policy, ChampionPolicy)
    returns = []
    for seed in episode_seeds(result["seed"], 0, 3, purpose=TEST).tolist():
        env = run.config.world.task.make()
        observation, _ = env.reset(seed=seed)
        policy.reset()
        total, over = 0.0, False
        while not over:
            observation, reward, over, *_ = env.step(policy(observation))
            total += float(reward)
        returns.append(total)
    assert result["mean"] == pytest.approx(np.mean(returns), abs=1e-12)
    assert "Infinity" not in (folder / SCALING).read_text()


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("render raises", "RuntimeError: no GL context"),
        ("render none", r"render\(\): expected a picture \[height, width, 3\], got a NoneType"),
        ("render exits", "SystemExit: 1"),
    ],
)
def test_a_run_whose_film_fails_has_everything_else(neatq: Say, how: str, reason: str) -> None:
    status, out, error = neatq(*short("Strange-v0", "neat", f"how={how}"), "--out", "run")
    assert (status, error) == (0, "")
    assert re.search(rf"^neatq: champion\.gif: left out: {reason}$", out, re.MULTILINE), out
    written = "metrics.csv, curves.png, champion.json, scaling.json, result.json, champion.png"
    assert out.startswith(f"neatq: run: {written}\n")
    assert not Path("run", FILM).exists()
    status, again, error = neatq("resume", "run", "--generations", "3")
    assert (status, error) == (0, "")
    assert f"neatq: run: {written}\n" in again and "left out" in again


def test_a_failure_in_mid_run_names_episode_seed_and_step(neatq: Say) -> None:
    import strange_tasks  # pyright: ignore[reportMissingImports]

    for how, what in (
        ("exit", r"sys.exit was called: no licence \(strange_tasks.py:\d+\)"),
        ("large", r"reward is 1e\+300; expected a finite number of at most 1e12; .*"),
        ("huge", r"observation\[1\] is .*e\+.*; expected a finite number within single .*"),
    ):
        strange_tasks.Strange.resets = 0
        shutil.rmtree("run", ignore_errors=True)
        options = short("Strange-v0", "neat", f"how={how}", "after=70")
        status, out, error = neatq(*options, "--generations", "30", "--out", "run")
        where = r"slot \d of arena 0 failed in episode 0 with seed \d+, after [12] steps: "
        wanted = (
            rf"neatq: error: strange_tasks:strange/Strange-v0: {where}{what}(; go on with: .*)?\n"
        )
        assert (status, out) == (2, "")
        assert re.fullmatch(wanted, error), error
    strange_tasks.Strange.resets = 0


@pytest.mark.parametrize("arm", ["neatq", "neat", "qnetwork"])
def test_a_single_action_is_refused_with_a_sentence_about_the_space(neatq: Say, arm: str) -> None:
    status, _, error = neatq(*short("Plain-v0", arm, "acts=one"))
    assert status == 2
    assert re.fullmatch(r"neatq: error: task: .* one action only \(Discrete\(1\)\): .*\n", error)


def test_an_environment_that_ends_its_process_in_random_play_is_named(neatq: Say) -> None:
    status, out, error = neatq(*short("Strange-v0", "neat", "how=die", workers=2))
    assert (status, out) == (2, "")
    wanted = r"neatq: error: task: random play in strange_tasks:strange/Strange-v0 did not survive"
    assert re.fullmatch(rf"{wanted}: a process ended with exit code 7.*\n", error), error


def test_random_play_apart_finds_the_same_and_says_the_same() -> None:
    plain = preset(f"{GYM}Plain-v0", "neat", env_kwargs={"observes": "dict"}).world
    apart, here = facts_of(plain, 0.9, apart=ThisMachine()), facts_of(plain, 0.9)
    assert apart is not None and here is not None
    assert apart.to_dict() == here.to_dict()
    image = preset(f"{GYM}Plain-v0", "neat", env_kwargs={"observes": "screen"}).world
    with pytest.raises(TaskError, match="not for these networks"):
        facts_of(image, 0.9, apart=ThisMachine())


def test_any_name_of_a_world_is_drawn(neatq: Say) -> None:
    """The second is UTF-8 that a terminal of another encoding handed on."""
    for name in ("a_$x_{$b", "\udcc3\udc9c", "Übung ±"):
        size = [f"name={name}", "robots=3", "lifetime_ticks=20"]
        options = ["train", "--arm", "rtneat", "--ticks", "40", "--env-kwargs", *size]
        status, _, error = neatq(*options, "--out", "run")
        assert (status, error) == (0, "")
        assert Path("run/arena.png").is_file()
        shutil.rmtree("run")


def test_a_name_that_the_file_system_does_not_know_is_written_otherwise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = preset("wall", "rtneat", env_kwargs={"name": "Übung ± 3"})
    assert default_folder(config) == Path("runs/Übung-3-rtneat-seed0")
    monkeypatch.setattr(sys, "getfilesystemencoding", lambda: "ascii")
    assert default_folder(config) == Path("runs/bung-3-rtneat-seed0")


def test_what_a_terminal_cannot_write_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(written, encoding="ascii"))
    assert main(["train", "--task", "Übung"]) == 2
    sys.stderr.flush()
    assert b"got '?bung'" in written.getvalue()


def test_a_shorter_life_moves_the_age_at_which_rtneat_judges() -> None:
    for arm in ("rtneat", "neatq"):
        by_kwargs = preset("wall", arm, env_kwargs={"lifetime_ticks": 300})
        by_setting = preset("wall", arm).changed({"world.scenario.lifetime_ticks": 300})
        assert by_kwargs.population.minimum_life_ticks == 300
        assert by_setting == by_kwargs
    own = {"world.scenario.lifetime_ticks": 300, "population.minimum_life_ticks": 70}
    assert preset("wall", "rtneat").changed(own).population.minimum_life_ticks == 70
    apart = preset("wall", "rtneat").changed({"population.minimum_life_ticks": 70})
    apart = apart.changed({"world.scenario.lifetime_ticks": 300})
    assert apart.population.minimum_life_ticks == 70


def test_a_close_that_fails_does_not_keep_a_run_from_its_end(neatq: Say) -> None:
    with pytest.warns(UserWarning, match=r"close\(\) of .*: OSError: already gone"):
        status, _, error = neatq(*short("Strange-v0", "neat", "how=close raises"), "--out", "run")
    assert (status, error) == (0, "")


@pytest.mark.parametrize("how", ["goes elsewhere", "goes elsewhere when made"])
def test_an_environment_that_goes_elsewhere_leaves_the_run_where_it_was_asked_for(
    neatq: Say, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    status, out, error = neatq(*short("Strange-v0", "neat", f"how={how}"), "--out", "run")
    assert (status, error) == (0, "") and out.startswith("neatq: run: metrics.csv")
    assert Path.cwd() == tmp_path
    monkeypatch.chdir(tmp_path / "here")
    assert load_run("run").result() is not None
    status, out, error = neatq("resume", "run", "--generations", "3")
    assert (status, error) == (0, "") and out.startswith("neatq: run: metrics.csv")
    assert {one.name for one in tmp_path.iterdir()} == {"here"}


@pytest.mark.parametrize("observes", ["box", "choice", "many", "binary", "dict", "tuple"])
def test_a_policy_takes_a_batch_of_any_observations(neatq: Say, observes: str) -> None:
    task = short("Plain-v0", "neat", "acts=many", f"observes={observes}")
    assert neatq(*task, "--out", "run")[0] == 0
    policy = load_policy("run")
    assert isinstance(policy, ChampionPolicy) and policy.interface is not None
    space = policy.interface.observation
    seen = [space.sample() for _ in range(6)]
    alone = np.stack([policy.predict(one)[0] for one in seen])
    batch = concatenate(space, seen, create_empty_array(space, 6))
    assert policy.predict(batch)[0].tolist() == alone.tolist()
    twice = gymnasium.vector.utils.batch_space(space, 2)
    pairs = create_empty_array(twice, 3)
    concatenate(
        twice,
        [concatenate(space, seen[i : i + 2], create_empty_array(space, 2)) for i in (0, 2, 4)],
        pairs,
    )
    assert policy.predict(pairs)[0].tolist() == alone.reshape(3, 2, -1).tolist()
    assert policy.predict(create_empty_array(space, 0))[0].shape == (0, 2)


@pytest.mark.parametrize(
    ("observes", "value", "words"),
    [
        ("choice", 9, r"whole numbers from 5 to 7, got 9"),
        ("choice", [5, 6.5], r"whole numbers from 5 to 7, got 6\.5"),
        ("box", np.full((2, 2), np.nan), "expected an observation of numbers, got NaN"),
        (
            "dict",
            {"place": np.zeros((3, 2)), "gear": [1, 2]},
            r"a batch \[2\] in every part",
        ),
        ("dict", {"place": np.zeros((3, 2))}, r"expected the parts \['gear', 'place'\]"),
        ("tuple", ([0, 1],), r"expected the parts \[0, 1\]"),
        ("tuple", [1, np.ones((2, 2)), 4], r"expected the parts \[0, 1\]"),
        ("many", [[0, 7], [0]], "expected numbers of the shape"),
    ],
)
def test_what_a_policy_cannot_read_is_named(
    neatq: Say, observes: str, value: Any, words: str
) -> None:
    task = short("Plain-v0", "neat", "acts=many", f"observes={observes}")
    assert neatq(*task, "--out", "run")[0] == 0
    with pytest.raises(ValueError, match=words):
        load_policy("run")(value)
