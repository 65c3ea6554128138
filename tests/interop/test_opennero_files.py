"""Files of OpenNERO teams: text, gzip and JSON, whole, damaged and hostile."""

from __future__ import annotations

import gzip
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import neatq_torch.interop.opennero as opennero
from neatq_torch.genome import Genome, initial_genome, layered_genome
from neatq_torch.genome.genome import COLUMNS
from neatq_torch.interop.opennero import TeamFile, TeamFileError, read_team_file, write_team_file

SENSORS = [*(f"node {one} 1 1 1 0" for one in range(1, 19)), "node 19 1 1 3 0"]
PAIR = ["node 20 1 0 2 0", "node 21 1 0 2 0"]
GENES = ["gene 1 1 20 0.1 0 5 0.1 1", "gene 1 30 30 -2 1 6 -2 0", "gene 1 1 30 4 0 7 4 1"]
WORDS = "genomestart genomeend node gene trait /* */ <message> { [ 22 serialization::archive \0 _"
NUMBERS = "0 1 2 3 20 30 -1 1.5 7000.0 1e39 nan inf 99999999999 9e99999 ٣ x"
HOSTILE = [*WORDS.split(), *NUMBERS.split(), "1" * 5000, "\n", "\r", "\x1c", "\u2028", "\ud800"]


def lines_of(number: int, *genes: str) -> list[str]:
    """A genome with a hidden node."""
    body = [*SENSORS, *PAIR, "node 30 1 0 0 0", *GENES, *genes]
    return [f"genomestart {number}", "trait 1 0 0 0 0 0 0 0 0", *body, f"genomeend {number}"]


def text_of(*genomes: list[str]) -> str:
    return "".join(f"{line}\n" for lines in genomes for line in lines)


def json_of(*genomes: list[str]) -> str:
    agents = [{"agent_ai": "neat", "args": [*lines, ""]} for lines in genomes]
    return json.dumps({"team_ai": "none", "agents": agents})


def refusal_of(path: Path) -> str:
    """What is said of a file behind its path, in one line."""
    with pytest.raises(TeamFileError) as caught:
        read_team_file(path)
    words = str(caught.value)
    assert words.startswith(f"{path}: ")
    assert "\n" not in words
    return words.removeprefix(f"{path}: ")


def assert_same(found: TeamFile, genomes: tuple[Genome, ...]) -> None:
    assert found.notes == ()
    assert len(found.genomes) == len(genomes)
    for one, other in zip(found.genomes, genomes, strict=True):
        assert one.genome_id == other.genome_id
        for name in COLUMNS:
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name


def test_teams_travel_through_all_formats(tmp_path: Path) -> None:
    names = ["team.txt", "team.txt.gz", "team.json", "team.json.gz"]
    (tmp_path / "start").write_text(text_of(lines_of(1), lines_of(1, GENES[0])), encoding="utf-8")
    team = read_team_file(tmp_path / "start")
    assert len(team.notes) == 2  # numbered anew, a second gene
    for name in names:
        write_team_file(team.genomes, tmp_path / name)
        assert_same(read_team_file(tmp_path / name), team.genomes)
    first = [(tmp_path / name).read_bytes() for name in names]
    for name in names:
        write_team_file(read_team_file(tmp_path / "team.json").genomes, tmp_path / name)
    assert [(tmp_path / name).read_bytes() for name in names] == first


def test_a_file_is_written_in_the_words_of_opennero(tmp_path: Path) -> None:
    (tmp_path / "start").write_text(text_of(lines_of(7)), encoding="utf-8")
    genomes = read_team_file(tmp_path / "start").genomes
    wanted = [
        "genomestart 7",
        "trait 1 0 0 0 0 0 0 0 0",
        *SENSORS,
        *PAIR,
        "node 30 1 0 0 0",
        "gene 1 1 20 0.100000001 0 5 0 1",
        "gene 1 30 30 -2 1 6 0 0",
        "gene 1 1 30 4 0 7 0 1",
        "genomeend 7",
    ]
    write_team_file(genomes, tmp_path / "out.txt")
    assert (tmp_path / "out.txt").read_bytes() == text_of(wanted).encode()
    write_team_file(genomes, tmp_path / "OUT.GZ")
    packed = (tmp_path / "OUT.GZ").read_bytes()
    assert packed[4:8] == bytes(4)  # the time of a gzip file
    assert gzip.decompress(packed) == text_of(wanted).encode()
    write_team_file(genomes, tmp_path / "out.json")
    args = ["Organism #7 Fitness: 0 Time: 0", *wanted, ""]
    assert json.loads((tmp_path / "out.json").read_text()) == {
        "team_ai": "rtneat",
        "agents": [{"agent_ai": "neat", "args": args}],
    }


