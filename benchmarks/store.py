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
    """Write all records."""
    plain = {row: asdict(record) for row, record in records.items()}
    FIGURES.write_text(json.dumps(_rounded(plain), indent=1) + "\n", encoding="utf-8")


def _rounded(value: object) -> object:
    """Six digits are more than any clock has."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value
