"""Cells of a comparison: the same seed is the same run, whatever happens to it."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from neatq_envs.arena import Arena
from neatq_envs.places import FlagSchedule
from neatq_torch.learning import EpsilonGreedy
from neatq_trainers.compare.cells import (
    Cell,
    _without_none,
    digest,
    grid,
    run_cell,
    runs_of,
    seed_result,
    share_done,
    study_of,
)
from neatq_trainers.compare.check import check_against
from neatq_trainers.compare.tables import POINT_TICKS
from neatq_trainers.compare.variants import ARMS, GROUPS, PARTS, VARIANTS, changed, config_of
from neatq_trainers.config import ConfigError, RunConfig
from neatq_trainers.metrics import Row
from neatq_trainers.progress import Progress
from neatq_trainers.report import read_metrics
from neatq_trainers.reproduce.experiment import Result, Results, Task
from neatq_trainers.reproduce.runner import tasks


def perform(cells: Sequence[Cell], seeds: tuple[int, ...], folder: Path) -> Results:
    """Run all cells in this process."""
    runs = runs_of(cells)
    return {
        arm: [
            {"seed": seed, **result}
            for seed, result in zip(
                seeds, runs.run(Task(arm, seeds, False, folder / arm)), strict=True
            )
        ]
        for arm in runs.arms
    }


def without_time(result: Result) -> Result:
    return {name: value for name, value in result.items() if name != "cpu_seconds"}


def test_every_arm_on_every_task_and_the_quick_ones_are_a_tenth() -> None:
    cells = grid(["flag", "wall"], ["rtneat", "neatq-frozen"], quick=True)
    assert [(cell.task, cell.arm, cell.config.ticks) for cell in cells] == [
        ("flag", "rtneat", 4000),
        ("flag", "neatq-frozen", 4000),
        ("wall", "rtneat", 7000),
        ("wall", "neatq-frozen", 7000),
    ]
    assert grid(["flag"], ["rtneat"], quick=False)[0].config.ticks == 40_000


def test_a_digest_knows_everything_but_names_seed_and_length() -> None:
    config = config_of("flag", "neatq")
    same = replace(config, seed=7, arenas=3, ticks=100, checkpoint_seconds=1.0, logger="csv")
    assert digest(same) == digest(config)
    assert digest(changed(config, {"learning.discount": 0.8})) != digest(config)
    assert digest(config_of("wall", "neatq")) != digest(config)
    assert digest(changed(config, {"scenario.max_speed": 1})) == digest(config)  # 1 is 1.0
    names = {cell.name for cell in grid(["flag", "wall"], [*ARMS, *VARIANTS], quick=False)}
    assert len({name.rsplit("-", 1)[1] for name in names}) == len(names)


def test_what_is_switched_off_does_not_count_in_a_digest() -> None:
    settings = {"later": None, "learning": {"epsilon": 0.0, "more": None}}
    assert _without_none(settings) == {"learning": {"epsilon": 0.0}}


def test_a_cell_that_has_changed_is_run_again_and_its_old_results_stay_out(
    tiny_cells: int, tmp_path: Path
) -> None:
    (cell,) = grid(["flag"], ["qlearning"], quick=True)
    other = cell._replace(config=changed(cell.config, {"learning.epsilon": 0.5}))
    folder = tmp_path / cell.name
    folder.mkdir(parents=True)
    (folder / "seed-0.json").write_text("{}")
    assert tasks(runs_of([cell]), tmp_path, seeds=1, quick=False) == []
    (task,) = tasks(runs_of([other]), tmp_path, seeds=1, quick=False)
    assert task.folder.is_relative_to(tmp_path / other.name)
    longer = cell._replace(config=replace(cell.config, ticks=2 * cell.config.ticks))
    assert len(tasks(runs_of([longer]), tmp_path, seeds=1, quick=False)) == 1


def test_quick_runs_are_the_beginning_of_whole_runs(tiny_cells: int, tmp_path: Path) -> None:
    names = ["flag"], ["rtneat", "neatq", "qlearning"]
    quick, whole = grid(*names, quick=True), grid(*names, quick=False)
    whole = [cell._replace(config=replace(cell.config, ticks=2 * POINT_TICKS)) for cell in whole]
    saved = study_of(whole, perform(whole, (0, 1), tmp_path))
    fresh = study_of(quick, perform(quick, (0, 1), tmp_path))
    assert fresh.points == tuple(point for point in saved.points if point.tick == POINT_TICKS)
    verdicts = check_against(saved, fresh)
    assert [(one.arm, one.tick, one.same) for one in verdicts] == [
        (arm, POINT_TICKS, True) for arm in names[1]
    ]


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
    whole = run_cell(configs, Task(cell.name, (0,), False, tmp_path / "whole"))
    task = Task(cell.name, (0,), False, tmp_path / "run")
    assert share_done(configs, task) == 0

    def press(_: Progress, tick: int, rows: Sequence[Row]) -> None:
        if tick == 240:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(Progress, "show", press)
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
    metrics = read_metrics(tmp_path / cells[0].name / "seeds-0-0")
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


def worlds_of(config: RunConfig, every: int) -> list[Any]:
    """Flags, and where lives begin, of a world whose robots begin a life every so many ticks."""
    flag = FlagSchedule(ring=(100.0, 200.0), interval_ticks=7)
    arena = Arena(config.scenario.replaced(flag=flag, robots=4), seeds=[5])
    first = arena.position.copy(), arena.heading_rad.copy()
    flags, places = [], []
    for tick in range(1, 40):
        arena.step(np.zeros((1, 4, len(arena.schema.actions))))
        flags.append(arena.flag.copy())
        if tick % every == 0:
            arena.respawn(np.ones((1, 4), bool))
            places.append(arena.position.copy())
    return [*first, np.stack(flags), np.stack(places)[:3]]


def test_a_seed_is_the_same_world_for_every_arm_and_variant() -> None:
    wanted = worlds_of(config_of("flag", "rtneat"), every=5)
    assert len(np.unique(wanted[2])) > 4  # the flag moves
    for number, arm in enumerate((*ARMS, *VARIANTS)):
        found = worlds_of(config_of("flag", arm), every=3 + number % 5)
        assert all(np.array_equal(one, other) for one, other in zip(wanted, found, strict=True))


def test_all_arms_have_the_same_task_but_for_sensors_and_reward() -> None:
    for task in ("flag", "wall"):
        worlds = [config_of(task, arm).scenario for arm in (*ARMS, *VARIANTS)]
        same = [world.replaced(sensors="arena", reward="progress") for world in worlds]
        assert all(world == same[0] for world in same)
        assert len({config_of(task, arm).ticks for arm in (*ARMS, *VARIANTS)}) == 1


def test_a_variant_is_its_arm_with_other_values() -> None:
    base, variant = (config_of("wall", name) for name in ("neatq", "neatq-darwinian"))
    learning = replace(base.learning, inheritance="darwinian")
    assert variant == replace(base, learning=learning)
    mixed = config_of("wall", "rtneat-neatq-senses")
    assert (mixed.scenario.sensors, mixed.scenario.reward) == ("arena", "progress")
    assert mixed.learning == config_of("wall", "rtneat").learning


def test_all_parts_together_lead_from_what_the_paper_describes_to_neatq() -> None:
    everything = {path: value for part in PARTS.values() for path, value in part.added.items()}
    described, neatq = config_of("wall", "described"), config_of("wall", "neatq")
    assert digest(changed(described, everything)) == digest(neatq)
    last_step = config_of("wall", list(GROUPS["ladder"])[-1])
    name, last = list(PARTS.items())[-1]
    before = changed(last_step, list(PARTS.values())[-2].added)
    assert digest(before) == digest(config_of("wall", f"neatq-without-{name}"))
    assert digest(changed(before, last.added)) == digest(neatq)


def test_a_part_that_is_taken_out_can_be_put_back() -> None:
    neatq = config_of("flag", "neatq")
    whole = {path: value for part in PARTS.values() for path, value in part.added.items()}
    for name, part in PARTS.items():
        without = config_of("flag", f"neatq-without-{name}")
        assert without != neatq
        assert changed(without, whole) == neatq
        assert part.added.keys() <= part.removed.keys()


def test_explorations_that_last_take_as_many_ticks_as_those_that_do_not() -> None:
    shares = []
    for name in ("neatq", "neatq-lasting-exploration"):
        learning = config_of("wall", name).learning
        explore = EpsilonGreedy(
            (1, 400),
            seeds=[0],
            epsilon=learning.epsilon,
            max_hold_ticks=learning.max_hold_ticks,
        )
        values = torch.tensor([1.0] + [0.0] * 4).expand(1, 400, 5)
        chosen = torch.stack([explore(values) for _ in range(4000)])
        shares.append((chosen != 0).float().mean().item())
    assert shares[0] == pytest.approx(shares[1], rel=0.1)


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"learning.speed": 1}, "learning.speed: there is no such value"),
        ({"learning.rule.name": 1}, "learning.rule.name: there is no such value"),
        ({"learning.discount": 2}, r"learning.discount: expected a number in \[0, 1\]"),
        ({"learning.rule": "guess"}, "Invalid enum value 'guess'"),
    ],
)
def test_a_change_that_cannot_be_made_is_named(changes: dict[str, Any], pattern: str) -> None:
    with pytest.raises(ConfigError, match=pattern):
        changed(config_of("wall", "neatq"), changes)


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
    assert (cell.task, cell.config.scenario.robots, cell.config.ticks) == ("labyrinth", 9, 7000)
