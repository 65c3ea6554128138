"""What a tick, an update and a replacement cost, counted in calls: a clock would flake.

A count tells whether something loops in Python over robots or networks, and whether something is
kept that should not be. How long a call takes is what `make bench` measures.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torch.utils._python_dispatch import TorchDispatchMode
from torchrl.collectors import Collector

from neatq_envs.scenario import TASKS
from neatq_envs.torchrl_env import ArenaEnv
from neatq_torch.genome import InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    EpsilonGreedy,
    LearnerParts,
    ReplayConfig,
    TDConfig,
    learner_kinds,
)
from neatq_torch.network import PopulationNetwork

# Upper bounds, about 1.3 times what was counted: releases of torch, TorchRL and Python differ by a
# few percent. To count again: python -m pytest tests/test_cost.py -rP
CALLS_PER_TICK = 1550
CALLS_PER_TICK_AND_ARENA = 55
OPERATORS_PER_TICK = 90
CALLS_PER_UPDATE = 3100
OPERATORS_PER_UPDATE = 220
CALLS_PER_SHARED_UPDATE_AND_ARENA = 660
CALLS_PER_REPLACEMENT = 210

TICKS = 10
FEW, MANY = 30, 50  # the physics has two Spaces for either
OWN = TDConfig(learning_rate=0.03, optimizer="adam", discount=0.9)
SHARED = ReplayConfig(learning_rate=0.03, optimizer="adam", discount=0.9, updates=4, horizon=40)


class _Operators(TorchDispatchMode):
    """Counts torch's operators, those of the backward pass as well.

    Networks take torch operators while they are counted, as they do on CUDA; calls are counted
    with the compiled kernels of the CPU.
    """

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += 1
        return func(*args, **(kwargs or {}))


def operators(action: Callable[[], object]) -> int:
    with _Operators() as counted:
        action()
    return counted.count


def calls(action: Callable[[], object]) -> int:
    """Calls of Python functions and of built-in ones."""
    count = 0

    def note(_: Any, event: str, __: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    gc.disable()  # a collection in between would call finalisers
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(before)
        gc.enable()
    return count


class Team:
    """Robots that look for a flag behind a wall and never end a life, a few batches after birth.

    They learn from their own ticks, unless from those of all (`shared`).
    """

    def __init__(
        self, *, arenas: int = 1, robots: int = FEW, ticks: int = TICKS, shared: bool = False
    ) -> None:
        scenario = TASKS["wall"].replaced(robots=robots, lifetime_ticks=0)
        env = ArenaEnv(scenario, arenas=arenas, seed=0)
        low, high = env.arena.schema.action_bounds(scenario)
        heads, seeds = CandidateHeads(5, low.tolist(), high.tolist()), range(arenas)
        inputs, rng = len(env.arena.schema.observations), np.random.default_rng(0)
        genomes = [
            initial_genome(inputs, heads.outputs, rng=rng, genome_id=number)
            for number in range(arenas * robots)
        ]
        network = PopulationNetwork(genomes, shape=(arenas, robots))
        exploration = EpsilonGreedy((arenas, robots), seeds=seeds, epsilon=0.01)
        config = SHARED if shared else OWN
        parts = LearnerParts(network, heads, (arenas, robots), seeds)
        self.learner = learner_kinds.maker_of(config)(config, parts)
        collector = Collector(
            env,
            CandidatePolicy(network, heads, exploration),
            frames_per_batch=arenas * robots * ticks,
            total_frames=-1,
            auto_register_policy_transforms=False,
            use_buffers=False,  # a network's state may grow from batch to batch
            track_traj_ids=False,
        )
        self._batches: Iterator[TensorDictBase] = iter(collector)
        for _ in range(3):  # whatever is made once is made now
            self.live()

    def act(self) -> TensorDictBase:
        return next(self._batches)

    def learn(self, batch: TensorDictBase) -> None:
        self.learner.update(batch)

    def live(self) -> None:
        self.learn(self.act())

    def counts(self) -> dict[str, int]:
        """Calls and operators of one batch and of one update."""
        batch = self.act()
        return {
            "calls to act": calls(self.act),
            "operators to act": operators(self.act),
            "calls to learn": calls(lambda: self.learn(batch)),
            "operators to learn": operators(lambda: self.learn(batch)),
        }


@pytest.fixture(scope="module")
def few() -> dict[str, int]:
    return Team(robots=FEW).counts()


def test_nothing_loops_over_robots_in_python(few: dict[str, int]) -> None:
    assert Team(robots=MANY).counts() == few


def test_an_arena_more_costs_a_few_calls_and_no_operator(few: dict[str, int]) -> None:
    two, four = Team(arenas=2).counts(), Team(arenas=4).counts()
    assert four["operators to act"] == two["operators to act"] == few["operators to act"]
    assert four["operators to learn"] == two["operators to learn"] == few["operators to learn"]
    assert four["calls to learn"] == two["calls to learn"] == few["calls to learn"]
    more = (four["calls to act"] - two["calls to act"]) / 2 / TICKS
    _check("CALLS_PER_TICK_AND_ARENA", more, CALLS_PER_TICK_AND_ARENA)


def test_learning_from_all_loops_over_arenas_at_most() -> None:
    teams = [Team(robots=robots, shared=True) for robots in (FEW, MANY)]
    few, many = (calls(lambda team=team: team.learn(team.act())) for team in teams)
    assert few == many
    two, four = (Team(arenas=arenas, shared=True) for arenas in (2, 4))
    batches = two.act(), four.act()
    more = calls(lambda: four.learn(batches[1])) - calls(lambda: two.learn(batches[0]))
    _check("CALLS_PER_SHARED_UPDATE_AND_ARENA", more / 2, CALLS_PER_SHARED_UPDATE_AND_ARENA)


def test_counts_stay_within_their_bounds(few: dict[str, int]) -> None:
    _check("CALLS_PER_TICK", few["calls to act"] / TICKS, CALLS_PER_TICK)
    _check("OPERATORS_PER_TICK", few["operators to act"] / TICKS, OPERATORS_PER_TICK)
    _check("CALLS_PER_UPDATE", few["calls to learn"], CALLS_PER_UPDATE)
    _check("OPERATORS_PER_UPDATE", few["operators to learn"], OPERATORS_PER_UPDATE)


def _check(name: str, counted: float, bound: float) -> None:
    print(f"{name}: counted {counted:g}, bound {bound:g}")
    assert counted <= bound


def test_a_replacement_costs_the_same_among_many_networks() -> None:
    among_few, among_many = (_replacement_calls(networks) for networks in (10, 200))
    assert among_many == among_few
    _check("CALLS_PER_REPLACEMENT", among_many, CALLS_PER_REPLACEMENT)


def _replacement_calls(networks: int) -> int:
    """Calls of one replacement and of the next forward pass, among copies of ten genomes."""
    rng = np.random.default_rng(0)
    founders = [initial_genome(12, 15, rng=rng, genome_id=number) for number in range(10)]
    ledger = InnovationLedger.for_genomes(founders)
    config = MutationConfig(add_node_prob=1.0)
    grown = [mutate(mutate(one, config, ledger, rng), config, ledger, rng) for one in founders]
    network = PopulationNetwork(grown * (networks // 10))
    observation = torch.zeros(networks, 12)

    def replaced() -> None:
        network.replace(3, grown[7])
        with torch.no_grad():
            network(observation)

    replaced()
    return calls(replaced)


def test_nothing_is_kept_from_batch_to_batch() -> None:
    team = Team(ticks=5)
    for _ in range(10):
        team.live()
    before = _alive()
    for _ in range(40):
        team.live()
    for kind, count in _alive().items():
        assert count - before[kind] < 40, f"{kind}: more than one for each batch"


def _alive() -> dict[str, int]:
    gc.collect()
    objects = gc.get_objects()
    return {
        "objects": len(objects),
        "tensors": sum(issubclass(type(one), torch.Tensor) for one in objects),
    }
