"""Genomes as torch modules."""

from neatq_torch.network.plan import Evaluation
from neatq_torch.network.population import PopulationNetwork
from neatq_torch.network.sensitivity import perturbation_scales, sensitivity
from neatq_torch.network.single import GenomeNetwork

__all__ = [
    "Evaluation",
    "GenomeNetwork",
    "PopulationNetwork",
    "perturbation_scales",
    "sensitivity",
]
