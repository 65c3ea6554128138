"""The table and the page, drawn from records."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from types import ModuleType

from benchmarks.result import Cost, Line
from benchmarks.store import Record, Records

_HEADER = ("row", "what", "ours", "beside", "its cost", "ours / its cost", "to reach", "reached")
_VERDICTS = {True: "yes", False: "**falls short**", None: ""}

_INTRODUCTION = """# Benchmarks

What the parts of neatq_torch cost, each beside something known. This page is made by `make bench`;
`python -m benchmarks ROW` measures one row alone and prints it.

Costs are medians over rounds, with quartiles in brackets; less is better. In each round ours and
what stands beside it are measured one after the other, on the same machine, and the ratio is the
median of the rounds' ratios: it says more about other machines than the costs do. One thread, CPU
time, unless the row says something else. What was to be reached was set before the measuring; a
line that does not reach it says so. `docs/benchmarks.json` holds the figures of every round;
`python -m benchmarks --draw` makes this page from them.
"""


def draw_table(records: Records) -> str:
    """All lines as one Markdown table, with columns of equal width."""
    cells = [_HEADER] + [
        _cells(row, line) for row, record in records.items() for line in record.lines
    ]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    rule = tuple("-" * width for width in widths)
    return "\n".join(_joined(row, widths) for row in (cells[0], rule, *cells[1:])) + "\n"


def draw_page(records: Records, rows: Mapping[str, tuple[ModuleType, str]]) -> str:
    """The whole page.

    Args:
        records: What was found.
        rows: The module of each row, whose docstring explains it, and its arguments.
    """
    newest = max(records.values(), key=lambda record: record.environment["date"])
    parts = [
        _INTRODUCTION,
        draw_table(records),
        f"Measured with: {_listed(newest.environment)}.\n",
        "## What the rows measure\n",
    ]
    for row, record in records.items():
        other = record.environment if record.environment != newest.environment else {}
        parts.append(_section(row, *rows[row], record, other))
    return "\n".join(parts)


def _section(
    row: str, module: ModuleType, arguments: str, record: Record, environment: dict[str, str]
) -> str:
    notes = list(dict.fromkeys(line.note for line in record.lines if line.note))
    lines = [
        f"### {row}\n",
        f"`python -m benchmarks {arguments}`\n",
        (inspect.getdoc(module) or "").strip() + "\n",
        *(f"- {note}" for note in notes),
    ]
    if environment:
        lines.append(f"- Measured with: {_listed(environment)}.")
    return "\n".join(lines).rstrip() + "\n"


def _listed(environment: dict[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in environment.items())


def _cells(row: str, line: Line) -> tuple[str, ...]:
    return (
        row,
        line.what,
        _cost(line.ours, line.unit),
        line.reference,
        "" if line.theirs is None else _cost(line.theirs, line.unit),
        "" if line.ratio is None else _times(line.ratio.median),
        "" if line.goal is None else line.goal.text,
        _VERDICTS[line.reached],
    )


def _joined(cells: Sequence[str], widths: Sequence[int]) -> str:
    padded = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
    return f"| {' | '.join(padded)} |"


def _cost(cost: Cost, unit: str) -> str:
    median = f"{_figure(cost.median)} {unit}"
    if len(cost.rounds) == 1:
        return median
    low, high = map(_figure, cost.quartiles)
    return f"{median} [{low}, {high}]"


def _times(ratio: float) -> str:
    cheaper = f" ({_figure(1 / ratio)} times cheaper)" if 0 < ratio < 0.5 else ""
    return _figure(ratio) + cheaper


def _figure(value: float) -> str:
    """Three digits that count; whole numbers from 100 on."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
