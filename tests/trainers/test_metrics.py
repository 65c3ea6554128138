"""The numbers of `metrics.csv`, checked by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.learning import LearningGenes
from neatq_trainers.build import Run
from neatq_trainers.metrics import HEADER, Row, rows

NAN = float("nan")


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
        "config": SimpleNamespace(learning=SimpleNamespace(epsilon=epsilon)),
        "populations": list(populations),
        "genes": None,
    }
    return cast(Run, SimpleNamespace(tick=tick, **parts))


def batch_of(distance: Any) -> TensorDict:
    """A batch of distances [arenas, robots, ticks] after each tick."""
    values = torch.tensor(distance, dtype=torch.float32)
    following = TensorDict({"distance": values.unsqueeze(-1)}, values.shape)
    return TensorDict({"next": following}, values.shape)


def test_a_row_by_hand() -> None:
    # Ticks 99, 100, 101: the row is that of tick 100, the second column.
    batch = batch_of([[[9, 10, 9], [9, 20, 9], [9, 60, 9]]])
    run = run_of(101, population([False, True, True], champion=1))
    (row,) = rows(run, batch, torch.tensor([[0.5, 1.0, 1.5]]))
    assert row == Row(
        arena=0,
        tick=100,
        min_distance=10.0,
        mean_distance=30.0,
        max_distance=60.0,
        eligible_mean_distance=40.0,
        newborn_mean_distance=10.0,
        champion_distance=20.0,
        births=6,
        species=2,
        mean_nodes=6.0,
        mean_links=1.0,
        td_loss=0.5,
        epsilon=0.25,
    )
    assert row.csv() == "0,100,10,30,60,40,10,20,6,2,6,1,0.5,0.25\n"


def test_where_epsilon_is_a_gene_a_row_has_its_mean() -> None:
    run = run_of(100)
    run.genes = cast(
        LearningGenes, SimpleNamespace(values=np.array([[[9.0, 0.1, 9.0], [9.0, 0.5, 9.0]]]))
    )
    (row,) = rows(run, batch_of([[[1], [2], [3]]]), torch.zeros(1, 3))
    assert row.epsilon == pytest.approx(0.3)


def test_without_anybody_eligible_and_without_learning_cells_are_empty() -> None:
    run = run_of(100, population([False, False, False], champion=None))
    (row,) = rows(run, batch_of([[[1], [2], [3]]]), torch.full((1, 3), NAN))
    assert row.csv() == "0,100,1,2,3,,2,,6,2,6,1,,0.25\n"


def test_without_evolution_the_cells_of_genomes_are_empty() -> None:
    (row,) = rows(run_of(100), batch_of([[[1], [2], [3]]]), torch.zeros(1, 3))
    assert row.csv() == "0,100,1,2,3,,,,0,0,,,0,0.25\n"


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
    assert [row.mean_distance for row in found] == wanted, "the distance of that very tick"


def test_each_arena_has_its_own_rows_tick_by_tick() -> None:
    batch = batch_of([[[1.0] * 200], [[2.0] * 200]])
    found = list(rows(run_of(200), batch, torch.tensor([[2.0], [4.0]])))
    assert [(row.tick, row.arena) for row in found] == [(100, 0), (100, 1), (200, 0), (200, 1)]
    assert [row.mean_distance for row in found] == [1.0, 2.0, 1.0, 2.0]
    assert [row.td_loss for row in found] == [1.0, 2.0, 1.0, 2.0]


def test_the_header_names_the_cells() -> None:
    assert HEADER == (
        "arena,tick,min_distance,mean_distance,max_distance,eligible_mean_distance,"
        "newborn_mean_distance,champion_distance,births,species,mean_nodes,mean_links,td_loss,epsilon\n"
    )
