"""The numbers of `metrics.csv`, checked by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from neatq_torch.genome import Genome, layered_genome
from neatq_trainers.build import build
from neatq_trainers.callbacks import Callback
from neatq_trainers.config import RunConfig
from neatq_trainers.metrics import DistanceMetrics, ReturnMetrics
from neatq_trainers.rows import DistanceRow, ReturnRow, csv_line, header, row_kind
from neatq_trainers.run import Run
from neatq_trainers.train import start
from neatq_trainers.worlds import facts_of

NAN = float("nan")
Tiny = Callable[..., RunConfig]


def population(eligible: list[bool], champion: int | None) -> SimpleNamespace:
    genomes = [
        SimpleNamespace(node_id=np.arange(nodes), link_enabled=np.array(links))
        for nodes, links in ((4, [True, True]), (5, [True, False]), (9, [False, False]))
    ]
    return SimpleNamespace(
        eligible=np.array(eligible), champion=champion, births=6, species=[1, 2], genomes=genomes
    )


def run_of(tick: int, *populations: SimpleNamespace, epsilon: float = 0.25) -> Run:
    parts = {
        "config": SimpleNamespace(learner=SimpleNamespace(epsilon=epsilon), generational=False),
        "populations": list(populations),
    }
    return cast(Run, SimpleNamespace(tick=tick, **parts))


def rows(run: Run, batch: TensorDict, error: torch.Tensor) -> list[DistanceRow]:
    return cast(list[DistanceRow], DistanceMetrics(len(error)).add(run, batch, error))


def batch_of(distance: Any) -> TensorDict:
    """A batch of distances [arenas, robots, ticks] after each tick."""
    values = torch.tensor(distance, dtype=torch.float32)
    following = TensorDict({"distance": values.unsqueeze(-1)}, values.shape)
    return TensorDict({"next": following}, values.shape)


def test_a_row_by_hand() -> None:
    # Ticks 99, 100, 101: the row ends with tick 100, the second column.
    batch = batch_of([[[9, 10, 9], [9, 20, 9], [9, 60, 9]]])
    run = run_of(101, population([False, True, True], champion=1))
    (row,) = rows(run, batch, torch.tensor([[1.0, 2.0, 3.0]]))
    assert row == DistanceRow(
        arena=0,
        tick=100,
        min_distance=10.0,
        mean_distance=19.5,
        max_distance=60.0,
        eligible_mean_distance=24.5,
        newborn_mean_distance=9.5,
        champion_distance=14.5,
        births=6,
        species=2,
        mean_nodes=6.0,
        mean_links=1.0,
        td_loss=1.0,  # half of the mean error
        epsilon=0.25,
    )
    assert csv_line(row) == "0,100,10,19.5,60,24.5,9.5,14.5,6,2,6,1,1,0.25\n"


def test_without_anybody_eligible_and_without_learning_cells_are_empty() -> None:
    run = run_of(100, population([False, False, False], champion=None))
    (row,) = rows(run, batch_of([[[1], [2], [3]]]), torch.full((1, 3), NAN))
    assert csv_line(row) == "0,100,1,2,3,,2,,6,2,6,1,,0.25\n"


def test_without_evolution_the_cells_of_genomes_are_empty() -> None:
    (row,) = rows(run_of(100), batch_of([[[1], [2], [3]]]), torch.zeros(1, 3))
    assert csv_line(row) == "0,100,1,2,3,,,,0,0,,,0,0.25\n"


@pytest.mark.parametrize(
    ("tick", "ticks", "wanted"),
    [
        (99, 99, []),
        (100, 1, [100]),
        (101, 1, []),
        (140, 40, []),
        (200, 100, [200]),
        (250, 250, [100, 200]),
        (300, 200, [200, 300]),
    ],
)
def test_every_hundredth_tick_belongs_to_one_batch(
    tick: int, ticks: int, wanted: list[int]
) -> None:
    batch = batch_of([[[float(tick - ticks + 1 + t) for t in range(ticks)]]])
    found = list(rows(run_of(tick), batch, torch.zeros(1, 1)))
    assert [row.tick for row in found] == wanted
    assert [row.min_distance for row in found] == wanted, "the distance of that very tick"
    first = max(tick - ticks, 0)
    means = [
        np.mean([float(t) for t in range(max(first, end - 100) + 1, end + 1)]) for end in wanted
    ]
    assert [row.mean_distance for row in found] == pytest.approx(means)


@given(st.lists(st.integers(1, 130), min_size=1, max_size=6), st.integers(0, 5))
@settings(deadline=None, max_examples=30)
def test_rows_do_not_depend_on_how_batches_are_cut(lengths: list[int], restored: int) -> None:
    total = sum(lengths)
    distance = np.random.default_rng(0).uniform(0, 300, (2, 3, total)).round(2)
    people = population([False, True, True], 1), population([True, True, False], 0)
    whole = rows(run_of(total, *people), batch_of(distance), torch.zeros(2, 3))
    own, parts, tick = DistanceMetrics(2), [], 0
    for number, length in enumerate(lengths):
        if number == restored:
            state, own = own.state_dict(), DistanceMetrics(2)
            own.load_state_dict(state)
        part = batch_of(distance[..., tick : tick + length])
        tick += length
        parts += own.add(run_of(tick, *people), part, torch.zeros(2, 3))
    assert [csv_line(row) for row in parts] == [csv_line(row) for row in whole]


def test_lives_that_begin_together_are_not_seen_at_one_age_alone() -> None:
    ages = np.arange(1000) % 1000
    away = np.maximum(141.0 - ages, 0)  # whoever runs 141 units to the flag is 10 away on average
    found = rows(run_of(1000), batch_of([[away.tolist()]]), torch.zeros(1, 1))
    assert np.mean([row.mean_distance for row in found]) == pytest.approx(10, abs=0.1)


def test_each_arena_has_its_own_rows_tick_by_tick() -> None:
    batch = batch_of([[[1.0] * 200], [[2.0] * 200]])
    found = list(rows(run_of(200), batch, torch.tensor([[4.0], [8.0]])))
    assert [(row.tick, row.arena) for row in found] == [(100, 0), (100, 1), (200, 0), (200, 1)]
    assert [row.mean_distance for row in found] == [1.0, 2.0, 1.0, 2.0]
    assert [row.td_loss for row in found] == [2.0, 4.0, 2.0, 4.0]


def test_the_header_names_the_cells() -> None:
    assert header(DistanceRow) == (
        "arena,tick,min_distance,mean_distance,max_distance,eligible_mean_distance,"
        "newborn_mean_distance,champion_distance,births,species,mean_nodes,mean_links,td_loss,epsilon\n"
    )
    assert header(ReturnRow) == (
        "arena,generation,episodes,steps,best_fitness,mean_fitness,evaluated_return,"
        "champion_return,species,mean_nodes,mean_links,td_error\n"
    )


def test_worlds_of_returns_have_rows_of_returns(tiny: Tiny, tiny_walk: Tiny) -> None:
    assert row_kind(tiny("neat")) is DistanceRow
    assert row_kind(tiny_walk("rtneat")) is ReturnRow


class Watch(Callback):
    """Adds up what happens in a run, step by step in plain Python."""

    def __init__(self) -> None:
        self.steps = self.episodes = 0
        self.lived = self.errors = torch.zeros(8)
        self.returns: dict[int, list[float]] = {}
        self.newborn = 0

    def batch(self, run: Run, batch: Any, error: torch.Tensor) -> None:
        living = batch.get("living")[0, ..., 0]
        for slot, tick in living.nonzero().tolist():
            now = batch[0, slot, tick]
            own = self.returns.setdefault(slot, [])
            if now["step_count"] == 0:
                own.append(0.0)
            own[-1] += float(now["next", "reward_vector"])
            self.steps += 1
            self.episodes += int(now["next", "done"])
        self.lived = self.lived + living.sum(-1)
        self.errors = self.errors + error[0] * living.sum(-1)

    def advance(self, run: Run, newborn: torch.Tensor) -> None:
        self.newborn += int(newborn.sum())


def row_of(folder: Any, number: int = 0) -> dict[str, float]:
    return {name: column[number] for name, column in folder.metrics().items()}


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize("arm", ["neat", "neat+q"])
def test_a_row_of_returns_by_hand(arm: str, tiny_walk: Tiny, tmp_path: Path) -> None:
    """A generation of 8 genomes with 2 episodes each."""
    watch = Watch()
    folder = start(tiny_walk(arm, generations=1), tmp_path / "run", callbacks=[watch])
    row = row_of(folder)
    assert row["generation"] == 1
    assert row["episodes"] == watch.episodes == 16
    assert row["steps"] == watch.steps <= 16 * 20
    assert [len(own) for own in watch.returns.values()] == [2] * 8
    fitness = [np.mean(own) for own in watch.returns.values()]
    assert row["best_fitness"] == pytest.approx(max(fitness), rel=1e-5)
    assert row["mean_fitness"] == pytest.approx(np.mean(fitness), rel=1e-5)
    assert row["champion_return"] == row["evaluated_return"]


@pytest.mark.usefixtures("without_pictures")
def test_the_td_error_is_the_mean_over_the_steps_of_each_life(
    tiny_walk: Tiny, tmp_path: Path
) -> None:
    watch = Watch()
    config = tiny_walk("neat+q", generations=1)
    folder = start(config, tmp_path / "run", callbacks=[watch])
    assert watch.lived.unique().numel() > 1, "some left the walk early"
    by_hand = (watch.errors / watch.lived).mean()
    assert row_of(folder)["td_error"] == pytest.approx(float(by_hand), rel=1e-5)


def test_a_td_error_by_hand(tiny_walk: Tiny) -> None:
    """Errors of two batches, one of which the first slot lived through only half."""
    config = tiny_walk("neat+q", **{"world.slots": 2, "population.episodes": 1})
    run = build(config, facts=facts_of(config.world, 0.99))
    run.world.close()
    living = torch.ones(1, 2, 4, 1, dtype=torch.bool)
    for error, ends in (([1.0, 2.0], False), ([4.0, 8.0], True)):
        if ends:
            living[0, 0, 2:] = False
        done = torch.zeros(1, 2, 4, 1, dtype=torch.bool)
        following = TensorDict({"done": done}, (1, 2, 4))
        batch = TensorDict({"living": living.clone(), "next": following}, (1, 2, 4))
        assert list(run.metrics.add(run, batch, torch.tensor([error]))) == []
    state = run.metrics.state_dict()
    # Slot 0: 4 steps of 1 and 2 of 4; slot 1: 4 of 2 and 4 of 8.
    assert (state["_error"] / state["_counted"]).tolist() == [[12 / 6, 40 / 8]]
    assert state["_steps"].tolist() == [6 + 8]


@pytest.mark.usefixtures("without_pictures")
def test_where_genomes_are_replaced_one_by_one_closed_trials_make_rows_and_births(
    tiny_walk: Tiny, tmp_path: Path
) -> None:
    """A trial of 2 episodes of 20 steps; 8 trials make a row.

    Half of the population may be too young, so one is replaced for every two trials that close,
    after the first of all: 8.
    """
    seen: list[tuple[int, int, int]] = []

    class Trials(Callback):
        def advance(self, run: Run, newborn: torch.Tensor) -> None:
            population: Any = run.populations[0]
            total = population.trials.total
            seen.append((total, population.births, int(newborn.sum())))
            env: Any = run.world.env
            now = env.episodes
            fresh = newborn.flatten().numpy()
            assert (now.step_count[fresh] == 0).all(), "a newborn begins a new episode"
            assert (now.reward[fresh] == 0).all()

    watch = Watch()
    config = tiny_walk("rtneat", steps=1600, batch_ticks=7)
    folder = start(config, tmp_path / "run", callbacks=[watch, Trials()])
    assert watch.newborn == seen[-1][1] > 5
    for total, births, _ in seen:
        assert births == (total - 8) // 2
    metrics = folder.metrics()
    assert metrics["generation"].tolist() == list(range(1, len(metrics["generation"]) + 1))
    assert metrics["steps"][-1] <= watch.steps
    assert folder.read()["done"]["generations"] == metrics["generation"][-1]
    assert (metrics["steps"] % 8 == 0).all(), "all live all the time"


# ------------------------------------------------------------------------- champions by parsimony

FULL = layered_genome(2, 1, rng=np.random.default_rng(0), hidden=2)


class Crowns:
    """An arena in which genomes of so many links are evaluated with such returns."""

    def __init__(self, parsimony: float | None = 0.1) -> None:
        config = SimpleNamespace(parsimony=parsimony)
        self.population = SimpleNamespace(generations=0, config=config, genomes=[])
        self.metrics = ReturnMetrics(cast(Any, [self.population]), (1, 9))

    def evaluate(self, *genomes: tuple[int, float]) -> tuple[int, float]:
        """Links and return of each; those of the champion afterwards."""
        own: list[Genome] = [FULL.replaced(link_enabled=np.arange(9) < n) for n, _ in genomes]
        self.population.genomes, self.population.generations = own, self.population.generations + 1
        parts = {"populations": [self.population], "normalization": None, "world": None}
        run = SimpleNamespace(genome=lambda _, slot: own[slot], **parts)
        scores = np.array([score for _, score in genomes])
        self.metrics._crown(cast(Run, run), 0, list(range(len(own))), scores)
        champion = self.metrics.champions[0]
        assert champion is not None
        return int(champion.genome.link_enabled.sum()), champion.score


def test_the_champion_is_the_smallest_within_the_share_of_the_best() -> None:
    crowns = Crowns()
    assert crowns.evaluate((9, 100.0), (5, 90.0), (3, 89.0), (6, 95.0)) == (5, 90.0)
    assert crowns.evaluate((5, 91.0), (6, 100.0)) == (5, 91.0)  # of as small ones the better
    assert crowns.evaluate((6, 99.0), (1, 0.0)) == (5, 91.0)
    assert crowns.evaluate((4, 90.5)) == (4, 90.5)


def test_champions_do_not_get_worse_step_by_step() -> None:
    crowns = Crowns()
    assert crowns.evaluate((9, 100.0)) == (9, 100.0)
    assert crowns.evaluate((8, 91.0)) == (8, 91.0)
    assert crowns.evaluate((7, 83.0)) == (8, 91.0)  # within a tenth of 91, not of 100
    assert crowns.evaluate((9, 110.0)) == (9, 110.0)  # 99 are good enough now
    assert crowns.evaluate((2, 98.9)) == (9, 110.0)


def test_of_negative_returns_those_a_share_below_are_good_enough() -> None:
    crowns = Crowns()
    assert crowns.evaluate((9, -100.0), (5, -110.0), (3, -110.5)) == (5, -110.0)


def test_a_checkpoint_keeps_the_best_return() -> None:
    before, after = Crowns(), Crowns()
    before.evaluate((9, 100.0), (5, 90.0))
    after.metrics.load_state_dict(before.metrics.state_dict())
    assert after.evaluate((4, 85.0)) == (5, 90.0)


def test_without_parsimony_the_best_is_champion_and_nothing_more_is_kept() -> None:
    crowns = Crowns(parsimony=None)
    assert crowns.evaluate((9, 100.0), (5, 99.0)) == (9, 100.0)
    assert crowns.evaluate((9, 100.0)) == (9, 100.0)
    champion = crowns.metrics.champions[0]
    assert champion is not None
    assert champion.generation == 2, "of equally good ones the later"
    assert "best" not in crowns.metrics.state_dict()


@pytest.mark.parametrize("arm", ["neat", "rtneat"])
def test_the_best_is_evaluated_beside_the_smallest(
    arm: str, tiny_walk: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = {"world.slots": 4, "world.evaluated": 3}
    config = tiny_walk(arm, **{"population.parsimony": 0.5, **size})
    run = build(config, facts=facts_of(config.world, 0.99))
    run.world.close()
    population, seen = run.populations[0], []
    one = population.genomes[2]
    population.genomes[2] = one.replaced(link_enabled=np.arange(one.link_enabled.size) < 1)
    for _ in range(2):  # episodes
        population.record(np.array([1.0, 4.0, 3.0, 3.5])[:, None, None], np.ones((4, 1), bool))

    def returns(genomes: list[Genome], *_: Any, **__: Any) -> np.ndarray:
        seen.extend(genome.genome_id for genome in genomes)
        return np.ones((len(genomes), 1))

    monkeypatch.setattr(run.world, "returns", returns)
    cast(ReturnMetrics, run.metrics)._evaluated(run, 0, over=True)
    assert seen == [population.genomes[slot].genome_id for slot in (1, 2, 3)]
