"""Cells of a comparison: the same seed is the same run, whatever happens to it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_experiments.compare import variants
from neatq_experiments.compare.cells import (
    Cell,
    _without_none,
    digest,
    grid,
    outdated,
    run_cell,
    runs_of,
    seed_result,
    share_done,
    study_of,
)
from neatq_experiments.compare.tables import POINT_TICKS, Study
from neatq_experiments.compare.variants import Variant, config_of, register_variants
from neatq_experiments.seeds import Result, Results, SeedTask, tasks
from neatq_torch.kinds import ConfigError
from neatq_trainers.callbacks import ProgressBar
from neatq_trainers.folder import load_run
from neatq_trainers.rows import Row
from neatq_trainers.train import Session
from neatq_trainers.worlds import ArenaConfig


def perform(cells: Sequence[Cell], seeds: tuple[int, ...], folder: Path) -> Results:
    """Run all cells in this process."""
    runs = runs_of(cells)
    return {
        arm: [
            {"seed": seed, **result}
            for seed, result in zip(
                seeds, runs.run(SeedTask(arm, seeds, False, folder / arm)), strict=True
            )
        ]
        for arm in runs.arms
    }


def without_time(result: Result) -> Result:
    return {name: value for name, value in result.items() if name != "cpu_seconds"}


def test_every_arm_on_every_task_and_the_quick_ones_are_a_tenth() -> None:
    cells = grid(["flag", "wall"], ["rtneat", "replay-frozen"], quick=True)
    assert [(cell.task, cell.arm, cell.config.ticks) for cell in cells] == [
        ("flag", "rtneat", 4000),
        ("flag", "replay-frozen", 4000),
        ("wall", "rtneat", 7000),
        ("wall", "replay-frozen", 7000),
    ]
    assert grid(["flag"], ["rtneat"], quick=False)[0].config.ticks == 40_000


def test_a_digest_knows_everything_but_names_seed_and_length() -> None:
    config = config_of("flag", "neatq")
    same = replace(config, seed=7, arenas=3, ticks=100, checkpoint_seconds=1.0, logger="csv")
    assert digest(same) == digest(config)
    assert digest(config.changed({"learner.discount": 0.8})) != digest(config)
    assert digest(config_of("wall", "neatq")) != digest(config)
    assert digest(config.changed({"world.scenario.max_speed": 1})) == digest(config)  # 1 is 1.0


def test_what_is_switched_off_does_not_count_in_a_digest() -> None:
    settings = {"later": None, "learning": {"epsilon": 0.0, "more": None}}
    assert _without_none(settings) == {"learning": {"epsilon": 0.0}}


def test_a_cell_that_has_changed_is_run_again_and_its_old_results_stay_out(
    tiny_cells: int, tmp_path: Path
) -> None:
    (cell,) = grid(["flag"], ["qlearning"], quick=True)
    other = cell._replace(config=cell.config.changed({"learner.epsilon": 0.5}))
    folder = tmp_path / cell.name
    folder.mkdir(parents=True)
    (folder / "seed-0.json").write_text("{}")
    assert tasks(runs_of([cell]), tmp_path, seeds=1, quick=False) == []
    (task,) = tasks(runs_of([other]), tmp_path, seeds=1, quick=False)
    assert task.folder.is_relative_to(tmp_path / other.name)
    longer = cell._replace(config=replace(cell.config, ticks=2 * tiny_cells))
    assert len(tasks(runs_of([longer]), tmp_path, seeds=1, quick=False)) == 1


def test_quick_runs_are_the_beginning_of_whole_runs(tiny_cells: int, tmp_path: Path) -> None:
    names = ["flag"], ["rtneat", "neatq", "qlearning"]
    quick, whole = grid(*names, quick=True), grid(*names, quick=False)
    whole = [cell._replace(config=replace(cell.config, ticks=POINT_TICKS + 100)) for cell in whole]
    saved = study_of(whole, perform(whole, (0, 1), tmp_path))
    fresh = study_of(quick, perform(quick, (0, 1), tmp_path))
    assert fresh.points == tuple(point for point in saved.points if point.tick == POINT_TICKS)


def test_a_seed_gives_the_same_whatever_runs_beside_it(tiny_cells: int, tmp_path: Path) -> None:
    cells = grid(["flag"], ["neatq"], quick=True)
    (both,) = perform(cells, (0, 1), tmp_path / "both").values()
    (alone,) = perform(cells, (1,), tmp_path / "alone").values()
    assert without_time(both[1]) == without_time(alone[0])


def test_an_interrupted_cell_goes_on_exactly(
    tiny_cells: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (cell,) = grid(["flag"], ["rtneat"], quick=True)
    configs = {cell.name: cell.config}
    whole = run_cell(configs, SeedTask(cell.name, (0,), False, tmp_path / "whole"))
    task = SeedTask(cell.name, (0,), False, tmp_path / "run")
    assert share_done(configs, task) == 0

    def press(_: ProgressBar, session: Session, rows: Sequence[Row]) -> None:
        if session.done == 240:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(ProgressBar, "rows", press)
        with pytest.raises(KeyboardInterrupt):
            run_cell(configs, task)
    assert 0.4 <= share_done(configs, task) < 1
    (result,) = run_cell(configs, task)
    assert without_time(result) == without_time(whole[0])
    assert result["cpu_seconds"] > 0
    assert share_done(configs, task) == 1
    assert run_cell(configs, task)[0]["cpu_seconds"] is None  # nothing was left to do


def test_cpu_seconds_are_those_of_a_thousand_ticks_of_one_arena(
    tiny_cells: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter((10.0, 16.0))
    cells = grid(["flag"], ["qlearning"], quick=True)
    monkeypatch.setattr("time.process_time", lambda: next(clock))
    (results,) = perform(cells, (0, 1), tmp_path).values()
    # 6 seconds for 500 ticks of 2 arenas.
    assert [result["cpu_seconds"] for result in results] == [6, 6]


def test_rows_are_means_of_five_looks(tiny_cells: int, tmp_path: Path) -> None:
    cells = grid(["flag"], ["rtneat"], quick=True)
    (results,) = perform(cells, (0,), tmp_path).values()
    metrics = load_run(tmp_path / cells[0].name / "seeds-0-0").metrics()
    assert metrics["tick"][:5].tolist() == [100, 200, 300, 400, 500]
    assert results[0]["tick"] == [500]
    assert results[0]["team"] == pytest.approx([metrics["mean_distance"][:5].mean()], abs=1e-4)
    assert results[0]["nearest"] == pytest.approx([metrics["min_distance"][:5].mean()], abs=1e-4)
    assert results[0]["births"] == [metrics["births"][4]]


def test_what_comes_after_the_last_tick_does_not_count() -> None:
    names = ("mean_distance", "min_distance", "eligible_mean_distance", "newborn_mean_distance")
    metrics = {name: np.full(10, 50.0) for name in (*names, "champion_distance", "births")}
    metrics |= {"arena": np.zeros(10), "tick": 100.0 * np.arange(1, 11)}
    metrics["min_distance"][9] = 0.0
    assert seed_result(metrics, 0, 1000)["first_contact"] == 1000
    early = seed_result(metrics, 0, 500)
    assert (early["tick"], early["first_contact"]) == ([500], None)


def test_an_arm_that_has_changed_since_is_outdated(study_of: Callable[..., Study]) -> None:
    study = study_of(rtneat=[[1]], unknown=[[1]])
    assert outdated(study) == [("flag", "rtneat")]
    now = digest(config_of("flag", "rtneat"))
    same = tuple(one._replace(digest=now) for one in study.outcomes)
    assert outdated(replace(study, outcomes=same)) == []


def test_a_variant_of_ones_own_is_an_arm_with_other_values(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(variants, "GROUPS", {})
    slow = Variant(base="neatq", summary="slow robots", changes={"world.scenario.max_speed": 0.5})
    register_variants("mine", {"neatq-slow": slow})
    base, variant = config_of("flag", "neatq"), config_of("flag", "neatq-slow")
    assert variant == base.changed({"world.scenario.max_speed": 0.5})
    register_variants("mine", {"neatq-slow": slow})  # the same again is no other
    fast = replace(slow, changes={"world.scenario.max_speed": 2.0})
    for group, name in (("mine", "neatq-slow"), ("others", "rtneat"), ("neatq", "neatq-fast")):
        with pytest.raises(ConfigError, match="is taken by something else"):
            register_variants(group, {name: fast})


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"learner.speed": 1}, "learner.speed: there is no such value"),
        ({"learner.kind.name": 1}, "learner.kind.name: there is no such value"),
        ({"learner.discount": 2}, r"learner.+discount: expected \[0, 1\]"),
        ({"learner.kind": "guess"}, "learner: expected one of none, td, .* got 'guess'"),
        ({"learner.kind": "td", "learner.horizon": 3}, "learner.horizon: there is no such value"),
    ],
)
def test_a_change_that_cannot_be_made_is_named(changes: dict[str, Any], pattern: str) -> None:
    with pytest.raises(ConfigError, match=pattern):
        config_of("wall", "neatq").changed(changes)


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        ((["flag"], ["rtneta"]), "arms: expected some of rtneat, .*ladder.*; got 'rtneta'"),
        ((["flga"], ["rtneat"]), "task: expected flag, .*; got 'flga'"),
        ((["flag", "flag"], ["rtneat"]), "tasks: expected .* none twice; got flag flag"),
        ((["flag"], ["rtneat", "rtneat"]), "arms: expected .* none twice"),
        ((["flag"], []), "arms: expected at least one"),
        (
            (["mine/flag.json"], ["rtneat"]),
            "would be called flag, which is another task; rename",
        ),
    ],
)
def test_a_grid_that_cannot_be_made_is_refused(names: Any, pattern: str) -> None:
    with pytest.raises(ConfigError, match=pattern):
        grid(*names, quick=False)


def test_a_scenario_file_is_a_task_named_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("labyrinth.json").write_text('{"name": "my labyrinth", "robots": 9}')
    (cell,) = grid(["labyrinth.json"], ["neatq"], quick=True)
    assert (cell.task, cell.config.ticks) == ("labyrinth", 7000)
    assert isinstance(cell.config.world, ArenaConfig)
    assert cell.config.world.scenario.robots == 9
