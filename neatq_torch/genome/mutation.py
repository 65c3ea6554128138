"""Mutation: one step away from the parent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.graph import reaches
from neatq_torch.genome.innovation import InnovationLedger
from neatq_torch.genome.rules import (
    ACTIVATIONS,
    LINK_FIELDS,
    NODE_FIELDS,
    NodeKind,
    check_innovations,
    check_weights,
    index_of,
)
from neatq_torch.jit import cached_njit
from neatq_torch.kinds import check_fields

WeightScheme = Literal["opennero", "uniform"]


@dataclass(frozen=True, kw_only=True)
class MutationConfig:
    """How often and how strongly genomes mutate; the defaults are those of OpenNERO.

    One mutation of a genome is: a new node; else a new link; else each of weights, toggle and
    re-enable. OpenNERO's trait mutations have no effect on behaviour and are left out.

    Attributes:
        add_node_prob: probability of a new node.
        add_link_prob: probability of a new link where there is no new node.
        link_weights_prob: probability of new weights where the structure stays.
        weight_scheme: "opennero", severe or by age of the gene (see `mutated_weights`), as in the
            programs of OpenNERO and of NEAT's authors; "uniform", each weight is perturbed or, with
            `weight_replace_prob`, new, as NEAT's paper says.
        weight_mutation_power: weights change by U(-power, power).
        weight_replace_prob: share of new weights in the scheme "uniform".
        max_link_weight: mutated weights are capped to this size; None for no cap.
        new_link_weight_power: weights of new links are U(-power, power).
        recurrent_link_prob: share of link mutations that must find a recurrent link.
        recurrent_loop_prob: share of those tries that look at a link from a node to itself.
        forward_from_outputs: whether a new link may leave an output and be forward; in OpenNERO
            it may, by a wrong comparison in its code.
        new_link_tries: pairs of nodes looked at before a link mutation gives up.
        split_tries: links looked at before a node mutation gives up.
        split_old_below: a genome with fewer links than this splits the oldest of those that can be
            split, or with probability 0.3 rather the next one, and so on, so that its first hidden
            nodes do not form a chain; 0 for the choice by chance in all genomes.
        split_weight_scale: weight behind a new node, as a share of the split link's weight.
        hidden_activation: activation of new nodes.
        toggle_enable_prob: probability that one link is enabled or disabled.
        reenable_prob: probability that the first disabled link is enabled.
        remove_link_prob: probability that an enabled link is removed for good where there is no
            new node or link. None: 0.1 where the population's `parsimony` is set, else 0.
    """

    add_node_prob: float = 0.03
    add_link_prob: float = 0.05
    link_weights_prob: float = 0.9
    weight_scheme: WeightScheme = "opennero"
    weight_mutation_power: float = 0.5
    weight_replace_prob: float = 0.1
    max_link_weight: float | None = 3.0
    new_link_weight_power: float = 1.0
    recurrent_link_prob: float = 0.15
    recurrent_loop_prob: float = 0.5
    forward_from_outputs: bool = True
    new_link_tries: int = 20
    split_tries: int = 20
    split_old_below: int = 0
    split_weight_scale: float = 0.3
    hidden_activation: str = "sigmoid"
    toggle_enable_prob: float = 0.0
    reenable_prob: float = 0.0
    remove_link_prob: float | None = None

    def __post_init__(self) -> None:
        intervals = {"_prob": "[0, 1]", "_power": "[0, inf)", "_tries": "[1, inf]"}
        for ending, interval in intervals.items():
            check_fields(self, **{name: interval for name in vars(self) if name.endswith(ending)})
        check_fields(self, weight_scheme=WeightScheme, max_link_weight="(0, inf]")
        check_fields(self, split_old_below="[0, inf]", split_weight_scale="(-inf, inf)")
        index_of(self.hidden_activation, ACTIVATIONS, "activation")


def mutate(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    """The genome after one mutation; a structural one is the only one it gets."""
    if rng.random() < config.add_node_prob:
        return add_node(genome, config, ledger, rng)
    if rng.random() < config.add_link_prob:
        return add_link(genome, config, ledger, rng)
    if config.remove_link_prob and rng.random() < config.remove_link_prob:
        return remove_link(genome, rng)
    if rng.random() < config.link_weights_prob:
        genome = mutate_weights(genome, config, rng)
    if rng.random() < config.toggle_enable_prob:
        genome = toggle_enable(genome, rng)
    if rng.random() < config.reenable_prob:
        genome = reenable(genome)
    return genome


def mutate_weights(genome: Genome, config: MutationConfig, rng: np.random.Generator) -> Genome:
    """The genome with mutated weights; disabled links mutate too."""
    weights = mutated_weights(genome.link_weight, config, rng)
    check_weights(genome.link_innovation, weights)
    return genome.unchecked(link_weight=weights)


def mutated_weights(
    weights: NDArray[np.float32], config: MutationConfig, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Weights [links] after one mutation of weights.

    Scheme "opennero" (`Genome::mutate_link_weights` there): half of the mutations are severe,
    with 70 % of the weights moved, 20 % new, 10 % kept; in the others the last fifth of a
    genome of 10 genes or more has 50 % moved, 20 % new, 30 % kept, and all older genes move.
    """
    links = weights.size
    shift = rng.uniform(-config.weight_mutation_power, config.weight_mutation_power, links)
    choice = rng.random(links)
    if config.weight_scheme == "uniform":
        old = young = (0.0, config.weight_replace_prob)
    elif rng.random() < 0.5:  # severe
        old = young = (0.1, 0.2)
    else:
        old, young = (0.0, 0.0), (0.3, 0.2) if links >= 10 else (0.0, 0.0)
    cap = np.inf if config.max_link_weight is None else float(config.max_link_weight)
    return _shaken(weights, shift, choice, old, young, cap)


