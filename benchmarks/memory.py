"""What networks and learner keep in memory.

Growth of the resident set by networks, plans and a learner with its moments, after one forward
pass, and the bytes of their tensors alone, each in a fresh process; genomes do not count. The last
line compares networks of about twice the links: linear growth has the ratio of the links.

`python -m benchmarks memory --ticks 1000000 --save` measures another thing and takes long:
the resident set of `neatq train` (1 arena, arm `replay`), sampled twenty times, as a slope over the
second half of the run. Networks grow while they evolve, so some growth is not a leak. What counts
as flat was written down after the first such run.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.genomes import INPUTS, LINKS, OUTPUTS, enabled_links, evolved
from benchmarks.measure import in_fresh_process, resident_bytes
from benchmarks.result import Goal, Line, compare, cost_at_most
from neatq_torch.genome import Genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    TDConfig,
    TDLearner,
)
from neatq_torch.network import PopulationNetwork

ROBOTS = 20 * 50
SAMPLES = 20

Footprint = tuple[int, int, int]
"""Bytes of tensors, growth of the resident set, links."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Networks of one size."""

    inputs: int = INPUTS
    outputs: int = OUTPUTS
    candidates: int = 1
    links: tuple[int, int] = LINKS


SMALL = Kind()
LARGE = Kind(links=(2 * LINKS[0], 2 * LINKS[1]))
ARM = Kind(inputs=12, outputs=15, candidates=5, links=(200, 230))
"""The arm replay; its genomes have 195 links at the start."""


def run(quick: bool) -> list[Line]:
    """Measure both populations, and one with twice the links."""
    many, some, rounds = (1000, 500, 1) if quick else (5000, 1000, 3)

    def found(kind: Kind, networks: int) -> list[Footprint]:
        return [in_fresh_process(footprint, kind, networks) for _ in range(rounds)]

    arm, small, large = found(ARM, ROBOTS), found(SMALL, some), found(LARGE, some)
    crowd = [in_fresh_process(footprint, SMALL, many)]
    return [
        *_lines("20 x 50 networks of the arm replay, moments of Adam", arm, ROBOTS),
        *_lines(f"{many:,} networks of {LINKS[0]} to {LINKS[1]} links", crowd, many),
        _linearity(some, small, large),
    ]


def _lines(what: str, found: list[Footprint], networks: int) -> list[Line]:
    tensors, resident, links = np.array(found, float).T
    return [
        compare(
            f"{what}: a {name}",
            resident / count,
            "its tensors alone",
            tensors / count,
            unit="bytes",
        )
        for name, count in (("network", networks), ("link", links))
    ]


def _linearity(networks: int, small: list[Footprint], large: list[Footprint]) -> Line:
    one, two = np.array(small, float), np.array(large, float)
    more = (two[:, 2] / one[:, 2]).mean()
    return compare(
        f"a network of {more:.2f} times the links",
        two[:, 1] / networks,
        f"one of {LINKS[0]} to {LINKS[1]} links",
        one[:, 1] / networks,
        unit="bytes",
        goal=Goal(text="linear in links, within a tenth", limit=1.1 * more, of="ratio"),
    )


def footprint(kind: Kind, networks: int) -> Footprint:
    """What so many networks take; to be called in a fresh process."""
    genomes = evolved(networks, seed=5, inputs=kind.inputs, outputs=kind.outputs, links=kind.links)
    warm = _used(genomes[:2], kind.candidates)  # what is loaded or compiled once does not count
    gc.collect()
    before = resident_bytes(os.getpid()), _tensor_bytes()
    kept = _used(genomes, kind.candidates)
    gc.collect()
    after = resident_bytes(os.getpid()), _tensor_bytes()
    del kept, warm
    return after[1] - before[1], after[0] - before[0], enabled_links(genomes)


def _used(genomes: list[Genome], candidates: int) -> TDLearner:
    """Networks that have been evaluated once, and their learner."""
    network = PopulationNetwork(genomes)
    actions = network.outputs // candidates - (candidates > 1)
    heads = CandidateHeads(candidates, [0.0] * actions, [1.0] * actions)
    loss = CandidateTDLoss(CandidateValue(network, heads))
    learner = TDLearner(network, loss, TDConfig(optimizer="adam"))
    with torch.no_grad():
        network(torch.zeros(len(genomes), network.inputs))
    return learner


def _tensor_bytes() -> int:
    tensors = [one for one in gc.get_objects() if issubclass(type(one), torch.Tensor)]
    storages = {one.untyped_storage().data_ptr(): one.untyped_storage() for one in tensors}
    return sum(storage.nbytes() for storage in storages.values())


def run_long(ticks: int) -> list[Line]:
    """The resident set of a run of so many ticks."""
    with tempfile.TemporaryDirectory() as folder:
        samples = _watch(Path(folder) / "run", ticks)
    return [growth(f"{ticks:,} ticks of 1 x 50 robots", samples, ticks, "ticks")]


def growth(what: str, samples: np.ndarray, length: int, unit: str) -> Line:
    """What a process grows by in a thousand of the second half of a run.

    Args:
        what: Is measured.
        samples: How far the run was, and resident bytes [samples, 2].
        length: Of the run.
        unit: Of its length.
    """
    half = samples[samples[:, 0] >= length / 2]
    slope = np.polyfit(half[:, 0] / 1000, half[:, 1], 1)[0]
    course = ", ".join(f"{size / 2**20:.0f}" for _, size in samples)
    return compare(
        f"{what}: growth in 1,000 {unit} of the second half",
        np.array([slope]),
        unit="bytes",
        goal=cost_at_most(0.01 * half[0, 1] / (length / 2000), "flat: 1 % in that half"),
        note=f"MiB, every {length // SAMPLES:,} {unit}: {course}.",
    )


def _watch(out: Path, ticks: int) -> np.ndarray:
    """Tick and resident bytes [samples, 2] of `neatq train`."""
    code = "import sys; from neatq_trainers.cli import main; sys.exit(main(sys.argv[1:]))"
    arguments = ["train", "--ticks", str(ticks), "--out", str(out)]
    samples: list[tuple[int, int]] = []
    command = [sys.executable, "-c", code, *arguments]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while process.poll() is None:
            time.sleep(0.1)
            tick = _last_tick(out / "metrics.csv")
            due = (len(samples) + 1) * (ticks // SAMPLES)
            if due <= tick < ticks:  # at the end it draws pictures
                samples.append((tick, resident_bytes(process.pid)))
    if process.returncode:
        raise RuntimeError(f"neatq train ended with status {process.returncode}")
    return np.array(samples)


def _last_tick(metrics: Path) -> int:
    """The last tick of which all is written in metrics.csv."""
    if not metrics.exists():
        return 0
    with metrics.open("rb") as file:
        file.seek(max(0, metrics.stat().st_size - 4096))
        lines = file.read().split(b"\n")
    cells = lines[-2].split(b",") if len(lines) > 1 else []
    return int(cells[1]) if len(cells) > 1 and cells[1].isdigit() else 0
