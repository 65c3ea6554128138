"""Scenarios: the original tasks, JSON files of users and errors that explain."""

from __future__ import annotations

import copy
import json
import math
import pickle
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_envs.checks import ScenarioError
from neatq_envs.gymnasium_task import assignments
from neatq_envs.scenario import TASKS, FlagSchedule, Scenario, Spawn, find_scenario
from neatq_envs.walls import Wall, box_distance


def test_the_tasks_have_the_original_geometry() -> None:
    flag, moving, wall = TASKS["flag"], TASKS["moving"], TASKS["wall"]
    for task in (flag, moving, wall):
        assert (task.width, task.height, task.robots, task.lifetime_ticks) == (800, 800, 50, 1000)
        assert task.spawns == (Spawn(x=400, y=266.67, jitter=20),)
        assert (task.max_speed, task.max_turn_rad) == (1.0, 0.2)
    assert math.dist((400, 266.67), flag.flag.positions[0]) == pytest.approx(141.42, abs=0.01)
    assert math.dist((400, 266.67), wall.flag.positions[0]) == pytest.approx(266.66, abs=0.01)
    box = wall.walls[0]
    edges = (box.x - box.width / 2, box.x + box.width / 2, box.y - 2, box.y + box.height / 2)
    assert edges == (350, 450, 398, 402)


def test_what_a_scenario_leaves_out() -> None:
    plain = Scenario(name="flag")
    assert plain == TASKS["flag"]
    assert (plain.sensors, plain.reward, plain.collide) == ("arena", "published", False)
    assert (plain.robot_radius, plain.walls, plain.weights().tolist()) == (4.09, (), [0, 0, 1])
    assert FlagSchedule(positions=[(1, 2)]).interval_ticks == 0  # type: ignore[arg-type]
    assert TASKS["maze"].spawns == (Spawn(x=34, y=22, jitter=6),)
    assert TASKS["switch"].flag.switch_ticks == 610


def test_the_moving_flag_keeps_the_published_distances() -> None:
    published = (164.3, 152.8, 167.3, 130.4, 158.0, 158.2, 103.3, 226.6, 127.0, 115.9, 228.5)
    schedule = TASKS["moving"].flag
    distances = [math.dist(place, (400, 266.67)) for place in schedule.positions]
    assert len(distances) == 13 and schedule.interval_ticks == 5000
    assert distances == pytest.approx([*published, 129.5, 244.2], abs=0.1)


@pytest.mark.parametrize("name", TASKS)
def test_a_scenario_survives_json(name: str) -> None:
    task = TASKS[name].replaced(collide=True, reward_weights={"stick_together": -0.5})
    assert Scenario.from_dict(json.loads(json.dumps(task.to_dict()))) == task


def test_a_ring_survives_json() -> None:
    task = TASKS["flag"].replaced(flag=FlagSchedule(ring=(100, 250), interval_ticks=50))
    assert Scenario.from_dict(json.loads(json.dumps(task.to_dict()))) == task


def test_a_scenario_can_be_copied_and_sent_to_other_processes() -> None:
    task = TASKS["wall"]
    assert pickle.loads(pickle.dumps(task)) == task == copy.deepcopy(task)
    assert asdict(task)["reward_weights"] == {"approach_flag": 1.0}


def test_a_scenario_keeps_its_own_weights() -> None:
    weights = {"approach_flag": 0.5}
    task = TASKS["flag"].replaced(reward_weights=weights)
    weights["approach_flag"] = 9.0
    assert task.weights().tolist() == [0.0, 0.0, 0.5]


def test_keys_left_out_come_from_the_defaults() -> None:
    assert Scenario.from_dict({"robots": 3}) == TASKS["flag"].replaced(robots=3)


def test_the_example_in_the_module_is_a_scenario() -> None:
    from neatq_envs import scenario

    text = scenario.__doc__ or ""
    example = json.loads(text[text.index("{") : text.rindex("}") + 1])
    assert Scenario.from_dict(example).walls[1].angle_rad == 0.5


