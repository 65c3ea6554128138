"""Heredity: how genes become those of a child, as compiled loops.

One file, as numba does not notice changes of what compiled functions call in others.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.genes import GeneNumbers, Genes, Herd, Means, NodeIndices, Rates
from neatq_torch.jit import cached_njit

Mutation = tuple[float, float, float, float]
"""What compiled code chose: a kind; the link, or source and target node, as indices; a weight."""

NOTHING, WEIGHTS, NODE, FORWARD, RECURRENT, REMOVED = map(float, range(6))
"""Kinds of mutations: a structural one that was not possible, none of the structure, the others."""

NO_MUTATION = NOTHING, 0.0, 0.0, 0.0
_BIAS, _OUTPUT = 1, 2  # of `NodeKind`

inner_njit = partial(cached_njit, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""For what is called by compiled code alone: without what Python would need it compiles faster."""


@cached_njit()
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


@cached_njit()
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
    return int(rng.integers(0, end))


@inner_njit()
def _genes_at(herd: Herd, genome: int) -> Genes:
    genes, first, last = herd.genes, herd.links[genome], herd.links[genome + 1]
    links = genes.innovation[first:last], genes.weight[first:last], genes.enabled[first:last]
    ends = genes.recurrent[first:last], genes.source[first:last], genes.target[first:last]
    first, last = herd.nodes[genome], herd.nodes[genome + 1]
    return Genes(*links, *ends, genes.node_id[first:last], genes.kind[first:last])


@cached_njit()
def born(
    rng: np.random.Generator, herd: Herd, home: GeneNumbers, means: Means
) -> tuple[NDArray[np.float32], NDArray[np.bool_], GeneNumbers, Any, Genes, GeneNumbers, bool]:
    """Let children of species `home` [children] be born until one is not only its fitter parent's.

    Returns weights and `enabled` of each, padded rows; its parents: who passes on its genes, the
    other one, the fitter one and the less fit one, -1 for none; its `Mutation`; and what `crossed`
    says of the last one that is born, with genes of both parents.
    """
    sizes = herd.links[1:] - herd.links[:-1]
    width = sizes.max()
    weight = np.empty((home.size, width), np.float32)
    enabled = np.empty((home.size, width), np.bool_)
    parents, mutations = np.empty((home.size, 4), np.int64), np.empty((home.size, 4))
    (mutate_only_prob, interspecies_prob), conception = means
    bounds, fitness, species = herd.homes, herd.fitness, herd.homes.size - 1
    child = 0
    while True:
        low, high = bounds[home[child]], bounds[home[child] + 1]
        first = second = low + _drawn_below(rng, high - low)
        two, outside = high - low > 1 and rng.random() >= mutate_only_prob, False
        if two:
            outside = species > 1 and rng.random() < interspecies_prob
            if outside:
                other = _drawn_below(rng, species - 1)
                second = bounds[other + (other >= home[child])]
            else:
                second = low + _drawn_below(rng, high - low)
        fitter = not two or fitness[first] > fitness[second]
        fitter |= fitness[first] == fitness[second] and sizes[first] < sizes[second]
        base, other = (first, second) if fitter else (second, first)
        one, another = (first, second) if fitness[first] >= fitness[second] else (second, first)
        parents[child, 0], parents[child, 1], parents[child, 2] = base, other, one
        parents[child, 3] = another if two else -1
        kinship = two, fitter, outside, herd.genome_id[first] == herd.genome_id[second]
        couple = _genes_at(herd, base), _genes_at(herd, other)
        genes, new, joined, mutation = conceived(rng, *couple, kinship, conception)
        for part in range(4):
            mutations[child, part] = mutation[part]
        for link in range(0 if joined else genes.weight.size):
            weight[child, link], enabled[child, link] = genes.weight[link], genes.enabled[link]
        child += 1
        if joined or child == home.size:
            return weight, enabled, parents[:child], mutations, genes, new, joined


