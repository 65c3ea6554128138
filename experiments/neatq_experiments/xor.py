"""XOR, as in Stanley & Miikkulainen 2002, section 4.1: does NEAT grow the hidden node it takes?

150 genomes without hidden nodes are evolved until one of them is on the right side of 0.5 for all
four inputs. Fitness is (4 - sum of the four errors)^2. Everything else is `NEATConfig()`.

Networks are evaluated in double precision, as the authors' program does it: where three of four
outputs are right and saturated, single precision rounds the fitness to exactly 9, and species that
still improve look as if they stagnated.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from neatq_experiments.experiment import Experiment, column, mean_and_error
from neatq_experiments.seeds import Result, Results, SeedTask
from neatq_torch.evolution import NEAT, NEATConfig
from neatq_torch.genome import Genome, NodeKind
from neatq_torch.network import PopulationNetwork

XOR_SLOTS = 150
XOR_GENERATIONS = 400
INPUTS = torch.tensor([[0, 0], [0, 1], [1, 0], [1, 1]], dtype=torch.float64)
TARGETS = torch.tensor([0, 1, 1, 0], dtype=torch.float64)


def run_xor(task: SeedTask) -> list[Result]:
    """Evolve once for each seed."""
    return [solve_xor(NEATConfig(), seed, generations=XOR_GENERATIONS) for seed in task.seeds]


def solve_xor(config: NEATConfig, seed: int, *, generations: int = XOR_GENERATIONS) -> Result:
    """Evolve XOR and say what it took.

    Evaluations count every genome from the founders to the first solution, which counts, too.
    """
    rng = np.random.default_rng(seed)
    population = NEAT.start(config, slots=XOR_SLOTS, inputs=2, outputs=1, rng=rng)
    for generation in range(generations):
        fitness, right = judge_xor(population.genomes)
        if right.any():
            slot = int(right.argmax())
            solution = population.genomes[slot]
            return {
                "solved": True,
                "evaluations": generation * XOR_SLOTS + slot + 1,
                "generations": generation + 1,
                "hidden": int((solution.node_kind == NodeKind.HIDDEN).sum()),
                "links": int(solution.link_enabled.sum()),
            }
        population.tell(fitness)
    names = ("evaluations", "generations", "hidden", "links")
    return {"solved": False} | dict.fromkeys(names)


def judge_xor(genomes: list[Genome]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return fitness and whether all four outputs are on the right side, both [genomes]."""
    outputs = answers(genomes)
    errors = (outputs - TARGETS).abs().sum(-1)
    right = ((outputs >= 0.5) == (TARGETS >= 0.5)).all(-1)
    return ((4.0 - errors) ** 2).numpy(), right.numpy()


@torch.no_grad()
def answers(genomes: list[Genome]) -> Tensor:
    """Return the outputs of all genomes for the four inputs, float64 [genomes, 4]."""
    network = PopulationNetwork(genomes).double()
    return network(INPUTS.expand(len(genomes), 4, 2))[..., 0]


def xor_table(results: Results) -> str:
    """Ours beside the paper's figures, as Markdown."""
    runs = results["neat"]
    ours = [mean_and_error(column(runs, "evaluations"), 0)]
    ours += [
        mean_and_error(column(runs, name), digits)
        for name, digits in (("generations", 1), ("hidden", 2), ("links", 2))
    ]
    failures = sum(not run["solved"] for run in runs)
    worst = column(runs, "evaluations").max(initial=0.0)
    return (
        "| XOR | runs | failures | evaluations | worst | generations | hidden nodes | links |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |\n"
        f"| ours | {len(runs)} | {failures} | {ours[0]} | {worst:,.0f} | "
        f"{' | '.join(ours[1:])} |\n"
        "| paper | 100 | 0 | 4,755 ± 255 | 13,459 | 32 | 2.35 ± 0.11 | 7.48 |\n"
        "| its program, run again | 100 | 0 | 5,234 and 5,549 | | | | |\n"
    )


XOR = Experiment(
    name="xor",
    summary="NEAT on XOR: evaluations until it is solved (Stanley & Miikkulainen 2002).",
    arms=("neat",),
    seeds=100,
    quick_seeds=10,
    batch=10,
    run=run_xor,
    table=xor_table,
)
