"""The pictures of a run, drawn from its folder alone."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_envs.episodes import TEST, episode_seeds
from neatq_envs.gymnasium_rows import begin, close
from neatq_envs.gymnasium_task import GymnasiumTask, TaskError
from neatq_envs.observations import input_name, raised_by_environment
from neatq_envs.render import ShownFigure, animation, draw_paths, frame, plain_title
from neatq_envs.torchrl_env import ArenaEnv
from neatq_torch.atomic import write_atomic
from neatq_torch.genome import Genome
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import (
    CHAMPION,
    CURVES,
    FILM,
    PATHS,
    PICTURE,
    ROUNDS,
    TEAM,
    Columns,
    RunFolder,
    life_ticks,
)
from neatq_trainers.genome_figure import candidate_names, draw_genome
from neatq_trainers.nero.league import RoundRow
from neatq_trainers.nero.life_film import life_frames
from neatq_trainers.nero.match_table import csv_text
from neatq_trainers.nero.nero_world import NeroConfig
from neatq_trainers.policy import ChampionPolicy, make_policy
from neatq_trainers.rows import ROW_TICKS
from neatq_trainers.run import Run
from neatq_trainers.worlds import ArenaConfig, ArenaWorld, GymnasiumConfig

FRAME_TICKS = 8
"""Ticks between two frames of the team's animation."""
MOST_FRAMES = 150
WIDEST = 300
"""Pixels of a frame of the champion's animation."""

_DISTANCES = (
    ("min_distance", "tab:blue", "nearest robot"),
    ("mean_distance", "tab:green", "mean of the team"),
    ("eligible_mean_distance", "0.45", "mean of the eligible"),
    ("newborn_mean_distance", "tab:orange", "mean of the newborn"),
)
_FIGHTS = (("hits", "tab:green", "hits scored"), ("damage", "tab:red", "damage taken"))
_HELD_OUT = (("held_out_wins", "tab:purple", "won against teams that training never meets"),)
_AWAY = (
    ("enemy_distance", "tab:blue", "to the nearest enemy"),
    ("friend_distance", "tab:orange", "to the nearest friend"),
    ("flag_distance", "0.45", "to the flag"),
)
_RETURNS = (
    ("mean_fitness", "tab:green", "mean of all lives"),
    ("best_fitness", "0.6", "best life"),
    ("champion_return", "tab:blue", "champion, when it was evaluated"),
)


def write_report(folder: RunFolder) -> list[str]:
    """Write the pictures of a run into its folder.

    All worlds: `curves.png`; where there is a champion, `champion.png`. The arena: `arena.png` and
    `team.gif`. Gymnasium: `champion.gif`, where the environment can be drawn. A run without a row
    of metrics yet has no curves, one without a batch no paths.

    Returns:
        What was left out, and why.
    """
    if folder.metrics()["arena"].size:
        save_figure(folder.plot(), folder.path / CURVES)
    champion = folder.champion() if (folder.path / CHAMPION).is_file() else None
    if isinstance(folder.config.world, ArenaConfig):
        if champion is not None:
            save_figure(draw_genome(champion), folder.path / PICTURE)
        _draw_team(folder, folder.config.world)
        return []
    if isinstance(folder.config.world, NeroConfig):
        return _draw_fighters(folder, champion)
    if champion is None:
        return []
    policy = make_policy(folder.config, champion, folder.facts())
    picture = draw_genome(
        champion,
        input_names=input_names(policy),
        output_names=output_names(folder, policy),
    )
    save_figure(picture, folder.path / PICTURE)
    try:
        frames = film(folder, policy)
    except TaskError as error:
        return [f"{FILM}: {error}"]
    if frames:
        write_atomic(folder.path / FILM, animation(frames))
    return []


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    write_atomic(path, buffer.getvalue())


