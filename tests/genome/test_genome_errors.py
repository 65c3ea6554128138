from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_torch.genome import Genome, GenomeError, initial_genome, load_genome, save_genome

Edit = Callable[[dict[str, Any]], object]


def put(table: str, column: str, place: int, value: object) -> Edit:
    return lambda data: data[table][column].__setitem__(place, value)


def drop(*keys: str) -> Edit:
    def edit(data: dict[str, Any]) -> None:
        for key in keys[:-1]:
            data = data[key]
        del data[keys[-1]]

    return edit


def add(**values: object) -> Edit:
    return lambda data: data.update(values)


BAD: dict[str, tuple[Edit, str]] = {
    "unknown target": (
        put("links", "target", 1, 99),
        "link with innovation 2: target 99 is not a node",
    ),
    "unknown source": (
        put("links", "source", 4, 77),
        "link with innovation 5: source 77 is not a node",
    ),
    "into input": (put("links", "target", 3, 2), "link with innovation 4: target 2 is an input"),
    "into bias": (put("links", "target", 3, 3), "link with innovation 4: target 3 is an input"),
    "nan weight": (put("links", "weight", 2, float("nan")), "link with innovation 3: weight nan"),
    "inf weight": (put("links", "weight", 2, float("inf")), "link with innovation 3: weight inf"),
    "weight beyond float32": (
        put("links", "weight", 2, 1e300),
        "link with innovation 3: weight inf",
    ),
    "weight beyond float64": (
        put("links", "weight", 2, 10**400),
        r"Number out of range - at `\$.links.weight\[2\]`",
    ),
    "text weight": (
        put("links", "weight", 0, "1"),
        r"Expected `float`, got `str` - at `\$.links.weight\[0\]`",
    ),
    "number as flag": (
        put("links", "enabled", 1, 1),
        r"Expected `bool`, got `int` - at `\$.links.enabled\[1\]`",
    ),
    "fraction as id": (
        put("nodes", "id", 0, 1.5),
        r"Expected `int`, got `float` - at `\$.nodes.id\[0\]`",
    ),
    "flag as id": (
        put("links", "source", 0, True),
        r"Expected `int`, got `bool` - at `\$.links.source\[0\]`",
    ),
    "id too large": (
        put("nodes", "id", 0, 2**31),
        r"Expected `int` <= 2147483647 - at `\$.nodes.id\[0\]`",
    ),
    "innovation too large": (
        put("links", "innovation", 4, 2**63),
        r"Expected `int` <= 9223372036854775807 - at `\$.links.innovation\[4\]`",
    ),
    "half a character": (put("links", "enabled", 0, "\ud800"), "surrogates not allowed"),
    "genome id too large": (
        add(genome_id=2**63),
        r"Expected `int` <= 9223372036854775807 - at `\$.genome_id`",
    ),
    "genome id of 400 digits": (add(genome_id=10**400), r"Expected `int` .* at `\$.genome_id`"),
    "node id of 400 digits": (put("nodes", "id", 0, 10**400), r"Expected `int` .*nodes.id\[0\]"),
    "node twice": (put("nodes", "id", 4, 4), "node id 4 occurs more than once"),
    "innovation twice": (
        put("links", "innovation", 3, 3),
        "link with innovation 3 occurs more than once",
    ),
    "unsorted": (
        put("links", "innovation", 0, 9),
        "link with innovation 2 follows the one with 9",
    ),
    "link twice": (
        lambda d: (put("links", "source", 1, 1)(d), put("links", "target", 1, 4)(d)),
        r"innovations \[1, 2\] all lead from 1 to 4",
    ),
    "loop": (put("links", "source", 3, 5), "cycle 5 -> 5 .* must be marked recurrent"),
    "kind": (
        put("nodes", "kind", 4, "hiden"),
        r"node_kind\[4\] 'hiden' is unknown; choose one of input, bias, output, hidden",
    ),
    "activation": (
        put("nodes", "activation", 4, "sigmiod"),
        r"node_activation\[4\] 'sigmiod' is unknown; choose one of identity, sigmoid,",
    ),
    "two biases": (put("nodes", "kind", 1, "bias"), r"nodes \[2, 3\] are all of kind bias"),
    "no output": (put("nodes", "kind", 3, "hidden"), "no output node"),
    "no input": (
        lambda d: (put("nodes", "kind", 0, "hidden")(d), put("nodes", "kind", 1, "hidden")(d)),
        "no input node",
    ),
    "missing key": (drop("genome_id"), "missing required field `genome_id`"),
    "missing column": (
        drop("links", "weight"),
        r"missing required field `weight` - at `\$.links`",
    ),
    "missing table": (drop("nodes"), "missing required field `nodes`"),
    "unknown key": (add(fitness=1), "unknown field `fitness`"),
    "unknown column": (
        lambda d: d["nodes"].update(bias=[]),
        r"unknown field `bias` - at `\$.nodes`",
    ),
    "short column": (
        lambda d: d["links"]["weight"].pop(),
        "one entry for each gene, not .*'link_weight': 4, 'link_enabled': 5",
    ),
    "column is no list": (
        lambda d: d["links"].update(weight=3),
        r"Expected `array`, got `int` - at `\$.links.weight`",
    ),
    "table is no object": (add(nodes=[1]), r"Expected `object`, got `array` - at `\$.nodes`"),
    "other version": (add(version=2), r"of version 1: .* 2 - at `\$.version`"),
    "version is text": (add(version="1"), r"of version 1: .* got `str` - at `\$.version`"),
    "no version": (drop("version"), "of version 1: .* missing required field `version`"),
    "other format": (add(format="neat"), r"a neatq-genome .* 'neat' - at `\$.format`"),
    "id is text": (add(genome_id="7"), r"Expected `int`, got `str` - at `\$.genome_id`"),
    "schema is a number": (
        add(observation_schema=1),
        r"Expected `str`, got `int` - at `\$.observation_schema`",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_genome_is_refused_by_name(small: Genome, name: str) -> None:
    edit, message = BAD[name]
    data = copy.deepcopy(small.to_dict())
    edit(data)
    with pytest.raises(GenomeError, match=message):
        Genome.from_json(json.dumps(data))


@pytest.mark.parametrize("text", ["", "{", "nothing", "[" * 200_000, '{"format": 1, }'])
def test_broken_json_is_refused(text: str) -> None:
    with pytest.raises(GenomeError, match="not valid JSON"):
        Genome.from_json(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"genome_id": ' + "9" * 5000 + "}", "limit"),
        ('{"genome_id": 1, "nodes": 2, "genome_id": 1}', "'genome_id' is given twice"),
        ("[" * 100_000 + "]" * 100_000, "nested more than 50 deep"),
        ("[" * 51 + "[]" + "]" * 51, "nested more than 50 deep"),
        ('{"nodes": ' * 600 + "1" + "}" * 600, "nested more than 50 deep"),
    ],
)
def test_json_that_no_genome_needs_is_refused(text: str, words: str) -> None:
    with pytest.raises(GenomeError, match=words):
        Genome.from_json(text)


def test_a_weight_beyond_all_numbers_is_named(small: Genome) -> None:
    text = small.to_json().replace("0.5", "1e400", 1)
    with pytest.raises(GenomeError, match="link with innovation 1: weight inf"):
        Genome.from_json(text)


def test_a_file_of_gigabytes_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "big.json").open("wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk
    with pytest.raises(GenomeError, match=r"big\.json: expected at most 100,000,000 bytes"):
        load_genome(tmp_path / "big.json")


@pytest.mark.parametrize("number", [2**63, -(2**63) - 1, 10**400, 1.5, "7", True, None])
def test_an_id_that_no_file_could_hold_is_refused(small: Genome, number: Any) -> None:
    with pytest.raises(GenomeError, match="genome_id must be a whole number"):
        small.replaced(genome_id=number)
    with pytest.raises(GenomeError, match="genome_id must be a whole number"):
        small.replaced(genome_id=number, node_id=small.node_id)


@pytest.mark.parametrize("ids", [[[1], [1, 2]], [10**400], [[]] * 3, [None], ["x"], 7])
def test_what_is_no_column_of_ids_is_refused(make_genome: Callable[..., Genome], ids: Any) -> None:
    with pytest.raises(GenomeError, match="link_source"):
        make_genome([(1, 1, 4, 1.0)], link_source=ids)


@pytest.mark.parametrize("text", ["[]", "3", "null", '"genome"'])
def test_json_that_is_no_object_is_refused(text: str) -> None:
    with pytest.raises(GenomeError, match="a neatq-genome of version 1: Expected `object`, got"):
        Genome.from_json(text)


def test_a_cycle_is_told_with_its_nodes(make_genome: Callable[..., Genome]) -> None:
    links = [(1, 1, 5, 1.0), (2, 5, 6, 1.0), (3, 6, 5, 1.0), (4, 6, 4, 1.0)]
    with pytest.raises(GenomeError, match=r"cycle (5 -> 6 -> 5|6 -> 5 -> 6) .* recurrent"):
        make_genome(links, hidden=(5, 6))


def test_a_disabled_forward_link_counts_for_cycles(make_genome: Callable[..., Genome]) -> None:
    links = [(1, 1, 4, 1.0), (2, 4, 4, 1.0)]
    with pytest.raises(GenomeError, match="cycle 4 -> 4"):
        make_genome(links, link_enabled=[True, False])


def test_columns_of_different_length_are_refused(make_genome: Callable[..., Genome]) -> None:
    with pytest.raises(GenomeError, match="'link_enabled': 2"):
        make_genome([(1, 1, 4, 1.0)], link_enabled=[True, True])


def test_an_array_is_never_rounded_to_ids(make_genome: Callable[..., Genome]) -> None:
    with pytest.raises(GenomeError, match=r"link_source\[0\] is 1.5"):
        make_genome([(1, 1, 4, 1.0)], link_source=[1.5])
    with pytest.raises(GenomeError, match="must be a 1-D array"):
        make_genome([(1, 1, 4, 1.0)], link_source=[[1]])


def test_weights_are_checked_where_they_are_replaced(small: Genome) -> None:
    with pytest.raises(GenomeError, match="link with innovation 4: weight nan"):
        small.with_weights([0.0, 0.0, 0.0, float("nan"), 0.0])
    with pytest.raises(GenomeError, match="5 links, not 4"):
        small.with_weights([0.0] * 4)
    with pytest.raises(GenomeError, match="5 links, not 1"):
        small.replaced(link_enabled=[True])


def test_a_kind_or_activation_out_of_range_is_refused(make_genome: Callable[..., Genome]) -> None:
    with pytest.raises(GenomeError, match="node 2: kind 4"):
        make_genome([], node_kind=[0, 4, 1, 2])
    with pytest.raises(GenomeError, match="node 4: activation 5"):
        make_genome([], node_activation=[0, 0, 0, 5])


def test_a_genome_of_other_observations_is_refused(tmp_path: Path) -> None:
    genome = initial_genome(2, 1, rng=np.random.default_rng(0), observation_schema="arena-1")
    path = tmp_path / "genome.json"
    save_genome(genome, path)
    assert load_genome(path, observation_schema="arena-1").to_json() == genome.to_json()
    with pytest.raises(GenomeError, match=r"genome.json: .*'arena-1', not 'opennero-2014'"):
        load_genome(path, observation_schema="opennero-2014")
