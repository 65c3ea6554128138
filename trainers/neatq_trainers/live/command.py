"""`neatq play`, and `--live` of `neatq train`."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import count
from pathlib import Path

from neatq_torch.kinds import ConfigError
from neatq_trainers.callbacks import Callback

ENDLESS_TICKS = 100_000_000
"""Length of a run that somebody plays with, and ends."""
_NEEDED = ("starlette", "uvicorn", "websockets", "msgspec")
_PLAY_HELP = """usage: neatq play [RUN] [-h] [OPTIONS]

Open a page in the browser in which robots learn while you watch: choose the speed, move walls and
flags, change rewards, click a robot and see its network think, keep teams, let them fight.

  RUN           a run folder, with which it goes on, or with a copy of it (runs/play-N) if it has
                its whole length; without a RUN one begins (runs/play-N)
  --port N      the first port to try (8642)
  --host ADDR   where to listen. Default: this machine alone. With 0.0.0.0 everybody who can reach
                the machine and has the address with its token can watch and change the run
  --speed N     ticks a second at first (60); 0: as fast as it can
  --no-browser  only print the address

All other OPTIONS are those of neatq train (neatq train --help), or with a RUN of neatq resume.

Examples: neatq play --task maze --arm neatq
          neatq play runs/first --ticks 100000 --speed 0
"""


def play_command(arguments: list[str]) -> None:
    """`neatq play`."""
    if arguments[:1] in (["-h"], ["--help"]):
        print(_PLAY_HELP, end="")
        return
    from neatq_trainers.commands import resume_command, train_command

    own, rest = window_options(arguments)
    if rest and not rest[0].startswith("-"):
        resume_command(_with_life_left(rest), own)
        return
    given = {one.partition("=")[0] for one in rest}
    if not given & {"--ticks", "--steps", "--generations"} and not _is_gymnasium(rest):
        rest = [*rest, "--ticks", str(ENDLESS_TICKS)]
    if "--out" not in given:
        rest = [*rest, "--out", str(_free_folder())]
    train_command(rest, own)


def window_options(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """The options of the window, and the rest.

    Raises:
        ConfigError: If one is impossible.
    """
    own = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    own.add_argument("--port", type=int, default=8642)
    own.add_argument("--host", default="127.0.0.1")
    own.add_argument("--speed", type=float, default=60.0)
    own.add_argument("--no-browser", "--no_browser", action="store_true")
    try:
        chosen, rest = own.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise ConfigError(str(error).removeprefix("argument ")) from error
    if not 0 < chosen.port < 65536:
        raise ConfigError(f"port: expected 1 to 65535, got {chosen.port}")
    if not 0 <= chosen.speed <= 100_000:
        raise ConfigError(f"speed: expected 0 to 100,000 ticks a second, got {chosen.speed:g}")
    return chosen, rest


@contextmanager
def opened(
    options: argparse.Namespace | None, workers: int | None
) -> Iterator[tuple[int | None, list[Callback]]]:
    """A window that serves pages while somebody trains; gives the workers and the callbacks.

    No options are no window.

    Raises:
        ConfigError: If what it needs is not installed, or more than one worker is asked for.
        OSError: If no port is free.
    """
    if options is None:
        yield workers, []
        return
    if workers not in (None, 1):
        raise ConfigError(f"workers: expected 1 with a window, which is in one, got {workers}")
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise ConfigError(f"the window needs {', '.join(missing)}: pip install 'neatq_torch[live]'")
    from neatq_trainers.live.server import Hub, Server
    from neatq_trainers.live.window import Window

    hub = Hub()
    with Server(hub, options.host, options.port) as server:
        print(f"neatq: watch at {server.url}", flush=True)
        if options.host not in ("127.0.0.1", "localhost", "::1"):
            print("neatq: whoever reaches this machine and has that address can change the run")
        with tempfile.TemporaryDirectory() as folder:
            if not options.no_browser and not webbrowser.open(_door(server.url, Path(folder))):
                print("neatq: no browser was found here; open that address in one", file=sys.stderr)
            yield 1, [Window(hub, options.speed or None)]


def _door(address: str, folder: Path) -> str:
    """A file that leads to an address: a command line shows its token to all users of a machine."""
    door = folder / "neatq.html"
    door.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    return door.as_uri()


def _with_life_left(arguments: list[str]) -> list[str]:
    """What to resume: where a run has its whole length a copy without end, and it stays."""
    from neatq_trainers.folder import load_run

    run = load_run(arguments[0])
    if any(one.startswith("--") for one in arguments) or not run.is_finished():
        return arguments
    copy, (unit, _) = _free_folder(), run.config.length
    shutil.copytree(run.path, copy, ignore=shutil.ignore_patterns("*.lock", ".*"))
    print(f"neatq: {arguments[0]} has its whole length; {copy} goes on from there", flush=True)
    return [str(copy), f"--{unit}", str(ENDLESS_TICKS)]


def _is_gymnasium(arguments: list[str]) -> bool:
    return any(one.startswith(("gym:", "--task=gym:")) for one in arguments)


def _free_folder() -> Path:
    """The first of runs/play-1, runs/play-2, ... that does not exist."""
    return next(path for n in count(1) if not (path := Path("runs") / f"play-{n}").exists())