def draw_curves(metrics: Columns, title: str, *, one_by_one: bool = True) -> Figure:
    """The curves of a run.

    In the arena: least and mean distance to the flag over time, as Robertson & Wu (2014) drew them,
    and the means of the robots that are old enough to be judged and of the others, in whose
    distance an offspring shows what it is worth at birth. Elsewhere: return over steps, as far as
    the arena with the fewest has come.

    With several arenas the lines are means over arenas, the bands cover all of them.

    Args:
        metrics: Columns of `metrics.csv`.
        title: What ran.
        one_by_one: Whether genomes are replaced one by one; else all are newborn at once, and then
            all are old enough.
    """
    if "hits" in metrics:
        return _draw_fights(metrics, title)
    figure = ShownFigure(figsize=(8, 5.2), layout="tight")
    axes = figure.add_subplot()
    arenas = len(np.unique(metrics["arena"]))
    distances = "min_distance" in metrics
    if not distances and arenas > 1:
        metrics = _at_the_same_steps(metrics)
    when = metrics["tick"] / ROW_TICKS if distances else metrics["steps"]
    shown = _DISTANCES if one_by_one else _DISTANCES[:2]
    for name, colour, label in shown if distances else _RETURNS:
        if not np.isnan(metrics[name]).all():
            _draw_curve(axes, when, metrics[name], colour, label)
    axes.set_xlabel(
        f"figure tick ({ROW_TICKS} simulation ticks)" if distances else "steps of all in an arena"
    )
    axes.set_ylabel("distance to the flag (units)" if distances else "return of an episode")
    title = title if arenas == 1 else f"{title}: mean and range of {arenas} arenas"
    plain_title(axes, title)
    axes.set_xlim(0, when.max() * (1 if distances else 1.02))  # so that the last step is seen
    if distances:
        axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def _draw_fights(metrics: Columns, title: str) -> Figure:
    """Hits and damage of a team on NERO's field, and how near it is to enemies and friends."""
    panels = _FIGHTS, _AWAY, _HELD_OUT
    if np.isnan(metrics.get("held_out_wins", np.nan)).all():
        panels = panels[:2]
    figure = ShownFigure(figsize=(8, 3.2 * len(panels)), layout="tight")
    drawn = figure.subplots(len(panels), sharex=True)
    upper, lower = drawn[0], drawn[1]
    when = metrics["tick"] / ROW_TICKS
    for axes, columns in zip(drawn, panels, strict=True):
        for name, colour, label in columns:
            if not np.isnan(metrics[name]).all():
                _draw_curve(axes, when, metrics[name], colour, label)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    arenas = len(np.unique(metrics["arena"]))
    plain_title(upper, title if arenas == 1 else f"{title}: mean and range of {arenas} arenas")
    upper.set_ylabel("of a robot in 100 ticks")
    lower.set_ylabel("mean distance (units)")
    if len(panels) > 2:
        drawn[2].set_ylabel("share of matches")
        drawn[2].set_ylim(0, 1)
    drawn[-1].set_xlabel(f"figure tick ({ROW_TICKS} simulation ticks)")
    return figure


def _at_the_same_steps(metrics: Columns) -> Columns:
    """Rows of all arenas at the steps at which any has one, each with what was known by then."""
    arena, steps = metrics["arena"], metrics["steps"]
    rows = [np.flatnonzero(arena == one) for one in np.unique(arena)]
    first, last = max(steps[own[0]] for own in rows), min(steps[own[-1]] for own in rows)
    moments = np.unique(steps)
    moments = moments[(moments >= first) & (moments <= max(first, last))]
    latest = [own[np.searchsorted(steps[own], moments, "right") - 1] for own in rows]
    found = {name: column[np.concatenate(latest)] for name, column in metrics.items()}
    return found | {"steps": np.tile(moments, len(rows))}


def _draw_curve(axes: Axes, when: np.ndarray, column: np.ndarray, colour: str, label: str) -> None:
    moments = np.unique(when[~np.isnan(column)])
    each = [column[when == moment] for moment in moments]
    each = [values[~np.isnan(values)] for values in each]
    middle = "mean of the" in label and "team" not in label
    champion = label.startswith("champion")  # stays until another one is better
    axes.plot(
        moments,
        [values.mean() for values in each],
        color=colour,
        lw=0.9 if middle else 1.5,
        label=label,
        marker="o" if moments.size == 1 else None,
        drawstyle="steps-post" if champion else "default",
    )
    if not middle and max(values.size for values in each) > 1:
        low, high = ([f(values) for values in each] for f in (np.min, np.max))
        step = "post" if champion else None
        axes.fill_between(moments, low, high, color=colour, alpha=0.15, lw=0, step=step)


def _draw_team(folder: RunFolder, world: ArenaConfig) -> None:
    state = folder.read()
    config = folder.config.split(len(state["runs"]))[0]
    run, life = build(config, state["runs"][0]), life_ticks(config)
    assert isinstance(run.world, ArenaWorld)
    champion = run.populations[0].champion if run.populations else None
    track = state["track"].swapaxes(0, 1)
    if config.generational and world.scenario.lifetime_ticks:
        # The batch in which a generation ends may be longer than its lives.
        track = track[: len(track) - -life % config.ticks_per_batch]
    if track.size:
        paths = draw_paths(
            run.world.env.scenario,
            track,
            run.world.env.arena.flag[0],
            highlight=champion,
            highlight_label="champion",
        )
        save_figure(paths, folder.path / PATHS)
    poses, flags = play(run, life)
    frames = [
        frame(run.world.env.scenario, pose[:, :2], pose[:, 2], flag, highlight=champion)
        for pose, flag in zip(poses[::FRAME_TICKS], flags[::FRAME_TICKS], strict=True)
    ]
    write_atomic(folder.path / TEAM, animation(frames))


def _draw_fighters(folder: RunFolder, champion: Genome | None) -> list[str]:
    """Write the champion, a life of the team on NERO's field and a league's rounds."""
    if champion is not None:
        save_figure(draw_genome(champion), folder.path / PICTURE)
    state = folder.read()
    parts = folder.config.split(len(state["runs"]))
    if rounds := sorted(_rounds(parts, state), key=lambda row: (row.tick, row.arena)):
        write_atomic(folder.path / ROUNDS, csv_text([RoundRow._fields, *rounds]))
    run = build(parts[0], state["runs"][0])
    frames = life_frames(run, life_ticks(folder.config), FRAME_TICKS)
    write_atomic(folder.path / TEAM, animation(frames))
    return []


