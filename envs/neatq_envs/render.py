"""Pictures of a world: frames for animations by numpy, paths of robots by matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from PIL import Image

from neatq_envs.scenario import BORDER_INSET, Scenario, Spawn
from neatq_envs.walls import Wall, box_distance

GROUND, WALL, SPAWN = (248, 247, 242), (70, 74, 82), (226, 232, 240)
ROBOT, CHAMPION_RGB, FLAG = (86, 133, 190), (240, 140, 0), (205, 38, 38)
TICK = (20, 30, 50)


def frame(
    scenario: Scenario,
    position: np.ndarray,
    heading_rad: np.ndarray,
    flag: np.ndarray,
    *,
    highlight: int | None = None,
    size: int = 400,
) -> np.ndarray:
    """Draw one arena, uint8 [height, width, 3]; y points up.

    Args:
        scenario: gives field, walls and spawns.
        position: [robots, 2] in units.
        heading_rad: [robots].
        flag: [2] in units; of two flags the one that counts, the other is drawn hollow.
        highlight: a robot to draw in another colour and on top, such as the champion.
        size: pixels of the longer side.
    """
    canvas = _background(scenario.width, scenario.height, scenario.walls, scenario.spawns, size)
    canvas = canvas.copy()
    scale = size / max(scenario.width, scenario.height)
    row = canvas.shape[0] - position[:, 1] * scale
    column = position[:, 0] * scale
    radius = max(3.0, scenario.robot_radius * scale)
    order = [robot for robot in range(len(position)) if robot != highlight]
    _draw_robots(canvas, row[order], column[order], heading_rad[order], radius, ROBOT)
    for x, y in _idle_flags(scenario, flag):
        _draw_flag(canvas, canvas.shape[0] - y * scale, x * scale, size, hollow=True)
    _draw_flag(canvas, canvas.shape[0] - flag[1] * scale, flag[0] * scale, size)
    if highlight is not None:
        top = slice(highlight, highlight + 1)
        _draw_robots(canvas, row[top], column[top], heading_rad[top], radius + 1.5, CHAMPION_RGB)
    return canvas


def animation(frames: Sequence[np.ndarray], fps: float = 20.0) -> bytes:
    """Frames, uint8 [height, width, 3] each, as the content of an endless GIF file."""
    if not len(frames):
        raise ValueError("frames: expected at least one, got none")
    if not fps > 0:
        raise ValueError(f"fps: expected more than 0 frames a second, got {fps}")
    first, *others = [Image.fromarray(image) for image in frames]
    file = io.BytesIO()
    duration = max(20, round(1000 / fps))  # viewers slow down shorter frames
    first.save(file, format="GIF", save_all=True, append_images=others, duration=duration, loop=0)
    return file.getvalue()


def draw_paths(
    scenario: Scenario,
    poses: np.ndarray,
    flag: np.ndarray,
    *,
    highlight: int | None = None,
    highlight_label: str = "highlighted robot",
) -> Figure:
    """Draw the way each robot took in its last life.

    Args:
        scenario: gives field, walls and spawns.
        poses: [ticks, robots, 3 or 2]: x, y (units), heading (rad).
        flag: [2] in units, at the end; of two flags the one that counts.
        highlight: a robot whose path is drawn thick and on top, such as the champion.
        highlight_label: what the legend calls it.
    """
    figure = Figure(figsize=(7.4, 6.0 * scenario.height / scenario.width + 1.0), layout="tight")
    axes = figure.add_subplot()
    _draw_field(axes, scenario)
    wall = Rectangle((0, 0), 1, 1, color=_rgb(WALL), label="wall")
    area = Rectangle((0, 0), 1, 1, fc="#c3cedd", ec="black", label="starting area")
    handles: list[Artist] = [wall, area]
    segments, ticks = _last_lives(scenario, poses)
    lines = LineCollection(list(segments), cmap="viridis", linewidths=0.7, alpha=0.65)
    lines.set_array(ticks)
    axes.add_collection(lines)
    figure.colorbar(lines, ax=axes, label="ticks since the life began", shrink=0.85)
    axes.plot(poses[-1, :, 0], poses[-1, :, 1], ".", color=_rgb(TICK), ms=4, zorder=4)
    handles.append(Line2D([], [], marker=".", ls="", color=_rgb(TICK), label="robot at the end"))
    if highlight is not None:
        way = _last_life(scenario, poses[:, highlight, :2])
        axes.plot(way[:, 0], way[:, 1], color=_rgb(CHAMPION_RGB), lw=2.5, zorder=5)
        axes.plot(*way[-1], "o", color=_rgb(CHAMPION_RGB), mec="black", ms=7, zorder=6)
        handles.append(Line2D([], [], color=_rgb(CHAMPION_RGB), lw=2.5, label=highlight_label))
    axes.plot(flag[0], flag[1], "*", color=_rgb(FLAG), mec="black", ms=16, zorder=7)
    handles.append(Line2D([], [], marker="*", ls="", color=_rgb(FLAG), ms=12, label="flag"))
    for x, y in _idle_flags(scenario, flag):
        star = {"marker": "*", "ls": "", "mfc": "white", "mec": _rgb(FLAG)}
        axes.plot(x, y, **star, ms=16, zorder=7)
        handles.append(Line2D([], [], **star, ms=12, label="flag that does not count"))
    axes.set_title(f'Last life of {poses.shape[1]} robots, task "{scenario.name}"')
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.1), "frameon": False}
    axes.legend(handles=handles, ncols=3, fontsize=9, **below)
    return figure


def _draw_field(axes: Axes, scenario: Scenario) -> None:
    axes.set(xlim=(0, scenario.width), ylim=(0, scenario.height), aspect="equal")
    axes.set(xlabel="x (units)", ylabel="y (units)", facecolor=_rgb(GROUND))
    for spine in axes.spines.values():
        spine.set(linewidth=2.5, color=_rgb(WALL))
    for spawn in scenario.spawns:
        reach = max(spawn.jitter, 1)
        corner = (spawn.x - reach, spawn.y - reach)
        axes.add_patch(Rectangle(corner, 2 * reach, 2 * reach, fc="#c3cedd", ec="black", zorder=2))
    for wall in scenario.walls:
        corner = wall.x - wall.width / 2, wall.y - wall.height / 2
        box = Rectangle(corner, wall.width, wall.height, rotation_point="center")
        box.set(angle=float(np.degrees(wall.angle_rad)), color=_rgb(WALL), zorder=3)
        axes.add_patch(box)


def _last_lives(scenario: Scenario, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All segments [segments, 2, 2] of the last lives and the tick of each."""
    segments, ticks = [np.zeros((0, 2, 2))], [np.zeros(0)]
    for robot in range(poses.shape[1]):
        way = _last_life(scenario, poses[:, robot, :2])
        segments.append(np.stack([way[:-1], way[1:]], axis=1))
        ticks.append(np.arange(len(way) - 1.0))
    return np.concatenate(segments), np.concatenate(ticks)


