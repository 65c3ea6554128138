"""Teams of OpenNERO against lines written by hand, and against a plain reading of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from neatq_torch.genome import Genome, NodeKind, initial_genome
from neatq_torch.genome.genome import COLUMNS
from neatq_torch.interop.opennero import TeamFile, TeamFileError, read_team_file, write_team_file
from neatq_torch.network import GenomeNetwork

SENSORS = [*(f"node {one} 1 1 1 0" for one in range(1, 19)), "node 19 1 1 3 0"]
PAIR = ["node 20 1 0 2 0", "node 21 1 0 2 0"]
GENES = [
    "gene 1 1 20 0.5 0 1 0.5 1",
    "gene 1 19 21 -2 0 2 -2 0",
    "gene 1 20 20 1.25 1 3 1.25 1",
]


def lines_of(
    number: Any = 7,
    *,
    nodes: list[str] | None = None,
    hidden: list[str] | None = None,
    genes: list[str] | None = None,
) -> list[str]:
    """A genome: its start is line 1, its first node line 3, its first gene line 24 at the least."""
    nodes = [*SENSORS, *PAIR] if nodes is None else nodes
    body = [*nodes, *(hidden or []), *(GENES if genes is None else genes)]
    return [f"genomestart {number}", "trait 1 0 0 0 0 0 0 0 0 ", *body, f"genomeend {number}"]


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., TeamFile]:
    def reading(*lines: str) -> TeamFile:
        path = tmp_path / "team.txt"
        path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        return read_team_file(path)

    return reading


def refused(path: Path) -> str:
    """What is said of a file behind its path, in one line."""
    with pytest.raises(TeamFileError) as caught:
        read_team_file(path)
    words = str(caught.value)
    assert words.startswith(f"{path}: ")
    assert "\n" not in words
    return words.removeprefix(f"{path}: ")


@pytest.fixture
def refusal(tmp_path: Path) -> Callable[..., str]:
    def refusing(*lines: str) -> str:
        path = tmp_path / "team.txt"
        path.write_text("\n".join(lines), encoding="utf-8")
        return refused(path)

    return refusing


def genes_of(genome: Genome) -> list[tuple[float, ...]]:
    """(innovation, source, target, weight, recurrent, enabled) of each link."""
    names = "innovation", "source", "target", "weight", "recurrent", "enabled"
    return list(zip(*(getattr(genome, f"link_{name}").tolist() for name in names), strict=True))


def assert_same(one: TeamFile, other: TeamFile) -> None:
    assert len(one.genomes) == len(other.genomes)
    for left, right in zip(one.genomes, other.genomes, strict=True):
        assert (left.genome_id, left.observation_schema) == (
            right.genome_id,
            right.observation_schema,
        )
        for name in COLUMNS:
            assert getattr(left, name).tobytes() == getattr(right, name).tobytes(), name


def test_a_genome_has_the_nodes_and_links_of_its_lines(read: Callable[..., TeamFile]) -> None:
    team = read(*lines_of())
    (genome,) = team.genomes
    assert team.notes == ()
    assert (genome.genome_id, genome.observation_schema) == (7, "opennero-2011")
    assert genome.node_id.tolist() == list(range(1, 22))
    assert genome.input_ids.tolist() == list(range(1, 19))
    assert genome.node_kind[18] == NodeKind.BIAS
    assert genome.output_ids.tolist() == [20, 21]
    assert genome.node_activation.tolist() == [0] * 19 + [1] * 2  # identity, sigmoid
    assert genes_of(genome) == [
        (1, 1, 20, 0.5, False, True),
        (2, 19, 21, -2.0, False, False),
        (3, 20, 20, 1.25, True, True),
    ]


def test_four_outputs_are_a_team_of_2014(read: Callable[..., TeamFile]) -> None:
    four = [*SENSORS, *PAIR, "node 22 1 0 2 0", "node 23 1 0 2 0"]
    (genome,) = read(*lines_of(nodes=four)).genomes
    assert (genome.output_ids.size, genome.observation_schema) == (4, "opennero-2014")


def test_inputs_and_outputs_keep_the_order_of_the_file(read: Callable[..., TeamFile]) -> None:
    nodes = ["node 21 1 0 2 0", *reversed(SENSORS[:18]), SENSORS[18], "node 20 1 0 2 0"]
    (genome,) = read(*lines_of(nodes=nodes)).genomes
    assert genome.input_ids.tolist() == list(range(18, 0, -1))
    assert genome.output_ids.tolist() == [21, 20]
    assert genome.node_id.tolist() == [21, *range(18, 0, -1), 19, 20]


def test_old_lines_with_names_of_sensors_and_without_functions_are_read(
    read: Callable[..., TeamFile],
) -> None:
    named = [f"node {one} 1 1 1 FriendRadarSensor 3 90 -90 15 0" for one in range(1, 19)]
    old = [*named, "node 19 1 1 3", "node 20 1 0 2", "node 21.0 0 0 2 1"]
    tabs = ["gene 1 1 \t20 \t0.5\t\t0 1 0 1 more", *GENES[1:]]
    assert_same(read(*lines_of()), read(*lines_of(nodes=old, genes=tabs)))
    assert read(*lines_of(nodes=old)).notes == ()


def test_lines_may_end_as_on_windows_and_begin_with_a_mark(tmp_path: Path) -> None:
    path = tmp_path / "windows.txt"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines_of()).encode())
    assert genes_of(read_team_file(path).genomes[0])[0] == (1, 1, 20, 0.5, False, True)


def test_a_weight_keeps_all_bits_of_float32(tmp_path: Path, read: Callable[..., TeamFile]) -> None:
    bits = np.array([0x3DCCCCCD, 0x7F7FFFFF, 0x00000001, 0x80000000, 0x3F800001], np.uint32)
    weights = bits.view(np.float32)
    genome = initial_genome(18, 2, rng=np.random.default_rng(0))
    start = genome.with_weights(np.resize(weights, genome.link_weight.size))
    write_team_file([start], tmp_path / "bits.txt")
    (back,) = read_team_file(tmp_path / "bits.txt").genomes
    assert back.link_weight[:5].view(np.uint32).tolist() == bits.tolist()
    # 14970 and -1e-3 as OpenNERO's files have them; weights are not clamped.
    far = ["gene 1 1 20 14970.0 0 1 0 1", "gene 1 2 20 -1e-3 0 2 0 1"]
    weights = read(*lines_of(genes=far)).genomes[0].link_weight
    assert weights.tolist() == [14970.0, np.float32(-0.001)]


def test_links_stand_in_the_order_of_their_innovations(read: Callable[..., TeamFile]) -> None:
    genes = ["gene 1 1 20 0.5 0 7000.0 0 1", "gene 1 2 20 0.25 0 -3 0 1"]
    team = read(*lines_of(genes=genes))
    assert genes_of(team.genomes[0]) == [
        (-3, 2, 20, 0.25, False, True),
        (7000, 1, 20, 0.5, False, True),
    ]
    assert team.notes == ()


@pytest.mark.parametrize("marking", ["0", "2", "1.5", "nan", "9007199254740994.0", "9" * 20, "x"])
def test_innovations_that_tell_nothing_are_numbered_in_the_order_of_the_file(
    marking: str, read: Callable[..., TeamFile]
) -> None:
    genes = [f"gene 1 3 20 0.5 0 {marking} 0 1", "gene 1 1 20 0.25 0 0 0 1"]
    team = read(*lines_of(genes=[*genes, "gene 1 2 21 1 0 2 0 1"]))
    assert [one[:3] for one in genes_of(team.genomes[0])] == [(1, 3, 20), (2, 1, 20), (3, 2, 21)]
    assert team.notes == (
        "line 1: genome '7', whose innovation numbers are not whole or not unique, had its links "
        "numbered anew.",
    )


def test_a_link_that_closes_a_cycle_is_marked_recurrent(read: Callable[..., TeamFile]) -> None:
    hidden = ["node 30 1 0 0 0", "node 31 1 0 0 0"]
    genes = [
        "gene 1 31 30 1 0 1 0 1",  # leads back, seen from input 1: 1 -> 30 -> 31
        "gene 1 1 30 1 0 2 0 1",
        "gene 1 30 31 1 0 3 0 0",
        "gene 1 31 20 1 0 4 0 1",
        "gene 1 21 21 1 0 5 0 1",
    ]
    team = read(*lines_of(hidden=hidden, genes=genes))
    assert team.genomes[0].link_recurrent.tolist() == [True, False, False, False, True]
    assert team.notes == (
        "line 26: the gene from 31 to 30, which closes a cycle, was marked as recurrent "
        "(and 1 more like it).",
    )


def test_the_walk_that_finds_cycles_goes_along_the_genes(read: Callable[..., TeamFile]) -> None:
    hidden = ["node 30 1 0 0 0", "node 31 1 0 0 0"]
    ends = [(1, 31), (1, 30), (30, 31), (31, 30)]
    genes = [f"gene 1 {one} {other} 1 0 {at} 0 1" for at, (one, other) in enumerate(ends)]
    (genome,) = read(*lines_of(hidden=hidden, genes=genes)).genomes
    assert genome.link_recurrent.tolist() == [False, False, True, False]  # 1 -> 31 -> 30 -> 31


def test_a_second_gene_is_kept_as_recurrent_and_a_third_is_added_to_it(
    read: Callable[..., TeamFile],
) -> None:
    genes = [f"gene 1 1 20 {weight} 0 {at} 0 1" for at, weight in enumerate([0.5, 0.13, 0.21], 1)]
    team = read(*lines_of(genes=genes))
    total = float(np.float32(0.13) + np.float32(0.21))  # not that of 0.34
    assert genes_of(team.genomes[0]) == [
        (1, 1, 20, 0.5, False, True),
        (2, 1, 20, total, True, True),
    ]
    assert [note.partition(":")[0] for note in team.notes] == ["line 25", "line 26"]


def test_of_two_genes_the_one_that_is_disabled_is_left_out(read: Callable[..., TeamFile]) -> None:
    genes = [
        "gene 1 1 20 1 0 1 0 0",
        "gene 1 1 20 2 0 2 0 1",
        "gene 1 2 20 3 0 3 0 1",
        "gene 1 2 20 4 0 4 0 0",
        "gene 1 3 20 5 0 5 0 0",
        "gene 1 3 20 6 0 6 0 0",
    ]
    team = read(*lines_of(genes=genes))
    assert [one[0] for one in genes_of(team.genomes[0])] == [2, 3, 5]
    assert team.notes == (
        "line 24: the gene, which is disabled, was left out, because another leads from 1 to 20 "
        "(and 2 more like it).",
    )


def test_a_link_and_its_recurrent_twin_are_both_kept(read: Callable[..., TeamFile]) -> None:
    genes = ["gene 1 1 20 1 0 1 0 1", "gene 1 1 20 2 1 2 0 1"]
    team = read(*lines_of(genes=genes))
    assert [one[3:5] for one in genes_of(team.genomes[0])] == [(1.0, False), (2.0, True)]
    assert team.notes == ()


def test_genes_without_effect_are_left_out_and_noted(read: Callable[..., TeamFile]) -> None:
    genes = [
        *GENES,
        "gene 1 20 5 1 0 4 0 1",
        "gene 1 20 19 1 0 5 0 1",
        "gene 1 1 99 1 0 6 0 1",
        "gene 1 98 20 1 0 7 0 1",
    ]
    team = read(*lines_of(genes=genes))
    assert_same(team, read(*lines_of()))
    assert team.notes == (
        "line 27: the gene from 20 to 5 was left out, because nothing flows into an input or bias "
        "(and 1 more like it).",
        "line 29: the gene from 1 to 99 was left out, because the genome has no node 99 "
        "(and 1 more like it).",
    )


def test_a_second_hidden_node_of_an_id_is_left_out(read: Callable[..., TeamFile]) -> None:
    team = read(*lines_of(hidden=["node 30 1 0 0 0", "node 30 1 0 0 0"]))
    assert_same(team, read(*lines_of(hidden=["node 30 1 0 0 0"])))
    assert team.notes == (
        "line 25: the hidden node was left out, because an earlier one has the id 30, too.",
    )


def plain_outputs(lines: list[str], observations: list[list[float]]) -> list[list[float]]:
    """What OpenNERO's networks do, straight from the lines: every gene counts, all at once."""
    rows = [line.split() for line in lines]
    place = {int(row[1]): int(row[4]) for row in rows if row[0] == "node"}
    genes = [row for row in rows if row[0] == "gene" and row[8] == "1"]
    links = [(int(row[2]), int(row[3]), float(row[4])) for row in genes]
    value = {one: float(place[one] == 3) for one in place}
    outputs = []
    for seen in observations:
        value |= dict(zip([one for one in place if place[one] == 1], seen, strict=True))
        total = dict.fromkeys([one for one in place if place[one] in (0, 2)], 0.0)
        for source, target, weight in links:
            if source in value and target in total:
                total[target] += value[source] * weight
        value |= {one: 1 / (1 + math.exp(-z)) for one, z in total.items()}
        outputs.append([value[one] for one in place if place[one] == 2])
    return outputs


