"""The figures of the last run of each row, from which the page is drawn: docs/benchmarks.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from benchmarks.result import Line

DOCS = Path(__file__).resolve().parents[1] / "docs"
FIGURES, PAGE = DOCS / "benchmarks.json", DOCS / "benchmarks.md"


@dataclass(frozen=True, kw_only=True)
class Record:
    """What one run of a row found, and on what."""

    lines: Sequence[Line]
    environment: dict[str, str]


Records = dict[str, Record]


def load() -> Records:
    """The saved records by row; none if nothing was saved."""
    if not FIGURES.exists():
        return {}
    return msgspec.json.decode(FIGURES.read_bytes(), type=Records)


def save(records: Records) -> None:
    """Write all records, each line of the table on a line of its own."""
    text = ",\n".join(f"{json.dumps(row)}: {_record(record)}" for row, record in records.items())
    FIGURES.write_text(f"{{\n{text}\n}}\n", encoding="utf-8")


def _record(record: Record) -> str:
    lines = ",\n  ".join(json.dumps(asdict(line)) for line in record.lines)
    environment = json.dumps(record.environment)
    return f'{{\n "environment": {environment},\n "lines": [\n  {lines}\n ]\n}}'