def _last_life(scenario: Scenario, way: np.ndarray) -> np.ndarray:
    """The part [ticks, 2] of a way after its last jump: a robot moves by its speed."""
    jumps = np.hypot(*np.diff(way, axis=0).T) > scenario.max_speed + scenario.robot_radius
    start = int(np.flatnonzero(jumps)[-1]) + 1 if jumps.any() else 0
    return way[start:]


@lru_cache(maxsize=8)
def _background(
    width: float, height: float, walls: tuple[Wall, ...], spawns: tuple[Spawn, ...], size: int
) -> np.ndarray:
    scale = size / max(width, height)
    rows, columns = max(1, round(height * scale)), max(1, round(width * scale))
    x = (np.arange(columns)[None, :] + 0.5) / scale
    y = height - (np.arange(rows)[:, None] + 0.5) / scale
    canvas = np.empty((rows, columns, 3), dtype=np.uint8)
    canvas[:] = GROUND
    for spawn in spawns:
        reach = max(spawn.jitter, 4)
        canvas[(np.abs(x - spawn.x) <= reach) & (np.abs(y - spawn.y) <= reach)] = SPAWN
    thick = max(BORDER_INSET, 1.0 / scale)
    canvas[(np.minimum(x, width - x) < thick) | (np.minimum(y, height - y) < thick)] = WALL
    for wall in walls:
        # Half a pixel more, so that a thin wall is never lost between pixels.
        canvas[box_distance(x, y, wall) <= 0.5 / scale] = WALL
    return canvas


@lru_cache(maxsize=8)
def _disc(radius: float) -> np.ndarray:
    """The offsets [pixels, 2] of a disc."""
    reach = int(np.ceil(radius))
    grid = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
    return grid[(grid**2).sum(1) <= radius * (radius + 0.7)]


def _stamp(
    canvas: np.ndarray,
    row: np.ndarray,
    column: np.ndarray,
    offsets: np.ndarray,
    colour: tuple[int, int, int],
) -> None:
    rows = (np.floor(row).astype(int)[:, None] + offsets[:, 0]).ravel()
    columns = (np.floor(column).astype(int)[:, None] + offsets[:, 1]).ravel()
    seen = (rows >= 0) & (rows < canvas.shape[0]) & (columns >= 0) & (columns < canvas.shape[1])
    canvas[rows[seen], columns[seen]] = colour


def _draw_robots(
    canvas: np.ndarray,
    row: np.ndarray,
    column: np.ndarray,
    heading_rad: np.ndarray,
    radius: float,
    colour: tuple[int, int, int],
) -> None:
    """Draw discs, and a tick from the middle of each beyond its rim along its heading."""
    _stamp(canvas, row, column, _disc(radius), colour)
    for step in np.arange(0.0, radius + 2.5, 0.5):
        ahead_row, ahead_column = row - step * np.sin(heading_rad), step * np.cos(heading_rad)
        _stamp(canvas, ahead_row, column + ahead_column, _disc(0.0), TICK)


def _idle_flags(scenario: Scenario, flag: np.ndarray) -> list[tuple[float, float]]:
    """The places of the flags that stand but do not count; `flag` is the one that does."""
    places = scenario.flag.positions if scenario.flag.switch_ticks else ()
    return [place for place in places if not np.allclose(place, flag)]


def _draw_flag(
    canvas: np.ndarray, row: float, column: float, size: int, *, hollow: bool = False
) -> None:
    """Draw a pole whose foot is the flag's place, with a triangle or its outline at its top."""
    tall = max(12, size // 22)
    pole = np.array([(-up, side) for up in range(tall + 1) for side in (0, 1)])
    half = tall // 3
    cloth = [(d, s) for d in range(-half, half + 1) for s in range(2 * (half - abs(d)) + 1)]
    if hollow:
        cloth = [(d, s) for d, s in cloth if s == 0 or s > 2 * (half - abs(d)) - 2]
    _stamp(canvas, np.array([row]), np.array([column]), pole, TICK)
    _stamp(canvas, np.array([row]) - tall + half, np.array([column]) + 2, np.array(cloth), FLAG)


def _rgb(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    return colour[0] / 255, colour[1] / 255, colour[2] / 255
