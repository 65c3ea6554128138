"""Inputs that nobody meant well: genomes, scenarios, configurations and checkpoints, mutated.

    python -m benchmarks.fuzz --inputs 100000                # all kinds
    python -m benchmarks.fuzz genomes --inputs 2000 --seed 7

Each input is a good one whose values, keys or bytes were changed, with memory and time bounded.
Whatever comes but our own error is a failure, and is printed with the number by which `--only`
makes it again.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from neatq_envs.checks import ScenarioError
from neatq_envs.scenario import TASKS, find_scenario
from neatq_torch.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from neatq_torch.genome import (
    Genome,
    GenomeError,
    InnovationLedger,
    MutationConfig,
    initial_genome,
    load_genome,
    mutate,
)
from neatq_torch.json_text import parse_json
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset
from neatq_trainers.config import RunConfig

SECONDS = 1.0
"""Of processor time for one input."""
MEGABYTES = 400
"""Beyond what the process has before the first input."""

ODD: tuple[str, ...] = (
    *("0", "-1", "1e-300", "1e300", "1e400", "-1e400", "NaN", "Infinity", "-Infinity", "0.5"),
    *(str(2**31), str(2**32), str(2**63), str(-(2**63) - 1), str(10**9), "9" * 400, "9" * 5000),
    *("true", "false", "null", '""', '"x"', '"\\ud800"', '"../../x"', '"a\\u0000b"'),
    *("[]", "{}", "[[]]", '{"x": 1}', "[1, 2]", '"' + "y" * 3000 + '"'),
    *("[" * 40 + "]" * 40, "[" * 900 + "]" * 900, "[" * 3000 + "]" * 3000, "[" * 3000),
)
"""Texts that stand in place of a value."""
_MARK = "\x01{}\x02"


@dataclass
class Outcome:
    """What came of many inputs of a kind."""

    kind: str
    inputs: int = 0
    refused: int = 0
    slowest_seconds: float = 0.0
    failures: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return (
            f"{self.kind}: {self.inputs:,} inputs, {self.refused:,} refused, "
            f"{self.inputs - self.refused - len(self.failures):,} fine, "
            f"{len(self.failures)} failures; slowest {self.slowest_seconds:.3f} s"
        )


Make = Callable[[np.random.Generator], Any]
Read = Callable[[Any], object]


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all values below a value."""
    items: Any = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    return [way for key, one in items for way in [(*path, key), *places(one, (*path, key))]]


def mutated(value: Any, rng: np.random.Generator) -> str:
    """JSON text of a value in which one to three things were changed."""
    value, texts = json.loads(json.dumps(value)), []
    for _ in range(rng.integers(1, 4)):
        ways = places(value)
        if not ways:
            break
        *above, key = ways[rng.integers(len(ways))]
        parent = value
        for one in above:
            parent = parent[one]
        _change(parent, key, texts, rng)
    text = json.dumps(value)
    for number, odd in enumerate(texts):
        text = text.replace(json.dumps(_MARK.format(number)), odd)
    return _damaged(text, rng) if rng.random() < 0.1 else text


def _change(parent: Any, key: Any, texts: list[str], rng: np.random.Generator) -> None:
    """Change the value at a key: remove, rename, double or replace it."""
    what = rng.integers(6)
    if what == 0:
        del parent[key]
    elif what == 1 and isinstance(parent, list):
        parent.insert(key, parent[key])
    elif what == 1:
        texts.append(f"1, {json.dumps(str(key))}: 2")  # the same key twice
        parent[key] = _MARK.format(len(texts) - 1)
    elif what == 2 and isinstance(parent, dict):
        parent[f"{key}x"] = parent.pop(key)
    elif what == 3 and type(parent[key]) in (int, float):
        parent[key] += (
            float(rng.normal()) if type(parent[key]) is float else int(rng.integers(-9, 9))
        )
    else:
        texts.append(ODD[rng.integers(len(ODD))])
        parent[key] = _MARK.format(len(texts) - 1)


def _damaged(text: str, rng: np.random.Generator) -> str:
    """A text with a part left out, doubled or changed."""
    start, length = int(rng.integers(len(text))), int(rng.integers(1, 30))
    middle = ("", text[start : start + length] * 2, chr(int(rng.integers(1, 0x300))))
    return text[:start] + middle[rng.integers(3)] + text[start + length :]


def _genomes() -> list[dict[str, Any]]:
    rng = np.random.default_rng(0)
    genome, found = initial_genome(3, 2, rng=rng), []
    ledger = InnovationLedger.for_genomes([genome])
    growth = MutationConfig(add_node_prob=0.5, add_link_prob=0.5)
    for _ in range(4):
        found.append(genome.to_dict())
        for _ in range(3):
            genome = mutate(genome, growth, ledger, rng)
    return found


def _read_genome(path: Path) -> object:
    genome = load_genome(path)
    return Genome.from_json(genome.to_json())


def _read_config(path: Path) -> object:
    try:
        values = parse_json(path.read_bytes())
    except ValueError as error:  # as `load_run` does
        raise ConfigError(str(error)) from error
    if not isinstance(values, dict):
        raise ConfigError("no object")
    return RunConfig.from_dict(RunConfig.from_dict(values).to_dict())


