"""Scenarios beyond all bounds: refused at once, with the place and the value."""

from __future__ import annotations

import json
import math
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_envs.checks import ScenarioError
from neatq_envs.gymnasium_task import assignments
from neatq_envs.scenario import TASKS, Scenario, Spawn, find_scenario
from neatq_envs.walls import Wall, box_distance

BOX = {"x": 100, "y": 100, "width": 10, "height": 10}
SPAWN = {"x": 400, "y": 400}
DIGITS_400, DIGITS_5000 = "9" * 400, "9" * 5000


def text(**values: Any) -> str:
    """JSON in which values that are texts stand as they are."""
    return "{" + ", ".join(f'"{name}": {value}' for name, value in values.items()) + "}"


def walls(**changes: str) -> str:
    return text(walls=f"[{text(**{key: str(value) for key, value in BOX.items()} | changes)}]")


BEYOND = {
    "a wall at 2^63": (walls(x=str(2**63)), "walls[0].x: ", "units", "got 9223372036854775808"),
    "400 digits": (walls(y=DIGITS_400), "walls[0].y: ", "units", "got 99999"),
    "5000 digits": (walls(x="-" + DIGITS_5000), "walls[0].x: ", "units", "got -inf"),
    "1e400": (walls(width="1e400"), "walls[0].width: ", "finite", "got inf"),
    "NaN": (walls(height="NaN"), "walls[0].height: ", "finite", "got nan"),
    "a thin wall": (walls(height="1e-300"), "walls[0].height: ", "from 0.01", "got 1e-300"),
    "a negative wall": (walls(width="-4"), "walls[0].width: ", "from 0.01", "got -4"),
    "degrees": (walls(angle_rad="90"), "walls[0].angle_rad: ", "radians", "got 90"),
    "true as a number": (walls(x="true"), "walls[0].x: ", "a number", "got True"),
    "1001 walls": (text(walls=json.dumps([BOX] * 1001)), "walls: ", "at most 1,000", "got [{"),
    "nested lists": (text(walls="[" * 2000 + "]" * 2000), "nested hundreds deep"),
    "nested in a list": (text(walls="[" * 500 + "]" * 500), "walls[0]: expected an object", "[[["),
    "jitter": (
        text(spawns=json.dumps([SPAWN | {"jitter": 4294967296}])),
        "spawns[0].jitter: ",
        "from 0 to 1,000 (units",
        "got 4294967296",
    ),
    "jitter of 5000 digits": (
        text(spawns=f'[{{"x": 1, "y": 1, "jitter": {DIGITS_5000}}}]'),
        "spawns[0].jitter: ",
        "got inf",
    ),
    "robots": (text(robots="1000000000"), "robots: ", "from 1 to 100,000", "got 1000000000"),
    "no robots": (text(robots="0"), "robots: ", "got 0"),
    "a field of 1e300": (text(width="1e300"), "width: ", "units", "got 1e+300"),
    "an endless field": (text(height="Infinity"), "height: ", "finite", "got inf"),
    "a life": (text(lifetime_ticks=DIGITS_400), "lifetime_ticks: ", "ticks"),
    "a speck": (text(robot_radius="1e-300", max_speed="1e-300"), "robot_radius: ", "1e-300"),
    "a weight": (text(reward_weights='{"approach_flag": 1e300}'), "reward_weights: ", "1e+300"),
    "a flag far away": (text(flag='{"positions": [[1e308, 1]]}'), "flag.positions[0]: ", "1e+308"),
    "a ring of 2^63": (text(flag=f'{{"ring": [1, {2**70}]}}'), "flag.ring: ", "units"),
    "a name of a megabyte": (text(name=f'"{"x" * 1_000_000}"'), "name: ", "1 to 200"),
    "no name": (text(name='""'), "name: ", "1 to 200"),
    "a name with a new line": (text(name='"a\\nb"'), "name: ", "printable"),
    "the same key twice": ('{"robots": 3, "robots": 4}', "'robots' is given twice"),
    "the same key twice below": (walls(**{'x": 5, "x': "6"}), "'x' is given twice"),
    "an unknown key of a megabyte": (text(**{"y" * 1_000_000: "1"}), "unknown key", "known: name"),
}


