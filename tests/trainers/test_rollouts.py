"""What others collect of a generation is what one process collects, bit for bit."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDictBase

from neatq_envs.episodes import EpisodeError
from neatq_envs.machines import Crew, Here, ThisMachine
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.config import RunConfig
from neatq_trainers.loop import make_collector, strides
from neatq_trainers.rollouts import Rollouts, shares
from neatq_trainers.run import Run
from neatq_trainers.worlds import facts_of

Tiny = Callable[..., RunConfig]


class Digests(Callback):
    """Notes every entry of every batch."""

    def __init__(self) -> None:
        self.batches: list[dict[str, Any]] = []

    def batch(self, run: Run, batch: TensorDictBase, error: Any) -> None:
        flat = {".".join(key): value for key, value in _flat(batch)}
        self.batches.append(
            {
                key: (value.dtype, value.shape, hashlib.sha256(value.numpy().tobytes()).digest())
                for key, value in flat.items()
            }
        )


def _flat(batch: TensorDictBase) -> Any:
    keys = batch.keys(include_nested=True, leaves_only=True)
    return [((key,) if isinstance(key, str) else key, batch.get(key)) for key in keys]


class OneProcess(ThisMachine):
    """Opens objects in this process, which is quicker to begin."""

    def open(self, make: Callable[..., Any], *arguments: Any, together: int = 1) -> Here:
        return Here(make(*arguments))


def batches_of(config: RunConfig, workers: int) -> list[dict[str, Any]]:
    """The batches of three strides, or generations."""
    digests = Digests()
    facts = facts_of(config.world, config.learner.discount if config.learns else 0.99)
    run = build(config, facts=facts, crew=Crew(workers, OneProcess()))
    going = strides(run, [digests])
    for _ in range(3):
        next(going)
    going.close()
    run.world.close()
    assert len({one["genome_id"] for one in digests.batches}) > 2  # there were births
    return digests.batches


@pytest.mark.parametrize(
    ("arm", "workers", "changes"),
    [
        ("neat", 3, {"network.double_activation": True}),
        ("neat+q", 2, {"learner.epsilon": 0.3, "learner.max_hold_ticks": 5}),
        ("neatq", 3, {"batch_ticks": 7}),  # taught, acts with noise, reads normalised observations
        ("rtneat", 3, {"batch_ticks": 7}),
        ("neat", 20, {}),  # more than there are slots
    ],
)
def test_batches_are_those_of_one_process(
    arm: str, workers: int, changes: dict[str, Any], tiny_walk: Tiny
) -> None:
    config = tiny_walk(arm, **changes)
    assert batches_of(config, 1) == batches_of(config, workers)


def test_other_shares_change_nothing(tiny_walk: Tiny, monkeypatch: pytest.MonkeyPatch) -> None:
    dealt: list[list[int]] = []

    def uneven(speeds: np.ndarray, slots: int) -> list[int]:
        dealt.append(np.roll([slots - 1, 1], len(dealt)).tolist())
        return dealt[-1]

    monkeypatch.setattr("neatq_trainers.rollouts.shares", uneven)
    config = tiny_walk("neat+q")
    assert batches_of(config, 1) == batches_of(config, 2)
    assert dealt[:2] == [[7, 1], [1, 7]]


def test_who_is_slow_gets_fewer_slots() -> None:
    assert shares(np.array([1.0, 1.0, 3.0]), 8) == [2, 2, 4]
    assert shares(np.array([np.nan, 1.0, 3.0]), 9) == [3, 2, 4]  # the unknown one counts as 2
    assert shares(np.full(3, np.nan), 5) == [2, 2, 1]
    assert shares(np.array([1e-9, 1.0]), 100) == [1, 99]


@given(st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=20), st.integers(0, 1000))
def test_all_slots_are_dealt_and_everybody_has_one(speeds: list[float], more: int) -> None:
    dealt = shares(np.array(speeds), len(speeds) + more)
    assert sum(dealt) == len(speeds) + more
    assert min(dealt) >= 1
    quickest, slowest = np.argmax(speeds), np.argmin(speeds)
    assert dealt[quickest] >= dealt[slowest]


def test_work_is_measured_where_it_is_done(tiny_walk: Tiny) -> None:
    config = tiny_walk("neat")
    run = build(config, facts=facts_of(config.world, 0.99), crew=Crew(2, OneProcess()))
    rollouts = make_collector(run)
    assert isinstance(rollouts, Rollouts)
    batch = next(iter(rollouts))
    seconds, steps = rollouts._work.T
    assert steps.sum() == batch.get("living").sum()
    assert (seconds > 0).all()


def test_messages_name_the_slot_of_the_arena(toy: str, tiny_walk: Tiny) -> None:
    config = tiny_walk("neat", "Broken-v0", env_kwargs={"step": 10_000})
    run = build(config, facts=facts_of(config.world, 0.99), crew=Crew(2, OneProcess()))
    collector = make_collector(run)
    assert isinstance(collector, Rollouts)
    next(iter(collector))
    for first, worker in zip((0, 4), collector._workers, strict=True):
        assert isinstance(worker, Here)
        breaks = worker._served._envs[2].unwrapped
        breaks.odd, breaks.break_step = True, breaks.count + 1
        worker.ask("collect", collector._news(slice(first, first + 4)))
        with pytest.raises(EpisodeError, match=f"slot {first + 2} of arena 0 failed in episode"):
            worker.answer()
