"""Networks and their learning on a GPU, beside the compiled code on one core of the same machine.

"forward": one pass of evolved networks, as in the row forward, without gradients, for 1 and for 64
observations each. "update": forward, TD error, backward and Adam (`CandidateTDLoss`, `TDLearner`)
for a batch of 40 ticks; 12 inputs, 5 candidates of 2 actions. Wall time, until the GPU is done.
Nothing is copied between host and GPU in between: worlds that live on the CPU would have to.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from tensordict import TensorDict

from benchmarks.genomes import INPUTS, evolved
from benchmarks.measure import interleaved
from benchmarks.result import Line, compare
from neatq_torch.genome import Genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    TDConfig,
    TDLearner,
)
from neatq_torch.network import PopulationNetwork

SENSORS, CANDIDATES, TICKS = 12, 5, 40


def run(quick: bool) -> list[Line]:
    """Measure populations of 50, 500 and 5,000."""
    if not torch.cuda.is_available():
        raise RuntimeError("the row gpu needs a CUDA device, and torch sees none")
    sizes, rounds = ((50, 500), 3) if quick else ((50, 500, 5000), 7)
    return [line for size in sizes for line in _lines(size, rounds)]


def _lines(size: int, rounds: int) -> list[Line]:
    genomes = evolved(size, seed=size)
    heads = CandidateHeads(CANDIDATES, [-1.0] * 2, [1.0] * 2)
    learning = evolved(size, seed=size, inputs=SENSORS, outputs=heads.outputs, links=(200, 230))
    works = {
        "forward, 1 observation": lambda device: _forward(genomes, 1, device),
        "forward, 64 observations": lambda device: _forward(genomes, 64, device),
        "update": lambda device: _update(learning, heads, device),
    }
    lines = []
    for name, work in works.items():
        samples = interleaved(
            {"cuda": work("cuda"), "cpu": work("cpu")}, rounds=rounds, clock=time.perf_counter
        )
        micros = {device: seconds / size * 1e6 for device, seconds in samples.items()}
        what = f"{name}, {size:,} networks, each"
        lines.append(compare(what, micros["cuda"], "one core", micros["cpu"], unit="us"))
    return lines


def _forward(genomes: list[Genome], batch: int, device: str) -> Callable[[], None]:
    network = PopulationNetwork(genomes).to(device)
    observation = torch.rand(len(genomes), batch, INPUTS, device=device)

    @torch.no_grad()
    def work() -> None:
        network(observation)
        _wait(device)

    return work


def _update(genomes: list[Genome], heads: CandidateHeads, device: str) -> Callable[[], None]:
    network = PopulationNetwork(genomes).to(device)
    loss = CandidateTDLoss(CandidateValue(network, heads)).to(device)
    loss.make_value_estimator(gamma=0.9)
    learner = TDLearner(network, loss, TDConfig(learning_rate=0.01, optimizer="adam"))
    shape = (len(genomes), TICKS)
    never = torch.zeros(*shape, 1, dtype=torch.bool, device=device)
    batch = TensorDict(
        {
            "observation": torch.rand(*shape, SENSORS, device=device),
            "candidate_index": torch.randint(CANDIDATES, shape, device=device),
            "genome_id": network.genome_id[:, None, None].expand(*shape, 1),
            "next": {
                "observation": torch.rand(*shape, SENSORS, device=device),
                "reward": torch.rand(*shape, 1, device=device),
                "done": never,
                "terminated": never,
            },
        },
        shape,
    )

    def work() -> None:
        learner.update(batch.clone(False))
        _wait(device)

    return work


def _wait(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()