@cached_njit()
def conceived(
    rng: np.random.Generator,
    fitter: Genes,
    other: Genes,
    kinship: tuple[bool, bool, bool, bool],
    means: Means,
) -> tuple[Genes, GeneNumbers, bool, Mutation]:
    """Return what `crossed` makes of parents, with mutated weights; a structural mutation of it.

    Kinship: whether there are two parents; whether the fitter one is the first, as one alone is;
    whether they are of different species; whether they have the same number.
    """
    two, in_order, interspecies, same = kinship
    multipoint_prob, mate_only_prob, keep_all_genes, shares, coefficients, rates = means
    mutation, mutates = NO_MUTATION, True
    if two:
        average = rng.random() >= multipoint_prob
        keep = keep_all_genes or interspecies
        child, new, joined = crossed(rng, fitter, other, in_order, average, keep, shares)
        mated_only = rng.random() < mate_only_prob
        mutates = not mated_only or same or _alike(fitter, other, coefficients)
    else:
        child, new, joined = _copied(fitter), np.empty(0, np.int64), False
    if mutates:
        mutation = _draw_mutation(rng, child, rates)
    return child, new, joined, mutation


@inner_njit()
def _alike(first: Genes, second: Genes, coefficients: tuple[float, float, float, float]) -> bool:
    """Tell whether the distance of two genomes, with the coefficients of its settings, is 0."""
    disjoint, excess, weight, _ = coefficients
    in_first, in_second = matching(first.innovation, second.innovation)
    if weight > 0.0 and (first.weight[in_first] != second.weight[in_second]).any():
        return False
    extra, beyond = first.weight.size + second.weight.size - 2 * in_first.size, 0
    for own, other in (
        (first.innovation, second.innovation),
        (second.innovation, first.innovation),
    ):
        beyond += (own > other[-1]).sum() if other.size else own.size
    return disjoint * (extra - beyond) + excess * beyond == 0.0


@inner_njit()
def _copied(genes: Genes) -> Genes:
    """Return the same genes, to be written to."""
    ends = genes.source.copy(), genes.target.copy()
    links = genes.innovation.copy(), genes.weight.copy(), genes.enabled.copy()
    return Genes(*links, genes.recurrent.copy(), *ends, genes.node_id.copy(), genes.kind.copy())


@cached_njit()
def crossed(
    rng: np.random.Generator,
    fitter: Genes,
    other: Genes,
    in_order: bool,
    average: bool,
    keep_all_genes: bool,
    shares: tuple[float, bool],
) -> tuple[Genes, GeneNumbers, bool]:
    """Return a child's genes; which nodes of the other parent are new in them; whether any gene is.

    Where none is, only weights and `enabled` are other than those of the fitter parent. It is the
    first one `in_order`. `shares` are those of `CrossoverConfig`.
    """
    disabled_prob, copy_disabled = shares
    own, others = matching(fitter.innovation, other.innovation)
    choice, spared = rng.random(0 if average else own.size), rng.random(own.size)
    child = _copied(fitter)
    for match in range(own.size):
        a, b = own[match], others[match]
        on = (fitter.enabled[a] and other.enabled[b]) or spared[match] >= disabled_prob
        if average:
            # Halves are added, as the sum of two large float32 weights could overflow.
            half = np.float32(0.5)
            child.weight[a] = fitter.weight[a] * half + other.weight[b] * half
        else:
            from_other = (choice[match] < 0.5) == in_order
            if from_other:
                child.weight[a] = other.weight[b]
            if copy_disabled:
                on = on and (other.enabled[b] if from_other else fitter.enabled[a])
        child.enabled[a] = on
    if keep_all_genes and own.size < other.innovation.size:
        return _with_extra_genes(child, other)
    return child, np.empty(0, np.int64), False


