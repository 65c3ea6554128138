"""Runs that are killed again and again end as those that never were.

    python -m benchmarks.soak --kills 50

Each run is a process of its own, `neatq train` and then `neatq resume`. At random moments its main
process or one of its workers is killed as by `kill -9`. Checked are that workers end with their
main process and the main process with its workers, that words without a traceback say what
happened, and in the end that the folder holds the same files as that of an uninterrupted run, with
the same content, and logs with the same rows.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
from tensorboard.backend.event_processing.event_file_loader import LegacyEventFileLoader

from neatq_trainers.callbacks import LOGS
from neatq_trainers.folder import CHECKPOINT, CONFIG, FILES
from neatq_trainers.lock import HOLDER, LOCK

_ARENA = ("--task", "flag", "--env-kwargs", "robots=9", "lifetime_ticks=200", "--arm", "neatq")
_POLE = ("--task", "gym:CartPole-v1", "--arm", "neat", "--world.slots", "8")
_POLE += ("--world.test-episodes", "5", "--world.episodes", "2")
RUNS = {
    "arena": (*_ARENA, "--ticks", "1000", "--arenas", "2", "--workers", "1"),
    "arena, 2 workers": (*_ARENA, "--ticks", "1000", "--arenas", "2", "--workers", "2"),
    "gymnasium": (*_POLE, "--generations", "4", "--workers", "1"),
    "gymnasium, 2 workers": (*_POLE, "--generations", "4", "--workers", "2"),
    "gymnasium, 2 arenas": (*_POLE, "--generations", "4", "--arenas", "2", "--workers", "2"),
}
LOGGERS = ("None", "csv", "tensorboard")
SECONDS_TO_END = 1.0
"""In which workers end after their main process."""
_SLACK = 1.0  # for a busy machine


class Reference(NamedTuple):
    """A run that nobody killed."""

    folder: Path
    seconds: float


def soak(kills: int, folder: Path, runs: Sequence[str], loggers: Sequence[str], seed: int) -> None:
    """Kill runs that often in a folder, one kind of run after the other, and print what happened.

    Raises:
        AssertionError: If something is not as it should be; the run's folder stays.
    """
    rng, left, done = np.random.default_rng(seed), kills, 0
    counts = {"main process": 0, "worker": 0}
    references: dict[tuple[str, str], Reference] = {}
    for kind in cycle([(run, logger) for logger in loggers for run in runs]):
        if left <= 0:
            break
        options = [*RUNS[kind[0]], "--logger", kind[1], "--checkpoint-seconds", "0.2"]
        if kind not in references:
            references[kind] = _uninterrupted(folder / f"whole {len(references)}", options)
        path = folder / f"run {done} ü"
        killed = list(_killed(path, options, references[kind].seconds, min(left, 6), rng))
        check_equal(path, references[kind].folder)
        left, done = left - len(killed), done + 1
        for victim in killed:
            counts[victim] += 1
        print(f"{kind[0]}, logger {kind[1]}: {', '.join(killed) or 'no kill'}; equal", flush=True)
    said = ", ".join(f"{count} of a {victim}" for victim, count in counts.items())
    print(f"{kills - left} kills ({said}) in {done} runs: all ended as if nobody had killed them")


def _uninterrupted(path: Path, options: Sequence[str]) -> Reference:
    before = time.monotonic()
    process = _begin(path, options)
    said = process.communicate()
    assert process.returncode == 0, said
    return Reference(path, time.monotonic() - before)


def _begin(path: Path, options: Sequence[str]) -> subprocess.Popen[str]:
    """Begin a run, or go on with it where it has a checkpoint."""
    command = ["train", *options, "--out", str(path)]
    if (path / CHECKPOINT).is_file():
        command = ["resume", str(path), "--workers", options[options.index("--workers") + 1]]
    return subprocess.Popen(
        [sys.executable, "-m", "neatq_trainers", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"},
    )


def _killed(
    path: Path, options: Sequence[str], seconds: float, kills: int, rng: np.random.Generator
) -> Iterator[str]:
    """Run to the end with at most so many kills; yields who was killed."""
    while True:
        process = _begin(path, options)
        if kills:
            time.sleep(rng.uniform(0, seconds))
            if process.poll() is None:
                kills -= 1
                yield _kill(process, path, rng)
                continue
        out, error = process.communicate()
        assert process.returncode == 0, f"{path}: {out}{error}"
        return


def _kill(process: subprocess.Popen[str], path: Path, rng: np.random.Generator) -> str:
    """Kill a process of a run, see that the others end, and return which it was."""
    main = psutil.Process(process.pid)
    workers = [one for one in main.children() if "spawn_main" in " ".join(_command(one))]
    if workers and rng.random() < 0.4:
        workers[int(rng.integers(len(workers)))].kill()
        victim = "worker"
    else:
        process.kill()
        victim = "main process"
    _, error = process.communicate(timeout=60)
    _, alive = psutil.wait_procs(workers, SECONDS_TO_END + _SLACK)
    assert not alive, f"{path}: {alive} live on without their main process"
    assert "Traceback" not in error, f"{path}: {error}"
    if victim == "worker" and process.returncode:
        assert process.returncode == 2, f"{path}: {process.returncode}: {error}"
        assert "SIGKILL" in error, f"{path}: {error}"
        if (path / CHECKPOINT).is_file():
            assert "neatq resume" in error, f"{path}: {error}"
    return victim


def _command(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


def check_equal(path: Path, whole: Path) -> None:
    """Compare a run folder with that of an uninterrupted run.

    Raises:
        AssertionError: If they differ in their files, what is in these, or the rows of their logs.
    """
    ours, theirs = set(os.listdir(path)), set(os.listdir(whole))
    ours, theirs = ours - {LOCK, HOLDER}, theirs - {LOCK, HOLDER}
    assert ours == theirs, f"{path} and {whole} have other files: {sorted(ours ^ theirs)}"
    for name in (CONFIG, *FILES):
        if name in theirs:
            same = (path / name).read_bytes() == (whole / name).read_bytes()
            assert same, f"{name} differs in {path} and {whole}"
    assert logged(path) == logged(whole), f"logs differ in {path} and {whole}"


def logged(path: Path) -> list[tuple[str, int, float]]:
    """All scalars in the logs of a run folder: name, step and value, in order."""
    rows = []
    for file in (path / LOGS).rglob("*.csv"):
        lines = [line.split(",") for line in file.read_text().splitlines()]
        rows += [(file.stem, int(step), float(value)) for step, value in lines]
    for file in (path / LOGS).rglob("events.out.tfevents.*"):
        for event in LegacyEventFileLoader(str(file)).Load():
            rows += [(one.tag, event.step, one.simple_value) for one in event.summary.value]
    return sorted(rows)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--runs", nargs="+", choices=[*RUNS], default=[*RUNS])
    parser.add_argument("--loggers", nargs="+", choices=LOGGERS, default=LOGGERS)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    chosen = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="soak "))
    print(f"in {folder}", flush=True)
    soak(chosen.kills, folder, chosen.runs, chosen.loggers, chosen.seed)


if __name__ == "__main__":
    main()
