"""A battle as a PettingZoo task: shots worked out by hand, who leaves when, and who won."""

from __future__ import annotations

import importlib
import math
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from PIL import ImageColor

from neatq_envs.checks import ScenarioError
from neatq_envs.nero.pettingzoo_nero import NeroBattle
from neatq_envs.nero.picture import STRUCK
from neatq_torch.genome import initial_genome
from neatq_trainers.nero.match import BattleRules, filmed
from neatq_trainers.nero.teams import Team

CLOSE: dict[str, Any] = {
    "name": "close",
    "walls": [],
    "spawns": [{"x": 380, "y": 400, "jitter": 15}, {"x": 420, "y": 400, "jitter": 15}],
    "hit_points": 2,
}
Step = tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]


def checker(name: str) -> Callable[..., None]:
    """Return one of PettingZoo's tests; their module warns of its own old imports."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
        return getattr(importlib.import_module("pettingzoo.test"), name)


def duel(distance: float, robots: int = 1, **changes: Any) -> NeroBattle:
    """Blue at x = 100, red so far to the right of it; all head to the right, so blue shoots."""
    spawns = [{"x": x, "y": 400.0, "jitter": 0} for x in (100.0, 100.0 + distance)]
    options = {name: changes.pop(name) for name in ("max_ticks",) if name in changes}
    env = NeroBattle(
        {"name": "duel", "walls": [], "spawns": spawns, **changes}, robots=robots, **options
    )
    env.reset(seed=3)
    env.field.pose[:, 2] = 0.0
    return env


def stay(env: NeroBattle) -> Step:
    return env.step({agent: np.zeros(env.action_space(agent).shape) for agent in env.agents})


def play_out(env: NeroBattle, seed: int) -> list[Step]:
    """Random actions to the end."""
    env.reset(seed=seed)
    rng, steps = np.random.default_rng(seed), []
    low, high = env.action_space("blue_0").low, env.action_space("blue_0").high
    while env.agents:
        steps.append(env.step({agent: rng.uniform(low, high) for agent in env.agents}))
    return steps


@pytest.mark.parametrize("sensors", ["opennero-2011", "opennero-2014", "nero-1"])
def test_pettingzoo_finds_the_interface_right(sensors: str) -> None:
    scenario = {**CLOSE, "sensors": sensors}
    checker("parallel_api_test")(NeroBattle(scenario, robots=4, max_ticks=30), num_cycles=40)
    checker("parallel_api_test")(NeroBattle(scenario, robots=3, max_ticks=400), num_cycles=400)


def test_pettingzoo_finds_that_a_seed_decides_everything() -> None:
    checker("parallel_seed_test")(lambda: NeroBattle(CLOSE, robots=4, max_ticks=300))


def test_agents_are_blue_and_red_and_spaces_are_those_of_the_sensors() -> None:
    env = NeroBattle({"name": "own", "sensors": "nero-1", "firing": "aimed"}, robots=2)
    seen, infos = env.reset(seed=0)
    assert env.agents == ["blue_0", "blue_1", "red_0", "red_1"] == list(seen) == list(infos)
    assert env.observation_space("red_1").shape == (23,) == seen["red_1"].shape
    space = env.action_space("blue_0")
    assert space.low.tolist() == pytest.approx([-1, -0.2, 0])
    assert space.high.tolist() == pytest.approx([1, 0.2, 1])
    assert NeroBattle().possible_agents[49:51] == ["blue_49", "red_0"]


def test_robots_of_both_teams_see_each_other() -> None:
    env = duel(120.0, hit_points=100)
    env.field.pose[1, 2] = math.pi
    seen = stay(env)[0]
    for values in seen.values():
        # Straight ahead is in the two middle sectors of the radar, 30 / 120, and in sight; the
        # mean of its own team is the robot itself, 0 units away in whatever direction (16).
        assert values[10:16].tolist() == pytest.approx([0, 0.25, 0.25, 0, 0, 0])
        assert values[17] == 1.0
        assert values[:5].tolist() == [1, 1, 1, 1, 1]  # no wall within 50 units


def test_from_600_units_every_shot_hits_what_is_ahead() -> None:
    env = duel(600.0, hit_points=5)
    for tick in range(1, 4):
        seen, rewards, terminated, truncated, infos = stay(env)
        assert rewards == {"blue_0": 1.0, "red_0": -1.0}
        assert seen["blue_0"][17] == 1.0 and seen["red_0"][17] == 0.0  # a target in sight
        assert not any(terminated.values()) and not any(truncated.values())
        assert infos["red_0"]["hit_points"] == 5 - tick and infos["blue_0"]["hit_points"] == 5
    assert env.winner is None


def test_from_300_units_two_draws_must_exceed_a_quarter() -> None:
    env = duel(300.0, hit_points=100)
    # The same generator in numpy: two places and two headings of one robot each, then two draws a
    # tick by blue alone, each to exceed (600 - 300) / 600 / 2.
    rng = np.random.default_rng([3, 9])
    rng.integers(0, 1, size=(2, 2))
    rng.random(2)
    wanted = [bool((rng.random(2) > 0.25).all()) for _ in range(60)]
    found = [stay(env)[1] for _ in range(60)]
    assert [rewards["blue_0"] for rewards in found] == wanted
    assert [rewards["red_0"] for rewards in found] == [-hit for hit in wanted]
    assert 0.35 < np.mean(wanted) < 0.8  # 0.75 squared is 0.56


def test_a_wall_between_them_stops_all_shots() -> None:
    env = duel(600.0, walls=[{"x": 400.0, "y": 400.0, "width": 4.0, "height": 20.0}])
    assert [stay(env)[1]["blue_0"] for _ in range(5)] == [0.0] * 5
    assert env.field.shot[0] == 1  # it does shoot


def test_blue_has_had_its_turn_when_red_shoots_so_it_takes_the_damage_a_tick_later() -> None:
    env = duel(600.0)
    env.field.pose[:, 2] = math.pi
    assert stay(env)[1] == {"blue_0": 0.0, "red_0": 1.0}
    assert stay(env)[1] == {"blue_0": -1.0, "red_0": 1.0}


def test_robots_turn_first_and_then_go_at_most_as_the_scenario_says() -> None:
    env = duel(300.0, max_speed=2.0, max_turn_rad=0.5)
    actions = {"blue_0": np.array([9.0, 9.0]), "red_0": np.array([-1.5, 0.0])}
    infos = env.step(actions)[4]
    blue, red = infos["blue_0"]["pose"], infos["red_0"]["pose"]
    assert blue == pytest.approx([100 + 2 * math.cos(0.5), 400 + 2 * math.sin(0.5), 0.5])
    assert red == pytest.approx([400 - 1.5, 400, 0])


def test_a_dead_robot_leaves_and_the_others_go_on() -> None:
    env = duel(600.0, robots=2, hit_points=3)
    env.field.pose[3, :2] = (400.0, 700.0)  # red_1, out of the line
    env.field.pose[1, 2] = math.pi / 2  # blue_1 looks away
    for _ in range(2):
        assert stay(env)[1] == {"blue_0": 1.0, "blue_1": 0.0, "red_0": -1.0, "red_1": 0.0}
    seen, rewards, terminated, truncated, infos = stay(env)
    dead = {"blue_0": False, "blue_1": False, "red_0": True, "red_1": False}
    assert terminated == dead and not any(truncated.values())
    assert list(seen) == list(rewards) == list(infos) == list(dead)
    assert infos["red_0"]["hit_points"] == 0
    assert env.agents == ["blue_0", "blue_1", "red_1"] and env.winner is None
    with pytest.raises(ValueError, match=r"each of 3 agents; missing: \[\], unknown: \['red_0'\]"):
        env.step(dict.fromkeys(env.possible_agents, np.zeros(2)))
    assert list(stay(env)[0]) == env.agents
    assert not env.field.alive[2]


@pytest.mark.parametrize("winner", ["blue", "red"])
def test_when_a_team_is_dead_everybody_is_terminated_and_the_other_one_has_won(winner: str) -> None:
    env = duel(600.0, robots=2, hit_points=1)
    env.field.pose[:, 2] = 0.0 if winner == "blue" else math.pi
    terminated, truncated = {}, {}
    while env.agents:
        _, _, terminated, truncated, _ = stay(env)
    assert all(terminated.values()) and not any(truncated.values())
    assert env.winner == winner
    with pytest.raises(ValueError, match=r"the battle is over; call reset\(\)"):
        env.step({})
    env.reset()
    assert env.winner is None and env.agents == env.possible_agents


def test_after_max_ticks_everybody_is_truncated_and_less_damage_wins() -> None:
    env = duel(600.0, max_ticks=2)
    assert not any(stay(env)[3].values())
    _, _, terminated, truncated, _ = stay(env)
    assert truncated == {"blue_0": True, "red_0": True} and not any(terminated.values())
    assert env.agents == [] and env.winner == "blue"
    nothing = duel(600.0, max_ticks=1)
    nothing.field.pose[:, 2] = math.pi / 2
    stay(nothing)
    assert nothing.winner == "draw"


def test_hits_beyond_the_last_hit_point_do_not_count_for_the_winner() -> None:
    env = duel(600.0, robots=2, hit_points=2, max_ticks=1)
    env.field.pose[:, 2] = math.pi / 2
    env.field.damage[:] = [1, 1, 3, 0]
    stay(env)
    assert env.winner == "draw"


def test_who_dies_in_the_last_tick_is_terminated_and_not_truncated() -> None:
    env = duel(600.0, robots=2, hit_points=1, max_ticks=1)
    env.field.pose[3, :2], env.field.pose[1, 2] = (400.0, 700.0), math.pi / 2
    _, _, terminated, truncated, _ = stay(env)
    assert [agent for agent, gone in terminated.items() if gone] == ["red_0"]
    assert [agent for agent, gone in truncated.items() if gone] == ["blue_0", "blue_1", "red_1"]


def test_turrets_shoot_and_are_no_agents() -> None:
    env = duel(300.0, turrets=[[700, 400]])
    env.field.pose[:] = [(100, 400, math.pi), (400, 700, math.pi), (700, 400, math.pi)]
    assert env.possible_agents == ["blue_0", "red_0"]
    # It hits blue, 600 units ahead, whose turn is over, and turns by more than 2 degrees.
    rewards = [stay(env)[1] for _ in range(3)]
    assert [one["blue_0"] for one in rewards] == [0.0, -1.0, 0.0]
    assert [one["red_0"] for one in rewards] == [0.0, 0.0, 0.0]
    assert env.field.pose[2].tolist() == pytest.approx([700, 400, 0.3 - math.pi])


def test_robots_that_always_do_the_same_fight_bit_for_bit_as_in_a_match() -> None:
    genome = initial_genome(18, 2, rng=np.random.default_rng(0))
    silent = replace(genome, link_enabled=np.zeros_like(genome.link_enabled))
    teams = [Team(name=n, genomes=(silent,), sensors="opennero-2011") for n in ("a", "b")]
    open_field = {"name": "open", "walls": []}
    rules = BattleRules(ticks=200, robots=20, hit_points=2, field=open_field)
    film = filmed(*teams, seed=11, rules=rules)
    env = NeroBattle({**open_field, "hit_points": 2}, robots=20, max_ticks=199)
    env.reset(seed=11)
    for tick, (pose, left, shot) in enumerate(
        zip(film.pose, film.hit_points, film.shot, strict=True)
    ):
        if tick:
            # Outputs that nothing reaches are 0: backwards, turning right, as fast as can be.
            env.step(dict.fromkeys(env.agents, np.array([-1.0, -0.2])))
        assert np.array_equal(env.field.pose.astype(np.float32), pose)
        points = np.maximum(2 - env.field.damage, 0)
        assert np.array_equal(np.where(env.field.alive, points, -1), left)
        assert np.array_equal(env.field.shot, shot)
    assert (film.hit_points[-1] < 0).sum() > 5 and env.winner == film.result.winner


def test_a_battle_is_its_seed_and_its_actions() -> None:
    first, again, other = (play_out(NeroBattle(CLOSE, robots=3), seed) for seed in (1, 1, 2))
    assert [step[1] for step in first] == [step[1] for step in again]
    assert all(
        np.array_equal(seen[agent], others[agent])
        for (seen, *_), (others, *_) in zip(first, again, strict=True)
        for agent in seen
    )
    assert [step[1] for step in first] != [step[1] for step in other]


def test_resets_without_a_seed_go_on_with_the_random_numbers() -> None:
    env = NeroBattle(CLOSE, robots=2)
    places = [env.reset(seed=4)[1]["red_1"]["pose"], env.reset()[1]["red_1"]["pose"]]
    assert not np.array_equal(*places)
    assert np.array_equal(env.reset(seed=4)[1]["red_1"]["pose"], places[0])
    assert np.array_equal(env.reset()[1]["red_1"]["pose"], places[1])
    unseeded = [NeroBattle(CLOSE, robots=2).reset()[1]["red_1"]["pose"] for _ in range(2)]
    assert not np.array_equal(*unseeded)


@pytest.mark.parametrize("sensors", ["opennero-2011", "opennero-2014", "nero-1"])
def test_a_battle_of_random_robots_comes_to_its_end_and_its_sums_are_right(sensors: str) -> None:
    env = NeroBattle({**CLOSE, "sensors": sensors}, robots=5, max_ticks=2000)
    steps = play_out(env, 0)
    left = dict.fromkeys(env.possible_agents, 2)
    present = env.possible_agents
    for seen, rewards, terminated, truncated, infos in steps:
        assert list(seen) == list(rewards) == list(terminated) == list(infos) == present
        for agent, values in seen.items():
            assert env.observation_space(agent).contains(values)
            assert infos[agent]["hit_points"] <= left[agent]
            left[agent] = infos[agent]["hit_points"]
            assert terminated[agent] == (left[agent] == 0) or not env.agents
        present = [agent for agent in present if not (terminated[agent] or truncated[agent])]
    dead = [all(left[f"{team}_{robot}"] == 0 for robot in range(5)) for team in ("blue", "red")]
    assert present == [] and any(dead) != (len(steps) == 2000)
    taken = [sum(2 - left[f"{team}_{robot}"] for robot in range(5)) for team in ("blue", "red")]
    assert env.winner == ("draw", "blue", "red")[int(np.sign(taken[1] - taken[0]))]


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (np.array([0.0, np.nan]), r"blue_0: expected 2 finite numbers \(speed, turn\), got array"),
        (np.zeros(3), r"blue_0: expected 2 finite numbers \(speed, turn\), got array"),
        (0.5, r"blue_0: expected 2 finite numbers \(speed, turn\), got 0.5"),
    ],
)
def test_actions_that_are_none_are_refused_and_change_nothing(action: Any, words: str) -> None:
    env = duel(300.0)
    before = env.field.pose.copy()
    with pytest.raises(ValueError, match=words):
        env.step({"blue_0": action, "red_0": np.zeros(2)})
    assert np.array_equal(env.field.pose, before)


def test_what_cannot_be_is_refused_in_a_sentence() -> None:
    with pytest.raises(ValueError, match='render_mode: expected "rgb_array" or None, got \'human'):
        NeroBattle(render_mode="human")
    with pytest.raises(ValueError, match="max_ticks: expected at least 1, got 0"):
        NeroBattle(max_ticks=0)
    with pytest.raises(ScenarioError, match="robots"):
        NeroBattle(robots=0)
    with pytest.raises(ScenarioError, match="no such field"):
        NeroBattle("no such field")
    with pytest.raises(ValueError, match="seed: expected 0 or more, got -1"):
        NeroBattle().reset(seed=-1)
    with pytest.raises(ResetNeeded, match=r"call reset\(\) first"):
        _ = NeroBattle().field


def test_a_picture_shows_the_whole_field_with_both_teams() -> None:
    env = NeroBattle(robots=1, render_mode="rgb_array")
    env.reset(seed=0)
    env.field.pose[:] = [(200, 200, 0), (600, 600, 0)]
    image = env.render()
    assert image is not None and image.shape == (560, 560, 3) and image.dtype == np.uint8
    assert tuple(image[420, 140]) == ImageColor.getrgb("#0072b2")  # 0.7 pixels a unit, y upwards
    assert tuple(image[140, 420]) == ImageColor.getrgb("#d55e00")
    env.field.damage[1], env.field.taken[0] = 20, 1
    dead = env.render()
    assert dead is not None and tuple(dead[420, 140]) == ImageColor.getrgb(STRUCK)
    assert tuple(dead[140, 420]) != ImageColor.getrgb("#d55e00")
    assert NeroBattle().render() is None


def test_without_pettingzoo_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "neatq_envs.nero.pettingzoo_nero")
    with pytest.raises(ImportError, match=r'NeroBattle needs .*"neatq_torch\[pettingzoo\]"'):
        importlib.import_module("neatq_envs.nero.pettingzoo_nero")
