"""Environments as they are: strange spaces work or are refused, what goes wrong has a sentence."""

from __future__ import annotations

import re
import sys
from collections import Counter
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.spaces import utils

from neatq_envs.episodes import EpisodeError, EpisodeRows, Starts, episode_seed
from neatq_envs.gymnasium_rows import RowError, SingleRows, begin, make_rows
from neatq_envs.gymnasium_task import GymnasiumTask, Interface, TaskError
from neatq_envs.observations import flat, flat_size, input_name
from neatq_envs.random_play import look_around

MODULE = "strange_tasks:strange/"


@pytest.fixture(scope="module", autouse=True)
def found() -> None:
    folder = str(Path(__file__).parents[1] / "toy")
    if folder not in sys.path:
        sys.path.insert(0, folder)


def plain(**spaces_: str) -> GymnasiumTask:
    return GymnasiumTask(id=f"{MODULE}Plain-v0", kwargs=spaces_)


def strange(how: str, env: str = "Strange-v0", **more: Any) -> GymnasiumTask:
    return GymnasiumTask(id=MODULE + env, kwargs={"how": how, **more})


def interface(**spaces_: str) -> Interface:
    return Interface.of(plain(**spaces_).make(), "it")


WHOLE = {"bits": (0, 1), "signed": (-3, 3), "bytes": (0, 255), "many": (0, 4), "binary": (0, 1)}


@pytest.mark.parametrize("acts", WHOLE)
def test_each_whole_number_has_an_equal_share(acts: str) -> None:
    own = interface(acts=acts)
    low, high = (np.array(bound) for bound in own.bounds)
    # In the middle of each of 7 x (number of values) equal parts of the last axis.
    count = int(high[-1] - low[-1])
    parts = (np.arange(7 * count) + 0.5) / (7 * count)
    points = np.tile(low, (parts.size, 1))
    points[:, -1] += parts * count
    seen = Counter(int(np.ravel(one)[-1]) for one in own.act(points.astype(np.float32)))
    least, most = WHOLE[acts]
    assert seen == dict.fromkeys(range(least, most + 1), 7)
    ends = own.act(np.stack([low - 9, high, high + 9]))
    assert [int(np.ravel(one)[-1]) for one in ends] == [least, most, most]


@pytest.mark.parametrize("acts", [*WHOLE, "truth", "float", "shifted", "dict", "tuple"])
def test_actions_are_what_the_space_samples(acts: str) -> None:
    """The environment asserts it; random play steps 20 of them side by side."""
    assert look_around(plain(acts=acts), 0.9).repeatable


def test_a_dict_of_actions_is_decoded_by_hand() -> None:
    own = interface(acts="dict")
    assert own.bounds == ([1.0, -1.0, -1.0], [4.0, 1.0, 1.0])
    (action,) = own.act(np.array([[3.2, 0.5, -7.0]]))
    assert {name: part.tolist() for name, part in action.items()} == {
        "gear": 3,
        "wheel": [0.5, -1.0],
    }
    assert [one.item() for one in interface(acts="shifted").act(np.array([[0.0], [2.0]]))] == [
        -4,
        -2,
    ]


@pytest.mark.parametrize("observes", ["choice", "many", "binary", "dict", "tuple", "box"])
def test_observations_are_flattened_as_gymnasium_does(observes: str) -> None:
    own = interface(observes=observes)
    space = own.observation
    space.seed(1)
    for _ in range(20):
        seen: Any = space.sample()
        expected: Any = utils.flatten(space, seen)
        assert own.read(seen).tolist() == expected.tolist()
    assert own.inputs == flat_size(space) == utils.flatdim(space)
    scaling = look_around(plain(observes=observes), 0.9).scaling
    assert scaling.offset.shape == scaling.scale.shape == (own.inputs,)
    names = [input_name(space, index) for index in range(own.inputs)]
    assert len({*names}) == own.inputs


def test_inputs_are_called_by_their_place() -> None:
    own = interface(observes="dict").observation
    assert input_name(own, 0) == "observation['gear'][0]"
    assert input_name(own, 4) == "observation['place'][1]"
    assert input_name(interface(observes="box").observation, 2) == "observation[1, 0]"
    assert input_name(spaces.Box(0, 1, ()), 0) == "observation"


