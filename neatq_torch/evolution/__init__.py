"""Who lives and who breeds; numpy only."""

from neatq_torch.evolution.eligibility import interval_ticks, intervals_until
from neatq_torch.evolution.neat import NEAT, NEATConfig
from neatq_torch.evolution.novelty import Novelty
from neatq_torch.evolution.reproduction import (
    AS_WRITTEN,
    NEAT_2002,
    OPENNERO,
    Parent,
    ReproductionConfig,
    offspring,
)
from neatq_torch.evolution.rtneat import Replacement, RtNEAT, RtNEATConfig
from neatq_torch.evolution.selection import choose_parents, roulette
from neatq_torch.evolution.species import Speciation, Species, SpeciesConfig
from neatq_torch.evolution.trials import Trials, relative_fitness, z_scores

__all__ = [
    "AS_WRITTEN",
    "NEAT",
    "NEAT_2002",
    "OPENNERO",
    "NEATConfig",
    "Novelty",
    "Parent",
    "Replacement",
    "ReproductionConfig",
    "RtNEAT",
    "RtNEATConfig",
    "Speciation",
    "Species",
    "SpeciesConfig",
    "Trials",
    "choose_parents",
    "interval_ticks",
    "intervals_until",
    "offspring",
    "relative_fitness",
    "roulette",
    "z_scores",
]
