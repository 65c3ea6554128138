"""What a genome is and how it varies; numpy only."""

from neatq_torch.genome.crossover import CrossoverConfig, first_is_fitter, multipoint
from neatq_torch.genome.distance import DistanceConfig, LinkTable, compatibility, first_compatible
from neatq_torch.genome.genome import Genome, load_genome, pack_genomes, save_genome, unpack_genomes
from neatq_torch.genome.heredity import node_levels
from neatq_torch.genome.initial import initial_genome, layered_genome, random_genome
from neatq_torch.genome.innovation import InnovationLedger
from neatq_torch.genome.mutation import MutationConfig, mutate
from neatq_torch.genome.rules import ACTIVATIONS, GenomeError, NodeKind

__all__ = [
    "ACTIVATIONS",
    "CrossoverConfig",
    "DistanceConfig",
    "Genome",
    "GenomeError",
    "InnovationLedger",
    "LinkTable",
    "MutationConfig",
    "NodeKind",
    "compatibility",
    "first_compatible",
    "first_is_fitter",
    "initial_genome",
    "layered_genome",
    "load_genome",
    "multipoint",
    "mutate",
    "node_levels",
    "pack_genomes",
    "random_genome",
    "save_genome",
    "unpack_genomes",
]
