"""Pictures: where things are drawn, and files that are whole."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from PIL import Image, ImageColor

from neatq_envs.render import FLAG, GROUND, HIGHLIGHT, ROBOT, WALL, animation, draw_paths, frame
from neatq_envs.scenario import TASKS

TASK = TASKS["wall"]


def picture(highlight: int | None = None) -> np.ndarray:
    place = np.array([[200.0, 600.0], [600.0, 200.0]])
    return frame(TASK, place, np.array([0.0, np.pi / 2]), np.array([400, 500]), highlight=highlight)


def centre(image: np.ndarray, colour: str) -> tuple[float, float]:
    """Return the middle (row, column) of all pixels of a colour."""
    rows, columns = np.nonzero((image == ImageColor.getrgb(colour)).all(-1))
    return float(rows.mean()), float(columns.mean())


def test_the_world_is_drawn_with_y_upwards() -> None:
    image = picture(highlight=1)
    assert image.shape == (400, 400, 3) and image.dtype == np.uint8
    assert centre(image, ROBOT) == pytest.approx((100, 100), abs=2)
    assert centre(image, HIGHLIGHT) == pytest.approx((300, 300), abs=2)
    row, column = centre(image, FLAG)
    assert 130 < row < 150 and 400 / 2 < column < 212  # the cloth is at the top of the pole
    wall, ground = ImageColor.getrgb(WALL), ImageColor.getrgb(GROUND)
    assert tuple(image[200, 200]) == wall and tuple(image[10, 10]) == ground
    assert tuple(image[0, 5]) == wall and tuple(image[399, 395]) == wall


def test_headings_point_out_of_the_robot() -> None:
    image = picture()
    rows, columns = np.nonzero((image[:, :390] < 60).all(-1))
    right = (rows == 100) & (columns > 102) & (columns < 110)
    upwards = (columns == 300) & (rows < 298) & (rows > 290)
    assert right.any() and upwards.any()


def test_a_frame_does_not_stain_the_background_of_the_next() -> None:
    first = picture()
    frame(TASK, np.array([[50.0, 50.0]]), np.zeros(1), np.array([700.0, 700.0]))
    assert np.array_equal(first, picture())


def test_a_field_that_is_not_square() -> None:
    image = frame(TASK.replaced(width=1000.0), np.array([[1000.0, 0.0]]), np.zeros(1), np.zeros(2))
    assert image.shape == (320, 400, 3)
    assert tuple(image[319, 399]) != ImageColor.getrgb(GROUND)


def test_an_animation_holds_every_frame_for_its_time() -> None:
    content = animation([picture(), picture(0), picture(1)], fps=10)
    with Image.open(io.BytesIO(content)) as image:
        assert getattr(image, "n_frames", 1) == 3 and image.info["duration"] == 100
    with pytest.raises(ValueError, match="at least one"):
        animation([])


def test_paths_show_the_last_life_only() -> None:
    poses = np.zeros((10, 2, 3))
    poses[:, 0, 0] = 100 + np.arange(10)
    poses[:, 1, 0] = [300, 301, 302, 303, 500, 501, 502, 503, 504, 505]  # respawned at tick 4
    figure = draw_paths(TASK, poses, np.array([400.0, 533.0]), highlight=1)
    axes = figure.axes[0]
    lines = next(part for part in axes.collections if isinstance(part, LineCollection))
    assert len(lines.get_segments()) == 9 + 5
    assert min(segment[0][0] for segment in lines.get_segments()[9:]) == 500
    assert axes.get_xlabel() == "x (units)" and axes.get_xlim() == (0, 800)
    legend = axes.get_legend()
    assert legend is not None
    words = [text.get_text() for text in legend.get_texts()]
    assert {"flag", "wall", "starting area", "highlighted robot"} <= set(words)