@pytest.mark.parametrize("seed", range(5))
def test_a_tangled_genome_computes_what_its_lines_say(
    seed: int, read: Callable[..., TeamFile]
) -> None:
    rng = np.random.default_rng(seed)
    hidden = [f"node {one} 1 0 0 0" for one in (40, 30, 31, 30)]
    sources = rng.choice([1, 2, 18, 19, 20, 21, 30, 31, 40, 99], 120)
    targets = rng.choice([20, 21, 30, 31, 40, 5, 99], 120)
    genes = [
        f"gene 1 {source} {target} {rng.normal():.6g} {rng.integers(2)} 0 0 {rng.random() < 0.7:d}"
        for source, target in zip(sources, targets, strict=True)
    ]
    lines = lines_of(hidden=hidden, genes=genes)
    team = read(*lines)
    observations = rng.uniform(0, 1, (6, 18)).astype(np.float32)
    network, state, found = GenomeNetwork(team.genomes[0], evaluation="synchronous"), None, []
    with torch.no_grad():
        for seen in torch.tensor(observations):
            output, state = network.step(seen, state)
            found.append(output.tolist())
    wanted = plain_outputs(lines, observations.tolist())
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6)
    assert len(team.notes) == 8  # all that can be wrong with genes and nodes


def test_what_stands_around_genomes_is_passed_over(read: Callable[..., TeamFile]) -> None:
    around = [
        "/* Organism #7 Fitness: 0 Time: 0 */",
        "/* genomestart 5",
        "node 1 1 */",
        *lines_of(7),
        "/* a */ genomestart 8",
        *lines_of(8)[1:],
        "",
    ]
    team = read(*around)
    assert [genome.genome_id for genome in team.genomes] == [7, 8]
    assert team.notes == ()


