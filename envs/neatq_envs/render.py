"""Pictures of a world: frames for animations by Pillow, paths of robots by matplotlib."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from PIL import Image, ImageDraw

from neatq_envs.physics import border_walls
from neatq_envs.scenario import Scenario

GROUND, WALL, SPAWN, TICK = "#f8f7f2", "#464a52", "#e2e8f0", "#141e32"
ROBOT, HIGHLIGHT, FLAG = "#5685be", "#f08c00", "#cd2626"
Pixel = tuple[int, int]  # column, row
Pen = ImageDraw.ImageDraw


class ShownFigure(Figure):
    """A figure that a notebook shows, whether pyplot is loaded there or not."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()


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
    scale = size / max(scenario.width, scenario.height)
    columns, rows = (max(1, round(side * scale)) for side in (scenario.width, scenario.height))
    image = Image.new("RGB", (columns, rows), GROUND)
    pen = ImageDraw.Draw(image)

    def pixel(place: Iterable[float]) -> Pixel:
        x, y = place
        return int(x * scale), int(rows - y * scale)

    for spawn in scenario.spawns:
        reach = max(spawn.jitter, 4)
        top_left = pixel((spawn.x - reach, spawn.y + reach))
        pen.rectangle((top_left, pixel((spawn.x + reach, spawn.y - reach))), SPAWN)
    for corners in _walls(scenario):
        pen.polygon([pixel(corner) for corner in corners], WALL, WALL)
    radius = max(3, round(scenario.robot_radius * scale))
    middles = [pixel(place) for place in position.tolist()]
    for robot, (middle, heading) in enumerate(zip(middles, heading_rad.tolist(), strict=True)):
        if robot != highlight:
            _draw_robot(pen, middle, heading, radius, ROBOT)
    for place in _idle_flags(scenario, flag):
        _draw_flag(pen, pixel(place), size, hollow=True)
    _draw_flag(pen, pixel(flag), size)
    if highlight is not None:
        heading = float(heading_rad[highlight])
        _draw_robot(pen, middles[highlight], heading, radius + 2, HIGHLIGHT)
    return np.array(image)


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
    ways = [_last_life(scenario, way) for way in poses[..., :2].swapaxes(0, 1)]
    segments = [segment for way in ways for segment in np.stack([way[:-1], way[1:]], axis=1)]
    lines = LineCollection(segments, cmap="viridis", linewidths=0.7, alpha=0.65)
    lines.set_array(np.concatenate([np.arange(len(way) - 1.0) for way in ways]))
    axes.add_collection(lines)
    figure.colorbar(lines, ax=axes, label="ticks since the life began", shrink=0.85)
    axes.plot(*poses[-1, :, :2].T, ".", color=TICK, ms=4, zorder=4, label="robot at the end")
    if highlight is not None:
        way = ways[highlight]
        axes.plot(way[:, 0], way[:, 1], color=HIGHLIGHT, lw=2.5, zorder=5, label=highlight_label)
        axes.plot(*way[-1], "o", color=HIGHLIGHT, mec="black", ms=7, zorder=6)
    star = {"marker": "*", "ls": "", "ms": 16, "zorder": 7}
    axes.plot(*flag, color=FLAG, mec="black", label="flag", **star)
    for place in _idle_flags(scenario, flag):
        axes.plot(*place, mfc="white", mec=FLAG, label="flag that does not count", **star)
    title = f'Last life of {poses.shape[1]} robots, task "{scenario.name}"'
    plain_title(axes, title)
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.1), "frameon": False}
    axes.legend(ncols=3, fontsize=9, **below)
    return figure


def _draw_field(axes: Axes, scenario: Scenario) -> None:
    axes.set(xlim=(0, scenario.width), ylim=(0, scenario.height), aspect="equal")
    axes.set(xlabel="x (units)", ylabel="y (units)", facecolor=GROUND)
    for number, spawn in enumerate(scenario.spawns):
        reach = max(spawn.jitter, 1)
        corner = (spawn.x - reach, spawn.y - reach)
        area = Rectangle(corner, 2 * reach, 2 * reach, fc="#c3cedd", ec="black", zorder=2)
        axes.add_patch(area).set_label("" if number else "starting area")
    for number, corners in enumerate(_walls(scenario)):
        wall = Polygon(corners, color=WALL, zorder=3, label="" if number else "wall")
        axes.add_patch(wall)


def _last_life(scenario: Scenario, way: np.ndarray) -> np.ndarray:
    """The part [ticks, 2] of a way after its last jump: a robot moves by its speed."""
    jumps = np.hypot(*np.diff(way, axis=0).T) > scenario.max_speed + scenario.robot_radius
    start = int(np.flatnonzero(jumps)[-1]) + 1 if jumps.any() else 0
    return way[start:]


def _draw_robot(pen: Pen, middle: Pixel, heading_rad: float, radius: int, colour: str) -> None:
    """Draw a disc, and a tick from its middle beyond its rim along the heading."""
    (column, row), long = middle, radius + 2
    pen.ellipse((column - radius, row - radius, column + radius, row + radius), colour)
    across, up = round(long * math.cos(heading_rad)), round(long * math.sin(heading_rad))
    pen.line((column, row, column + across, row - up), TICK)


def _idle_flags(scenario: Scenario, flag: np.ndarray) -> list[tuple[float, float]]:
    """The places of the flags that stand but do not count; `flag` is the one that does."""
    places = scenario.flag.positions if scenario.flag.switch_ticks else ()
    return [place for place in places if not np.allclose(place, flag)]


def _draw_flag(pen: Pen, foot: Pixel, size: int, *, hollow: bool = False) -> None:
    """Draw a pole whose foot is the flag's place, with a triangle or its outline at its top."""
    (column, row), tall = foot, max(12, size // 22)
    top, half = row - tall, tall // 3
    pen.rectangle((column, top, column + 1, row), TICK)
    cloth = [(column + 2, top), (column + 2 + 2 * half, top + half), (column + 2, top + 2 * half)]
    pen.polygon(cloth, None if hollow else FLAG, FLAG)


def _walls(scenario: Scenario) -> list[list[tuple[float, float]]]:
    """The corners (x, y) in units of all walls, those of the border included."""
    corners = []
    for wall in (*border_walls(scenario), *scenario.walls):
        cosine, sine = math.cos(wall.angle_rad), math.sin(wall.angle_rad)
        a, b = wall.width / 2, wall.height / 2
        sides = (-a, -b), (a, -b), (a, b), (-a, b)
        turned = [(cosine * u - sine * v, sine * u + cosine * v) for u, v in sides]
        corners.append([(wall.x + x, wall.y + y) for x, y in turned])
    return corners


def plain_title(axes: Axes, text: str, **font: Any) -> None:
    """Set a title that holds a user's name as it is: no formula, and a sign for what is no text."""
    text = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    axes.set_title(text, parse_math=False, **font)
