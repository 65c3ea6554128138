"""How far apart two genomes are: the measure behind species."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.jit import cached_njit
from neatq_torch.kinds import check_fields

SMALL_GENOME_LINKS = 20
KNOWN_GROUPS = 16
"""For so many groups a `LinkTable` remembers how far everybody is from the first member."""

Markings = NDArray[np.int64]
Weights = NDArray[np.float32]
Slots = NDArray[np.int64]
Coefficients = tuple[float, float, float, float]


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
        check_fields(self, disjoint="[0, inf)", excess="[0, inf)", weight="[0, inf)")

    @cached_property
    def coefficients(self) -> Coefficients:
        """The four fields as compiled code takes them."""
        return float(self.disjoint), float(self.excess), float(self.weight), float(self.normalised)


def compatibility(a: Genome, b: Genome, config: DistanceConfig) -> float:
    """Return the distance between two genomes, from the weights they have now.

    A gene is excess if it lies beyond the last gene of the other genome, else disjoint.
    """
    first, second = (a.link_innovation, a.link_weight), (b.link_innovation, b.link_weight)
    return _distance(*first, *second, config.coefficients, np.inf)


def first_compatible(
    genomes: Sequence[Genome],
    representatives: Sequence[Genome],
    threshold: float,
    config: DistanceConfig,
) -> NDArray[np.int64]:
    """Sort genomes, one after the other, into the first group that each is compatible with.

    Each representative stands for a group. A genome that none is closer to than the threshold
    represents a new group, numbered behind the others. Returns int64 [genomes], their groups.
    """
    everybody = [*representatives, *genomes]
    links = np.array([genome.link_weight.size for genome in everybody])
    innovation = np.concatenate([genome.link_innovation for genome in everybody])
    weight = np.concatenate([genome.link_weight for genome in everybody])
    genes = *_frozen(innovation, weight), links.cumsum() - links, links
    leaders, order = np.split(np.arange(len(everybody)), [len(representatives)])
    group = np.concatenate([leaders, np.full(order.size, -1)])
    starts = np.arange(leaders.size + 1)
    measure, known = (
        (float(threshold), config.coefficients),
        (np.empty(0, np.int64), np.empty((0, 0))),
    )
    _regroup(order, group, leaders, starts, genes, measure, *known)
    return group[leaders.size :]


class LinkTable:
    """Markings and weights of a population as rows that compiled code can walk along.

    Attributes:
        innovation: int64 [slots, columns]; a row means nothing beyond the links it has.
        weight: float32 [slots, columns].
        links: int64 [slots], how many links each genome has.
    """

    def __init__(self) -> None:
        self.innovation = np.zeros((0, 0), dtype=np.int64)
        self.weight = np.zeros((0, 0), dtype=np.float32)
        self.links = np.zeros(0, dtype=np.int64)
        self._config: DistanceConfig | None = None
        self._leaders = np.full(KNOWN_GROUPS, -1)
        self._apart = np.zeros((KNOWN_GROUPS, 0))

    def write(self, slots: Sequence[int], genomes: Sequence[Genome]) -> None:
        """Put the links of each genome in its slot, instead of those that are there."""
        if not slots:
            return
        links = np.array([genome.link_weight.size for genome in genomes])
        wanted = max(slots) + 1, links.max()
        # Where there are too few slots or columns: a quarter more than needed.
        pairs = zip(wanted, self.innovation.shape, strict=True)
        more = [(0, want + want // 4 - had if want > had else 0) for want, had in pairs]
        if any(new for _, new in more):
            self.innovation, self.weight = np.pad(self.innovation, more), np.pad(self.weight, more)
            self.links, self._config = np.pad(self.links, more[0]), None
            self._apart = np.zeros((KNOWN_GROUPS, self.links.size))
        filled = np.arange(links.max()) < links[:, None]
        for table, name in ((self.innovation, "link_innovation"), (self.weight, "link_weight")):
            block = np.zeros(filled.shape, table.dtype)
            block[filled] = np.concatenate([getattr(genome, name) for genome in genomes])
            table[slots, : links.max()] = block
        self.links[slots], self._apart[:, slots] = links, np.nan
        self._leaders[(self._leaders[:, None] == np.asarray(slots)).any(axis=1)] = -1

    def regroup(
        self, groups: Sequence[Slots], order: Slots, threshold: float, config: DistanceConfig
    ) -> list[Slots]:
        """Move every genome, one after the other, to the first group that it is compatible with.

        It is compatible with a group whose first member (at that moment) is closer than the
        threshold; without such a group it founds one behind the others. Genomes move in the
        `order` of their slots; no group is empty before, some may be in what comes back: the same
        groups, then the new ones. Who stays keeps its rank, who comes is appended.
        """
        if config != self._config:
            self._config, self._leaders[:] = config, -1
        sizes = [members.size for members in groups]
        slots, starts = np.concatenate(groups), np.cumsum([0, *sizes])
        old = np.full(self.links.size, -1)
        old[slots] = np.repeat(np.arange(len(groups)), sizes)
        rows = np.arange(self.links.size) * self.innovation.shape[1]
        genes = *_frozen(self.innovation.ravel(), self.weight.ravel()), rows, self.links
        group, measure = old.copy(), (float(threshold), config.coefficients)
        moved = _regroup(order, group, slots, starts, genes, measure, self._leaders, self._apart)
        if not moved.size:
            return list(groups)
        slots = np.concatenate([slots[group[slots] == old[slots]], moved])
        return [slots[group[slots] == one] for one in range(max(len(groups), group.max() + 1))]


def _frozen(innovation: Markings, weight: Weights) -> tuple[Markings, Weights]:
    """The same, read-only as those of a genome, so that `_distance` is compiled only once."""
    innovation.flags.writeable = weight.flags.writeable = False
    return innovation, weight


@cached_njit(no_cfunc_wrapper=True)
def _distance(
    own: Markings,
    own_weight: Weights,
    other: Markings,
    other_weight: Weights,
    coefficients: Coefficients,
    limit: float,
) -> float:
    """The distance of two lists of links, each sorted by innovation.

    Stops with infinity as soon as the genes without a match alone are clearly beyond the limit.
    """
    disjoint, excess, weight, normalised = coefficients
    least = 0.0 if normalised else min(disjoint, excess)
    limit = 1.000001 * limit  # whatever rounding does to the sums below
    i = j = matches = 0
    gaps = 0.0
    while i < own.size and j < other.size:
        if own[i] == other[j]:
            gaps += abs(np.float64(own_weight[i]) - np.float64(other_weight[j]))
            matches += 1
            i += 1
            j += 1
        elif least * (i + j - 2 * matches) > limit:
            return np.inf
        elif own[i] < other[j]:
            i += 1
        else:
            j += 1
    beyond = own.size - i + other.size - j
    between = own.size + other.size - 2 * matches - beyond
    counted = disjoint * between + excess * beyond
    larger = max(own.size, other.size)
    if normalised and larger >= SMALL_GENOME_LINKS:
        counted = counted / larger
    return counted + weight * gaps / max(matches, 1)


@cached_njit(no_cfunc_wrapper=True)
def _regroup(
    order: Slots,
    group: Slots,
    members: Slots,
    starts: Slots,
    genes: tuple[Markings, Weights, Slots, Slots],
    measure: tuple[float, Coefficients],
    leaders: Slots,
    apart: NDArray[np.float64],
) -> Slots:
    """Give `group` [slots] its new values; return the slots that moved, in that order.

    The members of old group g are `members[starts[g] : starts[g + 1]]`; who is in none has -1.
    Genes are markings and weights, and where those of each slot begin and how many they are; the
    measure is threshold and coefficients. The first groups have in `apart` [groups, slots], where
    known, everybody's distance from the slot in `leaders` [groups]; both are kept up to date.
    """
    (threshold, coefficients), groups = measure, starts.size - 1
    innovation, weight, begin, links = genes
    leader = np.empty(groups + order.size, np.int64)
    for home in range(groups):
        leader[home] = members[starts[home]]
    moved, moves = np.empty(order.size, np.int64), 0
    for slot in order:
        at, end = begin[slot], begin[slot] + links[slot]
        own, own_weight, home = innovation[at:end], weight[at:end], 0
        while home < groups:
            first = leader[home]
            if first >= 0:
                known = home < leaders.size
                if known and leaders[home] != first:
                    leaders[home], apart[home] = first, np.nan
                far = apart[home, slot] if known else np.nan
                if np.isnan(far):
                    at, end = begin[first], begin[first] + links[first]
                    other = innovation[at:end], weight[at:end]
                    limit = np.inf if known else threshold
                    far = _distance(own, own_weight, *other, coefficients, limit)
                    if known:
                        apart[home, slot] = far
                if far < threshold:
                    break
            home += 1
        old = int(group[slot])
        if home == old:
            continue
        if home == groups:
            leader[home] = slot
            groups += 1
        group[slot], moved[moves] = home, slot
        moves += 1
        if old >= 0 and leader[old] == slot:
            # Only old groups lose members: who has moved once stays where it is.
            leader[old], size = -1, starts[old + 1] - starts[old]
            for at in range(size + moves):
                next_one = members[starts[old] + at] if at < size else moved[at - size]
                if group[next_one] == old:
                    leader[old] = next_one
                    break
    return moved[:moves]