def test_statistics_and_tables_behind_genomes_are_noted_by_their_first_line(
    read: Callable[..., TeamFile],
) -> None:
    behind = [
        "",
        '<message time="3">',
        "12.5",
        "</message>",
        "",
        "22 serialization::archive 5 0 0 OpenNero::TableApproximator 1 0",
        "0 1 2 3",
        "",
        "22 serialization::archive 5 0 0 OpenNero::TableApproximator 1 0",
    ]
    team = read(*lines_of(7), *behind, *lines_of(8), "stray")
    assert [genome.genome_id for genome in team.genomes] == [7, 8]
    assert team.notes == (
        "line 29: statistics, which are no part of a genome, were left out.",
        "line 33: an agent that learns with a table was left out, because it is no genome "
        "(and 1 more like it).",
        "line 64: the line 'stray' was left out, because it means nothing where it stands.",
    )


def test_a_damaged_team_gives_what_is_whole_in_it(read: Callable[..., TeamFile]) -> None:
    first, broken, third = lines_of(1), lines_of(2), lines_of(3)
    first[-1] = "genomeend 1genomestart 9"
    team = read(*first, "gene 1 1 20 1 0 1 0 1", "hello", *broken[:10], *third, *broken[:9])
    assert [genome.genome_id for genome in team.genomes] == [1, 3]
    assert team.notes == (
        "line 27: genome '1' ends as '1genomestart', and was kept.",
        "line 28: the line 'gene 1 1 20 1 0 1 0 1' was left out, because it means nothing where it "
        "stands (and 1 more like it).",
        "line 30: genome '2' was left out, because another one starts in line 40 before its "
        "genomeend (and 1 more like it).",
    )


