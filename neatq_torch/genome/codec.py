"""Genomes as plain data: dictionaries and JSON text, exact to the last bit.

One list per column instead of one object per gene: large populations stay small on disk.
Float32 weights are written as float64 numbers, which JSON keeps exactly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from neatq_torch.genome.validation import LINK_FIELDS, NODE_FIELDS
from neatq_torch.genome.vocabulary import ACTIVATIONS, GenomeError, NodeKind

if TYPE_CHECKING:
    from neatq_torch.genome.genome import Genome

FORMAT = "neatq-genome"
VERSION = 1
KINDS: tuple[str, ...] = tuple(kind.name.lower() for kind in NodeKind)
NODE_COLUMNS = tuple(name.removeprefix("node_") for name in NODE_FIELDS)
LINK_COLUMNS = tuple(name.removeprefix("link_") for name in LINK_FIELDS)
KEYS = ("format", "version", "genome_id", "observation_schema", "nodes", "links")
WORDS = {"kind": KINDS, "activation": ACTIVATIONS}
TYPES: dict[str, tuple[type, ...]] = {
    "weight": (float, int),
    "enabled": (bool,),
    "recurrent": (bool,),
    "kind": (str,),
    "activation": (str,),
}


def encode(genome: Genome) -> dict[str, Any]:
    """Return the genome as a dictionary of JSON values."""
    nodes = {
        "id": genome.node_id.tolist(),
        "kind": [KINDS[kind] for kind in genome.node_kind.tolist()],
        "activation": [ACTIVATIONS[index] for index in genome.node_activation.tolist()],
    }
    links = {column: getattr(genome, f"link_{column}").tolist() for column in LINK_COLUMNS}
    return {
        "format": FORMAT,
        "version": VERSION,
        "genome_id": genome.genome_id,
        "observation_schema": genome.observation_schema,
        "nodes": nodes,
        "links": links,
    }


def decode(data: object) -> dict[str, Any]:
    """Return the fields of a Genome from what `encode` made; GenomeError names a bad key."""
    _check_header(data)
    mapping = _checked_mapping("genome", data, KEYS)
    return {
        "genome_id": _checked_value(mapping, "genome_id", int),
        "observation_schema": _checked_value(mapping, "observation_schema", str),
        **_decode_table("node", mapping["nodes"], NODE_COLUMNS),
        **_decode_table("link", mapping["links"], LINK_COLUMNS),
    }


def parse(text: str | bytes) -> object:
    """Return what JSON text says; GenomeError where it is broken."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise GenomeError(f"the text is not valid JSON: {error}.") from error


def _check_header(data: object) -> None:
    if not isinstance(data, Mapping):
        raise GenomeError(f"a genome is a JSON object, not {_named_type(data)}.")
    if data.get("format") != FORMAT:
        raise GenomeError(f"key 'format' must be {FORMAT!r}, not {data.get('format')!r}.")
    version = data.get("version")
    if type(version) is not int or version != VERSION:
        raise GenomeError(
            f"key 'version' is {version!r}, but this program reads version {VERSION} only."
        )


def _checked_mapping(name: str, data: object, keys: tuple[str, ...]) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        raise GenomeError(f"{name} must be a JSON object, not {_named_type(data)}.")
    missing = [key for key in keys if key not in data]
    if missing:
        raise GenomeError(f"{name}: key {missing[0]!r} is missing; expected {', '.join(keys)}.")
    unknown = [key for key in data if key not in keys]
    if unknown:
        raise GenomeError(f"{name}: key {unknown[0]!r} is unknown; expected {', '.join(keys)}.")
    return data


def _checked_value(data: Mapping[str, Any], key: str, expected: type) -> Any:
    value = data[key]
    if type(value) is not expected:
        raise GenomeError(f"key {key!r} must be {expected.__name__}, not {_named_type(value)}.")
    return value


def _decode_table(table: str, data: object, columns: tuple[str, ...]) -> dict[str, Any]:
    mapping = _checked_mapping(f"{table}s", data, columns)
    genes = mapping[columns[0]]
    return {
        f"{table}_{column}": _decode_column(table, column, mapping[column], genes)
        for column in columns
    }


def _decode_column(table: str, column: str, values: object, genes: object) -> NDArray[Any]:
    where = f"{table}s.{column}"
    if not isinstance(values, list) or not isinstance(genes, list):
        raise GenomeError(f"{where} must be a list, not {_named_type(values)}.")
    if len(values) != len(genes):
        raise GenomeError(f"{where} has {len(values)} entries for {len(genes)} {table}s.")
    expected = TYPES.get(column, (int,))
    for gene, value in zip(genes, values, strict=True):
        if type(value) not in expected:
            raise GenomeError(
                f"{_named_gene(table, gene)}: {column} must be {expected[0].__name__}, "
                f"not {value!r}."
            )
    if column in WORDS:
        values = [_word_index(table, column, *pair) for pair in zip(genes, values, strict=True)]
    return _column_array(table, column, values, genes)


def _word_index(table: str, column: str, gene: object, word: str) -> int:
    if word not in WORDS[column]:
        raise GenomeError(
            f"{_named_gene(table, gene)}: {column} {word!r} is unknown; choose one of "
            f"{', '.join(WORDS[column])}."
        )
    return WORDS[column].index(word)


def _column_array(table: str, column: str, values: list[Any], genes: list[Any]) -> NDArray[Any]:
    dtype = (NODE_FIELDS | LINK_FIELDS)[f"{table}_{column}"]
    try:
        # A weight beyond float32 becomes infinite here and is named by the genome's own check.
        with np.errstate(over="ignore"):
            return np.array(values, dtype=dtype)
    except OverflowError:
        wrong = next(i for i, value in enumerate(values) if not _fits(value, dtype))
        raise GenomeError(
            f"{_named_gene(table, genes[wrong])}: {column} {values[wrong]} is too large for "
            f"{dtype.__name__}."
        ) from None


def _fits(value: float, dtype: type[np.generic]) -> bool:
    try:
        np.array(value, dtype=dtype)
    except OverflowError:
        return False
    return True


def _named_gene(table: str, gene: object) -> str:
    return f"node {gene}" if table == "node" else f"link with innovation {gene}"


def _named_type(value: object) -> str:
    return f"{type(value).__name__} {value!r}"[:60]
