"""Mutation: one step away from the parent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.crossover import packed
from neatq_torch.genome.genes import Rates
from neatq_torch.genome.genome import Genome
from neatq_torch.genome.heredity import (
    LINK_GENE,
    NODE,
    NOTHING,
    RECURRENT,
    REMOVED,
    WEIGHTS,
    conceived,
    shake,
)
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
from neatq_torch.kinds import check_fields

WeightScheme = Literal["opennero", "uniform"]

_ENDS = {"source_index": np.intp, "target_index": np.intp}

_NO_MATING = 0.0, 0.0, False, (0.0, False), (0.0, 0.0, 0.0, 0.0)
"""What `conceived` does not read for one parent."""


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

    @cached_property
    def rates(self) -> Rates:
        """What compiled code reads."""
        own = vars(self) | {"uniform": self.weight_scheme == "uniform"}
        own["max_link_weight"] = self.max_link_weight or np.inf
        own["remove_link_prob"] = self.remove_link_prob or 0.0
        return Rates(*(float(own[name]) for name in Rates._fields))


def mutate(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    """The genome after one mutation; a structural one is the only one it gets.

    The genome itself comes back if nothing is found in `split_tries` or `new_link_tries` tries.
    """
    genes, means = packed(genome.genes), (*_NO_MATING, config.rates)
    (links, _), _, _, mutation = conceived(rng, genes, genes, (False, True, False, False), means)
    if mutation[0] == WEIGHTS:
        weight, enabled = links["weight"].copy(), links["enabled"].copy()
        check_weights(genome.link_innovation, weight)
        return genome.unchecked(link_weight=weight, link_enabled=enabled)
    return restructured(genome, mutation, config, ledger)


def restructured(
    genome: Genome, mutation: Sequence[float], config: MutationConfig, ledger: InnovationLedger
) -> Genome:
    """The genome after a structural mutation, numbered by the ledger, or as it is without one."""
    kind, one, two, weight = mutation
    if kind == NODE:
        return _with_node(genome, int(one), config, ledger)
    if kind == REMOVED:
        return _without_link(genome, int(one))
    if kind in (NOTHING, WEIGHTS):
        return genome
    return _with_link(genome, (int(one), int(two)), kind == RECURRENT, weight, ledger)


def mutated_weights(
    weights: NDArray[np.float32], config: MutationConfig, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Weights [links] after one mutation of weights; those of disabled links mutate too."""
    links = np.zeros(weights.size, LINK_GENE)
    links["weight"] = weights
    shake(rng, links, config.rates)
    return links["weight"].copy()


def _with_node(
    genome: Genome, chosen: int, config: MutationConfig, ledger: InnovationLedger
) -> Genome:
    """The genome with one enabled link split by a new node.

    The link is disabled; the weight in front of the node is 1, the one behind it the link's
    times `split_weight_scale`.
    """
    split = ledger.split(int(genome.link_innovation[chosen]), genome.node_id.tolist())
    weight = np.float32(genome.link_weight[chosen] * config.split_weight_scale)
    nodes, activation = genome.node_id.size, ACTIVATIONS.index(config.hidden_activation)
    links = _joined_links(
        genome,
        link_innovation=[split.in_innovation, split.out_innovation],
        link_source=[genome.link_source[chosen], split.node_id],
        link_target=[split.node_id, genome.link_target[chosen]],
        link_weight=[1.0, weight],
        link_recurrent=[genome.link_recurrent[chosen], False],
        source_index=[genome.source_index[chosen], nodes],
        target_index=[nodes, genome.target_index[chosen]],
    )
    links["link_enabled"] &= links["link_innovation"] != genome.link_innovation[chosen]
    return genome.unchecked(
        node_id=np.append(genome.node_id, np.int32(split.node_id)),
        node_kind=np.append(genome.node_kind, np.uint8(NodeKind.HIDDEN)),
        node_activation=np.append(genome.node_activation, np.uint8(activation)),
        **links,
    )


def _with_link(
    genome: Genome, pair: tuple[int, int], recurrent: bool, weight: float, ledger: InnovationLedger
) -> Genome:
    """The genome with a new link between two nodes, given by their indices (source, target)."""
    source, target = (int(genome.node_id[index]) for index in pair)
    known = ledger.link(source, target, recurrent, np.float32(weight).item())
    links = _joined_links(
        genome,
        link_innovation=[known.innovation],
        link_source=[source],
        link_target=[target],
        link_weight=[known.weight],
        link_recurrent=[recurrent],
        source_index=[pair[0]],
        target_index=[pair[1]],
    )
    return genome.unchecked(**links)


def _without_link(genome: Genome, chosen: int) -> Genome:
    """The genome without one of its enabled links, be it the last of an input or output.

    Hidden nodes that no link leaves any more, but to themselves, go with the links into them.
    """
    kept = np.arange(genome.link_enabled.size) != chosen
    onwards = genome.source_index != genome.target_index
    nodes, left = np.ones(genome.node_id.size, dtype=bool), -1
    while left != (left := np.count_nonzero(nodes)):
        nodes = genome.node_kind != NodeKind.HIDDEN
        nodes[genome.source_index[kept & onwards]] = True
        kept &= nodes[genome.source_index] & nodes[genome.target_index]
    links = {name: getattr(genome, name)[kept] for name in LINK_FIELDS}
    return genome.unchecked(**links, **{name: getattr(genome, name)[nodes] for name in NODE_FIELDS})


def _joined_links(genome: Genome, **new: list[Any]) -> dict[str, NDArray[Any]]:
    """The genome's link columns, and ends, with new, enabled links, sorted by innovation."""
    new["link_enabled"] = [True] * len(new["link_innovation"])
    joined: dict[str, NDArray[Any]] = {
        name: np.concatenate([getattr(genome, name), np.array(new[name], dtype=dtype)])
        for name, dtype in (LINK_FIELDS | _ENDS).items()
    }
    order = np.argsort(joined["link_innovation"], kind="stable")
    links = {name: column[order] for name, column in joined.items()}
    # A ledger that does not know the genome may give numbers that are taken.
    check_innovations(links["link_innovation"])
    check_weights(links["link_innovation"], links["link_weight"])
    return links
