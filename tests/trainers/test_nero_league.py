"""Leagues: two populations on one field, whom they meet, and what they are measured by."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import neatq_torch as nq
from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import NERO_TASKS, Stage
from neatq_envs.nero.training import Enemies, TrainingField
from neatq_envs.scenario import Spawn
from neatq_torch.genome import initial_genome
from neatq_torch.interop import write_team_file
from neatq_torch.kinds import ConfigError
from neatq_trainers.nero import BattleRules, find_team, play
from neatq_trainers.nero.brains import team_brains
from neatq_trainers.nero.held_out import share_of_wins
from neatq_trainers.nero.league import HALL_ROUNDS, League, RoundRow
from neatq_trainers.nero.nero_world import NeroConfig
from neatq_trainers.nero.teams import Team

SMALL = {"robots": 6, "lifetime_ticks": 50, "field": "battle", "round_ticks": 80}
NEAR = NERO_TASKS["battle"].replaced(
    robots=4,
    walls=(),
    hit_points=3,
    spawns=(Spawn(x=400.0, y=380.0, jitter=5), Spawn(x=400.0, y=420.0, jitter=5)),
)
"""Teams so near that they shoot at once."""


def a_team(name: str, seed: int = 0, weight: float = 1.0) -> Team:
    genome = initial_genome(18, 2, genome_id=1, rng=np.random.default_rng(seed))
    genome = replace(genome, link_weight=weight * genome.link_weight)
    return Team(name=name, genomes=(genome,), sensors="opennero-2011")


class Always:
    """The same enemies in every round."""

    def __init__(self, lineup: Sequence[Enemies], ticks: int = 50) -> None:
        self.lineup, self.ticks, self.tallies = lineup, ticks, []

    def reset(self) -> None:
        self.tallies.clear()

    def advance(self, tick: int, tally: np.ndarray) -> None:
        self.tallies.append((tick, tally.tolist()))

    def state(self) -> dict[str, Any]:
        return {}

    def load_state(self, state: Mapping[str, Any]) -> None:
        assert state == {}


def stepped(field: TrainingField, ticks: int, seed: int = 5) -> Iterator[int]:
    rng = np.random.default_rng(seed)
    for tick in range(ticks):
        field.step(rng.uniform(-1, 1, (*field.shape, 2)) * (1.0, 0.2))
        ended = field.terminated | field.truncated
        yield tick
        if ended.any():
            field.respawn(ended)


def test_rivals_share_a_field_and_what_one_hits_the_other_takes() -> None:
    field = TrainingField(_one_stage(), range(4), rounds=Always([None] * 4, ticks=10_000))
    assert len(field.fields) == 2
    hits, damage, pending = np.zeros(4), np.zeros(4), np.zeros(4)
    for _ in stepped(field, 1500):
        hits += field.measures[..., 0].sum(1)
        damage += field.measures[..., 1].sum(1)
        pending = np.concatenate([own.pending.reshape(2, -1).sum(1) for own in field.fields])
        team = np.stack([own.team for own in field.fields])
        np.testing.assert_array_equal(team, [[0] * 4 + [1] * 4] * 2)
    assert hits.min() > 8
    np.testing.assert_array_equal(field.tally, np.stack([hits, damage], -1))
    # A robot that dies takes what is on its way with it.
    lost = hits[[1, 0, 3, 2]] - damage - pending
    assert (lost >= 0).all()
    assert lost.sum() < 0.2 * hits.sum()


def test_a_rival_sees_what_its_side_of_the_field_sees() -> None:
    field = TrainingField(_one_stage(), range(2), rounds=Always([None, None]))
    for _ in stepped(field, 40):
        own = field.fields[0]
        seen = np.zeros((8, 18), np.float32)
        kernels.look(own, field._ground, field._law, 8, seen)
        np.testing.assert_array_equal(field.observation.reshape(8, 18), seen)
        np.testing.assert_array_equal(field.pose.reshape(8, 3)[:, 2], own.pose[:, 2])


def test_rounds_of_one_opponent_are_a_world_of_one_opponent_until_the_first_ends() -> None:
    enemies = team_brains([a_team("a", weight=4.0)], 4), 4
    plain = TrainingField(_one_stage(), range(2), enemies=enemies)
    rounds = Always([enemies, enemies], ticks=50)
    drawn = TrainingField(_one_stage(), range(2), rounds=rounds)
    for tick, _ in zip(stepped(plain, 49), stepped(drawn, 49), strict=True):
        np.testing.assert_array_equal(plain.observation, drawn.observation, err_msg=str(tick))
        np.testing.assert_array_equal(plain.reward, drawn.reward)
    tally = drawn.tally.tolist()
    next(stepped(drawn, 1))
    assert (drawn.truncated | drawn.terminated).all()
    assert rounds.tallies[0][0] == 50
    assert np.all(np.array(rounds.tallies[0][1]) >= tally)
    assert drawn.tally.tolist() == [[0, 0], [0, 0]]


def _one_stage() -> tuple[Any, ...]:
    return (Stage(scenario=NEAR),)


def a_league(names: Sequence[str], given: Sequence[Team] = (), arenas: int = 2) -> League:
    league = League(
        given,
        robots=2,
        seeds=range(arenas),
        ticks=100,
        together=2 if names else 1,
        remembers="league" in names,
    )
    league.fittest = lambda arena, name: a_team(name, seed=arena)
    return league


def test_whoever_was_beaten_is_met_less_often() -> None:
    league = a_league([], [a_team("strong"), a_team("weak", 1)], arenas=1)
    tally = {0: np.array([[0, 5]]), 1: np.array([[5, 0]])}
    for number in range(400):
        league.advance(100 * (number + 1), tally[league._drawn[0]])
    met = [row.opponent for row in league.rows]
    assert met[:20].count("weak") >= 2
    assert met[100:].count("weak") < 10  # the chance is 0.01 ** 2 : 1
    assert {(row.opponent, row.won) for row in league.rows} == {("strong", 0.0), ("weak", 1.0)}


def test_shares_of_rounds_won_follow_the_last_rounds() -> None:
    league = a_league([], [a_team("only")], arenas=1)
    for tick, tally in ((100, [3, 1]), (200, [1, 1]), (300, [0, 1])):
        league.advance(tick, np.array([tally]))
    # 0.5 -> 0.5 + (1 - 0.5) / 4 -> ... + (0.5 - ...) / 4 -> ... + (0 - ...) / 4
    assert league._wins[0, 0] == pytest.approx(((0.625 * 0.75) + 0.125) * 0.75)
    assert league.rows[0] == RoundRow(0, 100, "only", 3, 1, 1.0)


def test_rivals_meet_each_other_and_the_pasts_of_their_own_pair() -> None:
    league = a_league(["league"], [a_team("given")], arenas=4)
    for number in range(1, 400):
        league.advance(100 * number, np.zeros((4, 2)))
    for arena in range(4):
        own = [row for row in league.rows if row.arena == arena]
        assert 0.4 < np.mean([row.opponent == "rival" for row in own]) < 0.6
        assert {"given", f"itself at {100 * HALL_ROUNDS}"} <= {row.opponent for row in own}
        # Both of a pair meet each other in the same rounds.
        partner = [row for row in league.rows if row.arena == arena ^ 1]
        assert [row.opponent == "rival" for row in own] == [
            row.opponent == "rival" for row in partner
        ]
    weights = {id(made) for made in league._made}
    assert len(weights) == 1 + 4 * (399 // HALL_ROUNDS)


def test_without_the_hall_of_fame_rivals_meet_only_as_they_are() -> None:
    league = a_league(["present"])
    for number in range(1, 50):
        league.advance(100 * number, np.zeros((2, 2)))
    assert {row.opponent for row in league.rows} == {"rival"}
    assert league.lineup == [None, None]


def test_a_league_goes_on_from_its_state() -> None:
    league, other = (a_league(["league"], [a_team("given")]) for _ in range(2))
    for number in range(1, 30):
        league.advance(100 * number, np.array([[number % 3, 1], [1, number % 3]]))
    other.load_state(league.state())
    for number in range(30, 60):
        for one in (league, other):
            one.advance(100 * number, np.array([[number % 3, 1], [1, number % 3]]))
    assert other.rows == league.rows
    assert other._drawn == league._drawn


def test_rounds_are_whole_where_a_stage_ends_within() -> None:
    stages = Stage(scenario=NEAR, ticks=70), Stage(scenario=NEAR)
    rounds = Always([None, None], ticks=100)
    field = TrainingField(stages, range(2), rounds=rounds)
    hits = sum(field.measures[..., 0].sum() for _ in stepped(field, 100))
    assert rounds.tallies[0][0] == 100
    assert sum(scored for scored, _ in rounds.tallies[0][1]) == hits > 0


@pytest.mark.usefixtures("blank_pictures")
def test_the_fittest_of_a_later_stage_are_fit_by_its_weights_after_a_resume(tmp_path: Path) -> None:
    stages = [
        {"ticks": 160, "reward_weights": {"approach_enemy": 1.0}},
        {"reward_weights": {"stand_ground": 1.0}},
    ]
    kwargs = {**SMALL, "field": {"name": "two", "stages": stages}, "against": "league"}
    settings = {"batch_ticks": 40}  # an entry of the hall falls into the first batch after
    for name, ticks in (("whole", 640), ("parts", 280)):
        out = tmp_path / name
        nq.train("nero", "rtneat", ticks=ticks, out=out, env_kwargs=kwargs, settings=settings)
    nq.resume(tmp_path / "parts", ticks=640)
    whole, parts = (nq.load_run(tmp_path / name).read()["runs"][0] for name in ("whole", "parts"))
    for one, other in zip(
        whole["world"]["rounds"]["hall"], parts["world"]["rounds"]["hall"], strict=True
    ):
        np.testing.assert_array_equal(one["genomes"]["genome_id"], other["genomes"]["genome_id"])
        np.testing.assert_array_equal(
            one["genomes"]["link_weight"], other["genomes"]["link_weight"]
        )


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize("arm", ["rtneat", "neatq"])
def test_a_run_in_a_league_goes_on_as_if_it_had_not_been_stopped(tmp_path: Path, arm: str) -> None:
    kwargs = {**SMALL, "against": ["league"]}
    nq.train("nero", arm, ticks=720, out=tmp_path / "whole", env_kwargs=kwargs, seed=3)
    nq.train("nero", arm, ticks=400, out=tmp_path / "parts", env_kwargs=kwargs, seed=3)
    nq.resume(tmp_path / "parts", ticks=720)
    for name in ("metrics.csv", "rounds.csv", "champion.json"):
        whole, parts = ((tmp_path / run / name).read_text() for run in ("whole", "parts"))
        assert whole == parts, name
    rounds = (tmp_path / "whole" / "rounds.csv").read_text().splitlines()
    assert rounds[0] == "arena,tick,opponent,hits,damage,won"
    assert len(rounds) == 1 + 2 * 720 // 80


@pytest.mark.usefixtures("blank_pictures")
def test_pairs_of_rivals_are_the_same_in_any_number_of_processes(tmp_path: Path) -> None:
    kwargs = {**SMALL, "against": ["league"]}
    for workers in (1, 2):
        nq.train(
            "nero",
            "rtneat",
            env_kwargs=kwargs,
            ticks=200,
            arenas=4,
            workers=workers,
            out=tmp_path / str(workers),
        )
    for name in ("metrics.csv", "rounds.csv"):
        assert (tmp_path / "1" / name).read_text() == (tmp_path / "2" / name).read_text()


def test_a_run_is_measured_by_teams_that_it_never_meets(tmp_path: Path) -> None:
    files = []
    for number in range(3):
        files.append(tmp_path / f"team{number}.gz")
        write_team_file(a_team("a", seed=number).genomes, files[-1])
    kwargs = {**SMALL, "against": [str(files[0])], "held_out": [str(one) for one in files[1:]]}
    kwargs |= {"round_ticks": 30}
    run = nq.train("nero", "rtneat", env_kwargs=kwargs, ticks=300, out=tmp_path / "run")
    wins = run.metrics()["held_out_wins"]
    assert np.isnan(wins).tolist() == [True, True, False]
    others = [find_team(one) for one in files[1:]]
    team, world = find_team(run.folder), run.config.world
    assert isinstance(world, NeroConfig)
    scenario = world.scenario
    rules = BattleRules(robots=6, field=scenario)
    ours = [play(team, one, seed=0, rules=rules).winner for one in others]
    theirs = [play(one, team, seed=0, rules=rules).winner for one in others]
    points = {"draw": 0.5}
    expected = sum((points | {"blue": 1}).get(one, 0) for one in ours)
    expected += sum((points | {"red": 1}).get(one, 0) for one in theirs)
    assert share_of_wins(team, others, scenario) == expected / 4
    assert {"champion.png", "curves.png", "team.gif"} <= set(os.listdir(run.folder))
    opponents = (tmp_path / "run" / "rounds.csv").read_text()
    assert "team0.gz" in opponents
    assert "team1.gz" not in opponents


@pytest.mark.parametrize(
    ("arm", "kwargs", "said"),
    [
        ("neat", {"against": ["league"]}, "generations"),
        ("committed", {"against": ["present"]}, "twice"),
        ("committed", {"held_out": ["team.gz"]}, "twice"),
        ("rtneat", {"against": ["team.gz", "team.gz"]}, "different names"),
        ("rtneat", {"held_out": ["."]}, "no run"),
    ],
)
def test_who_cannot_play_in_a_league_is_told_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arm: str, kwargs: dict[str, Any], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_team_file(a_team("a").genomes, tmp_path / "team.gz")
    with pytest.raises(ConfigError, match=said):
        nq.train("nero", arm, env_kwargs={**SMALL, **kwargs}, ticks=100, out="no")
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    ("kwargs", "arenas", "said"),
    [
        ({"against": ["league"]}, 3, "even"),
        ({"against": ["league"], "enemy": "turrets"}, None, "enemy"),
        ({"against": ["nobody.gz"]}, None, "nobody.gz"),
        ({"held_out": ["nobody.gz"]}, None, "nobody.gz"),
        ({"against": ["league"], "round_ticks": 0}, None, "round_ticks"),
        ({"against": ["league"], "round_ticks": 1e3}, None, "round_ticks"),
        ({"against": ["league"], "round_ticks": "1000"}, None, "round_ticks"),
        ({"against": 5}, None, "against"),
    ],
)
def test_a_league_that_cannot_be_is_refused(
    tmp_path: Path, kwargs: dict[str, Any], arenas: int | None, said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        nq.train("nero", "rtneat", env_kwargs=kwargs, arenas=arenas, ticks=9, out=tmp_path / "no")
    assert not (tmp_path / "no").exists()
