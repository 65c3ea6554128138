"""The genome: what is inherited, as frozen arrays of genes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.atomic import write_atomic
from neatq_torch.genome.genes import Genes
from neatq_torch.genome.rules import (
    ACTIVATIONS,
    LINK_FIELDS,
    NODE_FIELDS,
    GenomeError,
    NodeKind,
    check_genome,
    check_label,
    check_weights,
    frozen_array,
    index_of,
)
from neatq_torch.json_text import parse_json

COLUMNS = NODE_FIELDS | LINK_FIELDS
STRUCTURE = COLUMNS.keys() - {"link_weight", "link_enabled"}
FIELDS = frozenset({"genome_id", "observation_schema", *COLUMNS})

WORDS = {"node_kind": tuple(kind.name.lower() for kind in NodeKind), "node_activation": ACTIVATIONS}
"""Names of what numbers stand for, as a file has them."""

MOST_BYTES = 100_000_000
"""Of a file: room for a genome of a million links."""

Id = Annotated[int, msgspec.Meta(ge=-(2**31), lt=2**31)]
Marking = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]


class NodeColumns(msgspec.Struct, forbid_unknown_fields=True):
    """The nodes in a file, in the order of `NODE_FIELDS`."""

    id: list[Id]
    kind: list[str]
    activation: list[str]


class LinkColumns(msgspec.Struct, forbid_unknown_fields=True):
    """The links in a file, in the order of `LINK_FIELDS`."""

    innovation: list[Marking]
    source: list[Id]
    target: list[Id]
    weight: list[float]
    enabled: list[bool]
    recurrent: list[bool]


class GenomeFile(msgspec.Struct, forbid_unknown_fields=True):
    """A genome as JSON values: a list per column, so that large populations are small on disk.

    Float32 weights are written as float64 numbers, which JSON keeps exactly.
    """

    format: Literal["neatq-genome"]
    version: Literal[1]
    genome_id: Marking
    observation_schema: str
    nodes: NodeColumns
    links: LinkColumns


@dataclass(frozen=True, eq=False, kw_only=True)
class Genome:
    """Nodes and links of one network (Stanley & Miikkulainen 2002, section 3.1).

    Arrays are copied, made read-only and checked. Rules: at least one input and one output,
    at most one bias; links enter outputs and hidden nodes only; the links that are not
    recurrent, enabled or not, form no cycle; (source, target, recurrent) is unique.

    Attributes:
        genome_id: number of the genome in its run, an int64.
        observation_schema: name of the meaning and order of its inputs, "" if unspecified.
        node_id: int32 [nodes], unique. Inputs and outputs among the nodes, in the order of
            this array, are the observations and the outputs of the network.
        node_kind: uint8 [nodes], a `NodeKind`.
        node_activation: uint8 [nodes], index into `ACTIVATIONS`.
        link_innovation: int64 [links], strictly increasing historical markings.
        link_source: int32 [links], node id.
        link_target: int32 [links], node id.
        link_weight: float32 [links], finite.
        link_enabled: bool [links].
        link_recurrent: bool [links]; a recurrent link carries its source's previous output.

    Raises:
        GenomeError: a rule is broken; the message names the gene.

    Example:
        >>> genome = load_genome("champion.json")
        >>> nodes, links = genome.node_id.size, genome.link_enabled.sum()
    """

    genome_id: int
    observation_schema: str = ""
    node_id: NDArray[np.int32]
    node_kind: NDArray[np.uint8]
    node_activation: NDArray[np.uint8]
    link_innovation: NDArray[np.int64]
    link_source: NDArray[np.int32]
    link_target: NDArray[np.int32]
    link_weight: NDArray[np.float32]
    link_enabled: NDArray[np.bool_]
    link_recurrent: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for name, dtype in COLUMNS.items():
            array = frozen_array(name, getattr(self, name), dtype)
            object.__setattr__(self, name, array)
        check_genome(self)

    @cached_property
    def node_order(self) -> NDArray[np.intp]:
        """[nodes] node indices that sort the node ids."""
        return np.argsort(self.node_id, kind="stable")

    @cached_property
    def source_index(self) -> NDArray[np.intp]:
        """[links] index of each link's source in the node arrays."""
        return self.node_index(self.link_source)

    @cached_property
    def target_index(self) -> NDArray[np.intp]:
        """[links] index of each link's target in the node arrays."""
        return self.node_index(self.link_target)

    @cached_property
    def interface(self) -> tuple[bytes, bytes]:
        """Ids and kinds of the nodes that are not hidden, as bytes: quick to compare."""
        outer = self.node_kind != NodeKind.HIDDEN
        return self.node_id[outer].tobytes(), self.node_kind[outer].tobytes()

    @property
    def genes(self) -> Genes:
        """The genome for compiled code, which must not write to it."""
        links = self.link_innovation, self.link_weight, self.link_enabled, self.link_recurrent
        ends = self.source_index, self.target_index
        return Genes(*links, *ends, self.node_id, self.node_kind)

    @property
    def input_ids(self) -> NDArray[np.int32]:
        """Ids of the input nodes, in the order of the observations."""
        return self.node_id[self.node_kind == NodeKind.INPUT]

    @property
    def output_ids(self) -> NDArray[np.int32]:
        """Ids of the output nodes, in the order of the outputs."""
        return self.node_id[self.node_kind == NodeKind.OUTPUT]

    def node_index(self, ids: NDArray[np.int32]) -> NDArray[np.intp]:
        """Return the index of each node id in the node arrays; meaningless for unknown ids."""
        order = self.node_order
        ranks = np.searchsorted(self.node_id, ids, sorter=order)
        return order[np.minimum(ranks, order.size - 1)]

    def with_weights(self, weights: ArrayLike) -> Self:
        """Return the genome with other weights, float32 [links], kept bit for bit."""
        return self.unchecked(link_weight=self._link_column("link_weight", weights))

    def replaced(self, **changes: Any) -> Self:
        """Return a copy with some fields changed; GenomeError if it breaks a rule.

        Changes that leave the structure alone (id, schema, weights, enabled) are cheap.
        """
        unknown = changes.keys() - FIELDS
        if unknown:
            raise TypeError(f"a Genome has no field {sorted(unknown)[0]!r}.")
        if not STRUCTURE.isdisjoint(changes):
            return type(self)(**({name: getattr(self, name) for name in FIELDS} | changes))
        for name in changes.keys() & LINK_FIELDS.keys():
            changes[name] = self._link_column(name, changes[name])
        copy = self.unchecked(**changes)
        check_label(copy)
        return copy

    def unchecked(self, **changes: Any) -> Self:
        """Return a copy with some fields changed by somebody who keeps the rules.

        For operators on sound genomes whose result is sound by construction: a check would cost
        several times as much as the operator. New arrays have the right type and belong to
        nobody else; they become read-only here. A new structure starts with empty caches, but for
        `source_index` and `target_index` where they are given.
        """
        own = self.__dict__
        if not STRUCTURE.isdisjoint(changes):
            own = {name: own[name] for name in FIELDS}
        copy = object.__new__(type(self))
        copy.__dict__.update(own)
        copy.__dict__.update(changes)
        for name, value in changes.items():
            if name in COLUMNS:
                value.flags.writeable = False
        return copy

    def _link_column(self, name: str, value: ArrayLike) -> NDArray[Any]:
        column = frozen_array(name, value, LINK_FIELDS[name])
        if column.size != self.link_innovation.size:
            raise GenomeError(
                f"{name} must have one entry for each of the genome's "
                f"{self.link_innovation.size} links, not {column.size}."
            )
        if name == "link_weight":
            check_weights(self.link_innovation, column)
        return column

    def to_dict(self) -> dict[str, Any]:
        """Return the genome as JSON values; `from_dict` gives it back bit for bit."""
        columns = {name: getattr(self, name).tolist() for name in COLUMNS}
        for name, words in WORDS.items():
            columns[name] = [words[number] for number in columns[name]]
        nodes = NodeColumns(*(columns[name] for name in NODE_FIELDS))
        links = LinkColumns(*(columns[name] for name in LINK_FIELDS))
        header = "neatq-genome", 1, self.genome_id, self.observation_schema
        return msgspec.to_builtins(GenomeFile(*header, nodes, links))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the genome that `to_dict` wrote; GenomeError names a bad key or gene."""
        try:
            file = msgspec.convert(data, GenomeFile)
        except (msgspec.ValidationError, UnicodeError) as error:  # of half a character
            raise GenomeError(f"expected a neatq-genome of version 1: {error}.") from error
        genes = msgspec.structs.astuple(file.nodes) + msgspec.structs.astuple(file.links)
        columns = dict(zip(COLUMNS, genes, strict=True))
        for name, words in WORDS.items():
            places = enumerate(columns[name])
            columns[name] = [index_of(word, words, f"{name}[{at}]") for at, word in places]
        return cls(genome_id=file.genome_id, observation_schema=file.observation_schema, **columns)

    def to_json(self) -> str:
        """Return the genome as one line of JSON."""
        return json.dumps(self.to_dict(), allow_nan=False)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Return the genome that `to_json` wrote; GenomeError names a bad key or gene."""
        try:
            data = parse_json(text)
        except ValueError as error:
            raise GenomeError(f"the text is not valid JSON: {error}.") from error
        return cls.from_dict(data)


