"""Genomes as torch modules."""

from neatq_torch.network.plan import Evaluation, check_evaluation
from neatq_torch.network.population import GenomeNetwork, PopulationNetwork, fitted

__all__ = ["Evaluation", "GenomeNetwork", "PopulationNetwork", "check_evaluation", "fitted"]
