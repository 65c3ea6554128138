"""Heredity: how genes become those of a child, as compiled loops.

One file, as numba does not notice changes of what compiled functions call in others.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba.np.random import generator_core
from numpy.typing import NDArray

from neatq_torch.genome.genes import GeneNumbers, Genes, Means, NodeIndices, Rates
from neatq_torch.jit import cached_njit

Links = Any
Nodes = Any
Packed = tuple[Links, Nodes]
"""`Genes` as arrays of records: with a column each all takes twice as long to compile."""

LINK_GENE = np.dtype({"names": Genes._fields[:6], "formats": [*"qf??qq"]}, align=True)
NODE_GENE = np.dtype({"names": Genes._fields[6:], "formats": [*"iB"]}, align=True)

Mutation = tuple[float, float, float, float]
"""What compiled code chose: a kind; the link, or source and target node, as indices; a weight."""

NOTHING, WEIGHTS, NODE, FORWARD, RECURRENT, REMOVED = map(float, range(6))
"""Kinds of mutations: a structural one that was not possible, none of the structure, the others."""

NO_MUTATION = NOTHING, 0.0, 0.0, 0.0
_BIAS, _OUTPUT = 1, 2  # of `NodeKind`

outer_njit = partial(cached_njit, no_cfunc_wrapper=True)
inner_njit = partial(outer_njit, no_cpython_wrapper=True)
"""For what is called by compiled code alone: without what Python would need it compiles faster."""


@outer_njit()
def node_levels(sources: NodeIndices, targets: NodeIndices, nodes: int) -> NDArray[np.int32] | None:
    """Return for each node the length of the longest path of links that ends in it.

    Links [links] lead from and to indices (not ids) of nodes. The levels are int32 [nodes], 0 for
    nodes without incoming links; None if the links form a cycle.
    """
    levels = np.zeros(nodes, dtype=np.int32)
    changed = True
    while changed:
        changed = False
        for link in range(sources.size):
            level = levels[sources[link]] + 1
            if level > levels[targets[link]]:
                levels[targets[link]] = level
                changed = True
                if level >= nodes:
                    return None
    return levels


@outer_njit()
def reaches(
    sources: NodeIndices, targets: NodeIndices, nodes: int, source: int, target: int
) -> bool:
    """Tell whether a path of links leads from node `source` to node `target` (indices).

    A node reaches itself. The links may contain cycles.
    """
    reached = np.zeros(nodes, dtype=np.bool_)
    reached[source] = True
    changed = True
    while changed and not reached[target]:
        changed = False
        for link in range(sources.size):
            if reached[sources[link]] and not reached[targets[link]]:
                reached[targets[link]] = changed = True
    return bool(reached[target])


@inner_njit()
def _drawn_below(rng: np.random.Generator, end: int) -> int:
    """`rng.integers(end)` for a number of at most 31 bits; that one takes a second to compile."""
    drawn = np.int64(0)
    if end > 1:
        drawn = np.int64(generator_core.next_uint32(rng.bit_generator)) * end
        while drawn % 2**32 < end and drawn % 2**32 < (2**32 - end) % end:
            drawn = np.int64(generator_core.next_uint32(rng.bit_generator)) * end
    return int(drawn >> 32)


@inner_njit()
def _forward_links(links: Links) -> tuple[GeneNumbers, GeneNumbers]:
    """Return sources and targets of the links that are not recurrent."""
    sources, targets, size = np.empty(links.size, np.int64), np.empty(links.size, np.int64), 0
    for link in links:
        sources[size], targets[size] = link.source, link.target
        size += not link.recurrent
    return sources[:size], targets[:size]


@inner_njit()
def _genes_at(herd: Packed, bounds: tuple[GeneNumbers, ...], one: int) -> Packed:
    (links, nodes), (link, node, _) = herd, bounds
    return links[link[one] : link[one + 1]], nodes[node[one] : node[one + 1]]


@outer_njit()
def born(
    rng: np.random.Generator,
    herd: Packed,
    bounds: tuple[GeneNumbers, GeneNumbers, GeneNumbers],
    genome_id: GeneNumbers,
    fitness: NDArray[np.float64],
    home: GeneNumbers,
    births: tuple[Links, GeneNumbers, NDArray[np.float64]],
    means: Means,
) -> tuple[int, Packed, GeneNumbers, bool]:
    """Let children of species `home` [children] be born until one is not only its fitter parent's.

    The bounds tell where links and nodes of each of the herd begin and end, one species behind the
    other, and where each species does. Of each birth are written: the links, a padded row; the
    parents: who passes on its genes, the other one, the fitter one and the less fit one, -1 for
    none; the `Mutation`. Returns how many are born, and what `crossed` says of the last one.
    """
    rows, parents, mutations = births
    (mutate_only_prob, interspecies_prob), conception = means
    (start, _, homes), species, child = bounds, bounds[2].size - 1, 0
    while True:
        low, high = homes[home[child]], homes[home[child] + 1]
        first = second = low + _drawn_below(rng, high - low)
        two = high - low > 1 and rng.random() >= mutate_only_prob
        outside = two and species > 1 and rng.random() < interspecies_prob
        if outside:
            other = _drawn_below(rng, species - 1)
            second = homes[other + (other >= home[child])]
        elif two:
            second = low + _drawn_below(rng, high - low)
        smaller = start[first + 1] - start[first] < start[second + 1] - start[second]
        fitter = not two or fitness[first] > fitness[second]
        fitter |= fitness[first] == fitness[second] and smaller
        base, other = (first, second) if fitter else (second, first)
        one, another = (first, second) if fitness[first] >= fitness[second] else (second, first)
        parents[child, 0], parents[child, 1], parents[child, 2] = base, other, one
        parents[child, 3] = another if two else -1
        kinship = two, fitter, outside, genome_id[first] == genome_id[second]
        couple = _genes_at(herd, bounds, base), _genes_at(herd, bounds, other)
        genes, new, joined, mutation = conceived(rng, *couple, kinship, conception)
        for part in range(4):
            mutations[child, part] = mutation[part]
        for link in range(0 if joined else genes[0].size):
            rows[child, link] = genes[0][link]
        child += 1
        if joined or child == home.size:
            return child, genes, new, joined


@outer_njit()
def conceived(
    rng: np.random.Generator,
    fitter: Packed,
    other: Packed,
    kinship: tuple[bool, bool, bool, bool],
    means: Means,
) -> tuple[Packed, GeneNumbers, bool, Mutation]:
    """Return what `crossed` makes of parents, with mutated weights; a structural mutation of it.

    Kinship: whether there are two parents; whether the fitter one is the first, as one alone is;
    whether they are of different species; whether they have the same number.
    """
    two, in_order, interspecies, same = kinship
    multipoint_prob, mate_only_prob, keep_all_genes, shares, coefficients, rates = means
    mutates = True
    if two:
        average = rng.random() >= multipoint_prob
        keep = keep_all_genes or interspecies
        child, new, joined = crossed(rng, fitter, other, in_order, average, keep, shares)
        mated_only = rng.random() < mate_only_prob
        mutates = not mated_only or same or _alike(fitter[0], other[0], coefficients)
    else:
        child, new, joined = (fitter[0].copy(), fitter[1]), np.empty(0, np.int64), False
    mutation = _draw_mutation(rng, child, rates) if mutates else NO_MUTATION
    return child, new, joined, mutation


@inner_njit()
def _alike(first: Links, second: Links, coefficients: tuple[float, float, float, float]) -> bool:
    """Tell whether the distance of two genomes, with the coefficients of its settings, is 0."""
    disjoint, excess, weight, _ = coefficients
    in_first, in_second = matching(first["innovation"], second["innovation"])
    for match in range(in_first.size):
        differs = first[in_first[match]].weight != second[in_second[match]].weight
        if weight > 0.0 and differs:
            return False
    extra, beyond = first.size + second.size - 2 * in_first.size, 0
    for own, other in ((first, second), (second, first)):
        for link in own:
            beyond += other.size == 0 or link.innovation > other[-1].innovation
    return disjoint * (extra - beyond) + excess * beyond == 0.0


@outer_njit()
def crossed(
    rng: np.random.Generator,
    fitter: Packed,
    other: Packed,
    in_order: bool,
    average: bool,
    keep_all_genes: bool,
    shares: tuple[float, bool],
) -> tuple[Packed, GeneNumbers, bool]:
    """Return a child's genes; which nodes of the other parent are new in them; whether any gene is.

    Where none is, only weights and `enabled` are other than those of the fitter parent. It is the
    first one `in_order`. `shares` are those of `CrossoverConfig`.
    """
    disabled_prob, copy_disabled = shares
    ours, theirs, child = fitter[0], other[0], fitter[0].copy()
    own, others = matching(ours["innovation"], theirs["innovation"])
    choice, spared = rng.random(0 if average else own.size), rng.random(own.size)
    for match in range(own.size):
        at, a, b = own[match], ours[own[match]], theirs[others[match]]
        on = (a.enabled and b.enabled) or spared[match] >= disabled_prob
        if average:
            # Halves are added, as the sum of two large float32 weights could overflow.
            child[at].weight = np.float32(0.5) * a.weight + np.float32(0.5) * b.weight
        else:
            from_other = (choice[match] < 0.5) == in_order
            child[at].weight = b.weight if from_other else a.weight
            on = on and (not copy_disabled or (b.enabled if from_other else a.enabled))
        child[at].enabled = on
    if keep_all_genes and own.size < theirs.size:
        return _with_extra_genes((child, fitter[1]), other)
    return (child, fitter[1]), np.empty(0, np.int64), False


@outer_njit()
def matching(first: GeneNumbers, second: GeneNumbers) -> tuple[GeneNumbers, GeneNumbers]:
    """Return the indices [matches] into two sorted lists of innovations that both have."""
    size = min(first.size, second.size)
    in_first, in_second = np.empty(size, np.int64), np.empty(size, np.int64)
    i = j = matches = 0
    while i < first.size and j < second.size:
        if first[i] == second[j]:
            in_first[matches], in_second[matches] = i, j
            matches += 1
        step_first, step_second = first[i] <= second[j], second[j] <= first[i]
        i += step_first
        j += step_second
    return in_first[:matches], in_second[:matches]


@inner_njit()
def _with_extra_genes(child: Packed, other: Packed) -> tuple[Packed, GeneNumbers, bool]:
    """Return a child with another genome's extra genes too, unless that makes a cycle."""
    (ours, our_nodes), (theirs, their_nodes) = child, other
    own, nodes = our_nodes.size, our_nodes.size
    joined, new = np.empty(their_nodes.size, np.int64), np.empty(their_nodes.size, np.int64)
    for node in range(joined.size):
        at, node_id = node, their_nodes[node].node_id  # mostly
        if node >= own or our_nodes[node].node_id != node_id:
            at = 0
            while at < own and our_nodes[at].node_id != node_id:
                at += 1
        joined[node] = at if at < own else nodes
        nodes += at == own
    theirs = theirs.copy()
    for link in theirs:
        link.source, link.target = joined[link.source], joined[link.target]
    links = _united(ours, theirs)
    if node_levels(*_forward_links(links), nodes) is None:
        return child, new[:0], False
    index = np.zeros(nodes, np.int64)
    for link in links:
        index[link.source] = index[link.target] = 1
    all_nodes, nodes = np.empty(nodes, NODE_GENE), own
    for node in range(own):
        all_nodes[node], index[node] = our_nodes[node], node
    for node in range(joined.size):
        if joined[node] >= own and index[joined[node]]:
            all_nodes[nodes], new[nodes - own], index[joined[node]] = their_nodes[node], node, nodes
            nodes += 1
    for link in links:
        link.source, link.target = index[link.source], index[link.target]
    return (links, all_nodes[:nodes]), new[: nodes - own], True


