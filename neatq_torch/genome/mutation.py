"""Mutation: one step away from the parent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.innovation import InnovationLedger
from neatq_torch.genome.mutation_config import MutationConfig
from neatq_torch.genome.structural import add_link, add_node, reenable, toggle_enable
from neatq_torch.genome.validation import check_weights

Shares = tuple[float, float]
ScalesOf = Callable[[Genome], NDArray[np.float64]]
"""How far each weight [links] of a genome moves when it is perturbed, as a multiple."""


def mutate(
    genome: Genome,
    config: MutationConfig,
    ledger: InnovationLedger,
    rng: np.random.Generator,
    scales_of: ScalesOf | None = None,
) -> Genome:
    """Return the genome after one mutation; a structural one is the only one it gets.

    Perturbations of weights are multiplied by what `scales_of` says of the genome.
    """
    if rng.random() < config.add_node_prob:
        return add_node(genome, config, ledger, rng)
    if rng.random() < config.add_link_prob:
        return add_link(genome, config, ledger, rng)
    if rng.random() < config.link_weights_prob:
        genome = mutate_weights(genome, config, rng, scales_of)
    if rng.random() < config.toggle_enable_prob:
        genome = toggle_enable(genome, rng)
    if rng.random() < config.reenable_prob:
        genome = reenable(genome)
    return genome


def mutate_weights(
    genome: Genome,
    config: MutationConfig,
    rng: np.random.Generator,
    scales_of: ScalesOf | None = None,
) -> Genome:
    """Return the genome with mutated weights; disabled links mutate too."""
    scales = None if scales_of is None else scales_of(genome)
    weights = mutated_weights(genome.link_weight, config, rng, scales)
    check_weights(genome.link_innovation, weights)
    return genome.unchecked(link_weight=weights)


def mutated_weights(
    weights: NDArray[np.float32],
    config: MutationConfig,
    rng: np.random.Generator,
    scales: NDArray[np.float64] | None = None,
) -> NDArray[np.float32]:
    """Return weights [links] after one mutation of weights.

    Perturbations are multiplied by `scales` [links]; weights that are drawn anew are not.

    Scheme "opennero" (`Genome::mutate_link_weights` there): half of the mutations are severe,
    with 70 % of the weights moved, 20 % new, 10 % kept; in the others the last fifth of a
    genome of 10 genes or more has 50 % moved, 20 % new, 30 % kept, and all older genes move.
    """
    links = weights.size
    shift = rng.uniform(-config.weight_mutation_power, config.weight_mutation_power, links)
    choice = rng.random(links)
    if config.weight_scheme == "uniform":
        old = young = (0.0, config.weight_replace_prob)
    else:
        old, young = _opennero_shares(links, severe=rng.random() < 0.5)
    cap = np.inf if config.max_link_weight is None else float(config.max_link_weight)
    move = shift if scales is None else shift * scales
    return _moved(weights, shift, move, choice, old, young, cap)


def _opennero_shares(links: int, *, severe: bool) -> tuple[Shares, Shares]:
    """Return the shares of (kept, replaced) weights among old and among young genes."""
    if severe:
        return (0.1, 0.2), (0.1, 0.2)
    return (0.0, 0.0), (0.3, 0.2) if links >= 10 else (0.0, 0.0)


@njit(cache=True)
def _moved(
    weights: NDArray[np.float32],
    shift: NDArray[np.float64],
    move: NDArray[np.float64],
    choice: NDArray[np.float64],
    old: Shares,
    young: Shares,
    cap: float,
) -> NDArray[np.float32]:
    """Return weights [links], capped; the last fifth of the genes counts as young."""
    new = np.empty_like(weights)
    for link in range(weights.size):
        kept, replaced = young if link > 0.8 * weights.size else old
        # choice: [0, kept) keeps, [kept, kept + replaced) replaces, the rest moves.
        if choice[link] < kept:
            weight = np.float64(weights[link])
        elif choice[link] < kept + replaced:
            weight = shift[link]
        else:
            weight = weights[link] + move[link]
        new[link] = min(max(weight, -cap), cap)
    return new