@pytest.mark.parametrize(
    ("value", "pattern"),
    [
        ({"gear": 1}, r"observation: expected the parts \['gear', 'place'\]"),
        ((1, 2), r"expected the parts .*, got \(1, 2\)"),
        (7, r"expected the parts .*, got 7"),
        ({"gear": 4, "place": [0, 0]}, r"observation\['gear'\]: expected whole .* 1 to 3, got 4"),
        ({"gear": 1, "place": [0]}, r"observation\['place'\]: .* shape \[2\] .*, got \[1\]"),
        ({"gear": 1, "place": "no"}, r"observation\['place'\]: expected numbers, got 'no'"),
        ({"gear": 1, "place": [[0], [1, 2]]}, r"observation\['place'\]: expected numbers of the"),
    ],
)
def test_what_is_not_of_the_space_is_named_by_its_part(value: Any, pattern: str) -> None:
    space = interface(observes="dict").observation
    with pytest.raises(ValueError, match=pattern):
        flat(space, value)


@pytest.mark.parametrize(
    ("kwargs", "pattern"),
    [
        ({"acts": "one"}, r"one action only \(Discrete\(1\)\): there is nothing to choose"),
        ({"acts": "point"}, "one action only"),
        ({"acts": "vast"}, "more than 16777216 whole numbers"),
        ({"acts": "wide"}, "actions without bounds"),
        ({"acts": "choices"}, "has 513 actions to choose from; supported are at most 512"),
        ({"acts": "crowd"}, "has 513 numbers in an action; supported are at most 512"),
        ({"observes": "screen"}, r"images .* not for these networks.*TransformObservation"),
        ({"observes": "floats"}, "images .* not for these networks"),
        ({"observes": "seen"}, "images .* not for these networks"),
        ({"observes": "tiles"}, "images .*if it is no picture: .*FlattenObservation"),
        ({"observes": "long"}, r"observes 1000 numbers \(Discrete\(1000\)\); .*at most 512"),
    ],
)
def test_spaces_without_a_use_are_refused_with_the_remedy(
    kwargs: dict[str, str], pattern: str
) -> None:
    with pytest.raises(TaskError, match=pattern) as caught:
        interface(**kwargs)
    assert ("FlattenObservation" in str(caught.value)) == (kwargs.get("observes") == "tiles")


FAILURES = {
    "exit": r"sys.exit was called: no licence \(strange_tasks.py:\d+\)",
    "raise": r"ZeroDivisionError: the world ended \(strange_tasks.py:\d+\)",
    "four": "step: expected a tuple of 5 .*, got 4 values; .*GymV21CompatibilityV0",
    "large": r"reward is 1e\+300; expected a finite number of at most 1e12; scale it",
    "vast": r"reward is -1e\+308; expected a finite number of at most 1e12",
    "nan": "reward is nan; expected a finite number",
    "none": "reward: expected a number, got None",
    "two": r"reward: expected a number, got array\(\[1., 1.\]\)",
    "text": "reward: expected a number, got 'much'",
    "huge": r"observation\[1\] is -?\d.*e\+\d+; expected a finite number within single",
    "inf": r"observation\[0\] is inf; expected a finite number",
    "short": r"observation: expected the shape \[2\] that its space has, got \[1\]",
    "column": r"observation: expected the shape \[2\] that its space has, got \[2, 1\]",
    "words": r"observation: expected numbers, got array\(\['a', 'b'\]",
    "another action space": r"action_space: expected Box\(.*\) for ever, .*, got Discrete\(2\)",
}


