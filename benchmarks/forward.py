"""One forward pass of every network of a population, without gradients.

Networks of 60 to 90 enabled links (20 inputs, 3 outputs, fully connected, then grown by this
project's mutations), float32, one observation each, CPU time for each network. neat-python and
MultiNEAT evaluate the same topologies with the same weights, one after the other, from Python;
MultiNEAT propagates each network as often as it is deep. "compiled loop" is the limit: the same
sums in a loop compiled by numba over arrays that lie ready, which can do nothing else. The row ends
with an error unless all outputs agree to 1e-4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from benchmarks import neat_python
from benchmarks.compiled import compiled
from benchmarks.genomes import INPUTS, evolved
from benchmarks.measure import interleaved
from benchmarks.result import Line, compare, cost_at_most, times_at_most
from neatq_torch.genome import Genome
from neatq_torch.network import PopulationNetwork

try:
    from benchmarks import multi_neat
except ImportError:  # no wheel for this Python
    multi_neat = None

GOALS = {
    "compiled loop": times_at_most(3),
    "neat-python": times_at_most(0.1),
    "MultiNEAT": times_at_most(1),
}
TENSORNEAT_US = (4, 6)

Forward = Callable[[], Any]


def run(quick: bool) -> list[Line]:
    """Measure 50, 500 and 5,000 networks."""
    sizes, rounds = ((50, 500), 3) if quick else ((50, 500, 5000), 7)
    return [line for size in sizes for line in _lines(size, rounds)]


def _lines(size: int, rounds: int) -> list[Line]:
    forwards = _forwards(evolved(size, seed=size))
    _check_agreement({name: _as_array(forward()) for name, forward in forwards.items()})
    samples = interleaved(forwards, rounds=rounds)
    micros = {name: seconds / size * 1e6 for name, seconds in samples.items()}
    ours = micros.pop("ours")
    what = f"{size:,} networks, each"
    lines = [
        compare(what, ours, name, theirs, unit="us", goal=GOALS[name])
        for name, theirs in micros.items()
    ]
    return [*lines, _beside_tensorneat(what, ours)]


def _forwards(genomes: list[Genome]) -> dict[str, Forward]:
    rows = np.random.default_rng(1).random((len(genomes), INPUTS), dtype=np.float32)
    network = PopulationNetwork(genomes)
    observation = torch.from_numpy(rows)

    def ours() -> Any:
        with torch.no_grad():
            return network(observation)

    config = neat_python.configuration()
    theirs = [neat_python.network(genome, config) for genome in genomes]
    lists = rows.tolist()
    forwards: dict[str, Forward] = {"ours": ours}
    loop = compiled(genomes)
    if loop is not None:
        forwards["compiled loop"] = lambda: loop(rows)
    forwards["neat-python"] = lambda: [
        one.activate(inputs) for one, inputs in zip(theirs, lists, strict=True)
    ]
    if multi_neat is not None:
        others = [multi_neat.Network(genome) for genome in genomes]
        biased = [[*inputs, 1.0] for inputs in lists]
        forwards["MultiNEAT"] = lambda: [
            one.activate(inputs) for one, inputs in zip(others, biased, strict=True)
        ]
    return forwards


def _as_array(outputs: Any) -> np.ndarray:
    if isinstance(outputs, torch.Tensor | np.ndarray):
        return np.asarray(outputs)
    return np.array([list(row) for row in outputs])


def _check_agreement(outputs: dict[str, np.ndarray]) -> None:
    """Raise unless all computed the same: else their times cannot be compared."""
    for name, values in outputs.items():
        if not np.allclose(values, outputs["ours"], atol=1e-4):
            raise AssertionError(f"{name} computes something else than this project's networks")


def _beside_tensorneat(what: str, ours: np.ndarray) -> Line:
    low, high = TENSORNEAT_US
    return compare(
        what,
        ours,
        f"TensorNEAT: {low} to {high} us",
        unit="us",
        goal=cost_at_most(low / 5, "at least 5 times cheaper"),
        note="TensorNEAT is not on the package index. Its figure was measured on another machine "
        "(JAX on CPU, exact sizes, 2 outputs), so this line compares machines, too.",
    )