@cached_njit()
def matching(first: GeneNumbers, second: GeneNumbers) -> tuple[GeneNumbers, GeneNumbers]:
    """Return the indices [matches] into two sorted lists of innovations that both have."""
    in_first = np.empty(min(first.size, second.size), np.int64)
    in_second = np.empty_like(in_first)
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
def _with_extra_genes(child: Genes, other: Genes) -> tuple[Genes, GeneNumbers, bool]:
    """Return a child with another genome's extra genes too, unless that makes a cycle."""
    own, nodes = child.node_id.size, child.node_id.size
    joined, new = np.empty(other.node_id.size, np.int64), np.empty(other.node_id.size, np.int64)
    for node in range(joined.size):
        at = node  # mostly
        if node >= own or child.node_id[node] != other.node_id[node]:
            at = 0
            while at < own and child.node_id[at] != other.node_id[node]:
                at += 1
        joined[node] = at if at < own else nodes
        nodes += at == own
    kept, links = _united(child, other, joined), child.weight.size
    size = kept.size
    innovation, weight = np.empty(size, np.int64), np.empty(size, np.float32)
    enabled, recurrent = np.empty(size, np.bool_), np.empty(size, np.bool_)
    source, target = np.empty(size, np.int64), np.empty(size, np.int64)
    for link in range(size):
        at = kept[link]
        if at < links:
            innovation[link], weight[link] = child.innovation[at], child.weight[at]
            enabled[link], recurrent[link] = child.enabled[at], child.recurrent[at]
            source[link], target[link] = child.source[at], child.target[at]
        else:
            at -= links
            innovation[link], weight[link] = other.innovation[at], other.weight[at]
            enabled[link], recurrent[link] = other.enabled[at], other.recurrent[at]
            source[link], target[link] = joined[other.source[at]], joined[other.target[at]]
    if node_levels(source[~recurrent], target[~recurrent], nodes) is None:
        return child, new[:0], False
    index = np.full(nodes, -1)
    for link in range(size):
        index[source[link]] = index[target[link]] = 0
    nodes = own
    for node in range(joined.size):
        if joined[node] >= own and index[joined[node]] == 0:
            new[nodes - own], index[joined[node]] = node, nodes
            nodes += 1
    index[:own] = np.arange(own)
    new = new[: nodes - own]
    for link in range(size):
        source[link], target[link] = index[source[link]], index[target[link]]
    node_id = np.concatenate((child.node_id, other.node_id[new]))
    kind = np.concatenate((child.kind, other.kind[new]))
    return Genes(innovation, weight, enabled, recurrent, source, target, node_id, kind), new, True


@inner_njit()
def _united(child: Genes, other: Genes, joined: GeneNumbers) -> GeneNumbers:
    """Return which links, in order, a child has that gets those of another genome.

    The other's are counted on behind the child's; its node i is node `joined[i]` of the child.
    Matching genes are the child's. Of rivals the older remains: links from the same node to the
    same node that are both recurrent or both forward; forward ones are rivals in opposite
    directions too. No genome holds rivals of its own.
    """
    gone, extra = np.zeros(child.weight.size, np.bool_), np.zeros(other.weight.size, np.bool_)
    older = 0
    for new in range(extra.size):
        while older < gone.size and child.innovation[older] < other.innovation[new]:
            older += 1
        if older < gone.size and child.innovation[older] == other.innovation[new]:
            continue
        source, target = joined[other.source[new]], joined[other.target[new]]
        recurrent, extra[new] = other.recurrent[new], True
        for old in range(gone.size):
            same = child.source[old] == source and child.target[old] == target
            opposite = child.source[old] == target and child.target[old] == source
            if child.recurrent[old] == recurrent and (same or (opposite and not recurrent)):
                extra[new] &= old >= older
                gone[old] |= old >= older
    kept = np.empty(gone.size + extra.size, np.int64)
    i = j = size = 0
    while i < gone.size or j < extra.size:
        if j == extra.size or (i < gone.size and child.innovation[i] < other.innovation[j]):
            kept[size] = i
            size += not gone[i]
            i += 1
        else:
            kept[size] = gone.size + j
            size += extra[j]
            j += 1
    return kept[:size]


@cached_njit()
def mutated_copy(rng: np.random.Generator, genes: Genes, rates: Rates) -> tuple[Genes, Mutation]:
    """Return genes with mutated weights and `enabled`, or which other mutation they have instead.

    A structural mutation is the only one that they get.
    """
    child = _copied(genes)
    return child, _draw_mutation(rng, child, rates)


@inner_njit()
def _draw_mutation(rng: np.random.Generator, genes: Genes, rates: Rates) -> Mutation:
    """The same, but written to the genes."""
    if rng.random() < rates.add_node_prob:
        return _drawn_split(rng, genes, rates)
    if rng.random() < rates.add_link_prob:
        return _drawn_link(rng, genes, rates)
    if rates.remove_link_prob and rng.random() < rates.remove_link_prob:
        on = np.flatnonzero(genes.enabled)
        return (
            (REMOVED, float(on[_drawn_below(rng, on.size)]), 0.0, 0.0) if on.size else NO_MUTATION
        )
    if rng.random() < rates.link_weights_prob:
        shake(rng, genes.weight, rates)
    enabled = genes.enabled
    if rng.random() < rates.toggle_enable_prob and enabled.size:
        # A link is only switched off if its source keeps another enabled link.
        chosen = _drawn_below(rng, enabled.size)
        enabled[chosen] = not enabled[chosen]
        enabled[chosen] |= not (enabled & (genes.source == genes.source[chosen])).any()
    if rng.random() < rates.reenable_prob and not enabled.all():
        enabled[enabled.argmin()] = True
    return WEIGHTS, 0.0, 0.0, 0.0


