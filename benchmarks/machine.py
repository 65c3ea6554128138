"""On what it was measured."""

from __future__ import annotations

import os
import platform
from datetime import date

import torch

from neatq_trainers.info import processor, version_of

PACKAGES = ("torch", "torchrl", "numpy", "numba", "pymunk", "neat-python", "multineat")


def environment() -> dict[str, str]:
    """Date, machine and versions, by name."""
    return {
        "date": date.today().isoformat(),
        "CPU": processor(),
        "cores": str(os.cpu_count()),
        "GPU": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
        **{name: version_of(name) for name in PACKAGES},
    }
