"""One genome of an OpenNERO team: from its lines to a `Genome`, and from a `Genome` to its lines.

The lines are those of OpenNERO's `Population::print_to_file` and `Genome` (2011 to 2014).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind
from neatq_torch.kinds import ConfigError

TEAM_INPUTS = 18
"""Inputs of every genome; the bias is the 19th sensor."""
TEAM_SCHEMAS = {2: "opennero-2011", 4: "opennero-2014"}
"""What is observed, by the number of outputs: speed and turn; since 2014 fire, ignore friends."""
NODE_PLACES: dict[tuple[int | None, int | None], NodeKind] = {
    (0, 0): NodeKind.HIDDEN,
    (1, 1): NodeKind.INPUT,
    (0, 2): NodeKind.OUTPUT,
    (1, 3): NodeKind.BIAS,
}
"""Kinds of nodes by type (1: sensor) and place, as a node line has them."""
TOO_HEAVY = 2.0**128 - 2.0**103
"""The smallest weight that float32 rounds to infinity."""
_SENSORS = (NodeKind.INPUT, NodeKind.BIAS)
_LONGEST = 100
"""Characters of a number, so that nobody pays for one of a million digits."""


class TeamFileError(ConfigError):
    """A team file is damaged or none; the message names it, the line and how to mend it."""


class TeamNotes:
    """What was left out or mended: the first of each kind, and how many followed it."""

    def __init__(self) -> None:
        self._first: dict[str, str] = {}
        self._more: dict[str, int] = {}

    def add(self, kind: str, where: str, text: str) -> None:
        """Note what was found at a line, unless something of its kind is noted already."""
        self._more[kind] = self._more.get(kind, -1) + 1
        self._first.setdefault(kind, f"{where}: {text}")

    def sentences(self) -> tuple[str, ...]:
        """One sentence for each kind, in the order in which they were found."""
        counts = {kind: f" (and {more:,} more like it)" for kind, more in self._more.items()}
        return tuple(
            f"{text}{counts[kind] if self._more[kind] else ''}."
            for kind, text in self._first.items()
        )


@dataclass(kw_only=True)
class GenomeLines:
    """A genome as it stands in a file: lines as (where, words)."""

    start: str
    words: list[str]
    nodes: list[tuple[str, list[str]]] = field(default_factory=list)
    genes: list[tuple[str, list[str]]] = field(default_factory=list)

    @property
    def name(self) -> str:
        """What the file calls it."""
        return clipped(self.words[1:2])


@dataclass(kw_only=True, slots=True)
class TeamGene:
    """A gene line; the innovation is None if it is no whole number of 64 bits."""

    where: str
    source: int
    target: int
    weight: float
    recurrent: bool
    innovation: int | None
    enabled: bool


def clipped(words: Iterable[str]) -> str:
    """Words of a file as they stand in a message."""
    text = " ".join(word[:_LONGEST] for word in words)
    return repr(text if len(text) <= _LONGEST else f"{text[:_LONGEST]}...")


def real_number(word: str) -> float | None:
    """The number that a word writes, be it infinite; None for other words."""
    if len(word) > _LONGEST or "_" in word or not word.isascii():
        return None
    try:
        return float(word)
    except ValueError:
        return None


def whole_number(word: str) -> int | None:
    """The whole number that a word writes, also as 7000.0; None for other words."""
    if word.isdecimal() and word.isascii() and len(word) <= _LONGEST:  # most are
        return int(word)
    number = real_number(word)
    if number is None or not number.is_integer():
        return None
    try:
        return int(word)
    except ValueError:  # written as a float, which is exact below 2^53
        return int(number) if abs(number) < 2**53 else None


def has_bits(number: int | None, bits: int) -> bool:
    """Whether a whole number fits into so many bits, of which one is its sign."""
    return number is not None and -(2 ** (bits - 1)) <= number < 2 ** (bits - 1)


def genome_of_lines(lines: GenomeLines, notes: TeamNotes) -> Genome:
    """Return the genome that lines describe.

    Raises:
        TeamFileError: beginning with the line.
    """
    nodes = _nodes_of(lines, notes)
    genes = [_gene_of(where, words) for where, words in lines.genes]
    genes = _numbered([gene for gene in genes if _is_of_use(gene, nodes, notes)], lines, notes)
    _mark_recurrent(genes, nodes, lines, notes)
    genes = _without_copies(genes, notes)
    kinds = list(nodes.values())
    sigmoid, identity = ACTIVATIONS.index("sigmoid"), ACTIVATIONS.index("identity")
    return Genome(
        genome_id=_genome_id(lines),
        observation_schema=TEAM_SCHEMAS[kinds.count(NodeKind.OUTPUT)],
        node_id=np.array(list(nodes), np.int32),
        node_kind=np.array(kinds, np.uint8),
        node_activation=np.array([identity if k in _SENSORS else sigmoid for k in kinds], np.uint8),
        link_innovation=np.array([gene.innovation for gene in genes], np.int64),
        link_source=np.array([gene.source for gene in genes], np.int32),
        link_target=np.array([gene.target for gene in genes], np.int32),
        link_weight=np.array([gene.weight for gene in genes], np.float32),
        link_enabled=np.array([gene.enabled for gene in genes], np.bool_),
        link_recurrent=np.array([gene.recurrent for gene in genes], np.bool_),
    )


def _genome_id(lines: GenomeLines) -> int:
    number = whole_number(lines.words[1]) if len(lines.words) > 1 else None
    if number is None or not has_bits(number, 32):
        raise TeamFileError(
            f"{lines.start}: expected genomestart and a whole number of 32 bits, got "
            f"{clipped(lines.words)}; give the genome any such number."
        )
    return number


def _nodes_of(lines: GenomeLines, notes: TeamNotes) -> dict[int, NodeKind]:
    """Kinds by id. In OpenNERO all genes of an id mean one node: a second one does nothing."""
    nodes: dict[int, NodeKind] = {}
    for where, words in lines.nodes:
        number, kind = _node_of(where, words)
        if kind == NodeKind.HIDDEN and number in nodes:
            text = f"the hidden node was left out, because an earlier one has the id {number}, too"
            notes.add("node copy", where, text)
        elif number in nodes:
            raise TeamFileError(
                f"{where}: expected an input, bias or output with an id of its own, got {number} "
                "again; remove the line or give the node another id."
            )
        else:
            nodes[number] = kind
    if fault := interface_fault(list(nodes.values())):
        raise TeamFileError(f"{lines.start}: {fault}")
    return nodes


def _node_of(where: str, words: list[str]) -> tuple[int, NodeKind]:
    """Id and kind; what follows the place is a function (or a sensor), which changes nothing."""
    number, _, sensor, place = [whole_number(word) for word in [*words[1:5], *[""] * 4][:4]]
    kind = NODE_PLACES.get((sensor, place))
    if kind is not None and number is not None and has_bits(number, 32):
        return number, kind
    raise TeamFileError(
        f"{where}: expected node, its id, its trait, its type and its place (0 0 for a hidden "
        "node, 1 1 for an input, 0 2 for an output, 1 3 for the bias), all whole numbers of 32 "
        f"bits; got {clipped(words)}; mend the line."
    )


def interface_fault(kinds: Sequence[int]) -> str:
    """What is wrong with the kinds of nodes for OpenNERO, in their order; "" if nothing."""
    names = {NodeKind.INPUT: "inputs", NodeKind.BIAS: "biases", NodeKind.OUTPUT: "outputs"}
    counts = {kind: sum(one == kind for one in kinds) for kind in names}
    inputs, biases, outputs = counts.values()
    if (inputs, biases) != (TEAM_INPUTS, 1) or outputs not in TEAM_SCHEMAS:
        came = ", ".join(f"{count} {names[kind]}" for kind, count in counts.items())
        return (
            f"expected {TEAM_INPUTS} inputs, 1 bias and 2 outputs (4 since 2014), got {came}; add "
            "the node lines that are missing, or take out those that are too many."
        )
    if NodeKind.INPUT in kinds[kinds.index(NodeKind.BIAS) :]:
        return (
            "expected the bias behind the inputs, got an input behind it; OpenNERO feeds its "
            "sensors in their order and the bias last: give place 3 to the last of them."
        )
    return ""


def _gene_of(where: str, words: list[str]) -> TeamGene:
    if len(words) < 9:
        raise TeamFileError(
            f"{where}: expected gene, trait, source, target, weight, recurrent, innovation, "
            f"mutation and enabled, got {clipped(words)}; complete the line or remove it."
        )
    ends = [_whole_word(where, word, "the id of a node") for word in words[2:4]]
    weight = real_number(words[4])
    if weight is None or not abs(weight) < TOO_HEAVY:
        raise TeamFileError(
            f"{where}: expected a weight that is a finite float32 number, got "
            f"{clipped([words[4]])}; write a smaller one or remove the gene."
        )
    marking = whole_number(words[6])
    return TeamGene(
        where=where,
        source=ends[0],
        target=ends[1],
        weight=float(np.float32(weight)),
        recurrent=_flag_word(where, words[5], "recurrent"),
        innovation=marking if has_bits(marking, 64) else None,
        enabled=_flag_word(where, words[8], "enabled"),
    )


def _whole_word(where: str, word: str, noun: str) -> int:
    number = whole_number(word)
    if number is None:
        raise TeamFileError(
            f"{where}: expected {noun}, a whole number, got {clipped([word])}; mend the number."
        )
    return number


def _flag_word(where: str, word: str, noun: str) -> bool:
    number = whole_number(word)
    if number not in (0, 1):
        raise TeamFileError(
            f"{where}: expected 0 or 1 for {noun}, got {clipped([word])}; write one of them."
        )
    return number == 1


def _is_of_use(gene: TeamGene, nodes: dict[int, NodeKind], notes: TeamNotes) -> bool:
    unknown = [end for end in (gene.source, gene.target) if end not in nodes]
    leads = f"the gene from {gene.source} to {gene.target}"
    if unknown:
        text = f"{leads} was left out, because the genome has no node {unknown[0]}"
        notes.add("unknown node", gene.where, text)
    elif nodes[gene.target] in _SENSORS:
        text = f"{leads} was left out, because nothing flows into an input or bias"
        notes.add("into sensor", gene.where, text)
    else:
        return True
    return False


def _numbered(genes: list[TeamGene], lines: GenomeLines, notes: TeamNotes) -> list[TeamGene]:
    """The genes by innovation; numbered in their order where innovations do not tell them apart."""
    markings = [gene.innovation for gene in genes]
    if None in markings or len(set(markings)) < len(markings):
        text = "whose innovation numbers are not whole or not unique, had its links numbered anew"
        notes.add("innovations", lines.start, f"genome {lines.name}, {text}")
        for marking, gene in enumerate(genes, 1):
            gene.innovation = marking
    return sorted(genes, key=lambda gene: gene.innovation or 0)


def _mark_recurrent(
    genes: list[TeamGene], nodes: Iterable[int], lines: GenomeLines, notes: TeamNotes
) -> None:
    """Mark the links that lead back on a walk into the depth, inputs first, along the genes.

    OpenNERO's networks do the same with and without the mark, because every link there carries the
    output of the step before.
    """
    leaving: dict[int, list[TeamGene]] = {node: [] for node in nodes}
    for gene in reversed(genes):
        if not gene.recurrent:
            leaving[gene.source].append(gene)
    met: set[int] = set()
    left: set[int] = set()
    for root in leaving:
        path = [root]
        while path:
            met.add(path[-1])
            if not leaving[path[-1]]:
                left.add(path.pop())
                continue
            gene = leaving[path[-1]].pop()
            if gene.target not in met:
                path.append(gene.target)
            elif gene.target not in left:
                gene.recurrent = True
                text = f"gene from {gene.source} to {gene.target}, which closes a cycle"
                notes.add("cycle", gene.where, f"the {text}, was marked as recurrent")


def _without_copies(genes: list[TeamGene], notes: TeamNotes) -> list[TeamGene]:
    """One gene for each (source, target, recurrent), together as strong as all were."""
    taken: dict[tuple[int, int, bool], TeamGene] = {}
    for gene in genes:
        key = gene.source, gene.target, gene.recurrent
        first = taken.get(key)
        if first and first.enabled and gene.enabled and not gene.recurrent:
            gene.recurrent = True
            text = f"the gene is a second one from {gene.source} to {gene.target}"
            notes.add("second", gene.where, f"{text}, and was marked as recurrent to keep both")
            key = gene.source, gene.target, True
            first = taken.get(key)
        taken[key] = gene if first is None else _merged_gene(first, gene, notes)
    return sorted(taken.values(), key=lambda gene: gene.innovation or 0)


def _merged_gene(first: TeamGene, second: TeamGene, notes: TeamNotes) -> TeamGene:
    ends = f"from {first.source} to {first.target}"
    if not (first.enabled and second.enabled):
        kept, lost = (second, first) if second.enabled else (first, second)
        text = f"the gene, which is disabled, was left out, because another leads {ends}"
        notes.add("disabled copy", lost.where, text)
        return kept
    weight = first.weight + second.weight
    if not abs(weight) < TOO_HEAVY:
        raise TeamFileError(
            f"{second.where}: expected genes {ends} whose weights add up to a finite float32 "
            f"number, got {first.weight:g} and {second.weight:g}; remove one of them."
        )
    text = f"the weight of the gene was added to that of another {ends}"
    notes.add("summed", second.where, text)
    first.weight = float(np.float32(weight))
    return first


def lines_of_genome(genome: Genome) -> list[str]:
    """The genome in the words of OpenNERO, one line each; weights keep their float32 bits."""
    words = {kind: f"{sensor} {place}" for (sensor, place), kind in NODE_PLACES.items()}
    lines = [f"genomestart {genome.genome_id}", f"trait 1{' 0' * 8}"]
    for node, kind in zip(genome.node_id.tolist(), genome.node_kind.tolist(), strict=True):
        lines.append(f"node {node} 1 {words[kind]} 0")
    names = "source", "target", "weight", "recurrent", "innovation", "enabled"
    columns = [getattr(genome, f"link_{name}").tolist() for name in names]
    for source, target, weight, recurrent, innovation, enabled in zip(*columns, strict=True):
        flow = f"{source} {target} {weight:.9g} {recurrent:d}"
        lines.append(f"gene 1 {flow} {innovation} 0 {enabled:d}")
    return [*lines, f"genomeend {genome.genome_id}"]
