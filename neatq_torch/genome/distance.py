"""How far apart two genomes are: the measure behind species."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome

SMALL_GENOME_LINKS = 20

Innovations = NDArray[np.int64]
Weights = NDArray[np.float32]
Rows = NDArray[np.int64]
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
        """Check every value."""
        for name in ("disjoint", "excess", "weight"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name} must be a finite number >= 0, not {value}.")

    @cached_property
    def coefficients(self) -> Coefficients:
        """The four fields as compiled code takes them."""
        return float(self.disjoint), float(self.excess), float(self.weight), float(self.normalised)


def compatibility(a: Genome, b: Genome, config: DistanceConfig) -> float:
    """Return the distance between two genomes, from the weights they have now.

    A gene is excess if it lies beyond the last gene of the other genome, else disjoint.
    """
    return _distance(
        a.link_innovation,
        a.link_weight,
        b.link_innovation,
        b.link_weight,
        config.coefficients,
        np.inf,
    )


def first_compatible(
    genomes: Sequence[Genome],
    representatives: Sequence[Genome],
    threshold: float,
    config: DistanceConfig,
) -> NDArray[np.int64]:
    """Sort genomes, one after the other, into the first group that each is compatible with.

    Args:
        genomes: those to sort, in this order.
        representatives: one for each group that exists.
        threshold: distance from which genomes are not compatible.
        config: how distances are measured.

    Returns:
        Group of each genome, int64 [genomes]. A genome that no representative is closer to than the
        threshold represents a new group, numbered behind the others.
    """
    everybody = [*representatives, *genomes]
    starts = np.cumsum([0, *(genome.link_weight.size for genome in everybody)])
    innovation = np.concatenate([genome.link_innovation for genome in everybody])
    weight = np.concatenate([genome.link_weight for genome in everybody])
    groups = len(representatives)
    return _sorted(innovation, weight, starts, groups, float(threshold), config.coefficients)


class LinkTable:
    """Innovations and weights of a population as rows that compiled code can walk along.

    Attributes:
        innovation: int64 [genomes, columns]; a row means nothing beyond the links it has.
        weight: float32 [genomes, columns].
        links: int64 [genomes], how many links each genome has.
    """

    def __init__(self) -> None:
        """Start without genomes."""
        self.innovation = np.zeros((0, 0), dtype=np.int64)
        self.weight = np.zeros((0, 0), dtype=np.float32)
        self.links = np.zeros(0, dtype=np.int64)

    def write(self, rows: Sequence[int], genomes: Sequence[Genome]) -> None:
        """Make the links of each genome a row, instead of those that are there."""
        if not rows:
            return
        links = np.array([genome.link_weight.size for genome in genomes])
        self._make_room(max(rows) + 1, links.max())
        filled = np.arange(links.max()) < links[:, None]
        for table, name in ((self.innovation, "link_innovation"), (self.weight, "link_weight")):
            block = np.zeros(filled.shape, table.dtype)
            block[filled] = np.concatenate([getattr(genome, name) for genome in genomes])
            table[rows, : links.max()] = block
        self.links[rows] = links

    def regroup(
        self,
        groups: Sequence[Rows],
        order: Rows,
        threshold: float,
        config: DistanceConfig,
    ) -> list[Rows]:
        """Move every genome, one after the other, to the first group that it is compatible with.

        It is compatible with a group whose first member (at that moment) is closer than the
        threshold; without such a group it founds one behind the others.

        Args:
            groups: rows of the members of each group, none of them empty.
            order: rows in the order in which they move.
            threshold: distance from which genomes are not compatible.
            config: how distances are measured.

        Returns:
            The same groups, which may be empty now, and the new ones. Who stays keeps its place,
            who comes is appended.
        """
        sizes = [members.size for members in groups]
        rows = np.concatenate(groups)
        old = np.full(self.links.size, -1)
        old[rows] = np.repeat(np.arange(len(groups)), sizes)
        group = old.copy()
        genes = self.innovation, self.weight, self.links
        starts = np.cumsum([0, *sizes])
        limit = float(threshold)
        moved = _regroup(order, group, rows, starts, genes, limit, config.coefficients)
        if not moved.size:
            return list(groups)
        rows = np.concatenate([rows[group[rows] == old[rows]], moved])
        return [rows[group[rows] == one] for one in range(max(len(groups), group.max() + 1))]

    def _make_room(self, rows: int, columns: int) -> None:
        """See to so many rows and columns; where they are new, to a quarter more."""
        more = [
            (0, wanted + wanted // 4 - had if wanted > had else 0)
            for wanted, had in zip((rows, columns), self.innovation.shape, strict=True)
        ]
        if any(new for _, new in more):
            self.innovation, self.weight = np.pad(self.innovation, more), np.pad(self.weight, more)
            self.links = np.pad(self.links, more[0])


@njit(cache=True)
def _distance(
    own: Innovations,
    own_weight: Weights,
    other: Innovations,
    other_weight: Weights,
    coefficients: Coefficients,
    limit: float,
) -> float:
    """Walk along two lists of links, each sorted by innovation.

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


@njit(cache=True)
def _sorted(
    innovation: Innovations,
    weight: Weights,
    starts: Rows,
    groups: int,
    threshold: float,
    coefficients: Coefficients,
) -> Rows:
    """Return the group of each genome; the first `groups` are the representatives of theirs."""
    leader = np.arange(starts.size - 1)
    group = np.empty(starts.size - 1 - groups, np.int64)
    first = groups
    for one in range(group.size):
        own = slice(starts[first + one], starts[first + one + 1])
        home = 0
        while home < groups:
            rival = slice(starts[leader[home]], starts[leader[home] + 1])
            apart = _distance(
                innovation[own],
                weight[own],
                innovation[rival],
                weight[rival],
                coefficients,
                threshold,
            )
            if apart < threshold:
                break
            home += 1
        if home == groups:
            leader[home] = first + one
            groups += 1
        group[one] = home
    return group


@njit(cache=True)
def _regroup(
    order: Rows,
    group: Rows,
    rows: Rows,
    starts: Rows,
    genes: tuple[Innovations, Weights, Rows],
    threshold: float,
    coefficients: Coefficients,
) -> Rows:
    """Give `group` [rows] its new values; return the rows that moved, in that order."""
    innovation, weight, links = genes
    groups = starts.size - 1
    leader = np.full(groups + order.size, -1)
    leader[:groups] = rows[starts[:-1]]
    moved = np.empty(order.size, np.int64)
    moves = 0
    for row in order:
        own, own_weight = innovation[row, : links[row]], weight[row, : links[row]]
        home = 0
        while home < groups:
            first = leader[home]
            if first >= 0:
                size = links[first]
                other, other_weight = innovation[first, :size], weight[first, :size]
                apart = _distance(own, own_weight, other, other_weight, coefficients, threshold)
                if apart < threshold:
                    break
            home += 1
        old = int(group[row])
        if home == old:
            continue
        if home == groups:
            leader[home] = row
            groups += 1
        group[row] = home
        moved[moves] = row
        moves += 1
        if leader[old] == row:
            # Only old groups lose members: who has moved once stays where it is.
            before = rows[starts[old] : starts[old + 1]]
            leader[old] = _first_of(old, group, before, moved[:moves])
    return moved[:moves]


@njit(cache=True)
def _first_of(one: int, group: Rows, before: Rows, moved: Rows) -> int:
    """Return the first row of a group, those it had `before` first; -1 if it is empty."""
    for row in before:
        if group[row] == one:
            return int(row)
    for row in moved:
        if group[row] == one:
            return int(row)
    return -1
