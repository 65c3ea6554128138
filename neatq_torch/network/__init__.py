"""Genomes as torch modules."""

from neatq_torch.network.plan import Evaluation
from neatq_torch.network.population import GenomeNetwork, PopulationNetwork, fitted

__all__ = ["Evaluation", "GenomeNetwork", "PopulationNetwork", "fitted"]