def _rounds(parts: Sequence[RunConfig], state: Mapping[str, Any]) -> Iterator[RoundRow]:
    """The rounds of a league; none without one."""
    for part, own in zip(parts, state["runs"], strict=True):
        league = own["world"]["rounds"] or {"rows": []}
        for arena, *rest in league["rows"]:
            yield RoundRow(part.seed - parts[0].seed + arena, *rest)


@torch.no_grad()
def play(run: Run, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Let a team live together from the spawn, without exploration and without learning.

    The networks of the run act; their recurrent state is used up. Returns poses [ticks, slots, 3]
    (x, y, heading in rad) and flags [ticks, 2] of arena 0.
    """
    env = ArenaEnv(run.world.env.scenario, arenas=run.shape[0], seed=run.config.seed)
    poses, flags = [], []
    run.policy.reset(torch.ones(run.shape, dtype=torch.bool))
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        rows = env.reset()
        for _ in range(ticks):
            poses.append(rows.get("pose")[0].numpy())
            flags.append(env.arena.flag[0].copy())
            _, rows = env.step_and_maybe_reset(run.policy(rows))
    return np.stack(poses), np.stack(flags)


def input_names(policy: ChampionPolicy) -> list[str]:
    """What the inputs of a network read, such as "observation['place'] [1]"."""
    numbers = range(policy.network.inputs)
    if policy.interface is None:
        return [f"observation [{i}]" for i in numbers]
    names = (input_name(policy.interface.observation, i) for i in numbers)
    return [" [".join(name.rsplit("[", 1)) for name in names]  # its first word is a group


def output_names(folder: RunFolder, policy: ChampionPolicy) -> list[str]:
    """What the outputs of a network mean."""
    heads = policy.heads
    if policy.interface is not None and policy.interface.choices is not None:
        value = "value of action" if folder.config.learns else "action"
        return [f"{value} {action}" for action in range(policy.interface.choices)]
    actions = [f"action {action}" for action in range(heads.actions)]
    return [*candidate_names(heads.candidates, actions)]


def film(folder: RunFolder, policy: ChampionPolicy) -> list[np.ndarray]:
    """Frames, uint8 [height, width, 3], of the champion's first test episode.

    None of them if the environment draws nothing.

    Raises:
        TaskError: If it cannot be made, played or drawn; the message says why.
    """
    world, result = folder.config.world, folder.result()
    if not isinstance(world, GymnasiumConfig) or result is None:
        return []
    seed = int(episode_seeds(result["champion"]["seed"], 0, 1, purpose=TEST)[0])
    return episode_film(world.task, policy, seed)


def episode_film(task: GymnasiumTask, policy: ChampionPolicy, seed: int) -> list[np.ndarray]:
    """Likewise of an episode that begins by a seed."""
    try:
        return _frames(task, policy, seed)
    except BaseException as error:  # whatever it objects to, the run is over
        if isinstance(error, TaskError) or not raised_by_environment(error):
            raise
        missing = isinstance(error, gymnasium.error.DependencyNotInstalled)
        kind = "" if missing else f"{type(error).__name__}: "
        raise TaskError(f"left out: {kind}{error}") from error


def _frames(task: GymnasiumTask, policy: ChampionPolicy, seed: int) -> list[np.ndarray]:
    """At most `MOST_FRAMES` pictures of an episode, evenly spaced in its steps.

    None if the environment draws nothing.
    """
    plain = task.make()
    modes = plain.metadata.get("render_modes") or ()
    close(plain)
    if "rgb_array" not in modes:
        return []
    if sys.platform == "linux" and not os.environ.keys() & {"DISPLAY", "WAYLAND_DISPLAY"}:
        # MuJoCo's usual renderer needs a display; tried again without one, it kills the process.
        os.environ.setdefault("MUJOCO_GL", "egl")
    env = task.make(render_mode="rgb_array")
    frames, apart = [], 1  # nobody knows how long an episode will be, and a picture takes long
    try:
        policy.reset()
        observation, step, done = begin(env, seed), 0, False
        while not done:
            if len(frames) == MOST_FRAMES:
                frames, apart = frames[::2], 2 * apart
            if step % apart == 0:
                frames.append(_picture(env.render()))
            observation, _, terminated, truncated, _ = env.step(policy(observation))
            step, done = step + 1, terminated or truncated
    finally:
        close(env)
    return frames


def _picture(drawn: Any) -> np.ndarray:
    if not isinstance(drawn, np.ndarray):
        words = f"expected a picture [height, width, 3], got a {type(drawn).__name__}"
        raise TaskError(f"left out: render(): {words}")
    picture = Image.fromarray(drawn)
    picture.thumbnail((WIDEST, WIDEST))
    return np.asarray(picture)
