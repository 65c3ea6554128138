"""The folder of a run, written so that nothing is ever half there."""

from __future__ import annotations

import csv
import json
import os
import shlex
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from neatq_envs.random_play import EnvFacts
from neatq_torch.atomic import leftovers, write_atomic
from neatq_torch.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from neatq_torch.genome import Genome, load_genome, save_genome
from neatq_torch.json_text import parse_json
from neatq_torch.kinds import ConfigError
from neatq_trainers.callbacks import LOGS
from neatq_trainers.changes import CHANGES, Record
from neatq_trainers.config import LENGTHS, RunConfig
from neatq_trainers.lock import HOLDER, LOCK, RunFolderError
from neatq_trainers.rows import DistanceRow, NeroRow, ReturnRow, Row, csv_line, header, row_kind
from neatq_trainers.run import State
from neatq_trainers.saved import best_score, check_saved
from neatq_trainers.workers import Snapshot
from neatq_trainers.worlds import GymnasiumConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONFIG, METRICS, CHECKPOINT = "config.json", "metrics.csv", "checkpoint.npz"
CHAMPION, CURVES, PICTURE = "champion.json", "curves.png", "champion.png"
PATHS, TEAM, FILM = "arena.png", "team.gif", "champion.gif"
SCALING, RESULT, ROUNDS = "scaling.json", "result.json", "rounds.csv"
FILES = (METRICS, CHANGES, CURVES, PATHS, TEAM, CHAMPION, SCALING, RESULT, PICTURE, FILM, ROUNDS)
"""What a run may leave, in the order in which it is told."""
_WRITTEN = (CONFIG, CHECKPOINT, *FILES)

Columns = dict[str, np.ndarray]


