"""Runs on NERO's field: they go on exactly, through stages, and their teams fight."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tensordict import TensorDictBase
from torch import Tensor

import neatq_torch as nq
from neatq_torch.interop import read_team_file, write_team_file
from neatq_torch.kinds import ConfigError
from neatq_trainers.cli import main
from neatq_trainers.nero import BattleRules, find_team, play
from neatq_trainers.run import Run

SMALL = {"robots": 6, "lifetime_ticks": 50}


def _metrics(folder: Path) -> str:
    return (folder / "metrics.csv").read_text()


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize("arm", ["rtneat", "neatq"])
def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(tmp_path: Path, arm: str) -> None:
    nq.train("nero", arm, ticks=480, out=tmp_path / "whole", env_kwargs=SMALL, seed=3)
    nq.train("nero", arm, ticks=240, out=tmp_path / "parts", env_kwargs=SMALL, seed=3)
    nq.resume(tmp_path / "parts", ticks=480)
    assert _metrics(tmp_path / "parts") == _metrics(tmp_path / "whole")
    champions = [nq.load_genome(tmp_path / name / "champion.json") for name in ("whole", "parts")]
    assert champions[0].to_json() == champions[1].to_json()


@pytest.mark.usefixtures("blank_pictures")
def test_a_curriculum_changes_fields_and_weights_at_the_tick_that_it_says(tmp_path: Path) -> None:
    file = tmp_path / "two.json"
    file.write_text(
        '{"name": "two", "sensors": "nero-1", "firing": "aimed", "robots": 6, "stages": ['
        '{"ticks": 100, "turrets": [[400, 500]], "reward_weights": {"approach_enemy": 1}},'
        '{"turrets": [], "reward_weights": {"stick_together": 1}}]}'
    )
    seen: list[tuple[int, tuple[float, ...]]] = []

    class Watch(nq.Callback):
        def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
            seen.append((run.tick, tuple(run.populations[0].reward_weights)))

    run = nq.train(
        "nero",
        "rtneat",
        env_kwargs={"field": str(file)},
        ticks=300,
        out=tmp_path / "run",
        callbacks=[Watch()],
    )
    rows = run.metrics()
    assert np.isfinite(rows["enemy_distance"]).tolist() == [True, False, False]
    approach, together = (0, 0, 1, 0, 0, 0), (0, 1, 0, 0, 0, 0)
    assert all(weights == (approach if tick < 100 else together) for tick, weights in seen)


@pytest.mark.usefixtures("blank_pictures")
def test_weights_that_somebody_changed_are_kept_by_a_resumed_run(tmp_path: Path) -> None:
    class Change(nq.Callback):
        def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
            run.world.env.arena.weights[:] = (0, 0, 0, 0, 0, 2)

    out = tmp_path / "run"
    nq.train("nero", "rtneat", out=out, env_kwargs=SMALL, ticks=200, callbacks=[Change()])
    found: list[tuple[float, ...]] = []

    class Look(nq.Callback):
        def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
            found.append(run.world.present_weights)

    nq.resume(tmp_path / "run", ticks=300, callbacks=[Look()])
    assert set(found) == {(0, 0, 0, 0, 0, 2)}


def test_a_team_of_a_run_fights_and_survives_a_file(tmp_path: Path) -> None:
    field = {**SMALL, "sensors": "opennero-2011", "firing": "2011"}
    nq.train("nero", "rtneat", ticks=200, out=tmp_path / "run", env_kwargs=field)
    assert {"champion.png", "curves.png", "team.gif"} <= set(os.listdir(tmp_path / "run"))
    team = find_team(tmp_path / "run")
    assert len(team.genomes) == 6
    assert (team.sensors, team.evaluation, team.bias) == ("opennero-2011", "synchronous", 1.0)
    rules = BattleRules(ticks=60, robots=6)
    assert play(team, team, seed=1, rules=rules) == play(team, team, seed=1, rules=rules)
    write_team_file(team.genomes, tmp_path / "team.gz")
    again = read_team_file(tmp_path / "team.gz").genomes
    assert [one.link_weight.tolist() for one in again] == [
        one.link_weight.tolist() for one in team.genomes
    ]


@pytest.mark.usefixtures("blank_pictures")
def test_each_arena_of_a_run_is_a_team(tmp_path: Path) -> None:
    out = tmp_path / "run"
    nq.train("nero", "rtneat", ticks=100, out=out, env_kwargs=SMALL, arenas=3, workers=2, seed=4)
    alone = nq.train("nero", "rtneat", ticks=100, out=tmp_path / "2", env_kwargs=SMALL, seed=6)
    team, same = find_team(f"{out}:2"), find_team(alone.folder)
    assert (team.name, find_team(out).name) == ("run:2", "run")
    assert [one.link_weight.tolist() for one in team.genomes] == [
        one.link_weight.tolist() for one in same.genomes
    ]
    with pytest.raises(ConfigError, match="below 3"):
        find_team(f"{out}:3")


@pytest.mark.usefixtures("blank_pictures")
def test_a_team_may_be_the_enemy_of_learners_that_sense_the_same(tmp_path: Path) -> None:
    field = {**SMALL, "sensors": "opennero-2011", "firing": "2011"}
    first = nq.train("nero", "rtneat", env_kwargs=field, ticks=100, out=tmp_path / "run")
    write_team_file(find_team(first.folder).genomes, tmp_path / "team.gz")
    enemy = {"enemy": str(tmp_path / "team.gz")}
    run = nq.train("nero", "rtneat", env_kwargs=field | enemy, ticks=100, out=tmp_path / "more")
    assert np.isfinite(run.metrics()["enemy_distance"]).all()
    learnt = {"enemy": str(first.folder)}  # as it is: another bias than that of a file
    run = nq.train("nero", "rtneat", env_kwargs=field | learnt, ticks=100, out=tmp_path / "again")
    assert np.isfinite(run.metrics()["enemy_distance"]).all()
    world: Any = nq.load_run(run.folder).config.world
    assert world.enemy == str(first.folder)
    with pytest.raises(ConfigError, match="opennero-2011"):
        nq.train("nero", "rtneat", env_kwargs=SMALL | enemy, ticks=100, out=tmp_path / "no")
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--task", "wall", "--reward", "hit_target=1"], "--reward"),
        (["--task", "nero", "--reward", "hits=1"], "hits"),
        (["--task", "nero", "--reward", "hit_target=1e300"], "reward_weights"),
        (["--task", "nero", "--reward", "hit_target=nan"], "reward_weights"),
        (["--task", "nero", "--reward", "hit_target=0"], "reward_weights"),
        (["--task", "nero", "--enemy", "nobody.gz"], "nobody.gz"),
        (["--task", "nero", "--enemy", "."], "no run"),
        (["--task", "nero", "--field", "nowhere"], "nowhere"),
        (["--task", "nero", "--env-kwargs", "robots=0"], "robots"),
        (["--task", "nero", "--env-kwargs", "turrets=[[0,0]]"], "turrets"),
    ],
)
def test_bad_input_is_a_sentence_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], given: list[str], said: str
) -> None:
    status = main(["train", *given, "--out", str(tmp_path / "run")])
    told = capsys.readouterr().err
    assert status == 2
    assert said in told
    assert told.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.usefixtures("blank_pictures")
def test_only_runs_of_nero_are_teams(tmp_path: Path) -> None:
    nq.train("flag", "rtneat", env_kwargs={"robots": 4}, ticks=100, out=tmp_path / "run")
    with pytest.raises(ConfigError, match="nero"):
        find_team(tmp_path / "run")
