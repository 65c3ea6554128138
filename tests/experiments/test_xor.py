"""NEAT solves XOR, and says truly what it took."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neatq_experiments.seeds import SeedTask
from neatq_experiments.xor import XOR, judge_xor, run_xor, solve_xor, xor_table
from neatq_torch.evolution import NEATConfig
from neatq_torch.genome import initial_genome


def test_fitness_is_the_square_of_4_minus_the_errors() -> None:
    genome = initial_genome(2, 1, rng=np.random.default_rng(0), activation="identity")
    # Weights of both inputs and of the bias: the outputs are 0.25, 0.5, 0.5 and 0.75.
    sloped = genome.with_weights([0.25, 0.25, 0.25])
    # All outputs are 0.75.
    level = genome.with_weights([0.0, 0.0, 0.75])
    fitness, right = judge_xor([sloped, level])
    assert fitness.tolist() == [
        (4 - 0.25 - 0.5 - 0.5 - 0.75) ** 2,
        (4 - 0.75 - 0.25 * 2 - 0.75) ** 2,
    ]
    assert right.tolist() == [False, False]


def test_xor_is_solved_with_a_hidden_node_and_the_same_seed_gives_the_same_run() -> None:
    first = solve_xor(NEATConfig(), 2)
    assert first["solved"] and first["hidden"] >= 1 and first["links"] >= 5
    assert 150 * (first["generations"] - 1) < first["evaluations"] <= 150 * first["generations"]
    assert solve_xor(NEATConfig(), 2) == first


def test_a_run_without_a_solution_has_failed() -> None:
    assert solve_xor(NEATConfig(), 0, generations=1) == {
        "solved": False,
        "evaluations": None,
        "generations": None,
        "hidden": None,
        "links": None,
    }


def test_the_table_counts_failures_and_means_only_what_was_solved() -> None:
    failed = solve_xor(NEATConfig(), 0, generations=1)
    won = {"solved": True, "generations": 20, "hidden": 2, "links": 7}
    results = [won | {"evaluations": 3000}, failed, won | {"evaluations": 5000}]
    line = xor_table({"neat": results}).splitlines()[2]
    assert line.startswith("| ours | 3 | 1 | 4,000 ± 1,000 | 5,000 | 20.0 ± 0.0 | 2.00 ± 0.00 |")


def test_a_task_runs_its_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("neatq_experiments.xor.XOR_GENERATIONS", 1)
    results = run_xor(SeedTask("neat", (0, 1), True, tmp_path))
    assert len(results) == 2
    assert XOR.arms == ("neat",) and XOR.seeds == 100