def test_agents_of_another_kind_are_left_out_of_a_json_team(tmp_path: Path) -> None:
    agents: list[dict[str, Any]] = [
        {"agent_ai": "qlearning", "args": []},
        {"agent_ai": "neat", "args": lines_of(3, "gene 1 1 99 1 0 8 0 1")},
        {"agent_ai": "turret", "args": []},
        {"agent_ai": "neat", "args": ["genomestart 4"]},
    ]
    path = tmp_path / "team"
    path.write_text(json.dumps({"team_ai": "none", "agents": agents}), encoding="utf-8")
    team = read_team_file(path)
    assert [genome.genome_id for genome in team.genomes] == [3]
    assert team.notes == (
        "agent 1: the agent of the kind 'qlearning' was left out, because it is no genome "
        "(and 1 more like it).",
        "agent 2, line 28: the gene from 1 to 99 was left out, because the genome has no node 99.",
        "agent 4, line 1: genome '4' was left out, because the text ends before its genomeend.",
        "agent 4: the agent was left out, because it has no genome.",
    )
    agents[1]["args"][3] = "node 2 1 1 1.5 0"
    path.write_text(json.dumps({"team_ai": "none", "agents": agents}), encoding="utf-8")
    assert refusal_of(path).startswith("agent 2, line 4: expected node, its id")