@cached_njit()
def shake(rng: np.random.Generator, weights: NDArray[np.float32], rates: Rates) -> None:
    """Mutate weights [links].

    Scheme "opennero" (`Genome::mutate_link_weights` there): half of the mutations are severe,
    with 70 % of the weights moved, 20 % new, 10 % kept; in the others the last fifth of a
    genome of 10 genes or more has 50 % moved, 20 % new, 30 % kept, and all older genes move.
    """
    links = weights.size
    power, cap = rates.weight_mutation_power, rates.max_link_weight
    shift, choice = rng.uniform(-power, power, links), rng.random(links)
    old, young = (0.0, 0.0), (0.3, 0.2) if links >= 10 else (0.0, 0.0)  # shares kept and new
    if rates.uniform:
        old = young = (0.0, rates.weight_replace_prob)
    elif rng.random() < 0.5:  # severe
        old = young = (0.1, 0.2)
    for link in range(links):
        kept, replaced = young if link > 0.8 * links else old
        # choice: [0, kept) keeps, [kept, kept + replaced) replaces, the rest moves.
        weight = np.float64(weights[link])
        if choice[link] >= kept:
            moved = choice[link] >= kept + replaced
            weight = weight + shift[link] if moved else shift[link]
        weights[link] = min(max(weight, -cap), cap)


@inner_njit()
def _drawn_split(rng: np.random.Generator, genes: Genes, rates: Rates) -> Mutation:
    """Choose an enabled link, not of the bias, to be split."""
    links, steps = genes.weight.size, -1
    if links and links >= rates.split_old_below:
        tries = np.empty(int(rates.split_tries), np.int64)
        for one in range(tries.size):
            tries[one] = _drawn_below(rng, links)
        for link in tries:
            if genes.enabled[link] and genes.kind[genes.source[link]] != _BIAS:
                return NODE, float(link), 0.0, 0.0
        return NO_MUTATION
    # The first enabled one, or each next one with probability 0.3. As in the code of Stanley &
    # Miikkulainen 2002, chance may end at a disabled link or beyond the last: none is split.
    for link in range(links):
        if genes.kind[genes.source[link]] == _BIAS:
            continue
        if steps < 0 and genes.enabled[link]:
            steps = rng.geometric(0.7)
        steps -= steps > 0
        if steps == 0:
            return (NODE, float(link), 0.0, 0.0) if genes.enabled[link] else NO_MUTATION
    return NO_MUTATION


@inner_njit()
def _drawn_link(rng: np.random.Generator, genes: Genes, rates: Rates) -> Mutation:
    """Choose two nodes to be linked, and a weight.

    A link is recurrent if its target already reaches its source by forward links, enabled or
    not, so that the forward links never form a cycle; or if it leaves an output, unless
    `forward_from_outputs`.
    """
    recurrent, tries = rng.random() < rates.recurrent_link_prob, int(rates.new_link_tries)
    enterable = np.flatnonzero(genes.kind > _BIAS)
    pairs = np.empty((tries, 2), np.int64)
    for one in range(tries):
        pairs[one, 0] = _drawn_below(rng, genes.kind.size)
    for one in range(tries):
        pairs[one, 1] = enterable[_drawn_below(rng, enterable.size)]
    for one in range(tries if recurrent else 0):
        if rng.random() < rates.recurrent_loop_prob:
            pairs[one, 0] = pairs[one, 1]
    power = rates.new_link_weight_power
    weight = rng.uniform(-power, power)
    forward = genes.source[~genes.recurrent], genes.target[~genes.recurrent]
    for one in range(tries):
        source, target = pairs[one, 0], pairs[one, 1]
        taken = False
        for link in range(genes.weight.size):
            same = genes.source[link] == source and genes.target[link] == target
            taken |= same and genes.recurrent[link] == recurrent
        kind, recurs = genes.kind[source], source == target
        if kind > _BIAS and not (taken or recurs):
            recurs = kind == _OUTPUT and not rates.forward_from_outputs
            recurs = recurs or reaches(*forward, genes.kind.size, target, source)
        if not taken and recurs == recurrent:
            return RECURRENT if recurrent else FORWARD, float(source), float(target), weight
    return NO_MUTATION