def wall_at(x: float, y: float) -> dict[str, Any]:
    return {"walls": [{"x": x, "y": y, "width": 100, "height": 4}]}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"robot": 3}, ['unknown key "robot"', 'did you mean "robots"']),
        ({"robots": 0}, ["robots", "at least 1", "got 0"]),
        ({"robots": "many"}, ["robots", "whole number", "'many'"]),
        ({"robots": True}, ["robots", "whole number", "True"]),
        ({"width": "wide"}, ["width", "a number"]),
        ({"collide": 1}, ["collide", "true or false"]),
        ({"lifetime_ticks": -1}, ["lifetime_ticks", "-1"]),
        ({"sensors": "open-nero"}, ["sensors", 'did you mean "opennero"']),
        ({"reward": "publish"}, ["reward", 'did you mean "published"']),
        ({"reward_weights": {"aproach_flag": 1}}, ['did you mean "approach_flag"']),
        ({"reward_weights": {"approach_flag": "1"}}, ["approach_flag", "number"]),
        ({"reward_weights": {"approach_flag": 0}}, ["reward_weights", "0"]),
        ({"reward_weights": [1]}, ["reward_weights", "object"]),
        ({"reward": "progress", "reward_weights": {"stand_ground": 1}}, ["progress"]),
        ({"max_speed": 5}, ["max_speed", "robot_radius", "4.09"]),
        ({"max_speed": float("nan")}, ["max_speed", "finite"]),
        ({"max_turn_rad": 4.0}, ["max_turn_rad", "0..pi"]),
        ({"robot_radius": 0}, ["robot_radius"]),
        ({"spawns": []}, ["spawns", "at least one"]),
        ({"spawns": [{"x": 20, "y": 400}]}, ["spawns[0]", "border"]),
        ({"spawns": [{"x": 780, "y": 400}]}, ["spawns[0]", "border"]),
        ({"spawns": [{"x": 400, "y": 900}]}, ["spawns[0]", "border"]),
        ({"spawns": [{"x": 400}]}, ["spawns[0]", "missing", "y"]),
        ({"spawns": [{"x": 400, "y": "low"}]}, ["spawns[0].y", "number", "'low'"]),
        ({"spawns": [{"x": 400, "y": 400, "jitter": 0.5}]}, ["jitter", "0.5"]),
        (wall_at(400, 290), ["spawns[0]", "walls[0]"]),
        (wall_at(300, 166.67), ["flag.positions[0]", "inside a wall"]),
        (
            {"walls": [{"x": 1, "y": 1, "width": 0, "height": 4}]},
            ["walls[0].width", "from 0.01 to 1,000,000 (units"],
        ),
        ({"walls": [{"x": 1, "y": 1, "w": 2}]}, ["walls[0]", 'unknown key "w"']),
        ({"walls": 5}, ["walls", "list"]),
        ({"walls": [5]}, ["walls[0]", "object"]),
        ({"flag": {}}, ["flag", "neither"]),
        ({"flag": {"positions": [[1, 2]], "ring": [1, 2]}}, ["flag", "both"]),
        ({"flag": {"positions": [[801, 5]]}}, ["flag.positions[0]", "outside"]),
        ({"flag": {"positions": [[1, 2, 3]]}}, ["flag.positions[0]", "two numbers"]),
        ({"flag": {"positions": [[1, float("inf")]]}}, ["flag.positions[0]", "finite"]),
        ({"flag": {"positions": 7}}, ["flag.positions", "list"]),
        ({"flag": {"ring": [100, 300]}}, ["flag.ring", "leaves the field", "266.67"]),
        ({"flag": {"ring": [9, 3]}}, ["flag.ring", "least <= greatest"]),
        ({"flag": {"ring": [1, 2], "interval_ticks": -5}}, ["interval_ticks", "-5"]),
    ],
)
def test_errors_name_the_key_and_what_came(values: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ScenarioError) as error:
        Scenario.from_dict(values)
    for word in words:
        assert word in str(error.value)


def test_file_errors_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    with pytest.raises(ScenarioError, match=r"mine\.json.*cannot be read"):
        find_scenario(path)
    for text, words in (('{"robots": ', "is not JSON"), ("[1]", "expected an object")):
        path.write_text(text)
        with pytest.raises(ScenarioError, match=rf"mine\.json.*{words}"):
            find_scenario(path)
    path.write_text('{"robotz": 4}')
    with pytest.raises(ScenarioError, match=r'mine\.json.*did you mean "robots"'):
        find_scenario(path)
    path.write_text('{"robots": 4}')
    assert find_scenario(path).robots == 4


