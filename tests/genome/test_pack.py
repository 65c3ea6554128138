"""Many genomes as a few arrays, and back."""

from __future__ import annotations

import numpy as np
import pytest

from neatq_torch.genome import (
    GenomeError,
    InnovationLedger,
    MutationConfig,
    initial_genome,
    mutate,
    pack_genomes,
    unpack_genomes,
)


def test_packed_genomes_come_back_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    genomes = [initial_genome(3, 2, rng=rng, genome_id=i, observation_schema="s") for i in range(5)]
    ledger = InnovationLedger.for_genomes(genomes)
    growth = MutationConfig(add_node_prob=0.5, toggle_enable_prob=0.5)
    for index, genome in enumerate(genomes):
        for _ in range(3 * index):
            genome = mutate(genome, growth, ledger, rng)
        genomes[index] = genome
    again = unpack_genomes(pack_genomes(genomes))
    assert all(a.to_json() == b.to_json() for a, b in zip(genomes, again, strict=True))


def test_a_packed_genome_is_checked_again() -> None:
    packed = pack_genomes([initial_genome(2, 1, rng=np.random.default_rng(0))])
    packed["link_target"] = packed["link_target"] + 90
    with pytest.raises(GenomeError, match="target"):
        unpack_genomes(packed)
