"""Who lives and who breeds; numpy only."""

from neatq_torch.evolution.neat import NEAT, NEATConfig
from neatq_torch.evolution.population import (
    FixedConfig,
    FixedPopulation,
    LayeredFounders,
    Population,
    Replacement,
    generator_from,
    population_kinds,
    register_population,
)
from neatq_torch.evolution.reproduction import NEAT_2002, OPENNERO, ReproductionConfig
from neatq_torch.evolution.rtneat import RtNEAT, RtNEATConfig, interval_ticks
from neatq_torch.evolution.species import Species, SpeciesConfig

register_population("rtneat", RtNEATConfig, RtNEAT)
register_population("neat", NEATConfig, NEAT)
register_population("fixed", FixedConfig, FixedPopulation)

__all__ = [
    "NEAT",
    "NEAT_2002",
    "OPENNERO",
    "FixedConfig",
    "FixedPopulation",
    "LayeredFounders",
    "NEATConfig",
    "Population",
    "Replacement",
    "ReproductionConfig",
    "RtNEAT",
    "RtNEATConfig",
    "Species",
    "SpeciesConfig",
    "generator_from",
    "interval_ticks",
    "population_kinds",
    "register_population",
]