@inner_njit()
def _united(child: Links, other: Links) -> Links:
    """Return the links, in order, of a child that gets those of another genome.

    All ends are nodes of the child. Matching genes are the child's. Of rivals the older remains:
    links from the same node to the same node that are both recurrent or both forward; forward
    ones are rivals in opposite directions too. No genome holds rivals of its own.
    """
    gone, extra, older = np.zeros(child.size, np.bool_), np.zeros(other.size, np.bool_), 0
    for new in range(other.size):
        gene = other[new]
        while older < child.size and child[older].innovation < gene.innovation:
            older += 1
        if older < child.size and child[older].innovation == gene.innovation:
            continue
        extra[new] = True
        for old in range(child.size):
            same = child[old].source == gene.source and child[old].target == gene.target
            opposite = child[old].source == gene.target and child[old].target == gene.source
            rivals = same or (opposite and not gene.recurrent)
            if rivals and child[old].recurrent == gene.recurrent:
                extra[new] &= old >= older
                gone[old] |= old >= older
    links, i, j, size = np.empty(child.size + other.size, LINK_GENE), 0, 0, 0
    while i < child.size or j < other.size:
        if j == other.size or (i < child.size and child[i].innovation < other[j].innovation):
            links[size] = child[i]
            size += not gone[i]
            i += 1
        else:
            links[size] = other[j]
            size += extra[j]
            j += 1
    return links[:size]


