"""The genome: what is inherited, as frozen arrays of genes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from neatq_torch.atomic import write_atomic
from neatq_torch.genome import codec, validation
from neatq_torch.genome.vocabulary import ACTIVATIONS, GenomeError, NodeKind

__all__ = [
    "ACTIVATIONS",
    "Genome",
    "GenomeError",
    "NodeKind",
    "identical",
    "load_genome",
    "save_genome",
]

COLUMNS = validation.NODE_FIELDS | validation.LINK_FIELDS
STRUCTURE = COLUMNS.keys() - {"link_weight", "link_enabled"}
FIELDS = frozenset({"genome_id", "observation_schema", *COLUMNS})


@dataclass(frozen=True, eq=False, kw_only=True)
class Genome:
    """Nodes and links of one network (Stanley & Miikkulainen 2002, section 3.1).

    Arrays are copied, made read-only and checked. Rules: at least one input and one output,
    at most one bias; links enter outputs and hidden nodes only; the links that are not
    recurrent, enabled or not, form no cycle; (source, target, recurrent) is unique.

    Attributes:
        genome_id: number of the genome in its run.
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
        """Freeze and check the arrays."""
        for name, dtype in COLUMNS.items():
            array = validation.frozen_array(name, getattr(self, name), dtype)
            object.__setattr__(self, name, array)
        validation.check(self)

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
    def input_ids(self) -> NDArray[np.int32]:
        """Ids of the input nodes, in the order of the observations."""
        return self.node_id[self.node_kind == NodeKind.INPUT]

    @property
    def output_ids(self) -> NDArray[np.int32]:
        """Ids of the output nodes, in the order of the outputs."""
        return self.node_id[self.node_kind == NodeKind.OUTPUT]

    @property
    def bias_id(self) -> int | None:
        """Id of the bias node, None if there is none."""
        ids = self.node_id[self.node_kind == NodeKind.BIAS]
        return int(ids[0]) if ids.size else None

    def node_index(self, ids: NDArray[np.int32]) -> NDArray[np.intp]:
        """Return the index of each node id in the node arrays; meaningless for unknown ids."""
        order = self.node_order
        place = np.searchsorted(self.node_id, ids, sorter=order)
        return order[np.minimum(place, order.size - 1)]

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
        for name in changes.keys() & validation.LINK_FIELDS.keys():
            changes[name] = self._link_column(name, changes[name])
        return self.unchecked(**changes)

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
        column = validation.frozen_array(name, value, validation.LINK_FIELDS[name])
        if column.size != self.link_innovation.size:
            raise GenomeError(
                f"{name} must have one entry for each of the genome's "
                f"{self.link_innovation.size} links, not {column.size}."
            )
        if name == "link_weight":
            validation.check_weights(self.link_innovation, column)
        return column

    def same_genes(self, other: Genome) -> bool:
        """Tell whether both have the same nodes and links; weights and enabled may differ."""
        return all(_equal(getattr(self, name), getattr(other, name)) for name in STRUCTURE)

    def same_structure(self, other: Genome) -> bool:
        """Tell whether both differ in genome id and weights at most."""
        same = self.observation_schema == other.observation_schema and self.same_genes(other)
        return same and _equal(self.link_enabled, other.link_enabled)

    def to_dict(self) -> dict[str, Any]:
        """Return the genome as JSON values; `from_dict` gives it back bit for bit."""
        return codec.encode(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the genome that `to_dict` wrote; GenomeError names a bad key or gene."""
        return cls(**codec.decode(data))

    def to_json(self) -> str:
        """Return the genome as one line of JSON."""
        return json.dumps(self.to_dict(), allow_nan=False)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Return the genome that `to_json` wrote; GenomeError names a bad key or gene."""
        return cls(**codec.decode(codec.parse(text)))


def _equal(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a is b or np.array_equal(a, b)


def identical(a: Genome, b: Genome) -> bool:
    """Tell whether two genomes are equal in every field, weights bit for bit."""
    same_weights = a.link_weight.tobytes() == b.link_weight.tobytes()
    return a.genome_id == b.genome_id and a.same_structure(b) and same_weights


def save_genome(genome: Genome, path: str | Path) -> None:
    """Write the genome as JSON, whole or not at all."""
    write_atomic(Path(path), genome.to_json().encode())


def load_genome(path: str | Path, *, observation_schema: str | None = None) -> Genome:
    """Return the genome in a file.

    Args:
        path: the file.
        observation_schema: name of the observations that the caller has for it; None accepts any.

    Raises:
        GenomeError: naming the file and what is wrong in it, or that it reads other observations.
    """
    try:
        genome = Genome.from_json(Path(path).read_bytes())
    except GenomeError as error:
        raise GenomeError(f"{path}: {error}") from error
    if observation_schema not in (None, genome.observation_schema):
        raise GenomeError(
            f"{path}: the genome reads the observations {genome.observation_schema!r}, not "
            f"{observation_schema!r}; use the sensors that it was evolved with."
        )
    return genome
