"""Parsimony: small networks that are good enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neatq_torch.evolution.reproduction import ReproductionConfig
from neatq_torch.genome import Genome


def lowest_good(best: float, share: float) -> float:
    """The least return that is good enough beside the best one, which may be negative."""
    return best - share * abs(best)


def enabled_links(genomes: Sequence[Genome]) -> NDArray[np.int64]:
    """How large networks are: their enabled links, int64 [genomes]."""
    return np.array([np.count_nonzero(one.link_enabled) for one in genomes], dtype=np.int64)


def good_ranks(
    returns: NDArray[np.float64], links: NDArray[np.int64], share: float
) -> NDArray[np.float64]:
    """Ranks [genomes], from 0 for the worst on: whom to show as the champion.

    Of genomes within the share of the best return the one with fewest links is first, of these the
    one with the highest return. Others are below, by return.
    """
    good = returns >= lowest_good(float(returns.max()), share)
    return _ranks(good, np.where(good, -links, 0), returns)


def front_ranks(returns: NDArray[np.float64], links: NDArray[np.int64]) -> NDArray[np.float64]:
    """Ranks [genomes], from 0 for the worst on: who lives and breeds.

    The better half is ranked as in NSGA-II (Deb et al. 2002), for a high return and few links:
    first the front of those that nobody beats, then that of those whom only these beat, and so on;
    in a front those are above that stand alone. The others are below, by return.

    Measured on CartPole-v1 (`neat`, 600,000 steps) and Pendulum-v1 (`neatq`, 120,000), links of the
    champion and its return: size only among those within 5 % of the best 5.5 at 500 and 31 at -156,
    fronts of all 2 at 500 and 21 at -204, these 4 at 500 and 23 at -136; without 10 and 32 at -133.
    """
    good = returns >= np.median(returns)
    as_good = (returns[:, None] >= returns) & (links[:, None] <= links)
    beats, left = as_good & ~as_good.T, good.copy()
    level, crowding = returns.copy(), np.zeros(returns.size)
    while left.any():
        now = left & ~beats[left].any(axis=0)
        level[now], crowding[now] = left.sum(), _crowding(returns[now]) + _crowding(links[now])
        left &= ~now
    return _ranks(good, level, crowding)


def _crowding(values: NDArray[Any]) -> NDArray[np.float64]:
    """How far the neighbours on both sides of each value lie apart; [values]."""
    order, apart = np.argsort(values, kind="stable"), np.full(values.size, np.inf)
    near = values[order]
    apart[order[1:-1]] = (near[2:] - near[:-2]) / (near[-1] - near[0] or 1)
    return apart


def _ranks(*keys: NDArray[Any]) -> NDArray[np.float64]:
    """From 0 on, by keys [genomes] of which the first counts most; equals have equal ranks."""
    return np.unique(np.stack(keys), axis=1, return_inverse=True)[1].ravel().astype(np.float64)


def shrinking(reproduction: ReproductionConfig) -> ReproductionConfig:
    """The same with a mutation that removes links, unless its probability is given."""
    if reproduction.mutation.remove_link_prob is not None:
        return reproduction
    return _shrinking(reproduction)


@lru_cache
def _shrinking(reproduction: ReproductionConfig) -> ReproductionConfig:
    mutation = replace(reproduction.mutation, remove_link_prob=0.1)
    return replace(reproduction, mutation=mutation)