@cached_njit()
def _shaken(
    weights: NDArray[np.float32],
    shift: NDArray[np.float64],
    choice: NDArray[np.float64],
    old: tuple[float, float],
    young: tuple[float, float],
    cap: float,
) -> NDArray[np.float32]:
    """Weights [links], capped; (kept, replaced) shares, the last fifth of the genes is young."""
    new = np.empty_like(weights)
    for link in range(weights.size):
        kept, replaced = young if link > 0.8 * weights.size else old
        # choice: [0, kept) keeps, [kept, kept + replaced) replaces, the rest moves.
        if choice[link] < kept:
            weight = np.float64(weights[link])
        elif choice[link] < kept + replaced:
            weight = shift[link]
        else:
            weight = weights[link] + shift[link]
        new[link] = min(max(weight, -cap), cap)
    return new


def add_node(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    """The genome with one enabled link split by a new node.

    The link is disabled; the weight in front of the node is 1, the one behind it the link's
    times `split_weight_scale`. Links of the bias are not split. The genome itself comes back
    if no link is found in `split_tries` tries.
    """
    chosen = _link_to_split(genome, config, rng)
    if chosen is None:
        return genome
    split = ledger.split(int(genome.link_innovation[chosen]), genome.node_id.tolist())
    weight = np.float32(genome.link_weight[chosen] * config.split_weight_scale)
    activation = ACTIVATIONS.index(config.hidden_activation)
    links = _joined_links(
        genome,
        link_innovation=[split.in_innovation, split.out_innovation],
        link_source=[genome.link_source[chosen], split.node_id],
        link_target=[split.node_id, genome.link_target[chosen]],
        link_weight=[1.0, weight],
        link_recurrent=[genome.link_recurrent[chosen], False],
    )
    links["link_enabled"] &= links["link_innovation"] != genome.link_innovation[chosen]
    return genome.unchecked(
        node_id=np.append(genome.node_id, np.int32(split.node_id)),
        node_kind=np.append(genome.node_kind, np.uint8(NodeKind.HIDDEN)),
        node_activation=np.append(genome.node_activation, np.uint8(activation)),
        **links,
    )


def _link_to_split(genome: Genome, config: MutationConfig, rng: np.random.Generator) -> int | None:
    links = genome.link_innovation.size
    if links == 0:
        return None
    to_split = genome.node_kind[genome.source_index] != NodeKind.BIAS
    if links >= config.split_old_below:
        tries = rng.integers(links, size=config.split_tries)
    else:
        # The first enabled one, or each next one with probability 0.3. As in the code of Stanley &
        # Miikkulainen 2002, chance may end at a disabled link or beyond the last: none is split.
        old = np.flatnonzero(to_split)
        enabled = genome.link_enabled[old]
        first = enabled.argmax() + rng.geometric(0.7) - 1 if enabled.any() else old.size
        tries = old[first : first + 1]
    found = tries[(genome.link_enabled & to_split)[tries]]
    return int(found[0]) if found.size else None


def add_link(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    """The genome with one new link, or the genome itself if no place was found.

    A link is recurrent if its target already reaches its source by forward links, enabled or
    not, so that the forward links never form a cycle; or if it leaves an output, unless
    `forward_from_outputs`.
    """
    recurrent = bool(rng.random() < config.recurrent_link_prob)
    pair = _free_pair(genome, recurrent, config, rng)
    weight = rng.uniform(-config.new_link_weight_power, config.new_link_weight_power)
    if pair is None:
        return genome
    source, target = (int(genome.node_id[index]) for index in pair)
    known = ledger.link(source, target, recurrent, np.float32(weight).item())
    links = _joined_links(
        genome,
        link_innovation=[known.innovation],
        link_source=[source],
        link_target=[target],
        link_weight=[known.weight],
        link_recurrent=[recurrent],
    )
    return genome.unchecked(**links)


def _free_pair(
    genome: Genome, recurrent: bool, config: MutationConfig, rng: np.random.Generator
) -> tuple[int, int] | None:
    """Node indices (source, target) between which such a link is missing."""
    tries, nodes = config.new_link_tries, genome.node_id.size
    enterable = np.flatnonzero(genome.node_kind > NodeKind.BIAS)
    sources = rng.integers(nodes, size=tries)
    targets = enterable[rng.integers(enterable.size, size=tries)]
    if recurrent:
        sources = np.where(rng.random(tries) < config.recurrent_loop_prob, targets, sources)
    same_kind = genome.link_recurrent == recurrent
    keys = (genome.source_index * nodes + genome.target_index)[same_kind]
    free = ~np.isin(sources * nodes + targets, keys)
    for source, target in zip(sources[free].tolist(), targets[free].tolist(), strict=True):
        if _would_recur(genome, config, source, target) == recurrent:
            return source, target
    return None


def _would_recur(genome: Genome, config: MutationConfig, source: int, target: int) -> bool:
    kind = genome.node_kind[source]
    if source == target or (kind == NodeKind.OUTPUT and not config.forward_from_outputs):
        return True
    if kind <= NodeKind.BIAS:
        return False
    forward = ~genome.link_recurrent
    sources, targets = genome.source_index[forward], genome.target_index[forward]
    return reaches(sources, targets, genome.node_id.size, target, source)


def toggle_enable(genome: Genome, rng: np.random.Generator) -> Genome:
    """The genome with one link switched on or off.

    A link is only switched off if its source keeps another enabled link.
    """
    if not genome.link_enabled.size:
        return genome
    chosen = int(rng.integers(genome.link_enabled.size))
    enabled = genome.link_enabled.copy()
    enabled[chosen] = not enabled[chosen]
    leaving = genome.link_source == genome.link_source[chosen]
    return genome.unchecked(link_enabled=enabled) if (enabled & leaving).any() else genome


def remove_link(genome: Genome, rng: np.random.Generator) -> Genome:
    """The genome without one of its enabled links, be it the last of an input or output.

    Hidden nodes that no link leaves any more, but to themselves, go with the links into them.
    """
    enabled = np.flatnonzero(genome.link_enabled)
    if not enabled.size:
        return genome
    kept = np.arange(genome.link_enabled.size) != enabled[rng.integers(enabled.size)]
    onwards = genome.source_index != genome.target_index
    nodes, left = np.ones(genome.node_id.size, dtype=bool), -1
    while left != (left := np.count_nonzero(nodes)):
        nodes = genome.node_kind != NodeKind.HIDDEN
        nodes[genome.source_index[kept & onwards]] = True
        kept &= nodes[genome.source_index] & nodes[genome.target_index]
    links = {name: getattr(genome, name)[kept] for name in LINK_FIELDS}
    return genome.unchecked(**links, **{name: getattr(genome, name)[nodes] for name in NODE_FIELDS})


def reenable(genome: Genome) -> Genome:
    """The genome with its first disabled link enabled."""
    if genome.link_enabled.all():
        return genome
    enabled = genome.link_enabled.copy()
    enabled[enabled.argmin()] = True
    return genome.unchecked(link_enabled=enabled)


def _joined_links(genome: Genome, **new: list[Any]) -> dict[str, NDArray[Any]]:
    """The genome's link columns with new, enabled links, sorted by innovation."""
    new["link_enabled"] = [True] * len(new["link_innovation"])
    joined = {
        name: np.concatenate([getattr(genome, name), np.array(new[name], dtype=dtype)])
        for name, dtype in LINK_FIELDS.items()
    }
    order = np.argsort(joined["link_innovation"], kind="stable")
    links = {name: column[order] for name, column in joined.items()}
    # A ledger that does not know the genome may give numbers that are taken.
    check_innovations(links["link_innovation"])
    check_weights(links["link_innovation"], links["link_weight"])
    return links
