"""Whatever is read, nothing but our own errors comes of it, in little time and memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KINDS = ("genomes", "scenarios", "configs", "checkpoints")


def test_hundreds_of_mutated_inputs_of_each_kind_are_read_or_refused() -> None:
    command = [sys.executable, "-m", "benchmarks.fuzz", "--inputs", "300"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(f"{kind}: 300 inputs" in done.stdout for kind in KINDS)