DAMAGED: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "expected a team, got an empty file"),
    "blank": (b" \n\n", "expected a team, got an empty file"),
    "packed emptiness": (gzip.compress(b""), "expected a team, got an empty file"),
    "binary": (bytes(range(256)), "got binary data"),
    "utf-16": (text_of(lines_of(1)).encode("utf-16"), "got binary data"),
    "prose": (b"hello\n", "expected at least one genome, from genomestart to genomeend, got none"),
    "half": (text_of(lines_of(1)[:-1]).encode(), "line 1: genome '1' was left out"),
    "cut gzip": (gzip.compress(text_of(lines_of(1)).encode())[:-20], "expected a whole gzip file"),
    "bent gzip": (b"\x1f\x8b\x08\x00garbage, not a stream", "expected a whole gzip file"),
    "odd gzip": (b"\x1f\x8b", "expected a whole gzip file"),
    "cut JSON": (json_of(lines_of(1))[:-5].encode(), "got no JSON"),
    "deep JSON": (b"[" * 100_000, "got no JSON"),
    "a list": (b"[1]", "got a list"),
    "no agents": (b'{"format": "neatq-genome"}', "got the keys 'format'"),
    "agents of text": (b'{"agents": "neat"}', "got the keys 'agents'"),
    "an agent of text": (b'{"agents": ["neat"]}', "agent 1: expected an object"),
    "a nameless agent": (b'{"agents": [{"args": []}]}', "agent 1: expected an object"),
    "args of numbers": (b'{"agents": [{"agent_ai": "neat", "args": [1]}]}', "got '[1]'"),
    "no args": (b'{"agents": [{"agent_ai": "neat"}]}', 'agent 1: expected "args"'),
    "no genomes": (b'{"agents": [{"agent_ai": "turret", "args": []}]}', "agent 1: the agent of"),
    "no team": (b'{"agents": []}', "expected at least one genome"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_file_that_is_no_team_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    data, came = DAMAGED[name]
    (tmp_path / "team").write_bytes(data)
    assert came in refusal_of(tmp_path / "team")


def test_a_path_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    assert refusal_of(tmp_path / "none.txt") == "cannot be read: No such file or directory."
    assert refusal_of(tmp_path).startswith("cannot be read: ")
    assert refusal_of(tmp_path / "team.txt\0").startswith("expected the name of a file: ")


def test_bytes_that_are_no_utf8_do_no_harm_in_what_is_passed_over(tmp_path: Path) -> None:
    comment = b"/* Stra\xdfe */ \n"
    (tmp_path / "latin").write_bytes(comment + text_of(lines_of(1)).encode())
    assert len(read_team_file(tmp_path / "latin").genomes) == 1


def test_what_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = text_of(lines_of(1), lines_of(2), lines_of(3)).encode()
    plain, packed = tmp_path / "plain", tmp_path / "packed"
    plain.write_bytes(text)
    packed.write_bytes(gzip.compress(text))
    limits = {"TEAM_BYTES": len(text), "TEAM_LINES": 84, "TEAM_GENOMES": 3, "GENOME_LINES": 25}
    for limit, value in limits.items():
        for path in (plain, packed):
            with monkeypatch.context() as patch:
                patch.setattr(opennero, limit, value)
                assert len(read_team_file(path).genomes) == 3
                patch.setattr(opennero, limit, value - 1)
                assert "expected " in refusal_of(path)
                assert "split the" in refusal_of(path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    (tmp_path / "bomb").write_bytes(gzip.compress(bytes(10**6)) * 2000)  # 2 GB in 2 MB
    assert refusal_of(tmp_path / "bomb").startswith("expected at most 100,000,000 bytes, unpacked")


def test_seventy_large_genomes_are_read_in_less_than_two_seconds(tmp_path: Path) -> None:
    genome = layered_genome(18, 2, hidden=8, rng=np.random.default_rng(0))
    write_team_file([genome] * 70, tmp_path / "team.txt.gz")  # 11,900 links
    assert genome.link_weight.size == 170
    started = time.process_time()
    assert len(read_team_file(tmp_path / "team.txt.gz").genomes) == 70
    assert time.process_time() - started < 2


def refuse_write(genomes: list[Genome], path: Path) -> str:
    with pytest.raises(TeamFileError) as caught:
        write_team_file(genomes, path)
    assert not path.exists() or path.is_dir()
    words = str(caught.value)
    assert words.startswith(f"{path}: ")
    return words.removeprefix(f"{path}: ")


def test_what_opennero_could_not_run_is_not_written(tmp_path: Path) -> None:
    path, rng = tmp_path / "team.txt", np.random.default_rng(0)
    good = initial_genome(18, 2, rng=rng)
    tanh = initial_genome(18, 2, rng=rng, activation="tanh")
    mixed = layered_genome(18, 2, hidden=2, rng=rng, hidden_activation="steep_sigmoid")
    four = initial_genome(18, 4, rng=rng)
    words = refuse_write([good, tanh], path)
    assert words.startswith(
        "genomes[1]: expected the activation \"sigmoid\", the only one of OpenNERO, got 'tanh' at "
    )
    assert "got 'steep_sigmoid' at node 22" in refuse_write([mixed], path)
    assert "got 17 inputs, 1 biases" in refuse_write([initial_genome(17, 2, rng=rng)], path)
    unbiased = initial_genome(18, 2, rng=rng, bias=False)
    assert "got 18 inputs, 0 biases" in refuse_write([unbiased], path)
    assert "3 outputs" in refuse_write([initial_genome(18, 3, rng=rng)], path)
    assert "the same number of outputs, got [2, 4]" in refuse_write([good, four], path)
    assert "got 2147483648" in refuse_write([good.replaced(genome_id=2**31)], path)
    assert "expected 1 to 10,000 genomes, got 0" in refuse_write([], path)
    assert "got 10,001" in refuse_write([good] * 10_001, path)
    assert refuse_write([good], tmp_path / "none" / "team.txt").startswith("cannot be written: ")
    assert refuse_write([good], tmp_path).startswith("cannot be written: ")


@pytest.mark.parametrize(("limit", "value"), [("GENOME_LINES", 59), ("TEAM_BYTES", 1400)])
def test_what_would_be_too_large_to_read_is_not_written(
    limit: str, value: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genome = initial_genome(18, 2, rng=np.random.default_rng(0))  # 21 nodes and 38 links
    write_team_file([genome], tmp_path / "whole.txt")
    assert 1400 < (tmp_path / "whole.txt").stat().st_size < 100_000
    monkeypatch.setattr(opennero, limit, value if limit == "TEAM_BYTES" else value - 1)
    words = refuse_write([genome], tmp_path / "team.txt")
    assert "expected at most" in words
    monkeypatch.setattr(opennero, limit, 100_000 if limit == "TEAM_BYTES" else value)
    write_team_file([genome], tmp_path / "team.txt")


@st.composite
def teams(draw: st.DrawFn) -> tuple[Genome, ...]:
    """Teams of valid genomes with the interface of OpenNERO: any weights, cycles, order, ids."""
    outputs = draw(st.sampled_from([2, 4]))
    return tuple(draw(genomes_of(outputs)) for _ in range(draw(st.integers(1, 3))))


@st.composite
def genomes_of(draw: st.DrawFn, outputs: int) -> Genome:
    hidden = draw(st.integers(0, 4))
    size = 19 + outputs + hidden
    ids = draw(
        st.lists(st.integers(-(2**31), 2**31 - 1), min_size=size, max_size=size, unique=True)
    )
    kinds = np.repeat([0, 1, 2, 3], [18, 1, outputs, hidden])
    rank = draw(st.permutations(range(19, size)))  # forward links rise in rank
    level = dict(zip(rank, range(size), strict=False)) | dict.fromkeys(range(19), -1)
    ends = st.tuples(st.integers(0, size - 1), st.integers(19, size - 1), st.booleans())
    links = [
        one
        for one in draw(st.lists(ends, unique=True, max_size=30))
        if one[2] or level[one[0]] < level[one[1]]
    ]
    count = len(links)
    markings = draw(
        st.lists(st.integers(-(2**63), 2**63 - 1), unique=True, min_size=count, max_size=count)
    )
    floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
    return Genome(
        genome_id=draw(st.integers(-(2**31), 2**31 - 1)),
        node_id=np.array(ids, np.int32),
        node_kind=kinds.astype(np.uint8),
        node_activation=(kinds > 1).astype(np.uint8),
        link_innovation=np.array(sorted(markings), np.int64),
        link_source=np.array([ids[one[0]] for one in links], np.int32),
        link_target=np.array([ids[one[1]] for one in links], np.int32),
        link_weight=np.array(draw(st.lists(floats, min_size=count, max_size=count)), np.float32),
        link_enabled=np.array(
            draw(st.lists(st.booleans(), min_size=count, max_size=count)), np.bool_
        ),
        link_recurrent=np.array([one[2] for one in links], np.bool_),
    )


@settings(max_examples=60)
@given(team=teams(), name=st.sampled_from(["a.txt", "a.txt.gz", "a.json"]))
def test_every_team_comes_back_bit_for_bit(
    team: tuple[Genome, ...], name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("round") / name
    write_team_file(team, path)
    found = read_team_file(path)
    assert_same(found, team)
    schemas = {"opennero-2011": 2, "opennero-2014": 4}
    assert {schemas[one.observation_schema] for one in found.genomes} == {team[0].output_ids.size}


def read_or_refuse(path: Path) -> None:
    """Whatever is read is written and read again without a note and without a difference."""
    try:
        team = read_team_file(path)
    except TeamFileError as error:
        assert str(error).startswith(f"{path}: ")
        return
    assert len(team.notes) <= 20
    write_team_file(team.genomes, path.with_name("again.txt"))
    assert_same(read_team_file(path.with_name("again.txt")), team.genomes)


changes = st.tuples(st.integers(0, 10**6), st.sampled_from(["put", "cut", "swap"]))


@settings(max_examples=300)
@given(
    edits=st.lists(st.tuples(changes, st.sampled_from(HOSTILE)), min_size=1, max_size=8),
    as_json=st.booleans(),
)
def test_hostile_words_are_read_or_refused(
    edits: list[tuple[tuple[int, str], str]],
    as_json: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    lines = [*lines_of(1), *lines_of(2)]
    for (at, kind), word in edits:
        line = at % len(lines)
        words = [*lines[line].split(" "), ""]
        place = at // len(lines) % len(words)
        if kind == "cut":
            lines[line : line + 1] = [] if place == 0 else [" ".join(words[:place])]
        elif kind == "swap":
            other = at // 7 % len(lines)
            lines[line], lines[other] = lines[other], lines[line]
        else:
            words[place] = word
            lines[line] = " ".join(words)
        lines = lines or ["genomestart"]
    path = tmp_path_factory.mktemp("hostile") / "team"
    text = json_of(lines) if as_json else text_of(lines)
    path.write_bytes(text.encode("utf-8", errors="surrogatepass"))
    read_or_refuse(path)


@settings(max_examples=200)
@given(
    kind=st.sampled_from(["text", "gzip", "json"]),
    edits=st.lists(st.tuples(st.integers(0, 10**6), st.binary(max_size=3)), min_size=1, max_size=5),
    cut=st.integers(0, 50),
)
def test_hostile_bytes_are_read_or_refused(
    kind: str,
    edits: list[tuple[int, bytes]],
    cut: int,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    text = (json_of if kind == "json" else text_of)(lines_of(1), lines_of(2)).encode()
    data = bytearray(gzip.compress(text) if kind == "gzip" else text)
    for at, piece in edits:
        start = at % len(data)
        data[start : start + 1 + at % 3] = piece
    path = tmp_path_factory.mktemp("bytes") / "team"
    path.write_bytes(data[: len(data) - cut])
    read_or_refuse(path)