def test_a_comment_that_never_ends_is_noted(read: Callable[..., TeamFile]) -> None:
    team = read(*lines_of(1), "/* open", *lines_of(2))
    assert [genome.genome_id for genome in team.genomes] == [1]
    assert team.notes == ("line 28: the comment never ends, and all behind it was left out.",)


BROKEN_NODES = {
    "17 inputs, 1 biases, 2 outputs": [*SENSORS[1:], *PAIR],
    "19 inputs, 0 biases, 2 outputs": [*SENSORS[:18], "node 19 1 1 1 0", *PAIR],
    "18 inputs, 2 biases, 2 outputs": [*SENSORS, "node 30 1 1 3 0", *PAIR],
    "18 inputs, 1 biases, 3 outputs": [*SENSORS, *PAIR, "node 22 1 0 2 0"],
    "got an input behind it": [SENSORS[18], *SENSORS[:18], *PAIR],
}


@pytest.mark.parametrize("came", BROKEN_NODES)
def test_other_inputs_or_outputs_are_refused_with_the_line_of_the_start(
    came: str, refusal: Callable[..., str]
) -> None:
    words = refusal(*lines_of(1), *lines_of(2, nodes=BROKEN_NODES[came]))
    assert words.startswith("line 28: expected")
    assert came in words


