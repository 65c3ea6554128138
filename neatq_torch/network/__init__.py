"""Genomes as torch modules."""

from neatq_torch.network.plan import Evaluation
from neatq_torch.network.population import GenomeNetwork, PopulationNetwork

__all__ = ["Evaluation", "GenomeNetwork", "PopulationNetwork"]
