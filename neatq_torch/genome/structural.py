"""Mutations of structure: new nodes, new links, links switched on and off."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genome import Genome
from neatq_torch.genome.graph import reaches
from neatq_torch.genome.innovation import InnovationLedger
from neatq_torch.genome.mutation_config import MutationConfig
from neatq_torch.genome.validation import LINK_FIELDS, check_innovations, check_weights
from neatq_torch.genome.vocabulary import NodeKind, activation_index


def add_node(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    """Return the genome with one enabled link split by a new node.

    The link is disabled; the weight in front of the node is 1, the one behind it the link's
    times `split_weight_scale`. Links of the bias are not split. The genome itself comes back
    if no link is found in `split_tries` tries.
    """
    chosen = _link_to_split(genome, config, rng)
    if chosen is None:
        return genome
    split = ledger.split(int(genome.link_innovation[chosen]), genome.node_id.tolist())
    weight = np.float32(genome.link_weight[chosen] * config.split_weight_scale)
    activation = activation_index(config.hidden_activation)
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
    from_bias = genome.node_kind[genome.source_index] == NodeKind.BIAS
    if links < config.split_old_below:
        return _old_link(genome, np.flatnonzero(~from_bias), rng)
    tries = rng.integers(links, size=config.split_tries)
    found = tries[(genome.link_enabled & ~from_bias)[tries]]
    return int(found[0]) if found.size else None


def _old_link(genome: Genome, links: NDArray[np.intp], rng: np.random.Generator) -> int | None:
    """Return the first enabled one of `links`, or each next one with probability 0.3.

    As in the code of Stanley & Miikkulainen 2002, chance may end at a disabled link: None.
    """
    enabled = genome.link_enabled[links]
    place = int(enabled.argmax()) + int(rng.geometric(0.7)) - 1 if enabled.any() else links.size
    return int(links[place]) if place < links.size and enabled[place] else None


def add_link(
    genome: Genome, config: MutationConfig, ledger: InnovationLedger, rng: np.random.Generator
) -> Genome:
    """Return the genome with one new link, or the genome itself if no place was found.

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
    """Look for node indices (source, target) between which such a link is missing."""
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
    if source == target:
        return True
    if genome.node_kind[source] == NodeKind.OUTPUT and not config.forward_from_outputs:
        return True
    if genome.node_kind[source] <= NodeKind.BIAS:
        return False
    forward = ~genome.link_recurrent
    sources, targets = genome.source_index[forward], genome.target_index[forward]
    return reaches(sources, targets, genome.node_id.size, target, source)


def toggle_enable(genome: Genome, rng: np.random.Generator) -> Genome:
    """Return the genome with one link switched on or off.

    A link is only switched off if its source keeps another enabled link.
    """
    links = genome.link_innovation.size
    if links == 0:
        return genome
    chosen = int(rng.integers(links))
    enabled = genome.link_enabled.copy()
    enabled[chosen] = not enabled[chosen]
    leaving = genome.link_source == genome.link_source[chosen]
    if not (enabled & leaving).any():
        return genome
    return genome.unchecked(link_enabled=enabled)


def reenable(genome: Genome) -> Genome:
    """Return the genome with its first disabled link enabled."""
    disabled = np.flatnonzero(~genome.link_enabled)
    if not disabled.size:
        return genome
    enabled = genome.link_enabled.copy()
    enabled[disabled[0]] = True
    return genome.unchecked(link_enabled=enabled)


def _joined_links(genome: Genome, **new: list[Any]) -> dict[str, NDArray[Any]]:
    """Return the genome's link columns with new, enabled links, sorted by innovation."""
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