def test_defaults_fill_what_a_file_leaves_out_and_changes_come_last(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text('{"name": "mine", "robots": 4, "sensors": "arena"}')
    world = {"sensors": "opennero", "reward": "progress"}
    expected = TASKS["flag"].replaced(name="mine", robots=4, reward="progress")
    content = json.loads(path.read_text())
    for source in (path, str(path), content):
        assert find_scenario(source, defaults=world) == expected
        changed = find_scenario(source, defaults=world, changes={"robots": 7, "reward": None})
        assert changed == expected.replaced(robots=7)
    assert find_scenario("trap", defaults=world) == TASKS["trap"].replaced(**world)
    assert find_scenario("trap", changes={"robots": 3}) == TASKS["trap"].replaced(robots=3)
    assert find_scenario(expected, defaults=world) == expected  # it leaves nothing out
    # What a file and the defaults cannot be together, changes may mend.
    path.write_text('{"reward_weights": {"stand_ground": 1}}')
    with pytest.raises(ScenarioError, match=r"mine\.json: reward \"progress\""):
        find_scenario(path, defaults=world)
    assert find_scenario(path, defaults=world, changes={"reward": "published"}).robots == 50


def test_a_scenario_is_changed_by_assignments() -> None:
    texts = [
        "robots=3",
        "name=two walls",
        'walls=[{"x": 300, "y": 400, "width": 200, "height": 4}]',
        'spawns=[{"x": 400, "y": 150}]',
        'flag={"ring": [50, 90], "interval_ticks": 20}',
        'reward_weights={"stick_together": 1}',
        "collide=true",
    ]
    assert find_scenario("flag", changes=assignments(texts)) == TASKS["flag"].replaced(
        robots=3,
        name="two walls",
        walls=(Wall(x=300, y=400, width=200, height=4),),
        spawns=(Spawn(x=400, y=150),),
        flag=FlagSchedule(ring=(50, 90), interval_ticks=20),
        reward_weights={"stick_together": 1},
        collide=True,
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot=3", ['unknown key "robot"', 'did you mean "robots"']),
        ("robots=many", ["robots", "whole number", "'many'"]),
        ('walls=[{"x": 3}]', ["walls[0]", "missing keys", "y"]),
        ('spawns=[{"x": 3, "z": 3}]', ["spawns[0]", 'unknown key "z"']),
        ('flag={"position": []}', ["flag", 'did you mean "positions"']),
        ('reward_weights={"together": 1}', ['did you mean "stick_together"']),
        ("reward_weights=approach_flag", ["reward_weights", "object"]),
    ],
)
def test_wrong_assignments_are_named(text: str, words: list[str], tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text("{}")
    for source in ("wall", path):
        with pytest.raises(ScenarioError) as error:
            find_scenario(source, changes=assignments([text]))
        assert all(word in str(error.value) for word in words)
        if "reward_weights" not in text:
            assert "mine.json" not in str(error.value)  # the file is not to blame


@pytest.mark.parametrize("source", ["flog", Path("flog")])
def test_an_unknown_task_is_answered_with_the_known_ones(source: Path | str) -> None:
    with pytest.raises(ScenarioError, match=r"expected flag, .*, behind or the path .* 'flog'"):
        find_scenario(source)


def test_a_spawn_that_just_clears_a_wall_is_allowed() -> None:
    # Offsets reach +19: the topmost robot centre is at 285.67, its rim at 289.76.
    values = {"walls": [{"x": 400, "y": 291.77, "width": 100, "height": 4}]}
    assert Scenario.from_dict(values).walls[0].y == 291.77
    values["walls"][0]["y"] = 291.75
    with pytest.raises(ScenarioError, match="would begin inside"):
        Scenario.from_dict(values)


def test_distance_to_a_turned_box() -> None:
    wall = Wall(x=10, y=20, width=8, height=2, angle_rad=math.pi / 2)
    x, y = np.array([10.0, 13.0, 10.0, 14.0]), np.array([27.0, 20.0, 20.0, 28.0])
    # Upright now: x 9..11, y 16..24.
    assert box_distance(x, y, wall) == pytest.approx([3.0, 2.0, -1.0, 5.0])
