"""Many genomes as a few arrays, for checkpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.validation import LINK_FIELDS, NODE_FIELDS


def pack_genomes(genomes: Sequence[Genome]) -> dict[str, Any]:
    """Return genomes as concatenated columns.

    Returns:
        `genome_id` int64 [genomes], `observation_schema` (one text each), `nodes` and `links`
        int64 [genomes] (how many genes each has), and every gene field over all genomes.
    """
    columns = {
        name: np.concatenate([getattr(genome, name) for genome in genomes])
        for name in (*NODE_FIELDS, *LINK_FIELDS)
    }
    return {
        "genome_id": np.array([genome.genome_id for genome in genomes], np.int64),
        "observation_schema": [genome.observation_schema for genome in genomes],
        "nodes": np.array([genome.node_id.size for genome in genomes], np.int64),
        "links": np.array([genome.link_weight.size for genome in genomes], np.int64),
        **columns,
    }


def unpack_genomes(packed: Mapping[str, Any]) -> list[Genome]:
    """Return the genomes that `pack_genomes` was given, bit for bit; each is checked again."""
    columns = {
        name: np.split(packed[name], np.cumsum(packed[counts])[:-1])
        for counts, names in (("nodes", NODE_FIELDS), ("links", LINK_FIELDS))
        for name in names
    }
    return [
        Genome(
            genome_id=int(genome_id),
            observation_schema=packed["observation_schema"][index],
            **{name: parts[index] for name, parts in columns.items()},
        )
        for index, genome_id in enumerate(packed["genome_id"])
    ]
