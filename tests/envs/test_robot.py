"""One robot as a Gymnasium task: the same world as everywhere, in the form others expect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from neatq_envs import register_all
from neatq_envs.arena import Arena
from neatq_envs.checks import ScenarioError
from neatq_envs.robot import RobotEnv, RobotVectorEnv
from neatq_envs.scenario import TASKS, FlagSchedule, Source
from neatq_envs.torchrl_env import ACTION, DISTANCE, OBSERVATION, POSE, REWARD, TRUNCATED, ArenaEnv

register_all()
RING = FlagSchedule(ring=(100.0, 250.0), interval_ticks=4)
SHORT = TASKS["wall"].replaced(robots=1, lifetime_ticks=6, flag=RING)


def random_actions(rows: int, ticks: int) -> np.ndarray:
    """Return actions [ticks, rows, 2], some of them outside the bounds."""
    rng = np.random.default_rng(5)
    return rng.uniform((-0.5, -0.3), (1.2, 0.3), (ticks, rows, 2)).astype(np.float32)


@pytest.mark.parametrize("reward", ["published", "progress"])
@pytest.mark.parametrize("task", ["wall", "opennero"])
def test_it_is_the_arena_of_one_robot_bit_for_bit(task: str, reward: str) -> None:
    scenario = SHORT.replaced(sensors="opennero" if task == "opennero" else "arena")
    env = RobotEnv(scenario, reward=reward)
    arena = ArenaEnv(scenario.replaced(reward=reward), seed=11)
    first, data = env.reset(seed=11), arena.reset()  # its second world: made with one, reset
    seen, info = env.reset()
    assert not np.array_equal(first[1]["pose"], info["pose"])
    acts = env.action_space.shape[0] if env.action_space.shape else 0
    for action in random_actions(1, 20)[:, 0]:
        assert np.array_equal(seen, data[OBSERVATION][0, 0].numpy())
        assert np.float32(info["distance"]) == data[DISTANCE][0, 0, 0].item()
        assert np.array_equal(info["pose"].astype(np.float32), data[POSE][0, 0].numpy())
        action = np.resize(action, acts)
        seen, gain, terminated, truncated, info = env.step(action)
        data = arena.step(data.set(ACTION, torch.from_numpy(action)[None, None]))["next"]
        assert np.float32(gain) == data[REWARD][0, 0, 0].item()
        assert truncated == data[TRUNCATED][0, 0, 0].item() and not terminated
        if truncated:
            (seen, info), data = env.reset(), arena.reset()


def test_a_seed_makes_the_same_world_and_no_seed_another_one() -> None:
    env = RobotEnv(SHORT)
    first = env.reset(seed=3)[1]["pose"]
    second = env.reset()[1]["pose"]
    assert not np.array_equal(first, second)
    assert np.array_equal(env.reset(seed=3)[1]["pose"], first)
    assert np.array_equal(env.reset()[1]["pose"], second)
    assert not np.array_equal(env.reset(seed=4)[1]["pose"], first)
    fresh = [RobotEnv(SHORT).reset()[1]["pose"].tolist() for _ in range(4)]
    assert len({tuple(pose) for pose in fresh}) == 4  # without any seed, worlds differ


def test_a_life_is_truncated_at_its_length_and_never_terminated() -> None:
    env = RobotEnv(SHORT)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2))[2:4] for _ in range(6)]
    assert ends == [(False, False)] * 5 + [(False, True)]
    endless = RobotEnv(SHORT.replaced(lifetime_ticks=0))
    endless.reset(seed=0)
    assert not any(endless.step(np.zeros(2))[3] for _ in range(2000))


def test_a_full_step_is_paid_by_the_way_made_to_the_flag() -> None:
    env = RobotEnv("flag", reward="progress")
    x, y, heading = env.reset(seed=0)[1]["pose"]
    _, reward, _, _, info = env.step(np.array([1.0, 0.0]))
    assert info["pose"] == pytest.approx([x + np.cos(heading), y + np.sin(heading), heading])
    before = np.hypot(300.0 - x, 166.67 - y)
    after = np.hypot(300.0 - x - np.cos(heading), 166.67 - y - np.sin(heading))
    assert info["distance"] == pytest.approx(after)
    assert reward == pytest.approx(0.5 + (before - after) / 2)
    assert env.step(np.zeros(2))[1] == pytest.approx(0.5)


def test_a_scenario_is_a_name_a_file_its_content_or_an_object(tmp_path: Path) -> None:
    content: dict[str, Any] = {"name": "mine", "robots": 9, "lifetime_ticks": 7}
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(content))
    wanted = TASKS["flag"].replaced(name="mine", robots=1, lifetime_ticks=7)
    sources: list[Source] = [content, path, str(path), wanted]
    assert [RobotEnv(source).scenario for source in sources] == [wanted] * 4
    assert RobotEnv("wall").scenario == TASKS["wall"].replaced(robots=1)
    with pytest.raises(
        ScenarioError,
        match=r"expected flag, moving, wall, trap, maze, switch, behind or the path .* 'wal'",
    ):
        RobotEnv("wal")
    with pytest.raises(ScenarioError, match="only reward weight"):
        RobotEnv({"reward_weights": {"stand_ground": 1.0}}, reward="progress")


def test_a_picture_shows_the_robot_and_the_flag() -> None:
    env = RobotEnv("wall", render_mode="rgb_array")
    env.reset(seed=0)
    image = env.render()
    assert image is not None and image.shape == (400, 400, 3) and image.dtype == np.uint8
    for _ in range(5):
        env.step(np.array([1.0, 0.0]))
    later = env.render()
    assert later is not None and not np.array_equal(later, image)
    with pytest.raises(ValueError, match="expected \"rgb_array\" or None, got 'human'"):
        RobotEnv(render_mode="human")


@pytest.mark.parametrize("make", [RobotEnv, RobotVectorEnv])
def test_a_step_before_the_first_reset_says_so(make: Any) -> None:
    with pytest.raises(ResetNeeded, match=r"call reset\(\) first"):
        make().step(np.zeros(2))


# ----------------------------------------------------------------------------- by name

IDS = tuple(f"neatq/{task.capitalize()}-v0" for task in TASKS)


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_finds_nothing_wrong(name: str) -> None:
    env = gymnasium.make(name)
    check_env(env.unwrapped)
    robot: Any = env.unwrapped
    assert robot.scenario.reward == "progress" and robot.scenario.robots == 1
    assert isinstance(gymnasium.make_vec(name, 3), RobotVectorEnv)
    text = robot.__doc__
    sections = ["Description", "Observation Space", "Action Space", "Rewards", "Starting State"]
    places = [text.find(f"## {section}\n") for section in (*sections, "Episode End")]
    assert min(places) > 0 and places == sorted(places)


def test_arguments_of_make_prevail() -> None:
    env: Any = gymnasium.make("neatq/Wall-v0", reward="published").unwrapped
    assert env.scenario == TASKS["wall"].replaced(robots=1, reward="published")


def test_each_moving_episode_has_its_flag_somewhere_else_in_sight() -> None:
    env: Any = gymnasium.make("neatq/Moving-v0").unwrapped
    env.reset(seed=5)
    flags = []
    for _ in range(20):
        env.reset()
        flags.append(env.arena.flag[0])
    away = np.hypot(*(np.array(flags) - (400.0, 266.67)).T)
    assert len(np.unique(flags, axis=0)) == 20
    assert 100 <= away.min() < 140 and 210 < away.max() <= 250
    env.reset(seed=5)
    env.reset()
    assert np.array_equal(env.arena.flag[0], flags[0])


# ------------------------------------------------------------------------------- rows


@pytest.mark.parametrize("seed", [21, [4, 9, 2]])
def test_rows_are_what_gymnasium_makes_of_single_robots(seed: Any) -> None:
    rows = RobotVectorEnv(3, SHORT)
    plain: Any = SyncVectorEnv([lambda: RobotEnv(SHORT)] * 3, autoreset_mode=AutoresetMode.DISABLED)
    assert rows.observation_space == plain.observation_space
    assert rows.action_space == plain.action_space
    assert rows.metadata["autoreset_mode"] is plain.metadata["autoreset_mode"]
    assert_equal(rows.reset(seed=seed), plain.reset(seed=seed))
    for tick, actions in enumerate(random_actions(3, 40)):
        stepped = rows.step(actions)
        assert_equal(stepped, plain.step(actions))
        over = stepped[3].copy()
        over[1] |= tick in (3, 10)  # a row that is reset before its end
        if over.any():
            seeds: Any = [None, tick, None]
            mine, info = rows.reset(seed=seeds, options={"reset_mask": over})
            theirs, plain_info = plain.reset(seed=seeds, options={"reset_mask": over})
            assert mine[over].tolist() == theirs[over].tolist()
            assert mine[~over].tolist() == stepped[0][~over].tolist()
            assert np.array_equal(info["pose"][over], plain_info["pose"][over])
    assert_equal(rows.reset(), plain.reset())


def assert_equal(mine: Any, plain: Any) -> None:
    """Require equal arrays and infos, bit for bit."""
    *mine, info = mine
    *plain, plain_info = plain
    assert [(a.dtype, a.tolist()) for a in mine] == [(a.dtype, a.tolist()) for a in plain]
    assert info.keys() == plain_info.keys()
    assert all(np.array_equal(info[key], plain_info[key]) for key in info)


def test_rows_refuse_seeds_and_masks_of_other_rows() -> None:
    rows = RobotVectorEnv(2)
    with pytest.raises(ValueError, match="one for each of 2 rows"):
        rows.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match=r"expected bool \[2\], got bool \[3\]"):
        rows.reset(options={"reset_mask": np.ones(3, dtype=bool)})


def test_what_was_returned_is_not_overwritten_by_later_steps() -> None:
    rows = RobotVectorEnv(2, SHORT)
    rows.reset(seed=0)
    kept = rows.step(random_actions(2, 1)[0])
    copies = [np.copy(value) for value in (*kept[:4], kept[4]["pose"], kept[4]["distance"])]
    for actions in random_actions(2, 9):
        rows.step(actions)
    now = (*kept[:4], kept[4]["pose"], kept[4]["distance"])
    assert all(np.array_equal(a, b) for a, b in zip(copies, now, strict=True))


def test_a_row_is_the_arena_of_one_robot() -> None:
    rows, arena = RobotVectorEnv(2, "flag"), Arena(TASKS["flag"].replaced(robots=1), [7])
    rows.reset(seed=6)
    for actions in random_actions(2, 50):
        rows.step(actions)
        arena.step(actions[1:, None])
    assert np.array_equal(rows.arena.position[1], arena.position[0])
    assert np.array_equal(rows.arena.reward[1], arena.reward[0])


def test_rescaled_actions_reach_the_bounds() -> None:
    env: Any = gymnasium.wrappers.RescaleAction(RobotEnv("flag"), np.float32(-1), np.float32(1))
    _, _, heading = env.reset(seed=1)[1]["pose"]
    turned = env.step(np.array([-1.0, 1.0], dtype=np.float32))[4]["pose"][2] - heading
    assert turned % (2 * np.pi) == pytest.approx(0.2)
