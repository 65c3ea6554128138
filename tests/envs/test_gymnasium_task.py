"""Which Gymnasium environments can be used, and what is said of the others."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from neatq_envs.gymnasium_task import GymnasiumTask, Interface, TaskError, assignments
from neatq_envs.random_play import EnvFacts, ObservationScaling


def refusal(task: str, *env_kwargs: str) -> str:
    parsed = GymnasiumTask(id=task, kwargs=assignments(env_kwargs))
    with pytest.raises(TaskError) as caught:
        Interface.of(parsed.make(), parsed.id)
    return str(caught.value)


@pytest.mark.parametrize(
    ("task", "pattern"),
    [
        ("CartPol-v1", r"did you mean CartPole-v1.*pprint_registry"),
        ("cartpole-v1", r"did you mean CartPole-v1"),
        ("CartPole-v9", r"did you mean CartPole-v1"),
        ("LunarLander-v2", r"LunarLander-v3"),
        ("qqqq", r"knows no 'qqqq'.*one of your own is gym:my_module:ID.*pprint_registry"),
        ("Nothing/CartPole-v1", r"knows no"),
        ("no_such_module:CartPole-v1", r"No module named 'no_such_module'.*PYTHONPATH"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_an_unknown_id_is_answered_with_close_ones(task: str, pattern: str) -> None:
    assert re.search(pattern, refusal(task))


@pytest.mark.parametrize(
    ("given", "pattern"),
    [
        ("wind=3", r"CartPole-v1 cannot be made with \{'wind': 3\}: TypeError.*--env-kwargs"),
        ("wind", r"expected name=value, such as continuous=true; got 'wind'"),
        ("=3", r"expected name=value.*got '=3'"),
    ],
)
def test_bad_arguments_of_the_environment_are_named(given: str, pattern: str) -> None:
    with pytest.raises(TaskError, match=pattern):
        GymnasiumTask(id="CartPole-v1", kwargs=assignments([given])).make()


def test_arguments_are_json_or_else_text() -> None:
    task = GymnasiumTask(
        id="X-v0", kwargs=assignments(["a=true", "b=-5.5", "c=human", "d=[1, 2]", "e=False"])
    )
    assert task.kwargs == {"a": True, "b": -5.5, "c": "human", "d": [1, 2], "e": False}
    assert task.id == "X-v0"


def test_what_a_plain_locale_hands_on_as_bytes_is_utf_8() -> None:
    assert assignments(["name=\udcc3\udc9cbung", 'b="\udcff"']) == {"name": "Übung", "b": "\ufffd"}


def test_a_time_limit_is_an_argument() -> None:
    env = GymnasiumTask(id="CartPole-v1", kwargs=assignments(["max_episode_steps=2"])).make()
    env.reset(seed=1)
    assert [env.step(0)[3] for _ in range(2)] == [False, True]


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: Any, **__: Any) -> None:
        raise gymnasium.error.DependencyNotInstalled("Box2D is not installed")

    monkeypatch.setattr(gymnasium, "make", missing)
    assert 'pip install "gymnasium[box2d]"' in refusal("LunarLander-v3")
    assert "Box2D is not installed" in refusal("CartPole-v1")


@pytest.mark.parametrize("task", ["Hopper-v5", "HalfCheetah-v5"])
def test_a_missing_mujoco_is_named(task: str) -> None:
    """In a process of its own: what is imported stays imported."""
    code = (
        "import sys; sys.modules['mujoco'] = None\n"
        "from neatq_envs.gymnasium_task import GymnasiumTask\n"
        f"GymnasiumTask(id={task!r}).make()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    wanted = f'TaskError: task: {task} needs what pip install "gymnasium[mujoco]" brings (MuJoCo is'
    assert wanted in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["observes=text"], r"observes Text.*cannot read.*Box.*TransformObservation.*my_module:"),
        (["observes=image"], r"observes images \(Box\(0, 255, \(8, 8, 3\), uint8\)\)"),
        (["observes=huge"], r"observes 10000 numbers \(\(100, 100\)\); .* at most 512"),
        (["acts=endless box"], r"actions without bounds.*TransformAction"),
        (["acts=text"], r"has the actions Text.*Discrete, Box.*TransformAction.*my_module:"),
    ],
)
def test_spaces_that_networks_cannot_use_are_named(
    toy: str, arguments: list[str], pattern: str
) -> None:
    assert re.search(pattern, refusal(f"{toy}Spaces-v0", *arguments), re.DOTALL)


def test_observations_and_actions_are_numbers(toy: str) -> None:
    env = GymnasiumTask(
        id=f"{toy}Spaces-v0", kwargs=assignments(["observes=choice", "acts=matrix"])
    ).make()
    interface = Interface.of(env, "toy")
    assert (interface.inputs, interface.choices) == (3, None)
    assert interface.read(6).tolist() == [0, 1, 0]  # the choices are 5, 6 and 7
    assert interface.bounds == ([-1.0] * 6, [1.0] * 6)
    own = interface.act(np.array([[0.5, 2, 3, 4, 5, -6]], np.float32))
    assert own[0].dtype == np.float32
    assert own[0].tolist() == [[0.5, 1, 1], [1, 1, -1]]
    choice = Interface(env.observation_space, env.observation_space)
    assert choice.act(np.array([[0.0], [2.0]])) == [5, 7]
    assert all(type(action) is np.int64 for action in choice.act(np.array([[1.0]])))


def test_sane_bounds_scale_and_other_entries_are_standardised() -> None:
    low, high = [-2, -np.inf, 0, -3e38, -10], [4, np.inf, 1, 3e38, 10]
    space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32))
    seen = np.array([[-0.5, 5, 0, 7, 1], [2, 9, 0, 7, -1]])
    scaling = ObservationScaling.fit(space, seen)
    assert scaling.offset.tolist() == [1, 7, 0.5, 7, 0]
    # 1.5 is how far the first went from 1; the last went 1, which is less than a fifth of 10.
    assert scaling.scale.tolist() == [1.5, 2, 0.5, 1, 2]
    assert scaling(np.array([4.0, 11, 0, 700, -3])).tolist() == [2, 2, -1, 10, -1.5]
    facts = EnvFacts(scaling, value_range=(0.0, 1.0), renewed=False, repeatable=True)
    again = EnvFacts.from_dict(json.loads(json.dumps(facts.to_dict()))).scaling
    assert again(seen).tobytes() == scaling(seen).tobytes()


def test_wide_bounds_and_small_spreads_count_within_reason() -> None:
    low, high = [-5e3, -2e4, -np.inf, -np.inf], [5e3, 2e4, np.inf, np.inf]
    space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32))
    seen = np.array([[4000, 4000, 0, 0], [2000, 2000, 0.002, 1e-7]])
    scaling = ObservationScaling.fit(space, seen)
    assert scaling.offset.tolist() == pytest.approx([0, 3000, 0.001, 5e-8])
    assert scaling.scale.tolist() == pytest.approx([4000, 1000, 0.001, 1])


def test_one_hot_observations_are_not_scaled() -> None:
    scaling = ObservationScaling.fit(spaces.Discrete(3), np.eye(3))
    assert scaling(np.eye(3)).tolist() == np.eye(3).tolist()
