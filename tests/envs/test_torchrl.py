"""The TorchRL environment: specs, partial resets, Collector, exact continuation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import NonTensorData, TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs, step_mdp

from neatq_envs.scenario import TASKS
from neatq_envs.torchrl_env import (
    ACTION,
    DISTANCE,
    DONE,
    OBSERVATION,
    POSE,
    REWARD,
    REWARD_VECTOR,
    STEP_COUNT,
    TERMINATED,
    TRUNCATED,
    ArenaEnv,
)

SMALL = TASKS["moving"].replaced(robots=4, lifetime_ticks=6)
SEEN = (OBSERVATION, REWARD_VECTOR, DISTANCE, POSE, STEP_COUNT, TRUNCATED)


def steer(tensordict: TensorDictBase) -> TensorDictBase:
    """Act by the observation alone: turn by what the radar and the friends say."""
    seen: Any = tensordict[OBSERVATION]
    turn = 0.2 * (seen[..., 5] - seen[..., 8] + 0.5 * seen[..., 9]) + 0.1 * (seen[..., 11] - 0.5)
    return tensordict.set(ACTION, torch.stack([torch.ones_like(turn), turn], -1))


def collector(env: ArenaEnv, ticks: int, batches: int) -> Collector:
    frames = env.batch_size.numel() * ticks
    return Collector(
        env,
        steer,
        frames_per_batch=frames,
        total_frames=frames * batches,
        auto_register_policy_transforms=False,
        use_buffers=False,
    )


@pytest.mark.parametrize("sensors", ["arena", "opennero"])
@pytest.mark.parametrize("reward", ["published", "progress"])
def test_specs_hold(sensors: str, reward: str) -> None:
    env = ArenaEnv(SMALL.replaced(sensors=sensors, reward=reward), arenas=3)
    check_env_specs(env, break_when_any_done="both")
    schema = env.arena.schema
    assert env.batch_size == (3, 4) and env.batch_locked
    assert env.action_spec.shape == (3, 4, len(schema.actions))
    assert env.action_spec.dtype == torch.float32
    low, high = schema.action_bounds(env.scenario)
    space: Any = env.action_spec.space
    assert space.low[1, 2].tolist() == low.tolist()
    assert space.high[1, 2].tolist() == high.tolist()


def test_shapes_and_types() -> None:
    env = ArenaEnv(SMALL, arenas=2)
    next_: Any = env.rand_step(env.reset())["next"]
    expected = {
        OBSERVATION: ([2, 4, 12], torch.float32),
        REWARD: ([2, 4, 1], torch.float32),
        REWARD_VECTOR: ([2, 4, 3], torch.float32),
        DISTANCE: ([2, 4, 1], torch.float32),
        POSE: ([2, 4, 3], torch.float32),
        STEP_COUNT: ([2, 4, 1], torch.int64),
        DONE: ([2, 4, 1], torch.bool),
        TERMINATED: ([2, 4, 1], torch.bool),
        TRUNCATED: ([2, 4, 1], torch.bool),
    }
    assert {k: (list(v.shape), v.dtype) for k, v in next_.items()} == expected
    x, y, heading = next_[POSE].unbind(-1)
    assert env.arena.position == pytest.approx(np.stack([x, y], -1), abs=1e-3)
    assert env.arena.heading_rad == pytest.approx(heading.numpy(), abs=1e-6)


def test_lives_end_by_truncation_never_by_termination() -> None:
    env = ArenaEnv(SMALL, arenas=2)
    data = env.rollout(20, steer, break_when_any_done=False, auto_cast_to_device=False)
    ages = data["next", STEP_COUNT][0, 0, :, 0].tolist()
    assert ages == [1, 2, 3, 4, 5, 6] * 3 + [1, 2]
    assert torch.equal(data["next", TRUNCATED], data["next", STEP_COUNT] == 6)
    assert torch.equal(data["next", DONE], data["next", TRUNCATED])
    assert not data["next", TERMINATED].any()
    # A new life is observed from its first moment on.
    assert data[STEP_COUNT][0, 0, :, 0].tolist() == [0, 1, 2, 3, 4, 5] * 3 + [0, 1]
    assert not data[DONE].any()
    assert (data[REWARD_VECTOR][:, :, [0, 6, 12, 18]] == 0).all()


def test_what_was_returned_is_not_overwritten_by_later_steps() -> None:
    env = ArenaEnv(SMALL, arenas=2)
    data = steer(env.reset())
    stepped = env.step(data)
    kept = stepped.clone()
    for _ in range(8):
        _, data = env.step_and_maybe_reset(steer(step_mdp(stepped)))
    for key in kept.keys(True, True):
        assert torch.equal(kept[key], stepped[key]), key


def act(root: Any, tick: int) -> Any:
    """Act as a policy with a memory of its own does, and as a collector that counts."""
    root = steer(root)
    root["network_state"] = torch.full((2, 4, 3), float(tick))
    root["next", "network_state"] = torch.full((2, 4, 3), float(tick + 1))
    root["next", DISTANCE] = torch.full((2, 4, 1), -1.0)  # the environment's own prevails
    root["collector", "traj_ids"] = torch.full((2, 4), tick)
    root["note"] = NonTensorData(f"tick {tick}", batch_size=root.batch_size)
    return root


def same(one: Any, other: Any) -> bool:
    """Return whether two tensordicts have the same entries, at the same depths."""
    return (
        type(one) is type(other)
        and one.batch_size == other.batch_size
        and set(one.keys(True)) == set(other.keys(True))
        and all(torch.equal(one[key], other[key]) for key in one.keys(True, True) if key != "note")
        and str(one.get("note", None)) == str(other.get("note", None))
    )


def test_the_short_way_of_stepping_does_what_torchrl_does() -> None:
    short, stock = ArenaEnv(SMALL, arenas=2), ArenaEnv(SMALL, arenas=2)
    root, stock_root = short.reset(), stock.reset()
    some = torch.tensor([[True, False, False, True], [False, True, False, False]])[..., None]
    ended = set()
    for tick in range(25):
        if tick == 8:  # until now all lives end together
            root = short.reset(root.set("_reset", some))
            stock_root = stock.reset(stock_root.set("_reset", some))
        data, stock_data = act(root, tick), act(stock_root, tick)
        collector = data["collector"]
        stepped, root = short.step_and_maybe_reset(data)
        stock_data, stock_root = EnvBase.step_and_maybe_reset(stock, stock_data)
        assert stepped is data and root["collector"] is not collector
        assert same(data, stock_data) and same(root, stock_root), tick
        ended.add(int(data["next", DONE].sum()))
    assert ended == {0, 3, 5, 8}


def test_an_uncommon_step_goes_the_way_of_torchrl(monkeypatch: pytest.MonkeyPatch) -> None:
    env = ArenaEnv(SMALL, arenas=2)

    def uncommon(data: Any, **attached: Any) -> bool:
        """Return whether a step is left to TorchRL."""
        left = []

        def stock(self: EnvBase, tensordict: Any) -> tuple[Any, Any]:
            left.append(tensordict)
            return tensordict, tensordict

        with monkeypatch.context() as patch:
            patch.setattr(EnvBase, "step_and_maybe_reset", stock)
            for name, value in attached.items():
                patch.setitem(vars(env), name, value)
            env.step_and_maybe_reset(data)
        return bool(left)

    def plain() -> Any:
        return steer(env.reset())

    everyone = torch.ones(2, 4, 1, dtype=torch.bool)
    named = plain()
    named.names = ["arena", "robot"]
    assert not uncommon(plain())
    assert uncommon(plain().set("_step", everyone)) and uncommon(plain().set("_reset", everyone))
    assert uncommon(named) and uncommon(plain().to("cpu")) and uncommon(plain()[0])
    assert uncommon(plain(), _post_step_mdp_hooks=lambda *both: both)
    assert uncommon(plain(), _compiled_step_and_maybe_reset=lambda data: (data, data))
    with pytest.raises(RuntimeError, match="batch_size"):
        env.step_and_maybe_reset(plain()[0])


def test_transforms_of_torchrl_count_lives() -> None:
    env = TransformedEnv(ArenaEnv(SMALL, arenas=2), StepCounter(step_count_key="ticks"))
    data = env.rollout(15, steer, break_when_any_done=False, auto_cast_to_device=False)
    assert torch.equal(data["next", "ticks"], data["next", STEP_COUNT])


@pytest.mark.parametrize("everyone", [False, True])
def test_a_masked_reset_respawns_robots_and_the_world_goes_on(everyone: bool) -> None:
    env = ArenaEnv(SMALL.replaced(lifetime_ticks=100), arenas=2)
    data = env.reset()
    for _ in range(9):
        data = step_mdp(env.step(steer(data)))
    before = data.clone()
    mask = torch.ones(2, 4, dtype=torch.bool)
    if not everyone:
        mask[:] = torch.tensor([[True, False, False, True], [False, True, False, False]])
    after = env.reset(data.set("_reset", mask[..., None]))
    assert env.arena.tick == 9
    assert after[STEP_COUNT][mask].unique().tolist() == [0]
    assert (after[POSE] != before[POSE]).any(-1)[mask].all()
    for key in SEEN:
        assert torch.equal(after[key][~mask], before[key][~mask]), key
    assert torch.equal(after[OBSERVATION], torch.from_numpy(env.arena.observation))
    env.reset()
    assert env.arena.tick == 0


def test_a_collector_respawns_each_row_at_the_end_of_its_own_life() -> None:
    env = ArenaEnv(SMALL, arenas=2)
    loop = collector(env, ticks=4, batches=5)
    mask = torch.zeros(2, 4, dtype=torch.bool)
    mask[1, 2] = True
    culled, others, last = [], [], None
    for number, batch in enumerate(loop):
        assert batch.batch_size == (2, 4, 4)
        if last is not None:  # rows that were not respawned go on where they were
            same = ~(last["next", TRUNCATED][..., -1, 0])
            same[mask] = False
            for key in (OBSERVATION, POSE):
                assert torch.equal(batch[key][:, :, 0][same], last["next", key][:, :, -1][same])
        culled += batch["next", STEP_COUNT][1, 2, :, 0].tolist()
        others += batch["next", STEP_COUNT][0, 1, :, 0].tolist()
        last = batch.clone()
        if number == 0:
            loop.reset(index=mask)
    loop.shutdown()
    assert others == [1, 2, 3, 4, 5, 6] * 3 + [1, 2]
    assert culled == [1, 2, 3, 4] + [1, 2, 3, 4, 5, 6] * 2 + [1, 2, 3, 4]
    assert env.arena.tick == 20


def test_arena_e_is_the_environment_of_seed_plus_e() -> None:
    def roll(env: ArenaEnv) -> TensorDictBase:
        return env.rollout(30, steer, break_when_any_done=False, auto_cast_to_device=False)

    together, alone = roll(ArenaEnv(SMALL, arenas=4, seed=10)), roll(ArenaEnv(SMALL, seed=12))
    for key in alone.keys(True, True):
        assert torch.equal(alone[key][0], together[key][2]), key
    env = ArenaEnv(SMALL, arenas=4)
    env.set_seed(10)
    assert torch.equal(roll(env)[POSE], together[POSE])


def batches(loop: Collector, count: int) -> list[Any]:
    steps = iter(loop)
    return [next(steps).clone() for _ in range(count)]


def test_a_restored_run_collects_the_same_batches() -> None:
    task = TASKS["wall"].replaced(robots=6, lifetime_ticks=25)
    live = ArenaEnv(task, arenas=2)
    loop = collector(live, ticks=10, batches=12)
    mask = torch.zeros(2, 6, dtype=torch.bool)
    mask[0, 3] = True
    steps = iter(loop)
    for _ in range(5):  # 50 ticks: all lives have just ended, so this is a moment of respawns
        next(steps)
    loop.reset(index=mask)  # and one robot was replaced
    next(steps)
    loop.reset(index=mask)
    live.rebuild()
    state = live.world_state()
    expected = [next(steps).clone() for _ in range(5)]
    restored = ArenaEnv(task, arenas=2, seed=99)
    restored.load_world_state(state)
    got = batches(collector(restored, ticks=10, batches=12), 5)
    for want, have in zip(expected, got, strict=True):
        for key in (*SEEN, ACTION, ("next", REWARD), ("next", OBSERVATION), ("next", POSE)):
            assert torch.equal(want[key], have[key]), key
    restored.reset()
    assert restored.arena.tick == 0  # once stepped, a reset makes new worlds again