BROKEN_LINES = {
    "gene 1 1 20 nan 0 9 0 1": "a weight that is a finite float32 number, got 'nan'",
    "gene 1 1 20 -inf 0 9 0 0": "got '-inf'",
    "gene 1 1 20 1e300 0 9 0 1": "got '1e300'",
    "gene 1 1 20 3.4028236e38 0 9 0 1": "got '3.4028236e38'",
    "gene 1 1 20 1_0 0 9 0 1": "got '1_0'",
    "gene 1 1 20 heavy 0 9 0 1": "got 'heavy'",
    "gene 1 1.5 20 1 0 9 0 1": "expected the id of a node, a whole number, got '1.5'",
    "gene 1 1 inf 1 0 9 0 1": "got 'inf'",
    "gene 1 1 20 1 2 9 0 1": "expected 0 or 1 for recurrent, got '2'",
    "gene 1 1 20 1 0 9 0 yes": "expected 0 or 1 for enabled, got 'yes'",
    "gene 1 1 20 1 0 9 0": "expected gene, trait, source",
    "node 22 1 0": "expected node, its id",
    "node 22.5 1 0 0 0": "got 'node 22.5 1 0 0 0'",
    "node 3000000000 1 0 0 0": "whole numbers of 32 bits",
    "node 22 1 1 0 0": "0 0 for a hidden node",
    "node 22 1 0 4 0": "1 3 for the bias",
    "node 20 1 0 2 0": "expected an input, bias or output with an id of its own, got 20 again",
}


@pytest.mark.parametrize("line", BROKEN_LINES)
def test_a_broken_line_is_refused_by_its_number(line: str, refusal: Callable[..., str]) -> None:
    words = refusal("", *lines_of(genes=[*GENES, line]))
    assert words.startswith("line 28: expected")
    assert BROKEN_LINES[line] in words
    assert words.endswith((";" + words.rpartition(";")[2],))


def test_weights_that_add_up_beyond_float32_are_refused(refusal: Callable[..., str]) -> None:
    genes = [f"gene 1 1 20 2e38 1 {at} 0 1" for at in (1, 2)]
    words = refusal(*lines_of(genes=genes))
    assert words.startswith("line 25: expected genes from 1 to 20 whose weights add up to a finite")


@pytest.mark.parametrize("start", ["genomestart", "genomestart x", "genomestart 2147483648"])
def test_a_start_without_a_number_is_refused(start: str, refusal: Callable[..., str]) -> None:
    words = refusal(start, *lines_of()[1:])
    assert words.startswith("line 1: expected genomestart and a whole number of 32 bits")


def test_teams_of_2011_and_2014_do_not_mix(refusal: Callable[..., str]) -> None:
    four = [*SENSORS, *PAIR, "node 22 1 0 2 0", "node 23 1 0 2 0"]
    words = refusal(*lines_of(1), *lines_of(2, nodes=four))
    assert words.startswith("line 28: expected 2 outputs, as the first genome of the file has, got")


def test_an_error_in_a_genome_that_is_never_finished_does_not_count(
    read: Callable[..., TeamFile],
) -> None:
    team = read("genomestart 1", "node what", *lines_of(2))
    assert [genome.genome_id for genome in team.genomes] == [2]
