"""Teams of OpenNERO: its text files (plain or gzip) and its JSON files, read and written."""

from __future__ import annotations

import gzip
import io
import json
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neatq_torch.atomic import write_atomic
from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind
from neatq_torch.interop.opennero_genome import (
    TEAM_SCHEMAS,
    GenomeLines,
    TeamFileError,
    TeamNotes,
    clipped,
    genome_of_lines,
    has_bits,
    interface_fault,
    lines_of_genome,
)
from neatq_torch.json_text import parse_json

__all__ = ["TeamFile", "TeamFileError", "read_team_file", "write_team_file"]

TEAM_BYTES = 100_000_000
"""Of a file, and of what is packed in it."""
TEAM_LINES = 10_000_000
TEAM_GENOMES = 10_000
GENOME_LINES = 100_000
_GZIP_MAGIC = b"\x1f\x8b"
_SILENT = {"trait", "factor"}
"""Keywords of a genome that do nothing to its network."""


@dataclass(frozen=True, kw_only=True)
class TeamFile:
    """A team as a file has it.

    Attributes:
        genomes: at least one, in the order of the file, all with the same number of outputs. Their
            observation_schema is "opennero-2011" with 2 outputs, "opennero-2014" with 4.
        notes: what was left out or mended, a sentence with its line for each kind of thing.
    """

    genomes: tuple[Genome, ...]
    notes: tuple[str, ...]


def read_team_file(path: str | Path) -> TeamFile:
    """Return the team in a file of OpenNERO.

    Networks are as OpenNERO runs them: every link, recurrent or not, carries the output of the step
    before, and all nodes but the sensors are sigmoid, whatever the file says. Genes that do
    nothing there (into sensors, of unknown nodes) are left out; links are marked as recurrent and
    numbered anew where the rules of `Genome` want it.

    Args:
        path: A text file, plain or packed with gzip, whatever its name; or a JSON team, whose
            agents of the kind "neat" are read.

    Raises:
        TeamFileError: The file cannot be read, is damaged or holds no genome that OpenNERO could
            run. The message begins with the path and the line.

    Example:
        >>> team = read_team_file("EvilCowards.txt.gz")
        >>> genomes, outputs = len(team.genomes), team.genomes[0].output_ids.size
    """
    try:
        return _team_of(_text_of(_bytes_of(path)))
    except OSError as error:
        raise TeamFileError(f"{path}: cannot be read: {error.strerror or error}.") from error
    except TeamFileError as error:
        raise TeamFileError(f"{path}: {error}") from error


def _bytes_of(path: str | Path) -> bytes:
    try:
        with open(path, "rb") as file:
            data = file.read(TEAM_BYTES + 1)
    except ValueError as error:  # of a path with a zero in it
        raise TeamFileError(f"expected the name of a file: {error}.") from error
    _refuse_size(data)
    if not data.startswith(_GZIP_MAGIC):
        return data
    try:
        with gzip.open(io.BytesIO(data)) as packed:
            unpacked = packed.read(TEAM_BYTES + 1)
    except (EOFError, OSError, zlib.error) as error:
        raise TeamFileError(
            f"expected a whole gzip file, got a damaged one ({error}); get the file again."
        ) from error
    _refuse_size(unpacked)
    return unpacked


def _refuse_size(data: bytes) -> None:
    if len(data) > TEAM_BYTES:
        raise TeamFileError(
            f"expected at most {TEAM_BYTES:,} bytes, unpacked, got more; split the team."
        )


def _text_of(data: bytes) -> str:
    if not data.strip():
        raise TeamFileError("expected a team, got an empty file; save the team again.")
    if b"\0" in data:
        raise TeamFileError(
            "expected a team as text (UTF-8), gzip or JSON, got binary data; save it as text."
        )
    text = data.decode("utf-8-sig", errors="replace")
    if text.count("\n") > TEAM_LINES:
        raise TeamFileError(f"expected at most {TEAM_LINES:,} lines, got more; split the team.")
    return text


def _team_of(text: str) -> TeamFile:
    scanner = _Scanner()
    if text.lstrip()[:1] in ("{", "["):
        _scan_json(text, scanner)
    else:
        scanner.scan(io.StringIO(text, newline=None))
    notes = scanner.notes.sentences()
    if not scanner.genomes:
        found = f"; {notes[0]}" if notes else "."
        raise TeamFileError(
            "expected at least one genome, from genomestart to genomeend, got none; save the team "
            f"again as OpenNERO or write_team_file does{found}"
        )
    return TeamFile(genomes=tuple(scanner.genomes), notes=notes)