@pytest.fixture
def little() -> Iterator[None]:
    """At most half a second and 30 MB."""
    tracemalloc.start()
    began = time.process_time()
    yield
    assert time.process_time() - began < 0.5
    assert tracemalloc.get_traced_memory()[1] < 30e6
    tracemalloc.stop()


@pytest.mark.parametrize("name", BEYOND)
def test_what_is_beyond_all_bounds_is_named_at_once(
    name: str, tmp_path: Path, little: None
) -> None:
    content, *words = BEYOND[name]
    (tmp_path / "mine.json").write_text(content)
    with pytest.raises(ScenarioError) as error:
        find_scenario(tmp_path / "mine.json")
    message = str(error.value)
    assert "mine.json: " in message and all(word in message for word in words), message
    assert len(message.replace(str(tmp_path), "")) < 500 and "\n" not in message


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("robots=1000000000", "robots: expected a whole number from 1 to 100,000"),
        (f"width={DIGITS_5000}", "width: .* got inf"),
        ("height=1e400", "height: .* got inf"),
        ("max_speed=NaN", "max_speed: .* got nan"),
        ("walls=" + "[" * 100_000, "nested hundreds deep"),
        ('flag={"ring": [1, 2], "ring": [3, 4]}', "'ring' is given twice"),
        ("collide=1", "collide: expected true or false, got 1"),
    ],
)
def test_options_have_the_same_bounds(assignment: str, words: str, little: None) -> None:
    with pytest.raises(ScenarioError, match=words):
        find_scenario("flag", changes=assignments([assignment]))


@pytest.mark.parametrize("source", ["a\0b.json", "x" * 5000, "x" * 5000 + ".json", "no\ud800.json"])
def test_what_is_no_name_of_a_file_is_no_scenario(source: str) -> None:
    with pytest.raises(ScenarioError, match=r"cannot be read|is not JSON"):
        find_scenario(source)


def test_a_file_of_many_megabytes_is_not_read(tmp_path: Path, little: None) -> None:
    with (tmp_path / "big.json").open("wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk
    with pytest.raises(ScenarioError, match=r"has 1,099,511,627,776 bytes; expected at most"):
        find_scenario(tmp_path / "big.json")


def test_numbers_at_their_bounds_are_taken() -> None:
    wide = Scenario(name="x" * 200, width=1e6, height=1_000_000, lifetime_ticks=10**9)
    assert wide.replaced(max_turn_rad=math.pi, robots=100_000).robots == 100_000
    assert Wall(x=-1e6, y=1e6, width=0.01, height=1e6, angle_rad=-2 * math.pi).x == -1e6


def test_robots_may_begin_anywhere_in_a_wide_field_with_many_walls(little: None) -> None:
    far = [{"x": 4000 + i, "y": 100, "width": 0.5, "height": 2} for i in range(1000)]
    spawns = [{"x": 1500, "y": 1500, "jitter": 1000}]
    values = {"width": 6000, "height": 3000, "walls": far, "spawns": spawns}
    assert len(Scenario.from_dict(values).walls) == 1000


def test_a_spawn_is_refused_just_where_a_place_of_it_touches_a_wall() -> None:
    # Against all places of the spawn at once, on turned walls round it.
    rng, outcomes = np.random.default_rng(0), set()
    for _ in range(200):
        place, angle = rng.uniform(-45, 45, 2) + 400, rng.uniform(-math.pi, math.pi)
        wall = Wall(x=place[0], y=place[1], width=30.0, height=5.0, angle_rad=angle)
        axis = 400.0 + np.arange(-20, 20)
        touches = bool((box_distance(axis[:, None], axis[None, :], wall) < 4.09).any())
        try:
            TASKS["flag"].replaced(walls=[wall], spawns=[Spawn(x=400.0, y=400.0)])
        except ScenarioError:
            outcomes.add((touches, True))
        else:
            outcomes.add((touches, False))
    assert outcomes == {(True, True), (False, False)}