class RunFolder:
    """A run on disk: what `train`, `resume` and `load_run` give.

    `metrics.csv` and the files of loggers grow; the checkpoint says how long they were, so that a
    run that goes on first cuts off what came later. All other files are replaced as a whole.

    Attributes:
        path: The folder; also `folder`.
        config: What runs.
        record: What somebody has changed in it since it began.
        track: Poses [slots, ticks, 3] of the latest strides of arena 0, one life of them.
        notes: What is to be said of the run after training.

    Example:
        >>> run = load_run("runs/wall-neatq-seed0")
        >>> run.metrics()["mean_distance"][-1]
        >>> policy = run.policy()
    """

    def __init__(self, path: Path, config: RunConfig) -> None:
        self.path, self.config, self.record = path, config, Record(path / CHANGES)
        self.track: deque[np.ndarray] = deque()
        self.notes: list[str] = []
        self._header = header(row_kind(config))
        self._bytes, self._crc = len(self._header), zlib.crc32(self._header.encode())

    def __repr__(self) -> str:
        return f"RunFolder({str(self.path)!r}, {self.config.arm} on {self.config.task})"

    @property
    def folder(self) -> Path:
        """The folder."""
        return self.path

    @staticmethod
    def create(path: Path, config: RunConfig) -> RunFolder:
        """Make the folder of a new run, with its configuration and metrics without rows.

        Raises:
            RunFolderError: If there is something in it.
            OSError: If it cannot be written.
        """
        check_new(path)
        path.mkdir(parents=True, exist_ok=True)
        (path / CHANGES).unlink(missing_ok=True)
        folder = RunFolder(path, config)
        folder.remove_leftovers()
        folder._write_config()
        write_atomic(path / METRICS, folder._header)
        return folder

    def remove_leftovers(self) -> None:
        """Remove temporary files of writes that were killed; nobody may train in the folder."""
        for temporary in leftovers(self.path, _WRITTEN):
            temporary.unlink(missing_ok=True)

    def load(self, until: float | None = None, **length: int | None) -> State:
        """What the checkpoint holds; the folder's other files are cut back to that moment.

        Args:
            until: Another return that ends it, see `RunConfig`. A return that the run has reached
                counts no more where only a length is given.
            length: Another length for the run, in a unit of its world.

        Returns:
            `runs`, a state for each part that had a worker of its own, and what else was saved.

        Raises:
            RunFolderError: If the run is longer than that already.
            CheckpointError: If the checkpoint is damaged, of another version or does not fit the
                folder's other files.
        """
        state = self.read()
        config = self._changed(state, until, length)
        for unit, value in length.items():
            if value is not None and value < state["done"][unit]:
                raise RunFolderError(
                    f"{unit}: the run in {self.path} has {state['done'][unit]} already, got "
                    f"{value}; give more, or begin a new run with another --out"
                )
        made = state.get("changes", 0) if state["done"]["ticks"] else 0  # else it begins anew
        self.record = Record(self.path / CHANGES, made)
        self._cut_metrics(state["metrics_bytes"], state["metrics_crc"])
        self._cut_logs(state.get("logs"))
        if config != self.config:
            self.config = config
            self._write_config()
        self.track = deque([state["track"]] if state["track"].size else [])
        return state

    def is_finished(self, until: float | None = None, **length: int | None) -> bool:
        """Whether the run is as long as it shall be, or solved, as far as its checkpoint tells."""
        state = self.read()
        config = self._changed(state, until, length)
        unit, total = config.length
        return state["done"][unit] >= total or config.solved_by(best_score(state))

    def _changed(
        self, state: State, until: float | None, length: Mapping[str, int | None]
    ) -> RunConfig:
        """The configuration with another end."""
        given = {unit: value for unit, value in length.items() if value is not None}
        changes: dict[str, Any] = dict.fromkeys(LENGTHS) | given if given else {}
        if until is not None or (given and self.config.solved_by(best_score(state))):
            changes["until"] = until
        return replace(self.config, **changes)

    def read(self) -> State:
        """What the checkpoint holds; nothing in the folder changes."""
        state = load_checkpoint(self.path / CHECKPOINT, observation_schema=self.config.world.schema)
        try:
            made_with = RunConfig.from_dict(state["config"])
        except (KeyError, TypeError, ConfigError) as error:
            raise CheckpointError(
                f"{self.path / CHECKPOINT}: not a run of this version of neatq ({error})"
            ) from error
        check_saved(self.path / CHECKPOINT, state, self.config)
        end = {name: getattr(self.config, name) for name in (*LENGTHS, "until")}
        if replace(made_with, **end) != self.config:
            raise CheckpointError(
                f"{self.path / CONFIG}: not the configuration that the run was made with; restore "
                "the file, or begin a new run with another --out"
            )
        return state

    def add_rows(self, rows: Sequence[Row]) -> None:
        """Add rows to the metrics."""
        text, path = "".join(map(csv_line, rows)).encode(), self.path / METRICS
        if not text:
            return
        try:
            with path.open("ab") as file:
                file.write(text)
        except OSError as error:
            error.filename = str(path)  # a full disk does not say which file
            raise
        self._bytes += len(text)
        self._crc = zlib.crc32(text, self._crc)

    def add_poses(self, poses: np.ndarray | None) -> None:
        """Add poses [slots, ticks, 3] of arena 0 to the track."""
        if poses is None:
            return
        self.track.append(poses)
        life = life_ticks(self.config)
        while sum(one.shape[1] for one in self.track) - self.track[0].shape[1] >= life:
            self.track.popleft()

    def latest_track(self) -> np.ndarray:
        """Poses [slots, ticks, 3] of the latest life, float32, or of as many ticks as there are.

        The same whether the run was interrupted or not.
        """
        if not self.track:
            return np.zeros((0, 0, 3), np.float32)
        life = life_ticks(self.config)
        return np.concatenate(list(self.track), 1)[:, -life:].astype(np.float32)

    def save(self, parts: Sequence[Snapshot], facts: EnvFacts | None, done: dict[str, int]) -> None:
        """Write the checkpoint, the best champion of all arenas, and what it needs to be used.

        Args:
            parts: The arenas as they stand, as the workers have them.
            facts: Of a Gymnasium task.
            done: How long the run is, by unit.
        """
        state = {
            "config": self.config.to_dict(),
            "runs": [part.state for part in parts],
            "track": self.latest_track(),
            "facts": facts and facts.to_dict(),
            "done": done,
            "changes": self.record.made,
            "metrics_bytes": self._bytes,
            "metrics_crc": self._crc,
            "logs": {name: path.stat().st_size for name, path in self._logs().items()},
        }
        schema = self.config.world.schema
        save_checkpoint(self.path / CHECKPOINT, state, observation_schema=schema)
        remembered = [one for part in parts for one in part.champions if one is not None]
        best = max(remembered, key=lambda one: one.score, default=None)  # of equal ones the first
        if facts is not None:
            own = best and best.scaling
            facts = facts if own is None else replace(facts, scaling=own)
            write_atomic(self.path / SCALING, json.dumps(facts.to_dict()) + "\n")
        champion = parts[0].champion if best is None else best.genome
        if champion is not None:
            save_genome(champion, self.path / CHAMPION)

    def write_result(self, result: dict[str, Any]) -> None:
        """Write what the test of the champions returned."""
        write_atomic(self.path / RESULT, json.dumps(result, indent=2) + "\n")

    def result(self) -> dict[str, Any] | None:
        """What the test of the champions returned; None where there was none."""
        path = self.path / RESULT
        return _read_file(path) if path.is_file() else None

    def solved(self) -> str:
        """In words, after how many steps a run `until` a return was solved; "" where it was not."""
        result = self.result() or {}
        if "solved_after_steps" not in result:
            return ""
        best = result["champion"]
        return (
            f"after {result['solved_after_steps']} steps: the champion of arena {best['arena']} "
            f"was evaluated to {best['evaluated_return']:g}, wanted {result['until']:g}"
        )

    def facts(self) -> EnvFacts | None:
        """What was known of a Gymnasium task before the run; None in other worlds.

        Where networks read normalised observations the scaling is that of the champion.
        """
        known = isinstance(self.config.world, GymnasiumConfig)
        return _read_file(self.path / SCALING, EnvFacts.from_dict) if known else None

    def metrics(self) -> Columns:
        """The columns of `metrics.csv`, float64 [rows] each; empty cells are NaN."""
        with (self.path / METRICS).open(newline="") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
            names = reader.fieldnames or []
        return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}

    def champion(self) -> Genome:
        """The fittest genome.

        Raises:
            CheckpointError: If there is none yet, or the run evolves none.
        """
        path = self.path / CHAMPION
        if not path.is_file():
            raise CheckpointError(
                f"{path}: there is no such file; nobody was judged yet, or nobody evolves here"
            )
        return load_genome(path, observation_schema=self.config.world.schema)

    def policy(self) -> Any:
        """The champion, ready to act: see `load_policy`."""
        from neatq_trainers.policy import load_policy

        return load_policy(self.path)

    def plot(self) -> Figure:
        """The curves of the run."""
        from neatq_trainers.report import draw_curves

        title = f"{self.config.arm} on {self.config.task}"
        return draw_curves(self.metrics(), title, one_by_one=not self.config.generational)

    def _cut_metrics(self, length: int, crc: int) -> None:
        """Cut the metrics back to what they were when the checkpoint was made."""
        path = self.path / METRICS
        content = path.read_bytes()[:length] if path.is_file() else b""
        if len(content) < length or zlib.crc32(content) != crc:
            raise CheckpointError(
                f"{path}: altered: its first {length} bytes are not those that it had when the "
                "checkpoint was made; restore the file, or begin a new run with another --out"
            )
        if not content.startswith(self._header.encode()):
            raise CheckpointError(
                f"{path}: not of this version of neatq, whose columns are {self._header.strip()}; "
                "go on with the version that made it, or begin a new run with another --out"
            )
        write_atomic(path, content)
        self._bytes, self._crc = length, crc

    def _logs(self) -> dict[str, Path]:
        """The files of loggers, by their paths in the folder."""
        files = sorted(path for path in (self.path / LOGS).rglob("*") if path.is_file())
        return {path.relative_to(self.path).as_posix(): path for path in files}

    def _cut_logs(self, sizes: dict[str, int] | None) -> None:
        """Cut the files of loggers back; checkpoints of earlier releases do not tell how long."""
        if sizes is None:
            return
        for name, path in self._logs().items():
            if name not in sizes:
                path.unlink()
            elif path.stat().st_size > sizes[name]:
                os.truncate(path, sizes[name])

    def _write_config(self) -> None:
        write_atomic(self.path / CONFIG, json.dumps(self.config.to_dict(), indent=2) + "\n")


