"""Animations of battles: what is seen of robots at which pixel, and files that are small."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from PIL import Image, ImageColor, ImageDraw, ImageFont

from neatq_envs.nero.picture import EMPTY, SIDES, STRUCK, blend
from neatq_envs.nero.scenario import NERO_TASKS, NeroScenario
from neatq_envs.render import FLAG, GROUND, TICK, WALL
from neatq_torch.genome import initial_genome
from neatq_trainers.nero.animation import (
    MARK_FRAMES,
    animate,
    battle_frames,
    battle_gif,
    frame_ticks,
    view,
)
from neatq_trainers.nero.match import BattleRules, Film, MatchResult, filmed
from neatq_trainers.nero.teams import Team

Colour = tuple[int, ...]
NAMES = "left.txt", "right.txt"
GROUND_RGB, BLUE_RGB, RED_RGB = (ImageColor.getrgb(one) for one in (GROUND, *SIDES[:2]))
BLUE_AT, RED_AT = (105, 280), (455, 280)
"""Column and row of (300, 400) and (500, 400): the robots are 200 units apart, so that two fifths
of the field are shown, 320 units from (240, 240) on, on 560 pixels: 1.75 pixels a unit."""


def shown(ticks: int, scenario: NeroScenario | None = None, **changes: Any) -> Film:
    """Blue at (300, 400) and red at (500, 400) face each other and do nothing."""
    pose = np.tile(np.array([(300, 400, 0), (500, 400, math.pi)], np.float32), (ticks, 1, 1))
    film = {
        "result": MatchResult(damage_blue=0, damage_red=0, ticks=ticks),
        "scenario": scenario or NERO_TASKS["battle"].replaced(robots=1, walls=()),
        "pose": pose,
        "hit_points": np.full((ticks, 2), 20, np.int16),
        "shot": np.full((ticks, 2), -1, np.int16),
        "team": np.array([0, 1]),
    }
    return Film(**(film | changes))


def frames(film: Film, names: tuple[str, str] = NAMES) -> list[Image.Image]:
    return [one.convert("RGB") for one in battle_frames(film, names)]


def pixel(image: Image.Image, at: tuple[int, int], right: int = 0, down: int = 0) -> Colour:
    found = image.getpixel((at[0] + right, at[1] + down))
    assert isinstance(found, tuple)
    return found


def test_every_second_tick_is_drawn_and_of_a_long_battle_fewer_but_always_the_last() -> None:
    assert frame_ticks(1) == [0]
    assert frame_ticks(5) == [0, 2, 4]
    assert frame_ticks(6) == [0, 2, 4, 5]
    assert frame_ticks(1000) == [*range(0, 1000, 4), 999]
    assert len(frame_ticks(1_000_000)) <= 301
    with pytest.raises(ValueError, match="a battle of at least 1 tick, got 0"):
        frame_ticks(0)


def test_a_film_of_five_ticks_has_three_frames_of_which_the_last_stands_still() -> None:
    film = shown(5)
    film.pose[:, 0, 1] += np.arange(5)
    with Image.open(io.BytesIO(battle_gif(film, NAMES))) as image:
        assert image.size == (560, 560 + 56) and image.info["loop"] == 0
        durations = []
        for frame in range(getattr(image, "n_frames", 1)):
            image.seek(frame)
            durations.append(image.info["duration"])
    assert durations == [50, 50, 4000]


def test_what_comes_out_of_the_file_is_what_was_drawn() -> None:
    film = shown(9, shot=np.array([(1, -1), (-1, 0), (1, 0)] * 3, np.int16))
    film.pose[:, :, 2] += np.linspace(0, 2, 9)[:, None]
    drawn = frames(film)
    with Image.open(io.BytesIO(battle_gif(film, NAMES))) as image:
        for number, frame in enumerate(drawn):
            image.seek(number)
            assert np.array_equal(np.asarray(image.convert("RGB")), np.asarray(frame)), number


def test_robots_are_where_they_were_in_the_colours_of_their_teams() -> None:
    (image,) = frames(shown(1))
    assert pixel(image, BLUE_AT) == BLUE_RGB and pixel(image, RED_AT) == RED_RGB
    away = np.asarray(image)[:560] != GROUND_RGB
    rows, columns = np.nonzero(away.any(-1))
    assert rows.min() >= 280 - 12 and rows.max() <= 280 + 12  # a radius of 6.53 units, 11 pixels
    near = np.minimum(abs(columns - 105), abs(columns - 455))
    assert near.max() <= 17 < abs(105 - 455)


def test_a_robot_has_its_nose_ahead_and_nothing_behind() -> None:
    pose = np.array([[(300, 400, math.pi / 2), (500, 400, math.pi)]], np.float32)
    (image,) = frames(shown(1, pose=pose))
    assert pixel(image, BLUE_AT, down=-14) != GROUND_RGB  # upwards: y grows
    assert pixel(image, BLUE_AT, down=14) == GROUND_RGB
    assert pixel(image, RED_AT, right=-14) != GROUND_RGB
    assert pixel(image, RED_AT, right=14) == GROUND_RGB


def test_a_robot_looks_the_same_whatever_its_heading() -> None:
    pixels = []
    for heading in np.radians([0, 37, 45, 120, -135]):
        pose = np.array([[(300, 400, heading), (500, 400, math.pi)]], np.float32)
        (image,) = frames(shown(1, pose=pose))
        pixels.append((np.asarray(image)[250:310, 75:135] != GROUND_RGB).any(-1).sum())
    assert max(pixels) < 1.15 * min(pixels)


def test_the_less_is_left_of_a_robot_the_emptier_it_is() -> None:
    (image,) = frames(shown(1, hit_points=np.array([[10, 5]], np.int16)))
    assert pixel(image, BLUE_AT) == blend(EMPTY, SIDES[0], 0.5)
    assert pixel(image, RED_AT) == blend(EMPTY, SIDES[1], 0.25)


@pytest.mark.parametrize("left", [0, -1, -3])
def test_a_dead_robot_is_a_cross_that_fades_and_no_robot(left: int) -> None:
    ticks = 2 * MARK_FRAMES + 5
    film = shown(ticks)
    film.hit_points[2:, 0] = left
    film.hit_points[4:, 0] = -1
    drawn = frames(film)
    assert pixel(drawn[0], BLUE_AT) == BLUE_RGB
    assert pixel(drawn[1], BLUE_AT) == blend(GROUND, SIDES[0], 0.75)
    assert pixel(drawn[1], BLUE_AT, right=12) == GROUND_RGB  # the nose was there
    half = pixel(drawn[1 + MARK_FRAMES // 2], BLUE_AT)
    assert half == blend(GROUND, SIDES[0], 0.375)
    assert pixel(drawn[1 + MARK_FRAMES], BLUE_AT) == GROUND_RGB
    assert pixel(drawn[-1], RED_AT) == RED_RGB


def test_a_shot_is_a_short_line_towards_its_target_also_one_between_two_frames() -> None:
    film = shown(5)
    film.shot[1, 0] = 1
    drawn = frames(film)
    for number, seen in enumerate((False, True, False)):
        column = np.asarray(drawn[number])[270:290, 105 + 57]  # at 5 radii of 11.4 pixels
        assert (column != GROUND_RGB).any() == seen
        far = np.asarray(drawn[number])[270:290, 105 + 98]  # beyond 8 radii
        assert (far == GROUND_RGB).all()


def test_the_dead_do_not_shoot() -> None:
    film = shown(1, hit_points=np.array([[0, 20]], np.int16), shot=np.array([[1, -1]], np.int16))
    (image,) = frames(film)
    assert (np.asarray(image)[270:290, 105 + 57] == GROUND_RGB).all()


def test_who_was_hit_since_the_last_frame_has_a_spark() -> None:
    film = shown(5)
    film.hit_points[1:, 1] = 19
    drawn = [pixel(image, RED_AT) for image in frames(film)]
    assert drawn == [RED_RGB, ImageColor.getrgb(STRUCK), RED_RGB]  # 19 of 20 is still full


def test_bars_tell_how_much_is_left_of_each_team() -> None:
    film = shown(1, hit_points=np.array([[10, 20]], np.int16))
    row = np.asarray(frames(film)[0])[560 + 30]
    # Of 560 columns 190 are for the score and 14 at each side are free: bars have 171.
    assert tuple(row[14 + 84]) == BLUE_RGB
    assert tuple(row[14 + 88]) == tuple(row[14 + 170]) == blend(GROUND, SIDES[0], 0.25)
    assert tuple(row[14 + 172]) == GROUND_RGB
    assert tuple(row[546]) == tuple(row[546 - 170]) == RED_RGB
    assert tuple(row[546 - 172]) == GROUND_RGB
    gone = np.asarray(frames(shown(1, hit_points=np.array([[20, -1]], np.int16)))[0])
    assert not (gone[560 + 30] == RED_RGB).all(-1).any()


def says(image: Image.Image, words: str, size: int, top: int, weight: str = "") -> bool:
    """Whether the caption has a text in its middle, but for a few pixels that a colour rounds."""
    fonts = Path(matplotlib.get_data_path(), "fonts", "ttf")
    font = ImageFont.truetype(fonts / f"DejaVuSans{weight}.ttf", size)
    wanted = Image.new("RGB", (560, 56), GROUND)
    ImageDraw.Draw(wanted).text((280, top), words, TICK, font, anchor="ma")
    rows = slice(top - 56, top - 56 + size if top + size < 56 else None)
    found, text = (np.asarray(one.convert("L"))[rows, 190:370] < 100 for one in (image, wanted))
    return bool((found ^ text).sum() < 0.1 * text.sum())


def test_the_score_is_the_damage_that_each_team_dealt() -> None:
    (image,) = frames(shown(1, hit_points=np.array([[17, -1]], np.int16)))
    assert says(image, "20 : 3", 18, 4, "-Bold") and not says(image, "3 : 20", 18, 4, "-Bold")
    (image,) = frames(shown(1, hit_points=np.array([[-4, 20]], np.int16)))
    assert says(image, "0 : 20", 18, 4, "-Bold")


@pytest.mark.parametrize(
    ("damage", "words"), [(0, ": left wins"), (2, ": right wins"), (1, ": a draw")]
)
def test_the_last_frame_says_who_won(damage: int, words: str) -> None:
    result = MatchResult(damage_blue=damage, damage_red=1, ticks=3)
    first, last = frames(shown(3, result=result))
    assert says(first, "tick 1", 11, 40) and not says(first, "tick 3", 11, 40)
    assert says(last, f"tick 3{words}", 11, 40)


@pytest.mark.parametrize("name", ["W" * 200, "\udcff\n\x00", "", "夏"])
def test_a_name_of_any_length_and_letters_stays_at_its_side(name: str) -> None:
    (image,) = frames(shown(1), (name, "right"))
    caption = np.asarray(image)[560 : 560 + 24]
    blue = (caption == BLUE_RGB).all(-1).any(0).nonzero()[0]
    assert blue.max(initial=0) <= 14 + 171
    assert ((caption == RED_RGB).all(-1).any(0).nonzero()[0] > 560 - 14 - 171).all()


def test_walls_the_border_turrets_and_the_flag_are_drawn() -> None:
    wall = {"x": 400, "y": 400, "width": 4, "height": 20}
    changes = {"walls": [wall], "turrets": [(400, 20)], "flag": (300, 200), "robots": 1}
    scenario = NeroScenario.from_dict({"name": "full", **changes})
    poses = np.array([[(300, 400, 0), (500, 400, 0), (400, 20, 0)]], np.float32)
    film = shown(
        1,
        scenario,
        team=np.array([0, 1, 2]),
        pose=poses,
        hit_points=np.full((1, 3), 20, np.int16),
        shot=np.full((1, 3), -1, np.int16),
    )
    # y from -6, 6 units beyond the border, to 430; x as far, its middle at 400: from 182 on.
    corner, share = view(film)
    assert (*corner, share) == pytest.approx((182, -6, 436 / 800))
    (image,) = frames(film)

    def at(x: float, y: float) -> Colour:
        return pixel(image, (round((x - 182) * 560 / 436), 560 - round((y + 6) * 560 / 436)))

    assert at(400, 400) == at(400, 408) == ImageColor.getrgb(WALL)
    assert at(400, 412) == at(404, 400) == GROUND_RGB  # the wall is from 390 to 410
    assert at(400, -2) == ImageColor.getrgb(WALL) and at(400, 4) == GROUND_RGB
    assert at(400, 20) == ImageColor.getrgb(SIDES[2])
    # The pole is 24 pixels high, 18.7 units, and the cloth is at its upper half, at its right.
    assert at(304, 214) == ImageColor.getrgb(FLAG) and at(304, 203) == GROUND_RGB


def test_robots_in_all_corners_are_seen_with_the_border_around() -> None:
    pose = np.array([[(7, 7, 0), (793, 793, 0)]], np.float32)
    film = shown(1, pose=pose)
    corner, share = view(film)
    assert (*corner, share) == pytest.approx((-6, -6, 812 / 800))
    rows = np.asarray(frames(film)[0])[:560]
    for edge in (rows[0], rows[-1], rows[:, 0], rows[:, -1]):
        assert (edge == ImageColor.getrgb(WALL)).all()


def test_a_narrow_field_has_room_for_the_caption() -> None:
    scenario = NERO_TASKS["battle"].replaced(robots=1, walls=(), height=2000.0)
    (image,) = frames(shown(1, scenario))
    assert image.size == (480, 560 + 56)


def test_a_long_battle_of_a_hundred_robots_that_all_walk_and_shoot_is_a_small_file() -> None:
    rng, ticks = np.random.default_rng(0), 100
    heading = rng.uniform(-3, 3, 100) + np.cumsum(rng.uniform(-0.2, 0.2, (ticks, 100)), 0)
    way = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], -1), 0)
    place = rng.uniform(120, 680, (100, 2)) + way
    film = shown(
        ticks,
        team=np.arange(100) // 50,
        pose=np.concatenate([place, heading[..., None]], -1).astype(np.float32),
        hit_points=np.clip(20 - np.arange(ticks)[:, None] // rng.integers(5, 20, 100), -1, 20),
        shot=rng.integers(0, 100, (ticks, 100)),
    )
    size = len(battle_gif(film, NAMES))
    assert size < 6_000_000 * 51 / 251  # 51 frames of the 251 of a battle of 1,000 ticks


def test_a_battle_of_two_teams_becomes_a_file_and_a_seed_decides_it(tmp_path: Path) -> None:
    teams = [
        Team(
            name=name,
            genomes=(initial_genome(18, 2, rng=np.random.default_rng(seed)),),
            sensors="opennero-2011",
        )
        for seed, name in enumerate(NAMES)
    ]
    rules = BattleRules(ticks=12, robots=3)
    paths = [tmp_path / f"{number}.gif" for number in range(3)]
    for seed, path in zip((5, 5, 6), paths, strict=True):
        animate(*teams, seed=seed, rules=rules, path=path)
    first, again, other = (path.read_bytes() for path in paths)
    assert first == again != other
    assert first == battle_gif(filmed(*teams, seed=5, rules=rules), NAMES)
    assert sorted(tmp_path.iterdir()) == paths
