"""`python -m benchmarks`: measure rows, print the table, and with --save write docs/benchmarks.*"""

from __future__ import annotations

import argparse
import sys
import time

from benchmarks import (
    arenas,
    breeding,
    crowd,
    forward,
    learning,
    memory,
    replacement,
    trainer,
)
from benchmarks.machine import environment
from benchmarks.measure import in_fresh_process
from benchmarks.store import PAGE, Record, Records, load, save
from benchmarks.table import draw_page, draw_table

ROWS = {
    "forward": forward,
    "learning": learning,
    "replacement": replacement,
    "breeding": breeding,
    "trainer": trainer,
    "arenas": arenas,
    "crowd": crowd,
    "memory": memory,
}
LONG = "million ticks"
"""The row that `--ticks` adds. Its last result stays on the page."""


def main() -> int:
    """Run the command line; returns 0 whether goals are reached or not: a page is no test."""
    arguments = _arguments()
    if arguments.draw:
        records = load()
    elif arguments.ticks:
        records = {LONG: Record(lines=memory.run_long(arguments.ticks), environment=environment())}
    else:
        records = _measured(arguments.rows or list(ROWS), arguments.quick)
    print(draw_table(records), end="")
    if arguments.draw or arguments.save:
        _write(records)
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


def _measured(rows: list[str], quick: bool) -> Records:
    """Run each row in a process of its own: it finds the same alone as among others."""
    records: Records = {}
    for row in rows:
        begin = time.perf_counter()
        lines = in_fresh_process(ROWS[row].run, quick)
        records[row] = Record(lines=lines, environment=environment())
        print(f"{row}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)
    return records


def _write(records: Records) -> None:
    """Put the records among those of other rows, in the order of the table."""
    known = load() | records
    known = {row: known[row] for row in (*ROWS, LONG) if row in known}
    save(known)
    rows = {row: (module, row) for row, module in ROWS.items()}
    rows[LONG] = (memory, "memory --ticks 1000000 --save")
    PAGE.write_text(draw_page(known, rows), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
