"""Arenas that exchange genomes: who goes where, under which numbers, and exactly so again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neatq_torch as nq
from neatq_torch.evolution import RtNEAT
from neatq_torch.genome import InnovationLedger
from neatq_torch.kinds import ConfigError
from neatq_trainers.build import build
from neatq_trainers.changes import _not_given
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import CHAMPION, METRICS
from neatq_trainers.islands import emigrants, immigrate
from neatq_trainers.loop import strides
from neatq_trainers.migration import MOST_ISLANDS, MigrationConfig, arrivals, routes
from neatq_trainers.run import Run
from neatq_trainers.train import resume, start

pytestmark = pytest.mark.usefixtures("without_pictures")
Tiny = Callable[..., RunConfig]
Say = Callable[..., tuple[int, str, str]]
EVERY = {"every_ticks": 80}


def same(one: Path, two: Path) -> bool:
    return all(
        (one / name).read_bytes() == (two / name).read_bytes() for name in (METRICS, CHAMPION)
    )


@pytest.fixture(scope="module")
def config(tiny: Tiny) -> RunConfig:
    return tiny("neatq", arenas=3, ticks=480, migration=EVERY)


@pytest.fixture(scope="module")
def whole(config: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return start(config, tmp_path_factory.mktemp("islands") / "run").path


def test_ways_by_hand() -> None:
    def ways(topology: Any) -> list[list[int]]:
        return routes(MigrationConfig(topology=topology), 3, 0, 0)

    assert ways("ring") == [[2], [0], [1]]
    assert ways("all") == [[1, 2], [0, 2], [0, 1]]
    leaving: Any = [["a"], ["b"], ["c", "d"]]
    assert arrivals(leaving, ways("ring")) == [["c", "d"], ["a"], ["b"]]
    assert arrivals(leaving, ways("all")) == [["b", "c", "d"], ["a", "c", "d"], ["a", "b"]]


@given(st.integers(2, 30), st.integers(0, 5), st.integers(0, 5))
def test_on_a_random_ring_each_sends_to_one_and_all_are_on_it(
    arenas: int, seed: int, times: int
) -> None:
    ways = routes(MigrationConfig(topology="random"), arenas, seed, times)
    before, seen = [own for (own,) in ways], [0]
    while before[seen[-1]] != 0:
        seen.append(before[seen[-1]])
    assert sorted(seen) == list(range(arenas))


def test_numbers_of_two_islands_never_meet() -> None:
    ledgers = [InnovationLedger(next_innovation=9, next_node_id=4) for _ in range(3)]
    for part, ledger in enumerate(ledgers):
        ledger.number_apart(part, 3)
    assert [one.link(1, 3, False, 0.0).innovation for one in ledgers] == [9, 10, 11]
    assert [tuple(one.split(1, [])) for one in ledgers] == [(6, 12, 15), (4, 13, 16), (5, 14, 17)]
    again = InnovationLedger.from_state(ledgers[1].state_dict())
    assert again.link(2, 3, False, 0.0).innovation == 19


def evolving(run: Run) -> list[RtNEAT]:
    """Its populations, which are of this kind."""
    return [one for one in run.populations if isinstance(one, RtNEAT)]


def trained(config: RunConfig, ticks: int) -> Run:
    run = build(config)
    for stride in strides(run):
        if stride.tick >= ticks:
            return run
    raise AssertionError


def test_the_fittest_go_and_the_worst_make_room(config: RunConfig) -> None:
    run = trained(config, 320)
    ids = [[genome.genome_id for genome in one.genomes] for one in run.populations]
    scores = [one.score.copy() for one in evolving(run)]
    leaving = emigrants(run, MigrationConfig(emigrants=2), 0)
    for population, own, score in zip(run.populations, leaving, scores, strict=True):
        judged = np.flatnonzero(population.eligible)
        best = judged[np.argsort(-score[judged], kind="stable")][:2]
        assert [one.genome_id for one in own] == [population.genomes[i].genome_id for i in best]
    arriving = arrivals(leaving, [[2], [0], [1]])
    immigrate(run, arriving)
    for arena, population in enumerate(run.populations):
        known = [slot for slot, one in enumerate(population.genomes) if one.genome_id in ids[arena]]
        fresh = sorted(set(range(len(population.genomes))) - set(known))
        assert len(fresh) == 2
        assert not population.eligible[fresh].any()
        assert scores[arena][fresh].max() <= scores[arena][population.eligible].min()
        weights = {population.genomes[slot].link_weight.tobytes() for slot in fresh}
        assert weights == {one.link_weight.tobytes() for one in arriving[arena]}
        for slot in fresh:  # they act with what they have learnt elsewhere
            own = run.genome(arena, slot)
            assert own.link_weight.tobytes() in weights
    next(strides(run))


def test_whoever_goes_at_random_could_be_judged(config: RunConfig) -> None:
    run = trained(config, 320)
    going = MigrationConfig(chosen="random", emigrants=3)
    left = [[one.genome_id for one in own] for own in emigrants(run, going, 0)]
    assert left != [[one.genome_id for one in own] for own in emigrants(run, going, 1)]
    assert left == [[one.genome_id for one in own] for own in emigrants(run, going, 0)]
    for population, own in zip(run.populations, left, strict=True):
        able = [population.genomes[slot].genome_id for slot in np.flatnonzero(population.eligible)]
        assert set(own) <= set(able)


def test_processes_make_no_difference(config: RunConfig, whole: Path, tmp_path: Path) -> None:
    start(config, tmp_path / "run", workers=2)
    assert same(whole, tmp_path / "run")


def test_a_run_stops_at_any_moment_and_goes_on_exactly(
    config: RunConfig, whole: Path, tmp_path: Path
) -> None:
    """Also where it stops when genomes are about to go."""
    start(replace(config, ticks=160), tmp_path / "run")
    resume(tmp_path / "run", ticks=280)
    resume(tmp_path / "run", ticks=480)
    assert same(whole, tmp_path / "run")


def test_without_migration_arenas_are_other_runs(
    config: RunConfig, whole: Path, tmp_path: Path
) -> None:
    start(replace(config, migration=None), tmp_path / "run")
    assert not same(whole, tmp_path / "run")


def test_where_all_are_protected_nobody_arrives(config: RunConfig) -> None:
    run = trained(config, 320)
    population = evolving(run)[0]
    population.protected |= {one.genome_id for one in population.genomes}
    before = [one.genome_id for one in population.genomes]
    immigrate(run, arrivals(emigrants(run, MigrationConfig(), 0), [[2], [0], [1]]))
    assert [one.genome_id for one in population.genomes] == before


def test_exploration_changes_in_any_number_of_processes(tiny: Tiny, tmp_path: Path) -> None:
    config = tiny("replay", arenas=2, ticks=320, migration=EVERY)
    change = '{"tick": 160, "change": {"kind": "exploration", "epsilon": 0.5}}\n'
    (tmp_path / "changes.jsonl").write_text(change)
    for workers in (1, 2):
        out = tmp_path / f"run{workers}"
        start(config, out, workers=workers, changes=tmp_path / "changes.jsonl")
    assert same(tmp_path / "run1", tmp_path / "run2")


def test_a_team_with_immigrants_is_of_this_run(config: RunConfig) -> None:
    run = trained(config, 320)
    first, second = run.populations[:2]
    own, genome = first.ledger.next_node_id, second.genomes[0]
    theirs = own + 10 * MOST_ISLANDS + 1  # the second island has found more
    assert not _not_given(np.append(genome.node_id, theirs), own, MOST_ISLANDS)
    assert _not_given(np.append(genome.node_id, own), own, MOST_ISLANDS)


@pytest.mark.slow
def test_what_comes_from_other_islands_breeds(tiny: Tiny) -> None:
    """Genes with numbers of several islands stand in one genome, each number with one meaning."""
    config = tiny("rtneat", arenas=2, ticks=2000, migration=EVERY)
    run, meaning = build(config), {}
    mixed = 0
    for stride in strides(run):
        if stride.tick % 80 == 0:
            immigrate(run, arrivals(emigrants(run, MigrationConfig(), 0), [[1], [0]]))
        if stride.tick >= 2000:
            break
    for population in run.populations:
        for genome in population.genomes:
            genome.replaced(node_id=genome.node_id)  # checks all rules
            columns = genome.link_innovation, genome.link_source, genome.link_target
            for number, *ends in zip(*(one.tolist() for one in columns), strict=True):
                assert meaning.setdefault(number, ends) == ends
            new = genome.link_innovation[genome.link_innovation > MOST_ISLANDS] % MOST_ISLANDS
            mixed += len(set(new.tolist())) > 1
    assert mixed


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"arenas": 1}, "arenas: expected 2 to 1024 islands, got 1"),
        ({"migration": {"emigrants": 9}}, r"fewer to arrive .* than there are robots \(9\), got 9"),
        ({"migration": {"topology": "star"}}, "topology"),
        ({"migration": {"every_ticks": 5}}, "every_ticks: expected at least 40"),
        ({"population.kind": "neat"}, "replaced one by one"),
    ],
)
def test_what_cannot_be_is_refused(config: RunConfig, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        config.changed(changes)


def test_islands_are_asked_for_on_the_command_line(neatq: Say) -> None:
    asked = ["--task", "flag", "--arm", "rtneat", "--ticks", "160", "--env-kwargs", "robots=9"]
    ways = ["--migrate-every", "80", "--migrate-to", "all", "--emigrants", "2"]
    status, _, error = neatq("train", *asked, "--islands", "3", *ways, "--out", "run")
    assert (status, error) == (0, "")
    config = nq.load_run("run").config
    expected = MigrationConfig(every_ticks=80, topology="all", emigrants=2)
    assert (config.arenas, config.migration) == (3, expected)
    assert "islands: expected a number" in neatq("train", *asked, *ways)[2]
    both = ["--islands", "3", "--arenas", "3"]
    assert "arenas: leave it out" in neatq("train", *asked, *both)[2]