def _state() -> dict[str, Any]:
    return {
        "tick": 7,
        "share": 0.1,
        "populations": [{"weight": np.arange(12.0).reshape(3, 4), "ids": np.arange(5)}],
        "flags": np.ones((2, 3), bool),
        "none": None,
        "text": "x",
        "order": np.asfortranarray(np.ones((2, 2), np.float32)),
    }


def _damaged_checkpoint(good: bytes, rng: np.random.Generator) -> bytes:
    """A checkpoint with changed bytes, or changed members with right checksums."""
    if rng.random() < 0.3:
        data = bytearray(good)
        for _ in range(rng.integers(1, 9)):
            data[rng.integers(len(data))] = rng.integers(256)
        cut = int(rng.integers(len(data))) if rng.random() < 0.2 else len(data)
        return bytes(data[:cut])
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = list(members)[rng.integers(len(members))]
    if name == "manifest.npy" and rng.random() < 0.8:
        text = mutated(json.loads(members[name][128:]), rng).encode(errors="surrogatepass")
        buffer = io.BytesIO()
        np.save(buffer, np.frombuffer(text, np.uint8))
        members[name] = buffer.getvalue()
    else:
        data = bytearray(members[name])
        head = min(len(data), 128) if rng.random() < 0.7 else len(data)
        for _ in range(rng.integers(1, 6)):
            data[rng.integers(head)] = rng.choice(list(b"0123456789(),'{}:<f|O \\n\\x00\\xff"))
        members[name] = bytes(data)
    if rng.random() < 0.5:
        members.pop("digest.npy", None)  # as files of version 0.2.0
    buffer = io.BytesIO()
    deflated = rng.random() < 0.05
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED if deflated else 0) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def kinds(folder: Path) -> dict[str, tuple[Make, Read, tuple[type[Exception], ...]]]:
    """Each kind: how an input is made, how it is read, and our own errors."""
    path = folder / "input.json"

    def text_of(examples: list[Any]) -> Make:
        def make(rng: np.random.Generator) -> Path:
            text = mutated(examples[rng.integers(len(examples))], rng)
            path.write_bytes(text.encode(errors="surrogatepass"))
            return path

        return make

    scenarios = [one.to_dict() for one in TASKS.values()]
    arms = [("wall", "neatq"), ("flag", "rtneat"), ("switch", "qlearning"), ("trap", "neat+q")]
    arms += [("gym:CartPole-v1", "neat"), ("gym:Pendulum-v1", "neatq")]
    configs = [preset(task, arm).to_dict() for task, arm in arms]
    save_checkpoint(folder / "good.npz", _state(), observation_schema="x")
    good = (folder / "good.npz").read_bytes()

    def checkpoint(rng: np.random.Generator) -> Path:
        (folder / "bad.npz").write_bytes(_damaged_checkpoint(good, rng))
        return folder / "bad.npz"

    return {
        "genomes": (text_of(_genomes()), _read_genome, (GenomeError,)),
        "scenarios": (text_of(scenarios), find_scenario, (ScenarioError,)),
        "configs": (text_of(configs), _read_config, (ConfigError,)),
        "checkpoints": (checkpoint, load_checkpoint, (CheckpointError,)),
    }


def fuzz(kind: str, inputs: range, seed: int, folder: Path) -> Outcome:
    """Read so many inputs of a kind; input i depends on the seed and i alone."""
    make, read, own = kinds(folder)[kind]
    outcome = Outcome(kind)
    for number in inputs:
        source = make(np.random.default_rng([seed, number]))
        began = time.process_time()
        error: BaseException | None = None
        try:
            read(source)
        except own:
            outcome.refused += 1
        except Exception as other:
            error = other
        seconds = time.process_time() - began
        outcome.inputs += 1
        outcome.slowest_seconds = max(outcome.slowest_seconds, seconds)
        if error is not None or seconds > SECONDS:
            what = f"{seconds:.1f} s" if error is None else f"{type(error).__name__}: {error}"
            outcome.failures.append(f"{kind} {number}: {what[:300]}")
            outcome.refused -= error is None
    return outcome


def bound_memory() -> None:
    """Let the process have only so much more than it has now."""
    if sys.platform == "linux":
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (used + MEGABYTES * 2**20, hard))


def main() -> None:
    """Read the options, and the inputs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", help="genomes, scenarios, configs, checkpoints")
    parser.add_argument("--inputs", type=int, default=2_000, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="the number of one input")
    options = parser.parse_args()
    inputs = (
        range(options.inputs) if options.only is None else range(options.only, options.only + 1)
    )
    failed = False
    with TemporaryDirectory() as folder:
        wanted = options.kinds or list(kinds(Path(folder)))
        fuzz(wanted[0], range(20), options.seed + 1, Path(folder))  # compile and load all
        bound_memory()
        for kind in wanted:
            outcome = fuzz(kind, inputs, options.seed, Path(folder))
            print(outcome, *outcome.failures[:20], sep="\n    ", flush=True)
            failed |= bool(outcome.failures)
    raise SystemExit(failed)


if __name__ == "__main__":
    main()