def check_new(path: Path) -> None:
    """Check that a run can begin in a folder.

    Raises:
        RunFolderError: If there is more in it than a run leaves that was killed before its first
            checkpoint.
    """
    if not path.exists() or (path.is_dir() and _unbegun(path)):
        return
    instead = "choose another --out"
    if (path / CHECKPOINT).is_file():
        command = f"neatq resume {shlex.quote(str(path))}"
        instead += f", or go on with the run in it: {command}"
    raise RunFolderError(f"{path}: exists and is not empty; {instead}")


def _unbegun(path: Path) -> bool:
    """Whether a folder holds nothing but what a run writes before its first checkpoint."""
    early = {
        CONFIG,
        METRICS,
        CHANGES,
        LOCK,
        HOLDER,
        *(one.name for one in leftovers(path, _WRITTEN)),
    }
    if {one.name for one in path.iterdir()} - early:
        return False
    metrics = path / METRICS
    headers = [header(kind).encode() for kind in (DistanceRow, NeroRow, ReturnRow)]
    return not metrics.exists() or metrics.read_bytes() in headers


def life_ticks(config: RunConfig) -> int:
    """How much of a run its pictures show: one life, or 1000 ticks where lives have no end."""
    return config.world.lifetime_ticks or 1000


def load_run(path: Path | str) -> RunFolder:
    """The run in a folder: its configuration, metrics, champion and policy.

    Raises:
        RunFolderError: If there is no run in it.
        CheckpointError: If its configuration is missing or damaged.

    Example:
        >>> load_run("runs/wall-neatq-seed0").plot()
    """
    path = Path(path)
    if not (path / CHECKPOINT).is_file():
        raise RunFolderError(f"{path}: no run; there is no {CHECKPOINT} in it")
    return RunFolder(path, _read_file(path / CONFIG, RunConfig.from_dict))


def _read_file(path: Path, made_of: Callable[[dict[str, Any]], Any] = dict) -> Any:
    """What is made of the object in one of the files that a run writes."""
    try:
        value = parse_json(path.read_bytes())
        if not isinstance(value, dict):
            raise ValueError("no object {...}")
        return made_of(value)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such file") from error
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CheckpointError(f"{path}: altered or damaged: {error}") from error
