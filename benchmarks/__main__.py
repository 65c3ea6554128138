"""`python -m benchmarks`: measure rows, print the table, and with --save write docs/benchmarks.*"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator

import torch

from benchmarks import (
    arenas,
    battle,
    breeding,
    cluster,
    crowd,
    forward,
    gpu,
    gymnasium,
    islands,
    learning,
    memory,
    population,
    replacement,
    startup,
    trainer,
    window,
)
from benchmarks.machine import environment
from benchmarks.measure import in_fresh_process
from benchmarks.result import Line
from benchmarks.store import PAGE, Record, Records, load, save
from benchmarks.table import draw_page, draw_table

ROWS = {
    "forward": forward,
    "learning": learning,
    "replacement": replacement,
    "breeding": breeding,
    "cluster": cluster,
    "trainer": trainer,
    "arenas": arenas,
    "gymnasium": gymnasium,
    "population": population,
    "islands": islands,
    "crowd": crowd,
    "battle": battle,
    "memory": memory,
    "startup": startup,
    "window": window,
    "gpu": gpu,
}
LONG = "million ticks"
"""The row that `--ticks` adds. Its last result stays on the page."""


def main() -> int:
    """Run the command line; returns 0 whether goals are reached or not: a page is no test."""
    arguments = _arguments()
    records: Records = {}
    for row, lines in _found(arguments):
        records[row] = Record(lines=lines, environment=environment())
        if arguments.save:  # now: what was measured is kept if a later row fails
            _write(load() | records)
    if arguments.draw:
        records = load()
        _write(records)
    print(draw_table(records), end="")
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"of {', '.join(ROWS)}; all")
    parser.add_argument("--quick", action="store_true", help="smaller and fewer rounds; no figures")
    parser.add_argument("--save", action="store_true", help=f"write {PAGE.name} and its figures")
    parser.add_argument("--draw", action="store_true", help="draw the page again from its figures")
    parser.add_argument("--ticks", type=int, help="of the long run of the row memory, alone")
    arguments = parser.parse_args()
    if unknown := set(arguments.rows) - set(ROWS):
        parser.error(f"expected rows of {', '.join(ROWS)}; got {', '.join(sorted(unknown))}")
    if arguments.quick and arguments.save:
        parser.error("expected --quick or --save; quick figures are too rough for the page")
    if arguments.ticks and arguments.rows != ["memory"]:
        parser.error("expected --ticks with the row memory: python -m benchmarks memory --ticks N")
    return arguments


def _found(arguments: argparse.Namespace) -> Iterator[tuple[str, list[Line]]]:
    """Run each row in a process of its own: it finds the same alone as among others."""
    if arguments.ticks:
        yield LONG, memory.run_long(arguments.ticks)
    elif not arguments.draw:
        for row in arguments.rows or _possible():
            begin = time.perf_counter()
            yield row, in_fresh_process(ROWS[row].run, arguments.quick)
            print(f"{row}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)


def _possible() -> list[str]:
    """All rows, without that of a GPU where there is none: its last result stays on the page."""
    return [row for row in ROWS if row != "gpu" or torch.cuda.is_available()]


def _write(records: Records) -> None:
    """Write figures and page, in the order of the table."""
    known = {row: records[row] for row in (*ROWS, LONG) if row in records}
    save(known)
    rows = {row: (module, row) for row, module in ROWS.items()}
    rows[LONG] = (memory, "memory --ticks 1000000 --save")
    PAGE.write_text(draw_page(known, rows), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