@inner_njit()
def _draw_mutation(rng: np.random.Generator, genes: Packed, rates: Rates) -> Mutation:
    """Mutate weights and `enabled` of links, or return which other mutation the genes have instead.

    A structural mutation is the only one that they get.
    """
    links = genes[0]
    if rng.random() < rates.add_node_prob:
        return _drawn_split(rng, genes, rates)
    if rng.random() < rates.add_link_prob:
        return _drawn_link(rng, genes, rates)
    if rates.remove_link_prob and rng.random() < rates.remove_link_prob:
        enabled = np.int64(0)
        for link in links:
            enabled += link.enabled
        left = _drawn_below(rng, enabled)
        for one in range(links.size):
            left -= links[one].enabled
            if left < 0:
                return REMOVED, float(one), 0.0, 0.0
        return NO_MUTATION
    if rng.random() < rates.link_weights_prob:
        shake(rng, links, rates)
    if rng.random() < rates.toggle_enable_prob and links.size:
        # A link is only switched off if its source keeps another enabled link.
        chosen, kept = links[_drawn_below(rng, links.size)], False
        chosen.enabled = not chosen.enabled
        for link in links:
            kept |= link.enabled and link.source == chosen.source
        chosen.enabled = chosen.enabled or not kept
    if rng.random() < rates.reenable_prob:
        for link in links:
            if not link.enabled:
                link.enabled = True
                break
    return WEIGHTS, 0.0, 0.0, 0.0


