"""Runs are those of the release before, bit for bit.

Results may move only on purpose. Then make the digests again, which this prints (with names behind
it: of these runs), and say under *Changes results* in CHANGELOG.md what moved:

    python tests/trainers/test_golden.py

The longer runs take minutes and are tested only when they are asked for:

    NEATQ_GOLDEN=full python -m pytest tests/trainers/test_golden.py

Bits may depend on the processor and on the versions of torch and numpy: matrices are multiplied in
another order. On a machine where these tests never passed, make the digests with the commit before
yours, and compare with those, or add them to those of `ELSEWHERE`.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from neatq_trainers.arms import preset
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHAMPION, METRICS
from neatq_trainers.train import start

pytestmark = pytest.mark.usefixtures("without_pictures")
Settings = dict[str, Any]

ARENA_ARMS = ("rtneat", "committed", "described", "replay", "qlearning")
CARS = ("CartPole-v1", "MountainCarContinuous-v0")


def arena(task: str, arm: str, ticks: int, changes: Settings | None = None) -> RunConfig:
    """Two arenas of a built-in task."""
    config = preset(task, arm, length={"ticks": ticks})
    return config.changed({"arenas": 2, **(changes or {})})


def switched(arm: str, changes: Settings) -> RunConfig:
    """A short run with other settings than the arm's, in which many are born."""
    life = {"population.minimum_life_ticks": 100, "population.ineligible_fraction": 0.5}
    size = {"world.scenario.robots": 9, "world.scenario.lifetime_ticks": 100}
    return arena("wall", arm, 600, size | life | changes)


def gym(task: str, arm: str, changes: Settings | None = None, *, generations: int = 3) -> RunConfig:
    """A few generations on a Gymnasium task; 8 genomes with lives of 2 episodes."""
    size = {"world.slots": 8, "population.episodes": 2, "arenas": 2}
    evaluation = {
        "world.every": 2,
        "world.evaluated": 2,
        "world.episodes": 3,
        "world.test_episodes": 2,
    }
    config = preset(f"gym:{task}", arm, length={"generations": generations})
    return config.changed(size | evaluation | (changes or {}))


def size(slots: int, episodes: int) -> Settings:
    """Of a population on a Gymnasium task."""
    return {"world.slots": slots, "population.episodes": episodes}


WIRES_AT_EVERY_STEP = {
    "learner.kind": "td",
    "learner.wires": True,
    "learner.trace_decay": 0.0,
    "learner.normalize_return": False,
    "batch_ticks": 1,
}
PLASTIC = {
    "learner.discount": 0.8,
    "learner.epsilon": 0.03,
    "learner.max_hold_ticks": 40,
    "learner.learning_rate": 0.05,
    "learner.updates": 16,
    "learner.horizon": 5,
    "learner.keep_every": 1,
    "learner.capacity": 1000,
    "batch_ticks": 20,
}

SHORT: dict[str, RunConfig] = {
    **{
        f"{task} {arm}": arena(task, arm, 1500)
        for task in ("flag", "wall")
        for arm in ARENA_ARMS
        if (task, arm) != ("wall", "committed")
    },
    # Earlier it is rtneat with more outputs: recurrent links and with them state come late.
    "wall committed": arena("wall", "committed", 4000),
    "darwinian": switched("replay", {"learner.inheritance": "darwinian"}),
    "holding": switched("replay", {"learner.max_hold_ticks": 20, "learner.epsilon": 0.05}),
    "target weights": switched("described", {"learner.target_tau": 0.1}),
    "target weights, replay": switched("replay", {"learner.target_tau": 0.1}),
    "long returns": switched("described", {"learner.trace_decay": 0.7}),
    "wires, own ticks": switched("replay", {"learner.kind": "td", "learner.wires": True}),
    "range of values": switched("replay", {"network.value_range": (0.2, 0.9)}),
    "replay-plastic": switched("replay", PLASTIC),
    "CartPole-v1 neat": gym("CartPole-v1", "neat", size(20, 2)),
    "CartPole-v1 neat+q": gym("CartPole-v1", "neat+q", size(12, 3)),
    "qnetwork": gym("CartPole-v1", "qnetwork", {**size(2, 5), "world.evaluated": 2}),
    "neat+q by wires": gym("Pendulum-v1", "neat+q", {**size(5, 1), **WIRES_AT_EVERY_STEP}),
    "neat+q, lamarckian": gym("CartPole-v1", "neat+q", {"learner.inheritance": "lamarckian"}),
    "neat+q, holding": gym(
        "CartPole-v1", "neat+q", {"learner.max_hold_ticks": 5, "learner.epsilon": 0.2}
    ),
    "neat+q, range of values": gym("CartPole-v1", "neat+q", {"network.value_range": (-5.0, 20.0)}),
    "neat, layered": gym(
        "CartPole-v1", "neat", {"population.start": "layered", "population.start_hidden": 3}
    ),
    "neat, synchronous": gym(
        "CartPole-v1", "neat", {"network.evaluation": "synchronous", "network.activation": "tanh"}
    ),
}
LONG: dict[str, RunConfig] = {
    # Episodes of a thousand steps; those of CartPole tell as much of both arms.
    "MountainCarContinuous-v0 neat": gym("MountainCarContinuous-v0", "neat", size(10, 1)),
    "MountainCarContinuous-v0 neat+q": gym(
        "MountainCarContinuous-v0", "neat+q", size(5, 1), generations=2
    ),
    **{
        f"{task} {arm}, long": arena(task, arm, 4000)
        for task in ("flag", "wall")
        for arm in ARENA_ARMS
        if (task, arm) != ("wall", "committed")
    },
    **{
        f"{task} {arm}, long": preset(f"gym:{task}", arm, length={"generations": 10})
        for task in CARS
        for arm in ("neat", "neat+q")
    },
}
# Others that run in any case have the same arms and settings, on other tasks or alone.
LONG |= {
    name: SHORT.pop(name)
    for name in (
        *("flag committed", "flag described", "flag qlearning"),
        *("neat+q, lamarckian", "neat+q, range of values", "neat+q by wires", "neat, synchronous"),
    )
}

