"""Short runs that compile what numba keeps, before processes of tests each do it by themselves.

`make test` calls it while the types are checked.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import torch

from neatq_trainers import train as trainer

SMALL = {"robots": 8, "lifetime_ticks": 100}
FOLLOWERS = {**SMALL, "sensors": "opennero-2011", "firing": "2011"}
RUNS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("wall", "replay", {"env_kwargs": SMALL, "ticks": 240}),
    ("wall", "described", {"env_kwargs": SMALL, "ticks": 240}),
    ("wall", "qlearning", {"env_kwargs": SMALL, "ticks": 80}),
    ("switch", "neatq", {"env_kwargs": SMALL, "ticks": 240}),
    ("nero", "neatq", {"env_kwargs": SMALL, "ticks": 240}),
    ("nero", "rtneat", {"env_kwargs": FOLLOWERS | {"against": ["league"]}, "ticks": 120}),
    ("gym:CartPole-v1", "neat+q", {"settings": {"world.slots": 10}, "generations": 2}),
    ("gym:Pendulum-v1", "neatq", {"settings": {"world.slots": 10}, "steps": 1500}),
)

if __name__ == "__main__":
    torch.set_num_threads(1)
    trainer.BUILT_IN = ()  # no files but the run's, and no pictures
    for task, arm, how in RUNS:
        with tempfile.TemporaryDirectory() as folder:
            trainer.train(task, arm, out=Path(folder) / "run", workers=1, **how)
