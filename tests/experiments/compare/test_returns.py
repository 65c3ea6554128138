"""Comparisons where returns of episodes count: tables, statistics, and runs from end to end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import neatq_torch as nq
from neatq_experiments.compare.cells import STEPS, grid
from neatq_experiments.compare.returns import (
    ReturnPoint,
    Returns,
    SeedReturn,
    draw_returns,
    read_returns,
    returns_report,
    write_returns,
)
from neatq_torch.kinds import ConfigError
from neatq_trainers.cli import main
from neatq_trainers.folder import RunFolderError

TASK = "CartPole-v1"
LITTLE: dict[str, Any] = {"max_episode_steps": 20}


def returns_of(**arms: list[float | None]) -> Returns:
    """One seed for each test return, with two generations of 100 steps."""
    points, outcomes = [], []
    for arm, tested in arms.items():
        for seed, value in enumerate(tested):
            key = TASK, arm, seed
            points += [ReturnPoint(*key, n, 100 * n, 10.0 * n + seed, 5.0 * n) for n in (1, 2)]
            outcomes.append(SeedReturn(*key, 200, 40, value, 10.0, 0.5, "0123456789ab"))
    return Returns(points=tuple(points), outcomes=tuple(outcomes))


def test_the_table_has_intervals_and_more_is_better() -> None:
    returns = returns_of(rtneat=[100, 110, 120], neatq=[130, 140, 150])
    text = returns_report(returns)
    assert "| neatq | rtNEAT, and a critic that learns" in text
    assert "| 3 | 200 | 140 [130, 150] | 140 [130, 150] | 10 [10, 10] | 0.50 |" in text
    assert "| neatq | 3 | +30 [+30, +30] | 1.00 [1.00, 1.00] |" in text


def test_without_a_test_the_mean_fitness_counts() -> None:
    returns = returns_of(mine=[None, None])
    assert returns.scores(TASK, "mine") == {0: 10.0, 1: 10.0}


def test_the_champion_stays_until_another_one_is_better() -> None:
    moments, curves = returns_of(mine=[1, 2]).champions(TASK, "mine")
    assert (moments[0], moments[-1]) == (0, 200)
    assert np.isnan(curves[:, moments < 100]).all()
    assert set(curves[1, moments >= 100].tolist()) == {11.0, 21.0}
    (axes,) = draw_returns(returns_of(mine=[1, 2]), TASK).axes
    labels = [str(line.get_label()) for line in axes.lines]
    assert [one for one in labels if not one.startswith("_")] == ["mine (2 seeds)"]


@pytest.mark.parametrize("compress", [False, True])
def test_what_was_written_is_read(tmp_path: Path, compress: bool) -> None:
    returns = returns_of(rtneat=[100, None])
    write_returns(returns, tmp_path, compress=compress)
    assert read_returns(tmp_path) == returns


def test_tables_without_the_sizes_of_later_versions_are_read(tmp_path: Path) -> None:
    returns = returns_of(rtneat=[100, None])
    write_returns(returns, tmp_path)
    path = tmp_path / "return_seeds.csv"
    lines = [line.split(",") for line in path.read_text().splitlines()]
    path.write_text("".join(",".join(line[:9]) + "\n" for line in lines))
    assert lines[0][8:] == ["digest", "parameters", "nodes", "forward_us", "settings"]
    assert read_returns(tmp_path) == returns
    assert "Size and speed" not in returns_report(returns)
    path.write_text("".join(",".join(line[:8]) + "\n" for line in lines))
    with pytest.raises(RunFolderError, match=r"expected the columns task,.*,digest,parameters"):
        read_returns(tmp_path)


def test_sizes_are_means_with_the_least_and_the_most_and_shares_of_anchors() -> None:
    returns = returns_of(mine=[1, 2], ppo=[3, 4], old=[5, 6])
    sizes = {"mine": [(10, 7, 2.0), (30, 9, 4.0)], "ppo": [(4610, None, 20.0), (4610, None, 30.0)]}
    outcomes = [
        one._replace(**dict(zip(("parameters", "nodes", "forward_us"), values, strict=True)))
        for arm, rows in sizes.items()
        for one, values in zip(returns.outcomes_of(TASK, arm), rows, strict=True)
    ]
    text = returns_report(replace(returns, outcomes=(*outcomes, *returns.outcomes_of(TASK, "old"))))
    assert "| mine | 20 [10, 30] | 8 [7, 9] | 3.0 | 0.43% |" in text
    assert "| ppo | 4,610 [4,610, 4,610] | – | 25.0 | 100.00% |" in text  # noqa: RUF001
    assert "| old | – | – | – | – |" in text  # noqa: RUF001


def test_arms_have_equal_steps_unless_asked_for_another_length() -> None:
    cells = grid([f"gym:{TASK}"], None, quick=False)
    assert [cell.arm for cell in cells] == ["rtneat", "neat", "neatq", "neat+q"]
    assert {cell.config.length for cell in cells} == {("steps", STEPS)}
    (quick,) = grid([f"gym:{TASK}"], ["neat"], quick=True, length={"generations": 50})
    assert (quick.task, quick.config.length) == (TASK, ("generations", 5))
    with pytest.raises(ConfigError, match="ticks: no run is that long: none of the tasks counts"):
        grid([f"gym:{TASK}"], ["neat"], quick=False, length={"ticks": 9})
    with pytest.raises(ConfigError, match="qlearning does not run on gym:CartPole-v1"):
        grid([f"gym:{TASK}"], ["qlearning"], quick=False)


@pytest.mark.usefixtures("spawned")
def test_a_comparison_on_a_gymnasium_task_is_that_of_single_runs_and_made_again_from_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: Any = {"steps": 6000, "env_kwargs": LITTLE}
    folder = tmp_path / "compared"
    found = nq.compare(f"gym:{TASK}", ["neat"], seeds=2, jobs=1, out=folder, **asked)
    assert found.study is None
    assert found.returns is not None
    alone = nq.train(f"gym:{TASK}", "neat", seed=1, out=tmp_path / "run", **asked)
    result = alone.result()
    assert result is not None
    one = found.returns.outcomes_of(TASK, "neat")[1]
    assert one.test_return == pytest.approx(result["champion"]["mean"])
    assert one.steps >= 6000
    own = [point for point in found.returns.points if point.seed == 1]
    assert [point.steps for point in own] == alone.metrics()["steps"].tolist()
    assert (folder / f"{TASK}.png").is_file()
    assert main(["compare", "--results", str(folder), "--out", str(tmp_path / "copy")]) == 0
    assert (tmp_path / "copy" / "returns.csv.gz").is_file()
    assert (tmp_path / "copy" / "report.md").read_text() == found.report()
    assert f"report.md, {TASK}.png" in capsys.readouterr().out
