"""The pictures of a run, drawn from its folder alone."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_envs.render import animation, draw_paths, frame
from neatq_envs.torchrl import ArenaEnv
from neatq_torch.atomic import write_atomic
from neatq_trainers.build import Run
from neatq_trainers.metrics import ROW_TICKS
from neatq_trainers.run_folder import (
    ANIMATION,
    ARENA,
    CURVES,
    METRICS,
    RunFolder,
    life_ticks,
)

FRAME_TICKS = 8
"""Ticks between two frames of the animation."""

Metrics = dict[str, np.ndarray]


def write_report(folder: RunFolder) -> None:
    """Write `curves.png`, `arena.png` and `team.gif` into the folder of a run.

    A run without a row of metrics yet has no curves, one without a batch no paths.
    """
    run = folder.read()
    life = life_ticks(run.config)
    arena = run.env.arena
    champion = run.populations[0].champion if run.populations else None
    metrics = read_metrics(folder.path)
    if metrics["tick"].size:
        title = f"{run.config.arm} on {run.config.scenario.name}"
        save_figure(draw_curves(metrics, title), folder.path / CURVES)
    if folder.track:
        poses = folder.latest_track(life).swapaxes(0, 1)
        paths = draw_paths(
            run.config.scenario,
            poses,
            arena.flag[0],
            highlight=champion,
            highlight_label="champion",
        )
        save_figure(paths, folder.path / ARENA)
    poses, flags = play(run, life)
    frames = [
        frame(run.config.scenario, pose[:, :2], pose[:, 2], flag, highlight=champion)
        for pose, flag in zip(poses[::FRAME_TICKS], flags[::FRAME_TICKS], strict=True)
    ]
    write_atomic(folder.path / ANIMATION, animation(frames))


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    write_atomic(path, buffer.getvalue())


@torch.no_grad()
def play(run: Run, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Let the team live together from the spawn, without exploration and without learning.

    Args:
        run: Its networks act; their recurrent state is used up.
        ticks: How long.

    Returns:
        Poses [ticks, robots, 3] (x, y, heading in rad) and flags [ticks, 2] of arena 0.
    """
    config = run.config
    env = ArenaEnv(config.scenario, arenas=config.arenas, seed=config.seed)
    poses, flags = [], []
    run.policy.reset(torch.ones(config.shape, dtype=torch.bool))
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        rows = env.reset()
        for _ in range(ticks):
            poses.append(rows.get("pose")[0].numpy())
            flags.append(env.arena.flag[0].copy())
            _, rows = env.step_and_maybe_reset(run.policy(rows))
    return np.stack(poses), np.stack(flags)


def read_metrics(path: Path) -> Metrics:
    """The columns of a run's `metrics.csv`, float64 [rows] each; empty cells are NaN."""
    with (path / METRICS).open(newline="") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
        names = reader.fieldnames or []
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}


def draw_curves(metrics: Metrics, title: str) -> Figure:
    """Least and mean distance to the flag over time, as Robertson & Wu (2014) drew them.

    Beside them the means of the robots that are old enough to be judged and of the others, in whose
    distance an offspring shows what it is worth at birth.

    With several arenas the lines are means over arenas, the band covers all of them.

    Args:
        metrics: Columns as `read_metrics` gives them.
        title: What ran.
    """
    figure = Figure(figsize=(8, 5.2), layout="tight")
    axes = figure.add_subplot()
    arenas = len(np.unique(metrics["arena"]))
    _draw_curve(axes, metrics, "min_distance", "tab:blue", "nearest robot")
    _draw_curve(axes, metrics, "mean_distance", "tab:green", "mean of the team")
    for name, colour, label in (
        ("eligible_mean_distance", "0.45", "mean of the eligible"),
        ("newborn_mean_distance", "tab:orange", "mean of the newborn"),
    ):
        if not np.isnan(metrics[name]).all():
            _draw_curve(axes, metrics, name, colour, label, band=False)
    axes.set_xlabel(f"figure tick ({ROW_TICKS} simulation ticks)")
    axes.set_ylabel("distance to the flag (units)")
    axes.set_title(title if arenas == 1 else f"{title}: mean and range of {arenas} arenas")
    axes.set_xlim(0, metrics["tick"].max() / ROW_TICKS)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def _draw_curve(
    axes: Axes, metrics: Metrics, name: str, colour: str, label: str, *, band: bool = True
) -> None:
    ticks = np.unique(metrics["tick"])
    values = np.stack([metrics[name][metrics["tick"] == tick] for tick in ticks])
    known = ~np.isnan(values).all(1)
    ticks, values = ticks[known] / ROW_TICKS, values[known]
    width = 1.4 if band else 0.9
    axes.plot(ticks, np.nanmean(values, 1), color=colour, lw=width, label=label)
    if band and values.shape[1] > 1:
        low, high = np.nanmin(values, 1), np.nanmax(values, 1)
        axes.fill_between(ticks, low, high, color=colour, alpha=0.15, lw=0)
