"""What a genome is and how it varies; numpy only."""

from neatq_torch.genome.crossover import (
    CrossoverConfig,
    first_is_fitter,
    multipoint,
    multipoint_average,
)
from neatq_torch.genome.distance import (
    DistanceConfig,
    LinkTable,
    compatibility,
    first_compatible,
)
from neatq_torch.genome.genome import (
    ACTIVATIONS,
    Genome,
    GenomeError,
    NodeKind,
    identical,
    load_genome,
    save_genome,
)
from neatq_torch.genome.graph import node_levels, reaches
from neatq_torch.genome.initial import initial_genome, layered_genome, random_genome
from neatq_torch.genome.innovation import InnovationLedger, LinkInnovation, Split
from neatq_torch.genome.mutation import ScalesOf, mutate, mutate_weights
from neatq_torch.genome.mutation_config import MutationConfig
from neatq_torch.genome.pack import pack_genomes, unpack_genomes
from neatq_torch.genome.structural import add_link, add_node, reenable, toggle_enable

__all__ = [
    "ACTIVATIONS",
    "CrossoverConfig",
    "DistanceConfig",
    "Genome",
    "GenomeError",
    "InnovationLedger",
    "LinkInnovation",
    "LinkTable",
    "MutationConfig",
    "NodeKind",
    "ScalesOf",
    "Split",
    "add_link",
    "add_node",
    "compatibility",
    "first_compatible",
    "first_is_fitter",
    "identical",
    "initial_genome",
    "layered_genome",
    "load_genome",
    "multipoint",
    "multipoint_average",
    "mutate",
    "mutate_weights",
    "node_levels",
    "pack_genomes",
    "random_genome",
    "reaches",
    "reenable",
    "save_genome",
    "toggle_enable",
    "unpack_genomes",
]
