"""Evolved genomes: fully connected founders, grown by the project's own mutations."""

from __future__ import annotations

import numpy as np

from neatq_torch.genome import (
    Genome,
    InnovationLedger,
    MutationConfig,
    NodeKind,
    initial_genome,
    mutate,
)

INPUTS, OUTPUTS = 20, 3
LINKS = (60, 90)

GROWTH = MutationConfig(add_node_prob=0.3, add_link_prob=0.7, recurrent_link_prob=0.0)
"""New nodes and new links in about the proportion of rtNEAT, but in nearly every mutation; no
recurrent links, as neat-python's feed-forward networks have none."""


def evolved(
    count: int,
    *,
    seed: int,
    inputs: int = INPUTS,
    outputs: int = OUTPUTS,
    links: tuple[int, int] = LINKS,
) -> list[Genome]:
    """Genomes of one run, each with a number of enabled links drawn from `links`."""
    rng = np.random.default_rng(seed)
    founder = initial_genome(inputs, outputs, rng=rng)
    ledger = InnovationLedger.for_genomes([founder])
    least, most = links
    sizes = rng.integers(max(least, founder.link_enabled.sum() + 3), most, count, endpoint=True)
    return [_grown(founder, number, size, ledger, rng) for number, size in enumerate(sizes, 1)]


def _grown(
    founder: Genome, number: int, size: int, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    links = founder.link_innovation.size
    genome = founder.replaced(
        genome_id=number, link_weight=rng.uniform(-1, 1, links).astype(np.float32)
    )
    while genome.link_enabled.sum() < size or hidden_nodes(genome) == 0:
        genome = mutate(genome, GROWTH, ledger, rng)
    return genome


def hidden_nodes(genome: Genome) -> int:
    """Number of hidden nodes."""
    return int((genome.node_kind == NodeKind.HIDDEN).sum())


def enabled_links(genomes: list[Genome]) -> int:
    """Enabled links of all genomes together."""
    return sum(int(genome.link_enabled.sum()) for genome in genomes)
