"""`neatq info`: what somebody must know who is to find a fault."""

from __future__ import annotations

import os
import platform
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch
import tyro

from neatq_envs.processes import usable_cores
from neatq_torch.checkpoint import CheckpointError
from neatq_trainers.commands import parse
from neatq_trainers.folder import CONFIG, load_run
from neatq_trainers.lock import RunFolderError

INFO_PACKAGES = (
    "neatq_torch",
    "torch",
    "torchrl",
    "tensordict",
    "numpy",
    "numba",
    "gymnasium",
    "pymunk",
)


@dataclass(frozen=True, kw_only=True)
class InfoCommand:
    """Say which versions run on which machine, and with which settings a run was made.

    Made to be pasted where you report a fault.
    """

    folder: tyro.conf.Positional[Path | None] = None
    """A run folder."""


def info_command(arguments: list[str]) -> None:
    """`neatq info`."""
    folder = parse(InfoCommand, "info", arguments).folder
    lines = {"python": platform.python_version(), **{one: version_of(one) for one in INFO_PACKAGES}}
    lines |= {
        "system": platform.platform(),
        "processor": processor(),
        "cores": f"{os.cpu_count()}, of which {usable_cores()} may be used",
        "GPU": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
    }
    if folder is not None:
        try:
            lines[CONFIG] = "\n" + (folder / CONFIG).read_text("utf-8", "replace").rstrip()
        except (FileNotFoundError, NotADirectoryError) as error:
            raise RunFolderError(f"{folder}: no run folder; there is no {CONFIG} in it") from error
        with suppress(RunFolderError, CheckpointError, LookupError, TypeError, ValueError):
            lines |= {"solved": solved} if (solved := load_run(folder).solved()) else {}
    for name, value in lines.items():
        print(f"{name}: {value}")


def version_of(package: str) -> str:
    """The installed version of a package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def processor() -> str:
    """What the processor is called."""
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    if platform.system() == "Darwin":
        command = ["sysctl", "-n", "machdep.cpu.brand_string"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    return platform.processor() or "unknown"
