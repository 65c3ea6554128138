"""Every test runs on one thread, without a display, with the same examples each time."""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")  # before anything imports matplotlib

import pytest
import torch
from hypothesis import settings

torch.set_num_threads(1)

# The same examples in every run: a red test stays red. To hunt for new examples:
#   HYPOTHESIS_PROFILE=search make test
settings.register_profile("ci", derandomize=True, deadline=None, database=None, print_blob=True)
settings.register_profile("search", max_examples=1000, deadline=None, database=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


@pytest.fixture(scope="session")
def toy() -> str:
    """What the ids of the toy environments begin with, once they can be imported."""
    folder = str(Path(__file__).parent / "toy")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    return "gym:toy_tasks:toy/"
