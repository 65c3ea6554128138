"""Social learning: who is in whose group, what is inherited, and what a run tells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_experiments import foraging
from neatq_experiments.foraging import (
    COMPLEX,
    FORAGING,
    PUBLISHED_COMPLEX,
    PUBLISHED_SIMPLE,
    SIMPLE,
    SOCIETIES,
    Society,
    best_over,
    forage,
    in_blocks,
    raise_all,
    run_foraging,
    sow,
    subcultures,
)
from neatq_experiments.seeds import SeedTask
from neatq_torch.evolution import NEAT

SHORT = COMPLEX._replace(generations=3)


@pytest.fixture(autouse=True)
def short_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foraging, "LIFE_STEPS", 100)


def founders(agents: int = 100) -> NEAT:
    return NEAT.start(SOCIETIES["esl"].evolution, slots=agents, inputs=41, outputs=2, rng=0)


def weights(population: NEAT) -> list[list[float]]:
    return [genome.link_weight.tolist() for genome in population.genomes]


def test_subcultures_are_ten_of_ten_drawn_anew() -> None:
    population, rng = founders(), np.random.default_rng(0)
    first, second = (subcultures(SOCIETIES["esl"], population, rng) for _ in range(2))
    # A group of each agent: groups share nobody.
    assert np.bincount(first).tolist() == np.bincount(second).tolist() == [10] * 10
    assert (first == second).mean() < 0.5


def test_other_groups_are_all_or_the_species() -> None:
    population, rng = founders(), np.random.default_rng(0)
    for _ in range(3):
        population.tell(np.arange(100.0))
    assert not subcultures(SOCIETIES["esl-one-culture"], population, rng).any()
    group = subcultures(SOCIETIES["esl-species"], population, rng)
    for number, species in enumerate(population.species):
        assert np.flatnonzero(group == number).tolist() == sorted(species.members.tolist())


@pytest.mark.parametrize(("world", "plants", "sum_"), [(COMPLEX, 100, 0.0), (SIMPLE, 100, 1e4)])
def test_plants_are_scattered_over_the_whole_world(
    world: foraging.Terrain, plants: int, sum_: float
) -> None:
    rng = np.random.default_rng(0)
    meadow, other = sow(world, rng), sow(world, rng)
    assert len(meadow.x) == plants and meadow.worth[meadow.kind].sum() == sum_
    for axis in (meadow.x, meadow.y):
        assert 0 <= axis.min() < 0.1 * world.size and 0.9 * world.size < axis.max() < world.size
    assert (meadow.x != other.x).all()


def lived(society: Society) -> tuple[NEAT, list[list[float]], np.ndarray]:
    """Founders after a life, their weights before, and who had lessons."""
    population, rng = founders(), np.random.default_rng(0)
    before = weights(population)
    group = subcultures(society, population, rng)
    _, lessons = raise_all(population, society, sow(COMPLEX, rng), group)
    return population, before, lessons > 0


def test_what_was_learnt_is_inherited_unless_the_society_is_darwinian() -> None:
    population, before, pupils = lived(SOCIETIES["esl"])
    assert pupils.sum() > 10
    changed = [new != old for new, old in zip(weights(population), before, strict=True)]
    assert changed == pupils.tolist()
    population, before, pupils = lived(SOCIETIES["esl-darwinian"])
    assert pupils.any() and weights(population) == before


def test_the_same_seed_gives_the_same_run() -> None:
    society = SOCIETIES["esl"]
    assert forage(SHORT, society, 1) == forage(SHORT, society, 1) != forage(SHORT, society, 2)


def test_arms_share_founders_layouts_and_groups() -> None:
    esl, darwinian, alone = (
        forage(SHORT, SOCIETIES[arm], 0) for arm in ("esl", "esl-darwinian", "neat")
    )
    assert esl["mean"][0] == darwinian["mean"][0] != alone["mean"][0]
    assert esl["mean"][1] != darwinian["mean"][1]
    assert alone["lessons"] == [0.0] * 3


@pytest.mark.parametrize("experiment", FORAGING, ids=lambda one: one.name)
def test_every_arm_runs(experiment: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foraging, "QUICK_FORAGING_GENERATIONS", 2)
    results = {arm: experiment.run(SeedTask(arm, (0,), True, tmp_path)) for arm in experiment.arms}
    for arm, (one,) in results.items():
        assert len(one["best"]) == len(one["mean"]) == len(one["lessons"]) == 2, arm
        assert one["best"][0] >= one["mean"][0]
    table = experiment.table(results)
    assert all(f"| {arm} | 1 |" in table for arm in experiment.arms)
    assert experiment.figure is not None
    (axes,) = experiment.figure(results).axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == list(experiment.arms)


def test_the_table_has_ours_above_the_published_ones() -> None:
    runs = [{"best": [level, *[100.0] * 9, 2 * level]} for level in (800.0, 1_000.0)]
    lines = FORAGING[0].table({"neat": runs, "esl": []}).splitlines()
    names = "".join(f" generation {one} |" for one in COMPLEX.shown)
    assert lines[0] == f"| arm | runs |{names} 1 to 20 | last 20 |"
    # (900 + 1,600) / 10 and (900 + 2,000) / 10; (800 + 900 + 1,600) / 11 and 3,900 / 11.
    tail = "|  |  |  | 270 ± 20 | 327 ± 27 |"
    assert lines[2] == f"| neat | 2 | 900 ± 100 | 1,800 ± 200 {tail}"
    assert lines[3] == "| neat, published | 30 | 910 | 1,713 | 2,120 |  | 2,000 |  |  |"
    assert len(lines) == 4
    assert best_over(runs, slice(11, 12)) == ""


def test_curves_are_drawn_in_blocks_of_whole_generations() -> None:
    generations, curves = in_blocks(np.arange(201.0)[None])
    # The mean of a block of consecutive numbers is its middle.
    assert curves[0] == pytest.approx(generations)
    assert generations[:10].tolist() == list(range(10)) and len(generations) < 30
    assert 170 < generations[-1] < 200
    assert in_blocks(np.ones((2, 3)))[1].tolist() == [[1.0] * 3] * 2


def test_published_figures_are_of_arms_and_shown() -> None:
    known = ((COMPLEX, PUBLISHED_COMPLEX), (SIMPLE, PUBLISHED_SIMPLE))
    for (terrain, published), experiment in zip(known, FORAGING, strict=True):
        assert published.keys() <= set(experiment.arms)
        assert all(points.keys() <= set(terrain.shown) for points in published.values())


def test_a_whole_task_has_all_generations(tmp_path: Path) -> None:
    (one, two) = run_foraging(SHORT, SeedTask("neat", (0, 1), False, tmp_path))
    assert len(one["best"]) == 3 and one != two


def test_every_society_is_in_an_experiment() -> None:
    assert {arm for one in FORAGING for arm in one.arms} == set(SOCIETIES)