DIGESTS: dict[str, tuple[str, ...]] = {
    "flag rtneat": ("f3fef753f2129f02", "7ab637adee13c724"),
    "flag committed": ("3acbdbfe552fa552", "6b795f76c9a1333f"),
    "flag described": ("433cfae2976ef501", "3463de55512f9fd5"),
    "flag replay": ("b3cd169a157b44b1", "f7758807132c289a"),
    "flag qlearning": ("58a3eb7a78226836",),
    "wall rtneat": ("17daae3c2c42131b", "88c4b6d1fb3ab8d5"),
    "wall described": ("35a107cc28d38e34", "f61b685a27285767"),
    "wall replay": ("d05ecb82e20c93c7", "feef56b957296cf8"),
    "wall qlearning": ("47b41afbf99d65ee",),
    "wall committed": ("919f5c0c4b32b2d5", "3039a031467bb330"),
    "darwinian": ("b7e2aeff36dffa51", "3c3812e201695bce"),
    "holding": ("76f886cbe878c3be", "87d91ee0ab4ba02e"),
    "target weights": ("ab7624b8e69d72c6", "1f0d293d1b4bfaf1"),
    "target weights, replay": ("ae11316264a0f717", "816455693c54e20b"),
    "long returns": ("e337417c974a29bb", "58d98a16b060e9f6"),
    "wires, own ticks": ("134b8dd29cb2242a", "f23a9264c474ae7b"),
    "range of values": ("f0ee0ed272125bdf", "7ddd9f6380c719e5"),
    "replay-plastic": ("a409a78144b15b3a", "8dec1f8b0f01ebc2"),
    "CartPole-v1 neat": ("54b6dba189361b5b", "28e3a8b055e255b8"),
    "CartPole-v1 neat+q": ("0e2ae181edd3240b", "c1d5d0444ebc8aa6"),
    "qnetwork": ("024d619f37cd6247", "c1c4d2da64745a27"),
    "neat+q by wires": ("4d9c267dd133ab19", "93dc05cdf63dda59"),
    "neat+q, lamarckian": ("ca5db6544350892a", "dc3718df8f254505"),
    "neat+q, holding": ("ebb0e8fd8afb42d3", "f10dff082e4b8313"),
    "neat+q, range of values": ("31fa9037990b1334", "75f3f9c9829d96ca"),
    "neat, layered": ("91ac1e712b1dbb74", "54a41e0587f8cfcb"),
    "neat, synchronous": ("00531c482bd8bc5f", "6b560e63b1378e4d"),
    "MountainCarContinuous-v0 neat": ("a79da92e6be6266c", "02e90f02306df9e9"),
    "MountainCarContinuous-v0 neat+q": ("d08d6a6effa0b885", "1e60145da323b861"),
    "flag rtneat, long": ("182f33aa957f9ede", "dbed7dfc3d8d181f"),
    "flag committed, long": ("03fbf5215a41000a", "c0f0f6c9af0bab85"),
    "flag described, long": ("729eaca80ec5e791", "bff49518054c9620"),
    "flag replay, long": ("2adcc67a9709ace0", "9c901ef5b685e33d"),
    "flag qlearning, long": ("7c76a899cf596a6f",),
    "wall rtneat, long": ("d24da9aa5b987e10", "88c4b6d1fb3ab8d5"),
    "wall described, long": ("9be32ba6291992b7", "c20bae2006eb2cbd"),
    "wall replay, long": ("0438139125be78e2", "ef12efe9d05c1f84"),
    "wall qlearning, long": ("70161f79c015be42",),
    "CartPole-v1 neat, long": ("d8a57c42c47e2fd5", "af5cf6aa5c6fb9ae"),
    "CartPole-v1 neat+q, long": ("1dcc41e0be3b72d7", "52ff868b074fd9ce"),
    "MountainCarContinuous-v0 neat, long": ("04aa0c432d188024", "90dae3296933f051"),
    "MountainCarContinuous-v0 neat+q, long": ("a8e1aecb23c3444a", "c1d2cdd291ca1361"),
}
"""The first 16 digits of the SHA-256 of metrics.csv and, where there is one, of champion.json."""
INTEL: dict[str, str] = {
    "flag described": "c766969801faa82a",
    "flag replay": "e7505e9723acb4d4",
    "wall replay": "d92cdf6f8a9df2ea",
    "darwinian": "854439c76abdef96",
    "holding": "9f68218e13305dce",
    "target weights": "1f0d293d1b4bfaf1",
    "target weights, replay": "a2eba61ad7f47980",
    "long returns": "e9c6a5c95ff3965b",
    "wires, own ticks": "ede58cc13c582e14",
    "range of values": "b861f99ba5c3db1e",
    "replay-plastic": "a5d1f7b7c52eca68",
}
"""Of champion.json, on another processor (Intel family 6, model 207); rows changed since."""
AMD: dict[str, str] = {
    "flag replay": "a2214bdbc89df647",
    "wall replay": "b61d59d8e2222a56",
    "darwinian": "5cddad2a6f7ffa95",
    "holding": "06a246fb1296e2ef",
    "target weights, replay": "0a5483540620a6e6",
    "wires, own ticks": "492e54cbce0bf2cc",
    "range of values": "a4b3bfdb3a731e49",
    "replay-plastic": "3a81fec1201af2fa",
}
"""Likewise, on a third one (AMD family 25, model 1)."""
ELSEWHERE = INTEL, AMD


