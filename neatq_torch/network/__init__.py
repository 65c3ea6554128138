"""Genomes as torch modules."""

from neatq_torch.network.plan import Evaluation
from neatq_torch.network.population import PopulationNetwork
from neatq_torch.network.single import GenomeNetwork

__all__ = ["Evaluation", "GenomeNetwork", "PopulationNetwork"]
