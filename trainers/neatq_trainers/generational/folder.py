"""The folder of a run on a Gymnasium task."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from neatq_torch.atomic import write_atomic
from neatq_torch.genome import save_genome
from neatq_trainers.config import ConfigError
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.metrics import HEADER, Row
from neatq_trainers.generational.run import Run, load_run, observation_schema
from neatq_trainers.loggers import RunLogger
from neatq_trainers.run_files import (
    CHAMPION,
    RunFiles,
    RunFolderError,
    require_run,
    write_config,
)

SCALING, RESULT = "scaling.json", "result.json"
PICTURE, ANIMATION = "champion.png", "champion.gif"


@dataclass(kw_only=True)
class GenerationalFolder(RunFiles):
    """A run on disk; see `RunFiles`."""

    header = HEADER

    @staticmethod
    def create(path: Path, run: Run) -> GenerationalFolder:
        """Make the folder of a new run.

        Raises:
            RunFolderError: If there is something in it.
            OSError: If it cannot be written.
        """
        GenerationalFolder.claim(path, run.config.to_dict())
        folder = GenerationalFolder(path=path, logger=_logger(run.config, path))
        folder.checkpoint(run)
        return folder

    @staticmethod
    def open(path: Path) -> GenerationalFolder:
        """Open the folder of a run that was begun.

        Raises:
            RunFolderError: If there is no checkpoint in it.
        """
        require_run(path)
        return GenerationalFolder(path=path, logger=RunLogger(None, path))

    def load(self, *, generations: int | None = None) -> Run:
        """The run as the checkpoint has it, and the folder's files cut back to that moment.

        Args:
            generations: Another length for the run.

        Raises:
            RunFolderError: If it has more generations than that already.
            CheckpointError: If the checkpoint is damaged, of another version or does not fit the
                folder's other files.
        """
        run, length, crc = self._read()
        if generations is not None and generations < run.generation:
            raise RunFolderError(
                f"generations: the run in {self.path} has {run.generation} already, got "
                f"{generations}; give more, or begin a new run with another --out"
            )
        if generations is not None:
            run.config = replace(run.config, generations=generations)
        self.cut_metrics(length, crc)
        if generations is not None:
            write_config(self.path, run.config.to_dict())
        self.logger = _logger(run.config, self.path)
        return run

    def read(self) -> Run:
        """The run as the checkpoint has it; nothing in the folder changes."""
        return self._read()[0]

    def _read(self) -> tuple[Run, int, int]:
        values = self.read_config()
        try:
            config = GenerationalConfig.from_dict(values)
        except ValueError as error:
            raise self.damaged_config(error) from error
        state = self.read_checkpoint(observation_schema(config))
        try:
            made_with = GenerationalConfig.from_dict(state["config"])
        except (KeyError, TypeError, ConfigError) as error:
            raise self.other_version(error) from error
        self.refuse_other_config(replace(made_with, generations=config.generations) == config)
        return load_run(config, state), state["metrics_bytes"], state["metrics_crc"]

    def checkpoint(self, run: Run) -> None:
        """Write the checkpoint, the best champion of all arenas and what it needs to be used."""
        schema = observation_schema(run.config)
        self.save(run.config.to_dict(), run.state(), observation_schema=schema)
        write_atomic(self.path / SCALING, json.dumps(run.surroundings.to_dict()) + "\n")
        if run.best is not None:
            save_genome(run.best.genome, self.path / CHAMPION)

    def write_result(self, run: Run, returns: np.ndarray) -> None:
        """Write what the champions' test returned, float64 [arenas, episodes]."""
        arenas = [
            {
                "arena": arena,
                "seed": run.config.seeds[arena],
                "generation": champion.generation,
                "evaluated_return": champion.score,
                **summary(returns[arena]),
            }
            for arena, champion in enumerate(run.champions)
        ]
        best = run.champions.index(run.best) if run.best else 0
        result = {
            "task": run.config.task,
            "arm": run.config.arm,
            "generations": run.generation,
            "champion": arenas[best],
            "arenas": arenas,
            "repeatable": run.surroundings.repeatable,
        }
        write_atomic(self.path / RESULT, json.dumps(result, indent=2) + "\n")

    def read_result(self) -> str:
        """What the test of the champions showed, in a line."""
        result = json.loads((self.path / RESULT).read_bytes())
        best, arenas = result["champion"], result["arenas"]
        text = (
            f"champion of arena {best['arena']}: return {best['mean']:.1f} ± "
            f"{best['standard_error']:.1f} (mean and standard error of {best['episodes']} new "
            "episodes)"
        )
        if len(arenas) > 1:
            every = summary(np.array([one["mean"] for one in arenas]))
            text += (
                f"; of all {len(arenas)} arenas: {every['mean']:.1f} ± "
                f"{every['standard_error']:.1f} over arenas"
            )
        return text

    def record(self, rows: Sequence[Row]) -> None:
        """Add the rows of a generation to the metrics."""
        self.add_rows(rows)


def summary(returns: np.ndarray) -> dict[str, float | int]:
    """Mean and standard error over episodes [episodes]."""
    error = float(returns.std(ddof=1) / np.sqrt(returns.size)) if returns.size > 1 else 0.0
    return {"mean": float(returns.mean()), "standard_error": error, "episodes": returns.size}


def _logger(config: GenerationalConfig, path: Path) -> RunLogger:
    return RunLogger(config.logger, path, "episodes")
