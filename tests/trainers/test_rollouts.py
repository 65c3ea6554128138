"""What others collect of a generation is what one process collects, bit for bit."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDictBase
from torch import Tensor

from neatq_envs.episodes import EpisodeError
from neatq_envs.gymnasium_rows import DealtRows
from neatq_envs.machines import Crew, Here, ThisMachine
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.changes import ChangeExploration
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


class Posted(Here):
    """An object of this process that gets copies, and gives some, as one elsewhere does."""

    def ask(self, method: str, *arguments: Any) -> None:
        super().ask(method, *pickle.loads(pickle.dumps(arguments)))

    def answer(self) -> Any:
        return pickle.loads(pickle.dumps(super().answer()))


class OneProcess(ThisMachine):
    """Opens objects in this process, which is quicker to begin."""

    def open(self, make: Callable[..., Any], *arguments: Any, together: int = 1) -> Here:
        return Posted(make(*arguments))


class Lived(NamedTuple):
    """What came of some strides, or generations: every batch, and the state after each stride."""

    batches: list[dict[str, Any]]
    states: list[Any]


def lived(config: RunConfig, workers: int, strides_of_run: int = 3, state: Any = None) -> Lived:
    digests, states = Digests(), []
    facts = facts_of(config.world, config.learner.discount if config.learns else 0.99)
    run = build(config, state, facts=facts, crew=Crew(workers, OneProcess()))
    going = strides(run, [digests])
    for _ in range(strides_of_run):
        next(going)
        states.append(pickle.loads(pickle.dumps(run.state_dict())))
    going.close()
    run.world.close()
    return Lived(digests.batches, states)


@pytest.mark.parametrize(
    ("arm", "workers", "changes"),
    [
        ("neat", 3, {"network.double_activation": True}),
        ("neat+q", 2, {"learner.epsilon": 0.3, "learner.max_hold_ticks": 5}),
        ("neatq", 3, {"batch_ticks": 7}),  # taught, acts with noise, reads normalised observations
        ("rtneat", 8, {"batch_ticks": 7, "network.double_activation": True}),
        ("neat", 20, {}),  # more than there are slots
        ("rtneat", 3, {"batch_ticks": 7, "arenas": 2}),  # these are stepped from here
    ],
)
def test_batches_and_states_are_those_of_one_process(
    arm: str,
    workers: int,
    changes: dict[str, Any],
    tiny_walk: Tiny,
    differences: Callable[..., list[str]],
) -> None:
    config = tiny_walk(arm, **changes)
    one, several = lived(config, 1), lived(config, workers)
    assert len({batch["genome_id"] for batch in one.batches}) > 2  # there were births
    assert one.batches == several.batches
    for alone, dealt in zip(one.states, several.states, strict=True):
        assert differences(_plain(alone), _plain(dealt)) == []


def _plain(value: Any) -> Any:
    """Tensors as arrays."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.detach().numpy() if isinstance(value, Tensor) else value


@pytest.mark.parametrize("arm", ["neatq", "rtneat"])
def test_a_run_goes_on_among_others_in_the_middle_of_episodes(arm: str, tiny_walk: Tiny) -> None:
    config = tiny_walk(arm, batch_ticks=7)
    whole = lived(config, 1)
    half = lived(config, 2, 1).states[0]
    assert half["world"]["rows"]["step_count"].any()
    rest = lived(config, 3, 2, half)
    assert rest.batches == whole.batches[-len(rest.batches) :]


def test_a_state_is_replayed_once_by_those_who_go_on(
    tiny_walk: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny_walk("rtneat", batch_ticks=7)
    half = lived(config, 2, 1).states[0]
    facts = facts_of(config.world, 0.99)
    monkeypatch.setattr(DealtRows, "step", None)  # how it would be replayed from here
    run = build(config, half, facts=facts, crew=Crew(2, OneProcess()))
    next(iter(make_collector(run)))
    before, after = (one["rows"]["steps"] for one in (half["world"], run.world.env.world_state()))
    assert (after == before + 7).all()


def test_exploration_that_changes_is_told(tiny_walk: Tiny) -> None:
    config, ways = tiny_walk("neat+q"), []
    for workers in (1, 2):
        digests = Digests()
        run = build(config, facts=facts_of(config.world, 0.99), crew=Crew(workers, OneProcess()))
        going = strides(run, [digests])
        next(going)
        ChangeExploration(epsilon=0.7).make(run)
        next(going)
        ways.append(digests.batches)
    assert ways[0] == ways[1]


def test_other_shares_change_nothing(tiny_walk: Tiny, monkeypatch: pytest.MonkeyPatch) -> None:
    dealt: list[list[int]] = []

    def uneven(speeds: np.ndarray, slots: int) -> list[int]:
        dealt.append(np.roll([slots - 1, 1], len(dealt)).tolist())
        return dealt[-1]

    monkeypatch.setattr("neatq_trainers.rollouts.shares", uneven)
    config = tiny_walk("neat+q")
    assert lived(config, 1).batches == lived(config, 2).batches
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


def test_those_who_are_as_quick_are_measured_as_quick(
    tiny_walk: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose slots were idle early is not slow: time beside the steps does not count."""
    clock = iter(range(10**6))
    monkeypatch.setattr("neatq_trainers.collecting.time.perf_counter", lambda: float(next(clock)))
    config = tiny_walk("neat")
    run = build(config, facts=facts_of(config.world, 0.99), crew=Crew(2, OneProcess()))
    rollouts = make_collector(run)
    assert isinstance(rollouts, Rollouts)
    batch = next(iter(rollouts))
    seconds, steps = rollouts._work.T  # a second for each step of all slots of a worker
    assert steps.sum() == batch.get("living").sum()
    assert seconds.tolist() == [batch.get("living")[0, own].any(0).sum() for own in rollouts._slots]


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
        worker.ask(
            "collect", collector._news(slice(first, first + 4), collector._policy.state_dict())
        )
        with pytest.raises(EpisodeError, match=f"slot {first + 2} of arena 0 failed in episode"):
            worker.answer()