@pytest.mark.parametrize("env", ["Strange-v0", "Bare-v0"])
@pytest.mark.parametrize("how", FAILURES)
def test_what_goes_wrong_in_a_step_has_one_sentence(how: str, env: str) -> None:
    """With a wrapper of Gymnasium that takes the step apart, and without one."""
    wanted = rf"{MODULE}{env}: row 0 failed in episode 0 with seed \d+, after [12] steps: "
    with pytest.raises(EpisodeError, match=wanted + FAILURES[how]) as caught:
        look_around(strange(how, env), 0.9)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("how", "pattern"),
    [
        ("exit", r"after 0 steps: sys.exit was called: 4 \(strange_tasks.py:\d+\)"),
        ("no tuple", r"reset: expected a tuple of 2 \(observation, info\), got a ndarray"),
        ("short", r"after 0 steps: observation: expected the shape \[2\]"),
        ("huge", r"after 0 steps: observation\[1\] is"),
    ],
)
def test_what_goes_wrong_in_a_reset_has_one_sentence(how: str, pattern: str) -> None:
    with pytest.raises(EpisodeError, match=r"episode 0 with seed \d+, .*" + pattern):
        look_around(strange(how, when=0), 0.9)


def test_an_environment_that_exits_when_it_is_made_is_named() -> None:
    with pytest.raises(TaskError, match=r"Strange-v0 cannot be made with .*: SystemExit: 4"):
        look_around(strange("exit when made"), 0.9)


@pytest.mark.parametrize("how", ["", "raise"])
def test_random_play_closes_what_it_has_opened(how: str) -> None:
    strange("").make().close()  # imports the class
    kind = sys.modules["strange_tasks"].Strange
    before = kind.opened
    with nullcontext() if not how else pytest.raises(EpisodeError):
        look_around(strange(how), 0.9)
    assert kind.opened == before


def test_a_close_that_fails_is_a_warning() -> None:
    with pytest.warns(UserWarning, match=r"close\(\) of .*: OSError: already gone"):
        look_around(strange("close raises"), 0.9)


def test_a_reward_may_be_an_array_of_one_number() -> None:
    found, same = (look_around(strange(how), 0.9) for how in ("array", ""))
    assert found.to_dict() == same.to_dict()


def test_the_largest_numbers_that_are_taken_leave_finite_scales() -> None:
    rows, own = make_rows(strange(""))
    episodes = EpisodeRows(rows, "it")
    episodes.begin(Starts.given([[1]]))
    for value, fits in ((3.4e38, True), (3.5e38, False)):
        seen = np.array([[0.0, value]])
        if fits:
            episodes._check(np.ones(1, bool), seen, np.array([-1e12]))
        else:
            with pytest.raises(RowError):
                episodes._check(np.ones(1, bool), seen, np.zeros(1))
    assert own.inputs == 2


def test_an_environment_of_small_seeds_gets_small_seeds_and_others_the_same_as_ever() -> None:
    large = next(seed for n in range(99) if (seed := episode_seed(0, 0, n)) >= 2**31)
    for how, wanted in (("small seeds", large % 2**31), ("", large)):
        env = strange(how).make()
        begin(env, large)
        assert env.unwrapped.seed == wanted  # type: ignore[attr-defined]


def test_a_failing_reset_keeps_its_own_error() -> None:
    class Sulking(gymnasium.Env[Any, Any]):
        def reset(self, *, seed: int | None = None, **_: Any) -> Any:
            raise RuntimeError(f"not with {seed}")

    for seed in (5, 2**31 + 5):
        with pytest.raises(RuntimeError, match=re.escape(f"not with {seed % 2**31}")):
            begin(Sulking(), seed)


def test_the_action_space_is_compared_where_episodes_begin_and_end() -> None:
    rows = SingleRows(plain(acts="bits"), interface(acts="bits"))
    rows.reset(np.ones(1, bool), np.ones(1, np.int64))
    rows._envs[0].unwrapped.action_space = spaces.Box(0, 1, (8,), np.int8)  # an equal one
    rows.reset(np.ones(1, bool), np.ones(1, np.int64))
    rows._envs[0].unwrapped.action_space = spaces.Discrete(2)
    with pytest.raises(RowError, match="action_space: expected"):
        rows.reset(np.ones(1, bool), np.ones(1, np.int64))


@pytest.mark.parametrize("when", [0, 2])
def test_what_ends_the_program_is_no_failure_of_the_environment(
    when: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Terminated(SystemExit):
        """What a handler of signals raises."""

    def end(_: object) -> None:
        raise Terminated(143)

    monkeypatch.setattr(sys, "exit", end)
    with pytest.raises(Terminated):
        look_around(strange("exit", when=when), 0.9)
    with pytest.raises(Terminated):
        look_around(strange("exit when made"), 0.9)
