"""The study's variants: one thing changed each, in a world that stays the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from neatq_envs.arena import Arena
from neatq_envs.flags import FlagSchedule
from neatq_envs.scenario import Scenario
from neatq_experiments.compare.cells import digest, grid
from neatq_experiments.compare.figures import colours_of
from neatq_experiments.compare.tables import SeedOutcome, Study
from neatq_experiments.compare.variants import PAPER_ARMS, config_of
from neatq_experiments.variants import STUDY_GROUPS, STUDY_PARTS, register
from neatq_torch.learning import EpsilonGreedy
from neatq_trainers.config import RunConfig
from neatq_trainers.train import start
from neatq_trainers.worlds import ArenaConfig

ON_GYMNASIUM = STUDY_GROUPS["critic"]
VARIANTS = {
    name: one
    for group in STUDY_GROUPS.values()
    for name, one in group.items()
    if name not in ON_GYMNASIUM
}
register()


@pytest.mark.parametrize(
    ("tasks", "arms"),
    [(["flag", "wall"], [*PAPER_ARMS, *VARIANTS]), (["gym:Pendulum-v1"], ["neatq", *ON_GYMNASIUM])],
)
def test_no_two_variants_have_the_same_configuration(tasks: list[str], arms: list[str]) -> None:
    names = {cell.name for cell in grid(tasks, arms, quick=False)}
    assert len(names) == len(tasks) * len(arms)
    assert len({name.rsplit("-", 1)[1] for name in names}) == len(names)


@pytest.mark.parametrize("group", STUDY_GROUPS)
def test_no_two_variants_of_a_group_have_the_same_colour(group: str) -> None:
    names = [*PAPER_ARMS, *STUDY_GROUPS[group]]
    outcomes = tuple(SeedOutcome("flag", name, 0, 500, None, None, 0, None, "") for name in names)
    colours = colours_of(Study(points=(), outcomes=outcomes).arms())
    assert len({colours[name] for name in names}) == len(names)


def scenario_of(config: RunConfig) -> Scenario:
    assert isinstance(config.world, ArenaConfig)
    return config.world.scenario


def worlds_of(config: RunConfig, every: int) -> list[Any]:
    """Flags, and where lives begin, of a world whose robots begin a life every so many ticks."""
    flag = FlagSchedule(ring=(100.0, 200.0), interval_ticks=7)
    arena = Arena(scenario_of(config).replaced(flag=flag, robots=4), seeds=[5])
    first = arena.position.copy(), arena.heading_rad.copy()
    flags, places = [], []
    for tick in range(1, 40):
        arena.step(np.zeros((1, 4, len(arena.schema.actions))))
        flags.append(arena.flag.copy())
        if tick % every == 0:
            arena.respawn(np.ones((1, 4), bool))
            places.append(arena.position.copy())
    return [*first, np.stack(flags), np.stack(places)[:3]]


def test_a_seed_is_the_same_world_for_every_arm_and_variant() -> None:
    wanted = worlds_of(config_of("flag", "rtneat"), every=5)
    assert len(np.unique(wanted[2])) > 4  # the flag moves
    for number, arm in enumerate((*PAPER_ARMS, *VARIANTS)):
        found = worlds_of(config_of("flag", arm), every=3 + number % 5)
        assert all(np.array_equal(one, other) for one, other in zip(wanted, found, strict=True))


def test_all_arms_have_the_same_task_but_for_sensors_reward_and_when_first_lives_end() -> None:
    for task in ("flag", "wall"):
        worlds = [scenario_of(config_of(task, arm)) for arm in (*PAPER_ARMS, *VARIANTS)]
        own = {"sensors": "arena", "reward": "progress", "first_lives": None}
        same = [world.replaced(**own) for world in worlds]
        assert all(world == same[0] for world in same)
        assert len({config_of(task, arm).ticks for arm in (*PAPER_ARMS, *VARIANTS)}) == 1


def test_a_variant_is_its_arm_with_other_values() -> None:
    base, variant = (config_of("wall", name) for name in ("replay", "replay-darwinian"))
    assert variant == base.changed({"learner.inheritance": "darwinian"})
    mixed = config_of("wall", "rtneat-replay-senses")
    assert (scenario_of(mixed).sensors, scenario_of(mixed).reward) == ("arena", "progress")
    assert mixed.learner == config_of("wall", "rtneat").learner


def test_all_parts_together_lead_from_what_the_paper_describes_to_replay() -> None:
    everything = {
        path: value for part in STUDY_PARTS.values() for path, value in part.added.items()
    }
    described, replay = config_of("wall", "described"), config_of("wall", "replay")
    assert digest(described.changed(everything)) == digest(replay)
    last_step = config_of("wall", list(STUDY_GROUPS["ladder"])[-1])
    name, last = list(STUDY_PARTS.items())[-1]
    before = last_step.changed(list(STUDY_PARTS.values())[-2].added)
    assert digest(before) == digest(config_of("wall", f"replay-without-{name}"))
    assert digest(before.changed(last.added)) == digest(replay)


def test_a_part_that_is_taken_out_can_be_put_back() -> None:
    replay = config_of("flag", "replay")
    whole = {path: value for part in STUDY_PARTS.values() for path, value in part.added.items()}
    for name in STUDY_PARTS:
        without = config_of("flag", f"replay-without-{name}")
        assert without != replay
        assert without.changed({"learner.kind": "td"}).changed(whole) == replay


def test_explorations_that_last_take_as_many_ticks_as_those_that_do_not() -> None:
    shares = []
    for name in ("replay", "replay-lasting-exploration"):
        learner = config_of("wall", name).learner
        explore = EpsilonGreedy(
            (1, 400),
            seeds=[0],
            epsilon=learner.epsilon,
            max_hold_ticks=learner.max_hold_ticks,
        )
        values = torch.tensor([1.0] + [0.0] * 4).expand(1, 400, 5)
        chosen = torch.stack([explore(values) for _ in range(4000)])
        shares.append((chosen != 0).float().mean().item())
    assert shares[0] == pytest.approx(shares[1], rel=0.1)


def test_who_learns_alone_learns(tmp_path: Path) -> None:
    """A control that stands still makes whoever is beside it look good."""
    config = config_of("flag", "neatq-learning-alone", {"robots": 12, "lifetime_ticks": 500})
    quick = {"ticks": 4500, "learner.newborn_updates": 100, "learner.updates_per_step": 0.04}
    distance = start(config.changed(quick), tmp_path / "run").metrics()["mean_distance"]
    assert distance[-5:].mean() < 0.7 * distance[:5].mean()
