"""The loop that `benchmarks.battle` measures against plays the same game as the library."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.battle import evolved_team
from benchmarks.battle_reference import fight, minds_of
from neatq_envs.nero.state import BATTLE_STREAM
from neatq_trainers.nero.match import BattleRules, play
from neatq_trainers.nero.teams import Team

GENOMES, ROBOTS = 8, 12  # some are clones


@pytest.fixture(scope="module")
def pairs() -> list[tuple[Team, Team]]:
    teams = [evolved_team(seed, robots=GENOMES) for seed in range(12)]
    return [(teams[i], teams[(i + step) % 12]) for i in range(12) for step in (1, 5)]


@pytest.mark.parametrize(("hit_points", "ticks"), [(20, 600), (1, 1000)])
def test_the_reference_plays_the_same_matches_as_the_library(
    pairs: list[tuple[Team, Team]], hit_points: int, ticks: int
) -> None:
    # As both draw in the same order, any rule that differs leads to another match. Teams are small,
    # since both round differently where robots touch walls, and that would grow.
    rules = BattleRules(ticks=ticks, robots=ROBOTS, hit_points=hit_points)
    library, reference = [], []
    for seed, (blue, red) in enumerate(pairs):
        result = play(blue, red, seed=seed, rules=rules)
        library.append((result.damage_blue, result.damage_red, result.ticks))
        minds = minds_of([blue.genomes, red.genomes], ROBOTS)
        rng = np.random.default_rng([seed, BATTLE_STREAM])
        reference.append(fight(minds, rng, ticks=ticks, hit_points=hit_points))
    assert reference == library
    assert all(blue + red > 0 for blue, red, _ in library), "without shots it would show little"
    if hit_points == 1:
        assert any(passed < ticks for *_, passed in library), "expected that a team dies"