@outer_njit()
def shake(rng: np.random.Generator, genes: Links, rates: Rates) -> None:
    """Mutate the weights of links.

    Scheme "opennero" (`Genome::mutate_link_weights` there): half of the mutations are severe,
    with 70 % of the weights moved, 20 % new, 10 % kept; in the others the last fifth of a
    genome of 10 genes or more has 50 % moved, 20 % new, 30 % kept, and all older genes move.
    """
    power, cap, links = rates.weight_mutation_power, rates.max_link_weight, genes.size
    shifts, choice = rng.random(links), rng.random(links)
    old, young = (0.0, 0.0), (0.3, 0.2) if links >= 10 else (0.0, 0.0)  # shares kept and new
    if rates.uniform:
        old = young = (0.0, rates.weight_replace_prob)
    elif rng.random() < 0.5:  # severe
        old = young = (0.1, 0.2)
    for link in range(links):
        kept, replaced = young if link > 0.8 * links else old
        # choice: [0, kept) keeps, [kept, kept + replaced) replaces, the rest moves.
        weight = np.float64(genes[link].weight)
        if choice[link] >= kept:
            shift = 2.0 * power * shifts[link] - power
            weight = weight + shift if choice[link] >= kept + replaced else shift
        genes[link].weight = min(max(weight, -cap), cap)


@inner_njit()
def _drawn_split(rng: np.random.Generator, genes: Packed, rates: Rates) -> Mutation:
    """Choose an enabled link, not of the bias, to be split."""
    (links, nodes), steps = genes, -1
    if links.size and links.size >= rates.split_old_below:
        tries = np.empty(int(rates.split_tries), np.int64)
        for one in range(tries.size):
            tries[one] = _drawn_below(rng, links.size)
        for link in tries:
            if links[link].enabled and nodes[links[link].source].kind != _BIAS:
                return NODE, float(link), 0.0, 0.0
        return NO_MUTATION
    # The first enabled one, or each next one with probability 0.3. As in the code of Stanley &
    # Miikkulainen 2002, chance may end at a disabled link or beyond the last: none is split.
    for link in range(links.size):
        if nodes[links[link].source].kind == _BIAS:
            continue
        if steps < 0 and links[link].enabled:
            steps, share, total, chance = 1, 0.7, 0.7, rng.random()  # `rng.geometric(0.7)`
            while chance > total:
                share *= 1.0 - 0.7
                steps, total = steps + 1, total + share
        steps -= steps > 0
        if steps == 0:
            return (NODE, float(link), 0.0, 0.0) if links[link].enabled else NO_MUTATION
    return NO_MUTATION


@inner_njit()
def _drawn_link(rng: np.random.Generator, genes: Packed, rates: Rates) -> Mutation:
    """Choose two nodes to be linked, and a weight.

    A link is recurrent if its target already reaches its source by forward links, enabled or
    not, so that the forward links never form a cycle; or if it leaves an output, unless
    `forward_from_outputs`.
    """
    links, nodes = genes
    recurrent, tries = rng.random() < rates.recurrent_link_prob, int(rates.new_link_tries)
    sources, targets = np.empty(tries, np.int64), np.empty(tries, np.int64)
    for one in range(tries):
        sources[one] = _drawn_below(rng, nodes.size)
    enterable, size = np.empty(nodes.size, np.int64), np.int64(0)
    for node in range(nodes.size):
        enterable[size] = node
        size += nodes[node].kind > _BIAS
    for one in range(tries):
        targets[one] = enterable[_drawn_below(rng, size)]
    for one in range(tries if recurrent else 0):
        if rng.random() < rates.recurrent_loop_prob:
            sources[one] = targets[one]
    power = rates.new_link_weight_power
    weight = 2.0 * power * rng.random() - power
    forward = _forward_links(links)
    for one in range(tries):
        source, target, taken = sources[one], targets[one], False
        for link in links:
            same = link.source == source and link.target == target
            taken |= same and link.recurrent == recurrent
        kind, recurs = nodes[source].kind, source == target
        if kind > _BIAS and not (taken or recurs):
            recurs = kind == _OUTPUT and not rates.forward_from_outputs
            recurs = recurs or reaches(*forward, nodes.size, target, source)
        if not taken and recurs == recurrent:
            return RECURRENT if recurrent else FORWARD, float(source), float(target), weight
    return NO_MUTATION
