"""How far apart two genomes are: the measure behind species."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.innovation import match

SMALL_GENOME_LINKS = 20
NONE = np.iinfo(np.int64).min


@dataclass(frozen=True, kw_only=True)
class DistanceConfig:
    """Coefficients of the distance (Stanley & Miikkulainen 2002, equation 1).

    Attributes:
        disjoint: weight of a disjoint gene.
        excess: weight of an excess gene.
        weight: weight of the mean difference between the weights of matching genes.
        normalised: divide the gene counts by the size of the larger genome, unless both have
            fewer than 20 links. Off in OpenNERO and in the code of the paper's authors.
    """

    disjoint: float = 1.0
    excess: float = 1.0
    weight: float = 0.4
    normalised: bool = False

    def __post_init__(self) -> None:
        """Check every value."""
        for name in ("disjoint", "excess", "weight"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name} must be a finite number >= 0, not {value}.")


def compatibility(a: Genome, b: Genome, config: DistanceConfig) -> float:
    """Return the distance between two genomes, from the weights they have now."""
    return float(distances(a, [b], config)[0])


def distances(
    genome: Genome, others: Sequence[Genome], config: DistanceConfig
) -> NDArray[np.float64]:
    """Return the distances [others] from one genome to many, without a loop over them.

    A gene is excess if it lies beyond the last gene of the other genome, else disjoint.
    """
    if not others:
        return np.zeros(0)
    own = genome.link_innovation
    sizes = np.array([other.link_innovation.size for other in others])
    owner = np.repeat(np.arange(len(others)), sizes)
    innovation = np.concatenate([other.link_innovation for other in others])
    place, matching = match(own, innovation)
    # One more weight, for the places of a genome without links.
    own_weight = np.append(genome.link_weight, 0.0)
    gap = np.abs(own_weight[place] - np.concatenate([other.link_weight for other in others]))
    gap[np.flatnonzero(~matching)] = 0.0
    gaps = np.bincount(owner, weights=gap, minlength=len(others))

    def count(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
        return np.bincount(owner[np.flatnonzero(mask)], minlength=len(others))

    matches = sizes - count(~matching)
    beyond_own = count(innovation > (own[-1] if own.size else NONE))
    last = np.array([o.link_innovation[-1] if o.link_innovation.size else NONE for o in others])
    excess = beyond_own + own.size - np.searchsorted(own, last, side="right")
    disjoint = own.size + sizes - 2 * matches - excess
    counted = config.disjoint * disjoint + config.excess * excess
    if config.normalised:
        larger = np.maximum(sizes, own.size)
        counted = counted / np.where(larger < SMALL_GENOME_LINKS, 1, larger)
    return counted + config.weight * gaps / np.maximum(matches, 1)
