"""An animation of a battle, to look at: a GIF by Pillow, below it who leads and how many live."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from neatq_envs.nero.picture import EMPTY, SIDES, STRUCK, Painter, Still, blend
from neatq_envs.render import FLAG, GROUND, TICK, WALL
from neatq_torch.atomic import write_atomic
from neatq_trainers.nero.figures import short_names
from neatq_trainers.nero.match import BattleRules, Film, filmed
from neatq_trainers.nero.teams import Team

FRAME_MS, LAST_FRAME_MS = 50, 4000
MOST_BATTLE_FRAMES = 300
"""Of a longer battle fewer ticks are shown."""
MARK_FRAMES = 48
"""How long the mark of a dead robot lasts."""
MARGIN_UNITS, RIM_UNITS, LEAST_SHARE = 30.0, 6.0, 0.4
"""What is shown around where robots ever were, at most how much beyond the field, and at least
which share of its sides."""
CAPTION_ROWS, LEAST_COLUMNS = 56, 480
_INSET, _BAR_ROWS, _BETWEEN = 14, 8, 190
"""Pixels in the caption: from its sides, of the bars, and between the teams for the score."""
_FADES = tuple(step / 8 for step in range(1, 9))


def animate(blue: Team, red: Team, *, seed: int, rules: BattleRules, path: Path) -> None:
    """Write an animation of a battle, the one that `play` lets two teams fight.

    Raises:
        ConfigError: If they sense differently.
        OSError: If the file cannot be written.
    """
    shown = filmed(blue, red, seed=seed, rules=rules)
    write_atomic(path, battle_gif(shown, (blue.name, red.name)))


def battle_gif(shown: Film, names: tuple[str, str]) -> bytes:
    """The content of an endless GIF; the end stands still for a while."""
    count = len(frame_ticks(len(shown.pose)))
    durations = [FRAME_MS] * (count - 1) + [LAST_FRAME_MS]
    frames = battle_frames(shown, names)
    file = io.BytesIO()
    options = {"save_all": True, "optimize": True, "duration": durations, "loop": 0}
    next(frames).save(file, format="GIF", append_images=frames, **options)
    return file.getvalue()


def battle_frames(shown: Film, names: tuple[str, str]) -> Iterator[Image.Image]:
    """Draw a battle, a frame every few ticks, as images of one palette (mode "P").

    Args:
        shown: the battle.
        names: of blue and of red.
    """
    corner, share = view(shown)
    painter = Painter(shown.scenario, corner=corner, share=share)
    ticks = frame_ticks(len(shown.pose))
    caption, palette = _Caption(shown, names), _Palette()
    for now, still in zip(ticks, _stills(shown, ticks), strict=True):
        field = painter.paint(still)
        columns = max(field.width, LEAST_COLUMNS)
        image = Image.new("RGB", (columns, field.height + CAPTION_ROWS), GROUND)
        image.paste(field, ((columns - field.width) // 2, 0))
        image.paste(caption.draw(columns, now), (0, field.height))
        yield palette.reduced(image)


def frame_ticks(ticks: int) -> list[int]:
    """Indices of the ticks that are drawn: at most every second one, and the last.

    Raises:
        ValueError: If there is none.
    """
    if ticks < 1:
        raise ValueError(f"ticks: expected a battle of at least 1 tick, got {ticks}")
    step = max(2, math.ceil(ticks / MOST_BATTLE_FRAMES))
    return [*range(0, ticks - 1, step), ticks - 1]


def view(shown: Film) -> tuple[tuple[float, float], float]:
    """The part of the field that is worth seeing: its least x and y, and its share of the sides."""
    field = np.array([shown.scenario.width, shown.scenario.height])
    seen = shown.pose[..., :2][shown.hit_points > 0]
    low = (seen.min(0) - MARGIN_UNITS).clip(-RIM_UNITS)
    high = np.minimum(seen.max(0) + MARGIN_UNITS, field + RIM_UNITS)
    share = max(LEAST_SHARE, float(((high - low) / field).max()))
    least, most = -RIM_UNITS, field * (1 - share) + RIM_UNITS
    x, y = np.maximum(np.minimum((low + high - share * field) / 2, most), least).tolist()
    return (x, y), share


def _stills(shown: Film, ticks: Sequence[int]) -> Iterator[Still]:
    """What is to be seen at these ticks, with the shots and hits since the one before."""
    most = shown.scenario.hit_points
    left = shown.hit_points.clip(0, most)
    mark = np.zeros(len(shown.team))
    for before, now in pairwise([-1, *ticks]):
        was = left[max(before, 0)]
        dead = left[now] == 0
        mark = np.where(dead & (was > 0), 1.0, (mark - 1 / MARK_FRAMES).clip(0))
        yield Still(
            pose=shown.pose[now],
            team=shown.team,
            left=left[now] / most,
            shot=shown.shot[before + 1 : now + 1].max(0),
            struck=left[now] < was,
            mark=mark,
        )


class _Caption:
    """What stands below the field: names, bars of hit points, damage that was dealt, the tick."""

    def __init__(self, shown: Film, names: tuple[str, str]) -> None:
        most, teams = shown.scenario.hit_points, [shown.team == side for side in (0, 1)]
        left = [shown.hit_points[:, team].clip(0, most) for team in teams]
        self._robots = [int(team.sum()) for team in teams]
        self._living = [(one > 0).sum(1).tolist() for one in left]
        self._points = [one.sum(1).tolist() for one in left]
        self._whole = [robots * most for robots in self._robots]
        self._names = [_printable(name) for name in short_names(names)]
        self._ends, self._winner = len(shown.pose) - 1, shown.result.winner

    def draw(self, columns: int, now: int) -> Image.Image:
        """Draw the caption of a tick, so many pixels wide."""
        image = Image.new("RGB", (columns, CAPTION_ROWS), GROUND)
        pen, wide = ImageDraw.Draw(image), (columns - _BETWEEN) // 2 - _INSET
        for side in (0, 1):
            self._draw_team(pen, columns, wide, side, now)
        middle = columns / 2
        dealt = [self._whole[side] - self._points[side][now] for side in (1, 0)]
        words = f"{dealt[0]:,} : {dealt[1]:,}"
        pen.text((middle, 4), words, TICK, caption_font(18, bold=True), anchor="ma")
        pen.text((middle, 27), "damage dealt", WALL, caption_font(10), anchor="ma")
        pen.text((middle, 40), self._words(now), TICK, caption_font(11), anchor="ma")
        return image

    def _draw_team(
        self, pen: ImageDraw.ImageDraw, columns: int, wide: int, side: int, now: int
    ) -> None:
        """Draw a team's name, how many live, and a bar, blue's at the left."""
        edge, anchor, ink = (
            (_INSET, "la", SIDES[0]) if side == 0 else (columns - _INSET, "ra", SIDES[1])
        )
        name = _fitting(self._names[side], caption_font(14, bold=True), wide)
        pen.text((edge, 5), name, ink, caption_font(14, bold=True), anchor=anchor)
        words = f"{self._living[side][now]} of {self._robots[side]} robots"
        pen.text((edge, 39), words, TICK, caption_font(11), anchor=anchor)
        share = self._points[side][now] / self._whole[side]
        for part, colour in ((1.0, blend(GROUND, ink, 0.25)), (share, ink)):
            end = edge + round(wide * part) * (1 if side == 0 else -1)
            if end != edge:
                pen.rectangle((min(edge, end), 26, max(edge, end), 26 + _BAR_ROWS), colour)

    def _words(self, now: int) -> str:
        if now < self._ends:
            return f"tick {now + 1:,}"
        if self._winner == "draw":
            return f"tick {now + 1:,}: a draw"
        name, tick = self._names[self._winner == "red"], f"tick {now + 1:,}: "
        room = _BETWEEN - 10 - caption_font(11).getlength(f"{tick} wins")
        return f"{tick}{_fitting(name, caption_font(11), room)} wins"


class _Palette:
    """The colours of an animation, and which of them is the nearest to any other."""

    def __init__(self) -> None:
        colours = dict.fromkeys([blend(GROUND, GROUND, 1.0)])
        for back in (GROUND, EMPTY):
            for ink in SIDES:
                colours |= dict.fromkeys(blend(back, ink, share) for share in _FADES)
        for ink in (WALL, TICK, FLAG, STRUCK, EMPTY):
            colours |= dict.fromkeys(blend(GROUND, ink, share) for share in _FADES[1::2])
        colours |= dict.fromkeys(blend(ink, TICK, share) for ink in SIDES for share in (0.25, 0.5))
        self._colours = np.array(list(colours))
        levels = np.arange(32) * 8 + 4
        cells = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), -1).reshape(-1, 3)
        away = [np.square(cells - colour).sum(-1) for colour in self._colours]
        self._nearest = np.argmin(away, axis=0).astype(np.uint8)
        self._nearest[_colour_cell(self._colours)] = np.arange(len(self._colours))

    def reduced(self, image: Image.Image) -> Image.Image:
        """The image with the nearest colour for each pixel, mode "P"."""
        nearest = self._nearest[_colour_cell(np.asarray(image))]
        reduced = Image.frombytes("P", image.size, nearest.tobytes())
        reduced.putpalette(self._colours.astype(np.uint8).tobytes())
        return reduced


def _colour_cell(colours: np.ndarray) -> np.ndarray:
    """Which of 32 x 32 x 32 cells of colours [..., 3] each is in."""
    red, green, blue = np.moveaxis(colours.astype(np.uint16) >> 3, -1, 0)
    return (red << 10) | (green << 5) | blue


@cache
def caption_font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font that comes with matplotlib."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts", "ttf", name), size)


def _printable(name: str) -> str:
    """A name in one line, with a sign for what is no text."""
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in name)


def _fitting(name: str, font: ImageFont.FreeTypeFont, wide: float) -> str:
    """As much of a name as fits into so many pixels."""
    cut = name
    while font.getlength(cut) > wide and len(cut) > 1:
        name = name[:-1]
        cut = f"{name}\u2026"
    return cut