def _scan_json(text: str, scanner: _Scanner) -> None:
    words = 'expected a team: {"team_ai": ..., "agents": [{"agent_ai": ..., "args": [...]}, ...]}'
    try:
        team = parse_json(text)
    except ValueError as error:
        raise TeamFileError(f"{words}, got no JSON: {error}; mend or save it again.") from error
    agents = team.get("agents") if isinstance(team, dict) else None
    if not isinstance(agents, list):
        came = f"the keys {clipped(team)}" if isinstance(team, dict) else "a list"
        raise TeamFileError(f"{words}, got {came}; give the file of a team.")
    for number, agent in enumerate(agents, 1):
        _scan_agent(agent, f"agent {number}", scanner)


def _scan_agent(agent: Any, where: str, scanner: _Scanner) -> None:
    kind = agent.get("agent_ai") if isinstance(agent, dict) else None
    if not isinstance(kind, str):
        raise TeamFileError(
            f'{where}: expected an object with "agent_ai" and "args", got '
            f"{clipped([str(agent)[:200]])}; mend it or take it out."
        )
    if kind != "neat":
        text = f"the agent of the kind {clipped([kind])} was left out, because it is no genome"
        scanner.notes.add("agent", where, text)
        return
    args = agent.get("args")
    if not (isinstance(args, list) and all(isinstance(line, str) for line in args)):
        raise TeamFileError(
            f'{where}: expected "args" to be the lines of a genome, a list of texts, got '
            f"{clipped([str(args)[:200]])}; mend it or take the agent out."
        )
    before = len(scanner.genomes)
    scanner.scan(io.StringIO("\n".join(args), newline=None), f"{where}, ")
    if len(scanner.genomes) == before:
        scanner.notes.add("no genome", where, "the agent was left out, because it has no genome")


class _Scanner:
    """Finds the genomes among the lines of a team."""

    def __init__(self) -> None:
        self.genomes: list[Genome] = []
        self.notes = TeamNotes()
        self._open: GenomeLines | None = None
        self._comment = ""
        """Where the comment begins that the next lines are part of."""
        self._foreign = False
        """Whether the next lines, up to a blank one, are statistics or a table."""

    def scan(self, lines: Iterable[str], prefix: str = "") -> None:
        """Read the lines of one text; `prefix` says where the text is."""
        self._comment, self._foreign = "", False
        for number, line in enumerate(lines, 1):
            self._take(f"{prefix}line {number}", line.strip())
        self._drop_open("the text ends")
        if self._comment:
            text = "the comment never ends, and all behind it was left out"
            self.notes.add("comment", self._comment, text)

    def _take(self, where: str, line: str) -> None:
        line = self._past_comment(where, line)
        words = line.split(maxsplit=9)
        if words[:1] == ["genomestart"]:
            self._drop_open(f"another one starts in {where}")
            self._open, self._foreign = GenomeLines(start=where, words=words), False
        elif self._open is not None:
            self._take_inside(self._open, where, words)
        else:
            self._take_between(where, words)

    def _past_comment(self, where: str, line: str) -> str:
        """What is left of a line behind comments, which stand between genomes."""
        if not self._comment and (self._open or not line.startswith("/*")):
            return line
        self._comment = "" if "*/" in line else self._comment or where
        return "" if self._comment else line.rpartition("*/")[2].strip()

    def _drop_open(self, reason: str) -> None:
        if self._open is not None:
            text = f"genome {self._open.name} was left out, because {reason} before its genomeend"
            self.notes.add("unfinished", self._open.start, text)
        self._open = None

    def _take_inside(self, genome: GenomeLines, where: str, words: list[str]) -> None:
        keyword = words[0] if words else ""
        if keyword in ("node", "gene"):
            (genome.nodes if keyword == "node" else genome.genes).append((where, words))
            if len(genome.nodes) + len(genome.genes) > GENOME_LINES:
                raise TeamFileError(
                    f"{where}: expected at most {GENOME_LINES:,} nodes and genes in a genome, got "
                    "more; split the file where genomes end."
                )
        elif keyword == "genomeend":
            self._finish(genome, where, words)
        elif words and keyword not in _SILENT:
            self._stray(where, words)

    def _finish(self, lines: GenomeLines, where: str, words: list[str]) -> None:
        genome, self._open = genome_of_lines(lines, self.notes), None
        if words[1:2] != lines.words[1:2]:
            text = f"genome {lines.name} ends as {clipped(words[1:2])}, and was kept"
            self.notes.add("other end", where, text)
        outputs = [one.output_ids.size for one in (*self.genomes[:1], genome)]
        if outputs[0] != outputs[-1]:
            raise TeamFileError(
                f"{lines.start}: expected {outputs[0]} outputs, as the first genome of the file "
                f"has, got {outputs[-1]}; keep genomes of 2011 and of 2014 in files of their own."
            )
        self.genomes.append(genome)
        if len(self.genomes) > TEAM_GENOMES:
            raise TeamFileError(f"{lines.start}: {_too_many('more')}")

    def _take_between(self, where: str, words: list[str]) -> None:
        if not words:
            self._foreign = False
        elif self._foreign or words[0] == "Organism":  # the heading of a genome in JSON
            return
        elif words[0].startswith("<"):
            text = "statistics, which are no part of a genome, were left out"
            self.notes.add("statistics", where, text)
            self._foreign = True
        elif "serialization::archive" in words[:2]:
            text = "an agent that learns with a table was left out, because it is no genome"
            self.notes.add("table", where, text)
            self._foreign = True
        else:
            self._stray(where, words)

    def _stray(self, where: str, words: list[str]) -> None:
        text = f"the line {clipped(words)} was left out, because it means nothing where it stands"
        self.notes.add("stray", where, text)


