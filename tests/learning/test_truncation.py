"""An episode that is cut off is not over: its value is bootstrapped from its last observation.

Expected numbers are worked out by hand. Four ticks of each robot; its networks have

    Q(s, 0) = 2 s,  Q(s, 1) = s  (with wires: Q(s, a) = 2 s),  so max Q(s) = 2 s for s > 0.

| tick | s | a | r | s' | |
| --- | --- | --- | --- | --- | --- |
| 0 | 1 | 0 | 1 | 2 | |
| 1 | 2 | 1 | 0.5 | 3 | the episode ends here; 3 is its last observation |
| 2 | 10 | 0 | 0 | 11 | another episode |
| 3 | 11 | 1 | 1 | 12 | the batch ends here, and the episode does not |
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from tensordict import TensorDict

from neatq_envs.gymnasium_rows import make_rows
from neatq_envs.gymnasium_task import GymnasiumTask
from neatq_envs.random_play import ObservationScaling
from neatq_envs.torchrl_rows import GymnasiumRows
from neatq_torch.genome import Genome, initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    DiscreteHeads,
    Heads,
    LearnerParts,
    ReplayConfig,
    ReplayLearner,
    TableConfig,
    TDConfig,
    TDLearner,
    TraceConfig,
    TraceLearner,
    compiled_wires,
    learner_kinds,
)
from neatq_torch.learning.memory import over_horizon
from neatq_torch.learning.table import TableLearner
from neatq_torch.network import PopulationNetwork

End = Literal["truncated", "terminated", "both"]
ENDS: tuple[End, ...] = ("truncated", "terminated", "both")
ROBOTS = 2


def linear(weights: list[float], genome_id: int) -> Genome:
    """Output i is weights[i] times the observation."""
    settings: dict[str, Any] = {"bias": False, "activation": "identity", "genome_id": genome_id}
    genome = initial_genome(1, len(weights), rng=np.random.default_rng(0), **settings)
    return genome.with_weights(np.array(weights, np.float32))


def batch(end: End) -> TensorDict:
    """The four ticks above of two robots, [1, 2, 4]."""

    def each(values: list[Any]) -> torch.Tensor:
        return torch.tensor(values).view(1, 1, 4, 1).expand(1, ROBOTS, 4, 1).clone()

    never = [False] * 4
    over = [False, True, False, False]
    following = {
        "observation": each([2.0, 3.0, 11.0, 12.0]),
        "reward": each([1.0, 0.5, 0.0, 1.0]),
        "terminated": each(never if end == "truncated" else over),
        "truncated": each(never if end == "terminated" else over),
        "done": each(over),
    }
    now = {
        "observation": each([1.0, 2.0, 10.0, 11.0]),
        "action": each([0.0, 1.0, 0.0, 1.0]),
        "candidate_index": each([0, 1, 0, 1]).squeeze(-1),
        "genome_id": torch.arange(ROBOTS).view(1, ROBOTS, 1, 1).expand(1, ROBOTS, 4, 1).clone(),
        "next": following,
    }
    return TensorDict(now, (1, ROBOTS, 4))


def learner_of(config: Any, *, wires: bool = False) -> Any:
    """A learner of two equal robots, in units of Q."""
    heads: Heads = CandidateHeads(2, [0.0], [1.0]) if wires else DiscreteHeads(2)
    weights = [0.0, 0.0, 2.0, 2.0] if wires else [2.0, 1.0]
    network = PopulationNetwork([linear(weights, i) for i in range(ROBOTS)], shape=(1, ROBOTS))
    return learner_kinds.maker_of(config)(config, LearnerParts(network, heads, (1, ROBOTS), [0]))


# ------------------------------------------------------------------------------------------- td

# r + 0.9 max Q(s') - Q(s, a) of each tick, or r - Q(s, a) at the end.
ONE_STEP = {
    "truncated": [1 + 0.9 * 4 - 2, 0.5 + 0.9 * 6 - 2, 0.9 * 22 - 20, 1 + 0.9 * 24 - 11],
    "terminated": [1 + 0.9 * 4 - 2, 0.5 - 2, 0.9 * 22 - 20, 1 + 0.9 * 24 - 11],
}
# G_t = r + 0.9 (max Q(s') + G_{t+1}) / 2, but r + 0.9 max Q(s') or r where the next tick is none
# of the episode.
LAMBDA = {
    "truncated": [1 + 0.9 * (4 + 5.9) / 2 - 2, 5.9 - 2, 0.9 * (22 + 22.6) / 2 - 20, 22.6 - 11],
    "terminated": [1 + 0.9 * (4 + 0.5) / 2 - 2, 0.5 - 2, 0.9 * (22 + 22.6) / 2 - 20, 22.6 - 11],
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize(("decay", "errors"), [(0.0, ONE_STEP), (0.5, LAMBDA)])
@pytest.mark.parametrize("tau", [None, 0.1])
def test_td(end: End, decay: float, errors: dict[str, list[float]], tau: float | None) -> None:
    config = TDConfig(discount=0.9, normalize_return=False, trace_decay=decay, target_tau=tau)
    learner = learner_of(config)
    assert isinstance(learner, TDLearner)
    ticks = batch(end)
    learner.update(ticks)
    wanted = np.abs(errors["truncated" if end == "truncated" else "terminated"])
    for robot in range(ROBOTS):
        assert ticks.get("td_error")[0, robot, :, 0].tolist() == pytest.approx(wanted, rel=1e-5)


# --------------------------------------------------------------------------------------- replay


@pytest.mark.parametrize("end", ENDS)
def test_a_sum_over_three_ticks_ends_with_the_episode(end: End) -> None:
    ahead = over_horizon(batch(end), 3, 0.9)
    assert ahead.shape == (1, ROBOTS, 4)

    def first(*name: str) -> torch.Tensor:
        return ahead.get(name)[0, 0]

    assert first("steps_to_next_obs").flatten().tolist() == [2, 1, 2, 1]
    over = end != "truncated"
    assert first("next", "terminated").flatten().tolist() == [over, over, False, False]
    assert first("next", "observation").flatten().tolist() == [3, 3, 12, 12]
    reward = first("next", "reward").flatten().tolist()
    assert reward == pytest.approx([1 + 0.9 * 0.5, 0.5, 0.9, 1])


# Of tick 0: r_0 + 0.9 r_1 + 0.9^2 max Q(3) - Q(1, 0), or without the third.
SUMS = {"truncated": 1 + 0.9 * 0.5 + 0.81 * 6 - 2, "terminated": 1 + 0.9 * 0.5 - 2}
REPLAY = ReplayConfig(
    discount=0.9,
    normalize_return=False,
    horizon=3,
    keep_every=4,  # tick 0 and no other is remembered
    updates=1,
    size=2,
)


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("how", ["discrete", "wires", "compiled wires"])
@pytest.mark.parametrize("tau", [None, 0.1])
def test_replay(end: End, how: str, tau: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    learner = learner_of(replace(REPLAY, target_tau=tau), wires=how != "discrete")
    assert isinstance(learner, ReplayLearner)
    assert compiled_wires.can_teach(learner.learner) == (how != "discrete")
    if how == "wires":
        monkeypatch.setattr(compiled_wires, "can_teach", lambda _: False)
    found = learner.update(batch(end)).flatten().tolist()
    wanted = SUMS["truncated" if end == "truncated" else "terminated"]
    assert found == pytest.approx([wanted**2] * ROBOTS, rel=1e-5)


@pytest.mark.parametrize("end", ENDS)
def test_rewards_are_weighed_and_values_are_not(end: End) -> None:
    """With `normalize_return` rewards count 0.1 each: 0.1 (1 + 0.45) + 0.81 max Q(3) - Q(1, 0)."""
    for wires in (False, True):
        learner = learner_of(replace(REPLAY, normalize_return=True), wires=wires)
        wanted = 0.145 + (0.81 * 6 if end == "truncated" else 0) - 2
        found = learner.update(batch(end)).flatten().tolist()
        assert found == pytest.approx([wanted**2] * ROBOTS, rel=1e-5)


# --------------------------------------------------------------------------------------- traces


@pytest.mark.parametrize("end", ENDS)
def test_traces(end: End) -> None:
    """Ticks 0 to 2 with the greedy action 0, gamma 0.9, lambda 0.5 and alpha 0.1, from w = 2.

    delta_0 = 1 + 0.9 (2 2) - 2 = 2.6             e_0 = 1             w = 2.26
    delta_1 = 0.5 [+ 0.9 (3 2.26)] - 2 2.26       e_1 = 0.45 + 2      w += 0.1 delta_1 2.45
    delta_2 = 0.9 (11 w) - 10 w = -0.1 w          e_2 = 10            w -= 0.1 (0.1 w) 10
    """
    learner = learner_of(TraceConfig(learning_rate=0.1, discount=0.9, trace_decay=0.5))
    assert isinstance(learner, TraceLearner)
    ticks = batch(end)
    ticks.set("candidate_index", torch.zeros(1, ROBOTS, 4, dtype=torch.long))
    bootstrapped = 0.9 * 3 * 2.26 if end == "truncated" else 0
    second = 0.5 + bootstrapped - 2 * 2.26
    weight = 2.26 + 0.1 * second * 2.45
    errors = [2.6, second, -0.1 * weight]
    found = learner.update(ticks[..., :3]).flatten().tolist()
    assert found == pytest.approx([np.mean(np.square(errors))] * ROBOTS, rel=1e-5)
    for robot in range(ROBOTS):
        learnt = learner.network.genome(robot).link_weight
        assert learnt.tolist() == pytest.approx([0.9 * weight, 1], rel=1e-5)


# ---------------------------------------------------------------------------------------- table


@pytest.mark.parametrize("end", ENDS)
def test_table(end: End) -> None:
    """gamma 0.5, alpha 1; no action of s' is worth more than -0.4, and rewards come a tick later.

    Tick 0: no reward yet, s' = 0.5 of the episode: Q = 0.5 (-0.4).
    Tick 1: reward 0.75 - 1, s' = 1 is the last observation: Q = -0.25 [+ 0.5 (-0.4)].
    """
    config = TableConfig(learning_rate=1.0, discount=0.5)
    learner = TableLearner((1, 1), [-1.0], [1.0], config, [0])
    for seen in (0.5, 1.0):
        learner.values[learner.rows(np.full((1, 1, 1), seen))] = -0.4
    over = torch.tensor([False, True]).view(1, 1, 2, 1)
    following = {
        "observation": torch.tensor([0.5, 1.0]).view(1, 1, 2, 1),
        "reward": torch.tensor([0.75, 0.0]).view(1, 1, 2, 1),
        "terminated": over & (end != "truncated"),
        "truncated": over & (end != "terminated"),
        "done": over,
    }
    now = {
        "observation": torch.tensor([0.0, 0.25]).view(1, 1, 2, 1),
        "action": torch.zeros(1, 1, 2, 1),
        "next": following,
    }
    learner.update(TensorDict(now, (1, 1, 2)))
    first, last = (learner.rows(np.full((1, 1, 1), seen))[0] for seen in (0.0, 0.25))
    assert learner.values[first].max() == 0
    assert learner.values[first].min() == pytest.approx(-0.2)
    assert learner.values[last].min() == pytest.approx(-0.45 if end == "truncated" else -0.25)


# ---------------------------------------------------------------------------- a real environment


class Counting(gymnasium.Env[Any, Any]):
    """Shows how many steps the episode has; ends for good after some of them."""

    observation_space = spaces.Box(0, 100, (1,))
    action_space = spaces.Discrete(2)

    def __init__(self, ends: int = 100) -> None:
        self.ends = ends

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.count = 0
        return np.zeros(1, np.float32), {}

    def step(self, action: int) -> Any:
        self.count += 1
        over = self.count >= self.ends
        return np.full(1, self.count, np.float32), 1.0, over, False, {}


@pytest.mark.parametrize(("ends", "end"), [(100, "truncated"), (3, "both"), (2, "terminated")])
@pytest.mark.parametrize("episodes", [None, 2])
def test_a_time_limit_truncates_and_the_last_observation_is_kept(
    ends: int, end: End, episodes: int | None
) -> None:
    if "Counting-v0" not in gymnasium.registry:
        make: Any = Counting
        gymnasium.register("Counting-v0", entry_point=make, max_episode_steps=3)
    rows, interface = make_rows(GymnasiumTask(id="Counting-v0", kwargs={"ends": ends}))
    as_it_is = ObservationScaling(np.zeros(1), np.ones(1))
    env = GymnasiumRows(rows, interface, as_it_is, shape=(1, 2), episodes=episodes)
    now, ticks = env.reset(), []
    for _ in range(5):
        tick, now = env.step_and_maybe_reset(now.set("action", torch.zeros(1, 2, 1)))
        ticks.append(tick)

    def seen(*name: str) -> list[float]:
        return [tick.get(name)[0, 1].item() for tick in ticks]

    last = 2 if end != "terminated" else 1
    length = last + 1
    assert seen("observation")[:4] == [*range(length), 0, 1][:4]
    following = [*range(1, length + 1), 1, 2]
    assert seen("next", "observation")[:4] == following[:4]
    for name in ("truncated", "terminated"):
        flags = seen("next", name)[: length + 1]
        assert flags == [*[False] * last, end in (name, "both"), False], name
