"""Kills, signals, full and read-only disks: nothing is lost, nothing is left behind."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import psutil
import pytest

from benchmarks.soak import check_equal, logged, soak
from neatq_envs.processes import ProcessEnded, Remote
from neatq_torch.genome import Genome, save_genome
from neatq_trainers import lock
from neatq_trainers import train as trainer
from neatq_trainers.callbacks import LOGS, Callback
from neatq_trainers.cli import main
from neatq_trainers.compiling import CompilingTold
from neatq_trainers.config import RunConfig
from neatq_trainers.folder import (
    CHAMPION,
    CHECKPOINT,
    CONFIG,
    METRICS,
    RunFolder,
    RunFolderError,
    load_run,
)
from neatq_trainers.rows import Row
from neatq_trainers.signals import Terminated, handling
from neatq_trainers.train import Session, resume, start

resource: Any = pytest.importorskip("resource", reason="Windows has other signals and limits")
pytestmark = pytest.mark.usefixtures("without_pictures")
Tiny = Callable[..., RunConfig]


class PowerCut(BaseException):
    """Nothing catches it."""


class AtTick(Callback):
    """Does something once a run is as long as that, after the rows of this moment are written."""

    def __init__(self, tick: int, act: Callable[[Session], object]) -> None:
        self.tick, self.act = tick, act

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        if session.lengths["ticks"] >= self.tick:
            self.tick = 10**9
            self.act(session)


def cut_power(*_: object) -> None:
    raise PowerCut


@pytest.fixture(scope="module")
def config(tiny: Tiny) -> RunConfig:
    return tiny("neatq", ticks=320, arenas=2)


@pytest.fixture(scope="module")
def whole(config: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return start(config, tmp_path_factory.mktemp("whole") / "run").path


# ---------------------------------------------------------------------------- one process a folder


def test_a_second_resume_is_refused_with_the_process_of_the_first(
    config: RunConfig, whole: Path, tmp_path: Path
) -> None:
    def second(session: Session) -> None:
        wanted = f"process {os.getpid()} on .* is training in it"
        with pytest.raises(RunFolderError, match=wanted):
            resume(session.folder.path)

    start(config, tmp_path / "run", callbacks=[AtTick(80, second)])
    check_equal(tmp_path / "run", whole)


HOLD = "import sys, time; from pathlib import Path; from neatq_trainers.lock import locked\n"
HOLD += "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)\n"


def test_the_lock_dies_with_its_owner(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "held\n"
        with pytest.raises(RunFolderError, match=f"process {owner.pid} on"), lock.locked(tmp_path):
            pass
        owner.kill()
        owner.wait()
    with lock.locked(tmp_path):
        assert f"process {os.getpid()} " in (tmp_path / lock.HOLDER).read_text()
    assert os.listdir(tmp_path) == []


class NoLock:
    """A lock as a file system without locks, or one that cannot be written, has it."""

    error = errno.EROFS

    def __init__(self, *_: object, **__: object) -> None: ...

    def acquire(self) -> None:
        raise OSError(self.error, os.strerror(self.error))

    def release(self) -> None: ...


def test_a_finished_run_on_a_read_only_disk_is_said_to_be_finished(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    monkeypatch.setattr(lock, "FileLock", NoLock)
    assert main(["resume", str(run)]) == 0
    assert "neatq: the run is finished; the folder cannot be written" in capsys.readouterr().out
    assert main(["resume", str(run), "--ticks", "1000"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{run}: cannot be written (Read-only file system), and its run is not finished" in line
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_without_locks_in_the_file_system_a_line_says_so_and_the_run_goes_on(
    config: RunConfig,
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(NoLock, "error", errno.ENOLCK)
    monkeypatch.setattr(lock, "FileLock", NoLock)
    start(config, tmp_path / "run")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"neatq: {tmp_path / 'run'}: its file system has no locks")
    check_equal(tmp_path / "run", whole)


# ---------------------------------------------------------------------------- kill -9


@pytest.mark.parametrize("logger", ["csv", "tensorboard"])
def test_a_killed_run_has_no_row_twice_in_its_logs(logger: str, tiny: Tiny, tmp_path: Path) -> None:
    config = tiny("rtneat", ticks=400, arenas=2, logger=logger, checkpoint_seconds=0.0)
    start(config, tmp_path / "whole")
    with pytest.raises(PowerCut):  # the row of tick 300 is logged, the checkpoint has 280 ticks
        start(config, tmp_path / "run", callbacks=[AtTick(300, cut_power)])
    assert max(step for _, step, _ in logged(tmp_path / "run")) == 300
    assert load_run(tmp_path / "run").read()["done"]["ticks"] == 280
    resume(tmp_path / "run")
    check_equal(tmp_path / "run", tmp_path / "whole")


def test_logs_that_the_first_checkpoint_does_not_know_go_when_the_run_begins_anew(
    tiny: Tiny, tmp_path: Path
) -> None:
    config = tiny("rtneat", ticks=200, logger="tensorboard")
    start(config, tmp_path / "whole")
    with pytest.raises(PowerCut):
        start(config, tmp_path / "run", callbacks=[AtTick(120, cut_power)])
    resume(tmp_path / "run")
    check_equal(tmp_path / "run", tmp_path / "whole")


def test_a_checkpoint_that_does_not_tell_of_logs_leaves_them_alone(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As those of the release before."""
    start(tiny("rtneat", ticks=120, logger="csv"), tmp_path / "run")
    before, read = logged(tmp_path / "run"), RunFolder.read

    def old(folder: RunFolder) -> Any:
        state = read(folder)
        del state["logs"]
        return state

    monkeypatch.setattr(RunFolder, "read", old)
    load_run(tmp_path / "run").load()
    assert logged(tmp_path / "run") == before


