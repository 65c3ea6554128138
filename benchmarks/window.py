"""`neatq train` with the training window and a page that looks: arm `replay`, `wall`, CPU time.

A tick of the trainer between tick 1,000 and the end of a run, as fast as it can, with a page that
takes all that is sent at 30 frames a second (a process of its own, which is not measured, and looks
into a robot), beside the same run without a window. The thread that serves the page is part of our
cost. With a window and no page open the run makes nothing for it.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarks.measure import in_rounds
from benchmarks.result import Goal, Line, compare
from neatq_torch import preset
from neatq_trainers.callbacks import Callback
from neatq_trainers.live.server import Hub, Server
from neatq_trainers.live.window import Window
from neatq_trainers.rows import Row
from neatq_trainers.train import Session, start

BEGIN = 1000
_PAGE = """
import sys
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
with connect(sys.argv[1], max_size=None) as page:
    page.send('{"type": "choose", "slot": 3}')
    try:
        while True:
            page.recv()
    except ConnectionClosed:
        pass
"""


class _Marks(Callback):
    """Reads the clock at ticks."""

    def __init__(self, ticks: Sequence[int]) -> None:
        self.ticks, self.seconds = ticks, list[float]()

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        if session.lengths["ticks"] in self.ticks:
            self.seconds.append(time.process_time())


def run(quick: bool) -> list[Line]:
    """Measure a tick with nobody there, with a window alone, and with a page."""
    ticks = BEGIN + (1000 if quick else 8000)
    _watched_micros(BEGIN + 400)  # which loads and compiles
    samples = in_rounds(
        {
            "none": lambda: _tick_micros(ticks, []),
            "window": lambda: _tick_micros(ticks, [Window(Hub(), None)]),
            "page": lambda: _watched_micros(ticks),
        },
        rounds=1 if quick else 5,
    )
    goal = Goal(text="at most 10 % on top", limit=1.1, of="ratio")
    nothing = Goal(text="nothing on top (2 %)", limit=1.02, of="ratio")
    beside, what = "without a window", "a tick, a page that looks"
    return [
        compare(what, samples["page"], beside, samples["none"], unit="us", goal=goal),
        compare(
            "a tick, no page is open", samples["window"], beside, samples["none"], unit="us",
            goal=nothing,
        ),
    ]  # fmt: skip


def _tick_micros(ticks: int, callbacks: Sequence[Callback]) -> float:
    marks = _Marks((BEGIN, ticks))
    with tempfile.TemporaryDirectory() as folder:
        config = preset("wall", "replay").changed({"ticks": ticks})
        start(config, Path(folder) / "run", callbacks=[*callbacks, marks])
    return 1e6 * (marks.seconds[1] - marks.seconds[0]) / (ticks - BEGIN)


def _watched_micros(ticks: int) -> float:
    hub = Hub()
    with Server(hub) as server, _page(server, hub):
        return _tick_micros(ticks, [Window(hub, None)])


@contextmanager
def _page(server: Server, hub: Hub) -> Iterator[None]:
    address = server.url.replace("http", "ws").replace("/?", "/socket?")
    page = subprocess.Popen([sys.executable, "-c", _PAGE, address])
    try:
        while not hub.watched:
            time.sleep(0.05)
        yield
    finally:
        page.kill()
        page.wait()