def _too_many(count: str) -> str:
    return f"expected 1 to {TEAM_GENOMES:,} genomes, got {count}; split the team into more files."


def write_team_file(genomes: Sequence[Genome], path: str | Path) -> None:
    """Write a team that OpenNERO can read, whole or not at all.

    Weights keep their float32 bits; activations of sensors and the names of observations are not
    part of the format. OpenNERO fills teams up to 50 by copies, and takes the first 50 of more.

    Args:
        genomes: 1 to 10,000 genomes with 18 inputs, then a bias, and 2 outputs (OpenNERO of 2011)
            or 4 (of 2014), all the same number; outputs and hidden nodes are "sigmoid".
        path: Its name says how: text, packed with gzip if it ends in .gz; a JSON team if it ends
            in .json (or .json.gz).

    Raises:
        TeamFileError: The file cannot be written, or OpenNERO could not run a genome.

    Example:
        >>> write_team_file(read_team_file("synth.pop.txt.gz").genomes, "synth.json")
    """
    name = Path(path).name.lower()
    try:
        _refuse_team(genomes)
        lines = [lines_of_genome(genome) for genome in genomes]
        as_json = name.removesuffix(".gz").endswith(".json")
        text = _json_of(lines) if as_json else "".join(f"{line}\n" for one in lines for line in one)
        data = text.encode()
        _refuse_size(data)
        write_atomic(path, gzip.compress(data, mtime=0) if name.endswith(".gz") else data)
    except OSError as error:
        raise TeamFileError(f"{path}: cannot be written: {error.strerror or error}.") from error
    except ValueError as error:
        raise TeamFileError(f"{path}: {error}") from error


def _json_of(genomes: list[list[str]]) -> str:
    agents = []
    for lines in genomes:
        heading = f"Organism #{lines[-1].split()[1]} Fitness: 0 Time: 0"
        agents.append({"agent_ai": "neat", "args": [heading, *lines, ""]})
    return json.dumps({"team_ai": "rtneat", "agents": agents}, indent=4) + "\n"


def _refuse_team(genomes: Sequence[Genome]) -> None:
    if not 1 <= len(genomes) <= TEAM_GENOMES:
        raise TeamFileError(_too_many(f"{len(genomes):,}"))
    outputs = {genome.output_ids.size for genome in genomes}
    for at, genome in enumerate(genomes):
        if fault := _unfit(genome):
            raise TeamFileError(f"genomes[{at}]: {fault}")
    if len(outputs) > 1:
        raise TeamFileError(
            f"expected genomes with the same number of outputs, got {sorted(outputs)}; write a "
            f"file for each of {', '.join(TEAM_SCHEMAS.values())}."
        )


def _unfit(genome: Genome) -> str:
    """Why OpenNERO could not run the genome; "" if it can."""
    if not has_bits(genome.genome_id, 32):
        return (
            f"expected a genome_id of 32 bits, got {genome.genome_id}; give the genome another "
            "with replaced(genome_id=...)."
        )
    if genome.node_id.size + genome.link_weight.size > GENOME_LINES:
        return (
            f"expected at most {GENOME_LINES:,} nodes and links in a genome, got more; write "
            "smaller genomes."
        )
    computing = genome.node_kind >= NodeKind.OUTPUT
    others = np.flatnonzero(computing & (genome.node_activation != ACTIVATIONS.index("sigmoid")))
    if others.size:
        node, word = genome.node_id[others[0]], ACTIVATIONS[genome.node_activation[others[0]]]
        return (
            f'expected the activation "sigmoid", the only one of OpenNERO, got {word!r} at node '
            f'{node}; evolve the genome with activation="sigmoid".'
        )
    return interface_fault(genome.node_kind.tolist())