def test_a_folder_whose_run_was_killed_while_its_first_files_were_written_can_be_begun_anew(
    config: RunConfig, whole: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    for name in (f".{CONFIG}.0123abcd", f".{METRICS}.ffffffff", lock.LOCK, lock.HOLDER):
        (run / name).write_text("half of i")
    start(config, run)
    check_equal(run, whole)


def test_resume_removes_what_killed_writes_left_and_nothing_else(
    whole: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    (run / f".{CHECKPOINT}.0123abcd").write_bytes(b"half")
    strangers = {".notes.txt.0123abcd", f".{CHECKPOINT}.backup", f"{CHECKPOINT}.0123abcd"}
    for name in strangers:
        (run / name).touch()
    resume(run)
    assert set(os.listdir(run)) == set(os.listdir(whole)) | strangers


@pytest.mark.parametrize("world", ["arena", "gymnasium"])
def test_a_kill_between_the_last_checkpoint_and_the_other_files_loses_nothing(
    world: str, tiny: Tiny, tiny_walk: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny("replay", ticks=320) if world == "arena" else tiny_walk("neat")
    config = replace(config, checkpoint_seconds=0.0)
    start(config, tmp_path / "whole")

    def late(genome: Genome, path: Path) -> None:
        if load_run(path.parent).is_finished():
            raise PowerCut
        save_genome(genome, path)

    with monkeypatch.context() as patch, pytest.raises(PowerCut):
        patch.setattr("neatq_trainers.folder.save_genome", late)
        start(config, tmp_path / "run")
    ours, theirs = ((tmp_path / name / CHAMPION) for name in ("run", "whole"))
    assert ours.read_bytes() != theirs.read_bytes(), "that of an earlier checkpoint"
    resume(tmp_path / "run")
    check_equal(tmp_path / "run", tmp_path / "whole")


# ---------------------------------------------------------------------------- workers


@pytest.mark.parametrize(
    ("end", "says"),
    [
        ((signal.raise_signal, signal.SIGSEGV), r"exit code -11 \(SIGSEGV: a segmentation fault"),
        ((signal.raise_signal, signal.SIGKILL), r"exit code -9 \(SIGKILL: .*want of memory"),
        ((os._exit, 3), "exit code 3; what is on disk"),
    ],
)
def test_how_a_process_ended_is_said(end: tuple[Any, int], says: str) -> None:
    remote = Remote(*end)
    with pytest.raises(ProcessEnded, match=says):
        remote.answer()
    remote.close()


@pytest.mark.parametrize(
    ("error", "status", "says"),
    [
        (ProcessEnded("a process ended"), 2, "error: a process ended; go on with: neatq resume"),
        (MemoryError(), 2, "error: out of memory; try fewer .*; go on with: neatq resume"),
        (OSError(errno.ENOSPC, "No space left", "f"), 2, "f: No space left; go on with: neatq res"),
        (KeyboardInterrupt(), 130, "stopped; go on with: neatq resume"),
        (Terminated(143), 143, "stopped; go on with: neatq resume"),
        (Terminated(129), 129, "stopped; go on with: neatq resume"),
    ],
)
def test_what_stops_a_run_is_said_in_a_line_with_what_to_type(
    error: BaseException,
    status: int,
    says: str,
    whole: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(trainer, "resume", stopped)
    assert main(["resume", str(whole)]) == status
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(says, line), line


ORPHAN = """
import os, signal, sys
from neatq_envs.processes import Remote
if __name__ == "__main__":
    remote = Remote(exec, "while True: pass")
    print(remote._process.pid, flush=True)
    sys.stdin.readline()
    EXIT
"""


@pytest.mark.parametrize(
    "exit_", [f"os.kill(os.getpid(), signal.{name})" for name in ("SIGKILL", "SIGTERM")]
)
def test_a_busy_process_ends_within_a_second_of_the_one_that_began_it(
    exit_: str, tmp_path: Path
) -> None:
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN.replace("EXIT", exit_))
    command, pipe = [sys.executable, str(script)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        worker = psutil.Process(int(process.stdout.readline()))
        while worker.cpu_times().user < 0.5:  # it is at work
            time.sleep(0.05)
        process.stdin.write("\n")
        process.stdin.flush()
        process.wait()
        gone, _ = psutil.wait_procs([worker], 2.0)
    assert gone == [worker]


@pytest.mark.usefixtures("spawned")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_process_that_still_imports_leaves_signals_to_the_one_that_began_it(name: str) -> None:
    remote = Remote(float, 3)
    assert remote._process.pid is not None
    os.kill(remote._process.pid, getattr(signal, name))
    remote.ask("is_integer")
    assert remote.answer() is True
    remote.close()


@pytest.mark.usefixtures("spawned")
def test_nobody_forks_and_a_path_may_have_spaces_and_umlauts(
    config: RunConfig, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> int:
        raise AssertionError("somebody forks")

    monkeypatch.setattr(os, "fork", refuse)
    folder = tmp_path / "mein Läufe" / "arena ü"
    with start_method("spawn"):
        start(replace(config, ticks=120), folder, workers=2)
    monkeypatch.undo()
    resume(folder, ticks=config.ticks, workers=1)
    assert (folder / METRICS).read_bytes() == (whole / METRICS).read_bytes()


@contextmanager
def start_method(name: str) -> Iterator[None]:
    before = multiprocessing.get_start_method(allow_none=True)
    multiprocessing.set_start_method(name, force=True)
    try:
        yield
    finally:
        multiprocessing.set_start_method(before, force=True)


# ---------------------------------------------------------------------------- signals and streams


def signal_everybody(name: str) -> None:
    """What a scheduler does: every process of the run gets the signal."""
    for child in multiprocessing.active_children():
        assert child.pid is not None
        os.kill(child.pid, getattr(signal, name))
    signal.raise_signal(getattr(signal, name))


@pytest.mark.parametrize(("name", "workers"), [("SIGTERM", 2), ("SIGHUP", 1)])
def test_sigterm_and_sighup_end_a_run_in_order(
    name: str, workers: int, config: RunConfig, whole: Path, tmp_path: Path
) -> None:
    act, number = AtTick(40, lambda _: signal_everybody(name)), getattr(signal, name)
    default: Any = signal.SIG_DFL
    with handling([number], default):  # where the tests themselves run under nohup, too
        with pytest.raises(Terminated) as caught:
            start(replace(config, ticks=5000), tmp_path / "run", workers=workers, callbacks=[act])
        assert signal.getsignal(number) is signal.SIG_DFL
    assert caught.value.code == 128 + number
    assert multiprocessing.active_children() == []
    assert 40 <= load_run(tmp_path / "run").read()["done"]["ticks"] < 600
    if workers == 1:
        resume(tmp_path / "run", ticks=320)
        check_equal(tmp_path / "run", whole)


def test_a_signal_that_is_ignored_stays_ignored(
    config: RunConfig, whole: Path, tmp_path: Path
) -> None:
    """As nohup has it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        act = AtTick(40, lambda _: signal.raise_signal(signal.SIGHUP))
        start(config, tmp_path / "run", callbacks=[act])
    finally:
        signal.signal(signal.SIGHUP, before)
    check_equal(tmp_path / "run", whole)


def test_ctrl_c_while_the_program_imports_is_answered_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text(
        "import signal, time\ntry:\n    signal.raise_signal(signal.SIGINT)\n    time.sleep(9)\n"
        "except BaseException as error:\n    raise ImportError('numpy says so') from error\n"
    )
    done = in_new_process(tmp_path, ["-m", "neatq_trainers", "resume", "my run"])
    assert done.returncode == 130
    assert done.stderr == "neatq: stopped before it began; begin with: neatq resume 'my run'\n"


def in_new_process(folder: Path, arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(folder), *sys.path])
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
        # Whoever is started in the background of a script is deaf to Ctrl-C, and hands that on.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


@pytest.mark.parametrize("module", ["neatq_trainers", "neatq_trainers.cli"])
def test_the_package_is_the_command(module: str, tmp_path: Path) -> None:
    done = in_new_process(tmp_path, ["-m", module])
    assert (done.returncode, done.stderr) == (2, "")
    assert done.stdout.startswith("usage: neatq")


def test_a_run_needs_no_standard_streams(
    config: RunConfig, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    start(config, tmp_path / "run")
    monkeypatch.undo()
    check_equal(tmp_path / "run", whole)


def test_the_command_runs_with_closed_streams_and_no_file_takes_their_numbers(
    tmp_path: Path,
) -> None:
    code = (
        "import os, sys\nfrom neatq_trainers.cli import main\nassert sys.stderr is None\n"
        "main(['--help'])\nfile = open('file', 'w')\nassert file.fileno() > 2\n"
        "os.write(2, b'a library complains')\nfile.write('good')\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    command = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", sys.executable, str(script)]
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 0
    assert (tmp_path / "file").read_text() == "good"


# ---------------------------------------------------------------------------- full disks


def test_a_disk_that_is_full_in_the_middle_of_a_row_loses_nothing(
    config: RunConfig, whole: Path, tmp_path: Path
) -> None:
    def fill(session: Session) -> None:
        size = (session.folder.path / METRICS).stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 10, hard))

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OSError, match="File too large") as caught:
            start(config, tmp_path / "run", callbacks=[AtTick(120, fill)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert caught.value.filename == str(tmp_path / "run" / METRICS)
    assert not (tmp_path / "run" / METRICS).read_bytes().endswith(b"\n"), "half a row"
    resume(tmp_path / "run")
    check_equal(tmp_path / "run", whole)


def test_a_disk_that_is_full_when_a_logger_writes_is_named(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("torchrl.record.loggers.csv.CSVLogger.log_scalar", full)
    with pytest.raises(OSError, match="No space left") as caught:
        start(tiny("rtneat", ticks=120, logger="csv"), tmp_path / "run")
    assert caught.value.filename == str(tmp_path / "run" / LOGS)


# ---------------------------------------------------------------------------- what it says


def test_info_has_versions_machine_and_settings(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(whole)]) == 0
    head, _, settings = capsys.readouterr().out.partition(f"{CONFIG}: ")
    names = [line.partition(": ")[0] for line in head.splitlines()]
    assert {"python", "neatq_torch", "torch", "torchrl", "tensordict", "numpy"} <= {*names}
    assert {"numba", "gymnasium", "pymunk", "system", "processor", "cores", "GPU"} <= {*names}
    assert json.loads(settings) == json.loads((whole / CONFIG).read_text())


def test_info_of_no_run_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(tmp_path)]) == 2
    assert f"{tmp_path}: no run folder; there is no config.json in it" in capsys.readouterr().err


def test_compiling_is_told_once_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    told = CompilingTold()
    for number in (1, 2):
        numba.njit(lambda x, number=number: x + number)(1)
    told.close()
    numba.njit(lambda x: x + 3)(1)
    first, last = capsys.readouterr().err.splitlines()
    assert first == "neatq: the first run on this machine compiles; that takes a while, once"
    assert last.startswith("neatq: compiled in ")


@pytest.mark.slow
def test_runs_that_are_killed_end_as_those_that_are_not(tmp_path: Path) -> None:
    """The quick form of `make soak`."""
    soak(1, tmp_path, ["arena"], ["csv"], seed=2)
