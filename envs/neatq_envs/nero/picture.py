"""Pictures of a battle, drawn by Pillow: walls, robots, what is left of them, shots, the dead."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageColor, ImageDraw

from neatq_envs.nero.scenario import NeroScenario
from neatq_envs.nero.state import RADIUS, wall_corners
from neatq_envs.render import FLAG, GROUND, TICK, WALL
from neatq_envs.scenario import BORDER_INSET

SIDES = "#0072b2", "#d55e00", "#7a7f87"
"""Teams 0 and 1 in colours that everybody can tell apart (Okabe & Ito 2008), and turrets."""
EMPTY, STRUCK = "#ffffff", "#ffd21f"
"""Inside of a robot that has no hit points left, and around one that has just been hit."""
SHADES = 8
"""Steps of what fades: the insides of robots and the marks of the dead."""
_FINE = 3
"""Pixels are drawn so many times as fine, then averaged."""
_LEAST_RADIUS_PIXELS = 4.0
_DART = np.array([(1.45, 0.0), (-0.95, 0.9), (-0.5, 0.0), (-0.95, -0.9)])
"""A robot that heads to the right, in radii."""
_SHOT_FROM, _SHOT_TO = 2.0, 8.0
"""Where the line of a shot begins and where it ends at the latest, in radii."""
Dot = tuple[float, float]  # column, row


@dataclass(frozen=True, kw_only=True)
class Still:
    """What there is to see of robots, a row each.

    Attributes:
        pose: x and y in units and the heading in rad, float [robots, 3]; a dead one's last.
        team: int [robots].
        left: share of the hit points that is left, 0 of the dead, float [robots].
        shot: at whom a robot shot, -1: at nobody, int [robots].
        struck: who has just been hit, bool [robots].
        mark: how fresh the mark of a dead robot is, from 1 to 0, where there is none;
            float [robots].
    """

    pose: np.ndarray
    team: np.ndarray
    left: np.ndarray
    shot: np.ndarray
    struck: np.ndarray
    mark: np.ndarray


class Painter:
    """Draws stills of a field, or of a part of it; y points up.

    Args:
        scenario: the field.
        size: pixels of the longer side.
        corner: least x and least y that are drawn, in units.
        share: of the field's sides that is drawn.
    """

    def __init__(
        self,
        scenario: NeroScenario,
        *,
        size: int = 560,
        corner: tuple[float, float] = (0.0, 0.0),
        share: float = 1.0,
    ) -> None:
        width, height = scenario.width, scenario.height
        self._scale = _FINE * size / (max(width, height) * share)
        pixels = [max(1, round(size * side / max(width, height))) for side in (width, height)]
        self._corner, self._rows = corner, _FINE * pixels[1]
        self._radius = max(RADIUS[0] * self._scale, _FINE * _LEAST_RADIUS_PIXELS)
        self._empty = Image.new("RGB", (_FINE * pixels[0], _FINE * pixels[1]), WALL)
        self._draw_field(ImageDraw.Draw(self._empty), scenario)

    def paint(self, still: Still) -> Image.Image:
        """Draw a still, an RGB image."""
        image = self._empty.copy()
        pen = ImageDraw.Draw(image)
        dots = self._dots(still.pose[:, :2])
        inks = [SIDES[min(team, len(SIDES) - 1)] for team in still.team.tolist()]
        for robot in np.flatnonzero(still.mark > 0).tolist():
            self._draw_mark(pen, dots[robot], inks[robot], still.mark[robot])
        standing = np.flatnonzero(still.left > 0)
        for robot in standing[still.shot[standing] >= 0].tolist():
            self._draw_shot(pen, dots[robot], dots[still.shot[robot]], inks[robot])
        for robot in standing.tolist():
            heading = float(still.pose[robot, 2])
            self._draw_dart(pen, dots[robot], heading, inks[robot], still.left[robot])
        spark = 0.45 * self._radius
        for robot in standing[still.struck[standing]].tolist():
            column, row = dots[robot]
            pen.ellipse((column - spark, row - spark, column + spark, row + spark), STRUCK)
        return image.reduce(_FINE)

    def _draw_field(self, pen: ImageDraw.ImageDraw, scenario: NeroScenario) -> None:
        inset, width, height = BORDER_INSET, scenario.width, scenario.height
        top_left, bottom_right = self._dots([(inset, height - inset), (width - inset, inset)])
        pen.rectangle((*top_left, *bottom_right), GROUND)
        for wall in scenario.walls:
            pen.polygon(self._dots(wall_corners(wall)), WALL, WALL, _FINE)
        if scenario.flag is not None:
            self._draw_pennant(pen, self._dots([scenario.flag])[0])

    def _dots(self, at: np.ndarray | Sequence[tuple[float, float]]) -> list[Dot]:
        """Where points in units, [points, 2], are on the fine image."""
        off = (np.asarray(at, np.float64) - self._corner) * self._scale
        return [(x, self._rows - y) for x, y in off.tolist()]

    def _draw_mark(self, pen: ImageDraw.ImageDraw, at: Dot, colour: str, share: float) -> None:
        """Draw a cross that fades into the ground."""
        (column, row), arm = at, 0.9 * self._radius
        ink = blend(GROUND, colour, 0.75 * stepped(share))
        for slope in (-arm, arm):
            ends = column - arm, row - slope, column + arm, row + slope
            pen.line(ends, ink, round(1.5 * _FINE))

    def _draw_shot(self, pen: ImageDraw.ImageDraw, at: Dot, aim: Dot, colour: str) -> None:
        """Draw a short line towards whom is shot at."""
        across, down = aim[0] - at[0], aim[1] - at[1]
        distance = math.hypot(across, down)
        begin, end = _SHOT_FROM * self._radius, min(_SHOT_TO * self._radius, distance)
        if end > begin:
            across, down = across / distance, down / distance
            ends = [(at[0] + across * far, at[1] + down * far) for far in (begin, end)]
            pen.line(ends, blend(GROUND, colour, 0.6), _FINE)

    def _draw_dart(
        self, pen: ImageDraw.ImageDraw, at: Dot, heading_rad: float, colour: str, left: float
    ) -> None:
        """Draw a robot, its nose ahead; the less is left of it, the emptier."""
        cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
        turned = self._radius * _DART @ np.array([(cosine, -sine), (-sine, -cosine)])
        corners = [(at[0] + across, at[1] + down) for across, down in turned.tolist()]
        pen.polygon(corners, blend(EMPTY, colour, stepped(left)))
        pen.line([*corners, corners[0]], blend(colour, TICK, 0.5), _FINE)

    def _draw_pennant(self, pen: ImageDraw.ImageDraw, foot: Dot) -> None:
        (column, row), tall = foot, 24 * _FINE
        pen.rectangle((column, row - tall, column + 2 * _FINE, row), TICK)
        tip, half = column + 16 * _FINE, tall / 4
        cloth = [(column, row - tall), (tip, row - tall + half), (column, row - tall + 2 * half)]
        pen.polygon(cloth, FLAG)


def blend(back: str, front: str, share: float) -> tuple[int, int, int]:
    """A colour between two, `front` where the share is 1."""
    pairs = zip(ImageColor.getrgb(back)[:3], ImageColor.getrgb(front)[:3], strict=True)
    red, green, blue = (round(b + (f - b) * share) for b, f in pairs)
    return red, green, blue


def stepped(share: float) -> float:
    """The share, rounded up to a whole number of `SHADES`."""
    return math.ceil(SHADES * min(max(float(share), 0.0), 1.0)) / SHADES