def save_genome(genome: Genome, path: str | Path) -> None:
    """Write the genome as JSON, whole or not at all.

    Example:
        >>> save_genome(genome, "champion.json")
    """
    write_atomic(Path(path), genome.to_json().encode())


def load_genome(path: str | Path, *, observation_schema: str | None = None) -> Genome:
    """Return the genome in a file, to be fed `observation_schema`; None accepts any.

    Raises:
        GenomeError: naming the file and what is wrong in it, or that it reads other observations.

    Example:
        >>> network = GenomeNetwork(load_genome("champion.json"))
    """
    try:
        size = Path(path).stat().st_size
        if size > MOST_BYTES:
            raise GenomeError(f"expected at most {MOST_BYTES:,} bytes, got {size:,}.")
        genome = Genome.from_json(Path(path).read_bytes())
    except GenomeError as error:
        raise GenomeError(f"{path}: {error}") from error
    if observation_schema not in (None, genome.observation_schema):
        raise GenomeError(
            f"{path}: the genome reads the observations {genome.observation_schema!r}, not "
            f"{observation_schema!r}; use the sensors that it was evolved with."
        )
    return genome


def pack_genomes(genomes: Sequence[Genome]) -> dict[str, Any]:
    """Return genomes as concatenated columns: every gene field over all genomes.

    With them go `genome_id`, `nodes` and `links` int64 [genomes] (the last two: how many genes each
    has) and `observation_schema` (one text each).
    """
    return {
        "genome_id": np.array([genome.genome_id for genome in genomes], np.int64),
        "observation_schema": [genome.observation_schema for genome in genomes],
        "nodes": np.array([genome.node_id.size for genome in genomes], np.int64),
        "links": np.array([genome.link_weight.size for genome in genomes], np.int64),
        **{name: np.concatenate([getattr(one, name) for one in genomes]) for name in COLUMNS},
    }


def unpack_genomes(packed: Mapping[str, Any]) -> list[Genome]:
    """Return the genomes that `pack_genomes` was given, bit for bit; each is checked again."""
    columns: dict[str, Any] = {
        name: np.split(packed[name], np.cumsum(packed[counts])[:-1])
        for counts, names in (("nodes", NODE_FIELDS), ("links", LINK_FIELDS))
        for name in names
    }
    columns["genome_id"] = [int(one) for one in packed["genome_id"]]
    columns["observation_schema"] = packed["observation_schema"]
    genomes = zip(*columns.values(), strict=True)
    return [Genome(**dict(zip(columns, fields, strict=True))) for fields in genomes]