def digests(folder: Path) -> tuple[str, ...]:
    """Of the results of a run."""
    files = [folder / name for name in (METRICS, CHAMPION) if (folder / name).is_file()]
    return tuple(hashlib.sha256(file.read_bytes()).hexdigest()[:16] for file in files)


def as_before(name: str, config: RunConfig, folder: Path) -> None:
    """Compare a run with that of the release before."""
    now = digests(start(config, folder / "run").path)
    assert now == DIGESTS[name] or now[-1] in [one.get(name) for one in ELSEWHERE], (
        f"{name}: not the run of the release before. Either a change moves results, or this "
        "processor or its libraries round otherwise (then other runs differ, too): the top of "
        f"{Path(__file__).name} says how to tell, and how to make the digests again"
    )


@pytest.mark.parametrize("name", SHORT)
def test_a_run_is_that_of_the_release_before(name: str, tmp_path: Path) -> None:
    as_before(name, SHORT[name], tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(
    os.environ.get("NEATQ_GOLDEN") != "full", reason="takes minutes; NEATQ_GOLDEN=full runs it"
)
@pytest.mark.parametrize("name", LONG)
def test_a_long_run_is_that_of_the_release_before(name: str, tmp_path: Path) -> None:
    as_before(name, LONG[name], tmp_path)


def test_every_golden_run_has_its_digests() -> None:
    assert sorted(DIGESTS) == sorted([*SHORT, *LONG])


def show(names: list[str]) -> None:
    """Print the digests of runs, as they stand in this file."""
    runs = SHORT | LONG
    for name in names or runs:
        with tempfile.TemporaryDirectory() as folder:
            found = digests(start(runs[name], Path(folder) / "run").path)
        written = ", ".join(f'"{one}"' for one in found) + ("," if len(found) == 1 else "")
        print(f'    "{name}": ({written}),', flush=True)


if __name__ == "__main__":
    import torch

    torch.set_num_threads(1)
    show(sys.argv[1:])
