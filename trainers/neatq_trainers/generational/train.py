"""Training on a Gymnasium task from the first generation to the last."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from neatq_envs.gymnasium_rows import make_rows
from neatq_trainers.config import ConfigError
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.folder import GenerationalFolder
from neatq_trainers.generational.loop import train_generation, try_champions
from neatq_trainers.generational.metrics import Row
from neatq_trainers.generational.run import Run, begin_run
from neatq_trainers.generational.scout import scout
from neatq_trainers.generational.team import Team, open_team
from neatq_trainers.interrupt import stop_on_interrupt
from neatq_trainers.progress import ProgressBar


def start(config: GenerationalConfig, out: Path, *, workers: int | None = 1) -> GenerationalFolder:
    """Make the folder `out` and train in it from the beginning.

    Args:
        config: The run.
        out: A new or empty folder.
        workers: Processes among which the genomes are dealt; 1 trains in this process, None
            takes one for each core. The results do not depend on it.

    Raises:
        TaskError: If the environment cannot be used.
        ConfigError: If the run cannot be built, there are no workers, or the folder is in use.
        EpisodeError: If an environment fails; the run can go on from the generation before.
        KeyboardInterrupt: After Ctrl-C; `resume` goes on.
    """
    if workers is not None and workers < 1:
        raise ConfigError(f"workers: expected at least 1, got {workers}")
    surroundings = scout(config.environment, config.learning.step.discount)
    interface = make_rows(config.environment)[1]
    run = begin_run(config, surroundings, interface)
    with open_team(config, surroundings, workers) as team:
        folder = GenerationalFolder.create(out, run)
        if not surroundings.repeatable:
            print(
                f"neatq: {config.environment.id} does not repeat itself with the same seed, so "
                "neither will this run",
                file=sys.stderr,
            )
        train(run, team, folder)
    return folder


def resume(
    out: Path, generations: int | None = None, *, workers: int | None = 1
) -> GenerationalFolder:
    """Go on with the run in folder `out`, to so many generations if given, else as planned."""
    folder = GenerationalFolder.open(out)
    run = folder.load(generations=generations)
    with open_team(run.config, run.surroundings, workers) as team:
        train(run, team, folder)
    return folder


def train(run: Run, team: Team, folder: GenerationalFolder) -> None:
    """Train until the run has the generations of its configuration, or until Ctrl-C; then test.

    Raises:
        KeyboardInterrupt: If it was stopped; what it has so far is in the folder.
    """
    config = run.config
    try:
        with (
            ProgressBar(config.generations, run.generation, "generations") as progress,
            stop_on_interrupt() as stop,
        ):
            saved = time.monotonic()
            while run.generation < config.generations and not stop.requested:
                rows = train_generation(run, team)
                folder.record(rows)
                progress.move(run.generation, words(rows))
                if time.monotonic() >= saved + config.checkpoint_seconds:
                    folder.checkpoint(run)
                    saved = time.monotonic()
    finally:
        folder.checkpoint(run)  # whatever happened, a run stands between two generations
    if run.generation < config.generations:
        raise KeyboardInterrupt
    folder.write_result(run, try_champions(run, team))


def words(rows: Sequence[Row]) -> str:
    """How the arenas are doing, in a few words: means over them."""
    best, champion = (
        sum(getattr(row, name) for row in rows) / len(rows)
        for name in ("best_fitness", "champion_return")
    )
    return f"best {best:.1f}, champion {champion:.1f}"
