"""Training from the first tick to the last: workers, run folder, callbacks, Ctrl-C."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from neatq_envs.machines import Crew, Machines, open_machines
from neatq_envs.pool import TRIES
from neatq_envs.processes import MachinesLeft, ProcessEnded, unguarded_script
from neatq_envs.random_play import EnvFacts
from neatq_torch.kinds import ConfigError
from neatq_trainers.arms import preset
from neatq_trainers.callbacks import (
    Callback,
    Checkpoints,
    MetricsFile,
    ProgressBar,
    Report,
    TorchRLLogger,
)
from neatq_trainers.changes import REFUSALS, Recorded, read_record
from neatq_trainers.config import LENGTHS, RunConfig
from neatq_trainers.effects import refuse_without_effect
from neatq_trainers.final_test import judge_champions
from neatq_trainers.folder import CHECKPOINT, RunFolder, check_new, load_run
from neatq_trainers.lock import RunFolderError, locked
from neatq_trainers.loop import Stride
from neatq_trainers.migration import arrivals, routes
from neatq_trainers.names import file_name
from neatq_trainers.rows import ReturnRow, Row
from neatq_trainers.saved import best_score
from neatq_trainers.session import Session
from neatq_trainers.signals import ending_by_signals, noting_signals, raise_for
from neatq_trainers.workers import Workforce, fitting_workers, open_team
from neatq_trainers.worlds import facts_of

STRIDES_AHEAD = 8
"""Strides that a worker may have under way, so that none waits for a slower one."""
BUILT_IN = (MetricsFile, TorchRLLogger, ProgressBar, Checkpoints, Report)


def train(  # noqa: PLR0913  (each is a setting of a run)
    task: str,
    arm: str = "neatq",
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    population: str | None = None,
    learner: str | None = None,
    settings: Mapping[str, Any] | None = None,
    ticks: int | None = None,
    steps: int | None = None,
    generations: int | None = None,
    until: float | None = None,
    arenas: int | None = None,
    seed: int = 0,
    out: Path | str | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    changes: Path | str | None = None,
    callbacks: Sequence[Callback] = (),
) -> RunFolder:
    """Train a population and write a run folder; returns the run.

    Args:
        task: A built-in task ("wall"), a scenario's path, "gym:ID", or a registered world's name.
        arm: The preset of population, learner and network; see `ARMS`.
        env_kwargs: Keys of the scenario, or arguments of the environment, with other values.
        population: Another kind of population: "rtneat", "neat", "fixed" or a registered one.
        learner: Another kind: "none", "td", "replay", "traces", "table" or a registered one.
        settings: Other values by dotted path, such as {"learner.epsilon": 0.05}.
        ticks: Length in a world of robots.
        steps: Length on a Gymnasium task, in environment steps of all genomes of an arena.
        generations: Length on a Gymnasium task.
        until: On a Gymnasium task: held-out return with which the best arena's champion ends it.
        arenas: Populations side by side; arena i is the run with seed + i. Default: 1; rivals: 2.
        seed: Of arena 0.
        out: The run folder; new or empty. Default: runs/TASK-ARM-seedSEED.
        workers: Processes; the results do not depend on it. Default: those that fit the machines.
        cluster: A Ray cluster where these live, see `open_machines`; what is lost is made up for.
        changes: The `changes.jsonl` of a run that was steered, to be repeated in this one.
        callbacks: Called while it trains.

    Raises:
        ConfigError: If the run cannot be made as asked, or the folder is in use.
        TaskError: If the environment cannot be used.
        EpisodeError: If an environment fails; `resume` goes on, as after the next two.
        ProcessEnded: If a worker dies; on a cluster again and again.
        ClusterError: If there is none.
        KeyboardInterrupt, SystemExit: After Ctrl-C; after SIGTERM or SIGHUP.

    Example:
        >>> run = train("gym:CartPole-v1", arm="neat", generations=10)
    """
    length = {"ticks": ticks, "steps": steps, "generations": generations}
    kinds: Any = {"population": population, "learner": learner}
    config = preset(task, arm, env_kwargs=env_kwargs, **kinds, length=length)
    arenas = config.arenas if arenas is None else arenas
    config = config.changed({"until": until, "arenas": arenas, "seed": seed, **(settings or {})})
    refuse_without_effect(config, settings or {})
    how: Any = {"workers": workers, "cluster": cluster, "changes": changes, "callbacks": callbacks}
    return start(config, out, **how)


def start(
    config: RunConfig,
    out: Path | str | None = None,
    *,
    workers: int | None = 1,
    cluster: str | None = None,
    changes: Path | str | None = None,
    callbacks: Sequence[Callback] = (),
) -> RunFolder:
    """Make a run folder and train in it from the beginning; see `train`."""
    path = (default_folder(config) if out is None else Path(out)).absolute()
    check_new(path)
    repeated = [] if changes is None else read_record(Path(changes))
    with open_machines(cluster) as machines:
        crew = _crew(workers, config, machines)
        begin = partial(_begin, config, path, crew, repeated, callbacks)
        go_on = partial(_go_on, path, {}, workers, machines, callbacks)
        return _whatever_is_lost(begin, go_on, path, machines)


def _begin(
    config: RunConfig,
    path: Path,
    crew: Crew,
    repeated: Sequence[Recorded],
    callbacks: Sequence[Callback],
) -> RunFolder:
    parts = config.split(min(crew.size, config.groups))
    everybody = [kind() for kind in BUILT_IN] + list(callbacks)
    with ending_by_signals(), ExitStack() as stack:
        discount = getattr(config.learner, "discount", 0.99)
        facts = facts_of(config.world, discount, apart=crew.machines if crew.size > 1 else None)
        states = [None] * len(parts)
        team = stack.enter_context(open_team(parts, states, facts, everybody, crew))
        begun = team.asked("snapshot")  # what cannot be built leaves no folder
        path.mkdir(parents=True, exist_ok=True)
        stack.enter_context(locked(path))
        folder = RunFolder.create(path, config)
        folder.record.begin_with(repeated)
        session = Session(config=config, folder=folder, facts=facts)
        session.folder.save(begun, facts, session.lengths)
        if facts is not None and not facts.repeatable:
            print(
                f"neatq: {config.task} does not repeat itself with the same seed, so neither will "
                "this run",
                file=sys.stderr,
            )
        _train(session, team, everybody)
    return session.folder


def _whatever_is_lost(
    begin: Callable[[], RunFolder],
    go_on: Callable[[], RunFolder],
    path: Path,
    machines: Machines,
) -> RunFolder:
    """Train; where machines may come and go, go on from the last checkpoint when one is lost.

    Raises:
        ProcessEnded: If workers are lost again and again without a new checkpoint.
    """
    train, known, losses = begin, None, 0
    while True:
        try:
            return train()
        except ProcessEnded as error:
            if not machines.elastic or not (path / CHECKPOINT).is_file():
                raise
            done = load_run(path).read()["done"]
            losses = (losses if done == known else 0) + (not isinstance(error, MachinesLeft))
            known = done
            if losses >= TRIES:
                raise
            print(f"neatq: {error}; the run goes on from tick {done['ticks']}", file=sys.stderr)
            train = go_on


def resume(
    path: Path | str,
    *,
    ticks: int | None = None,
    steps: int | None = None,
    generations: int | None = None,
    until: float | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    callbacks: Sequence[Callback] = (),
) -> RunFolder:
    """Go on with a run, exactly where it stopped.

    Args:
        path: Its folder.
        ticks: Another length, as in `train`.
        steps: Another length.
        generations: Another length.
        until: Another return that ends it, as in `train`; without it the run's own counts on. A run
            that has reached its own goes on, without one, to another length.
        workers: Processes; by default those that fit the machines. Arenas stay in as many parts as
            the run was begun with, and no more processes than that have work.
        cluster: Where these processes live, as in `train`; however many cores there are.
        callbacks: Called while it trains.

    Raises:
        RunFolderError: If there is no run in the folder, it is longer than that already, another
            process trains in it, or it cannot be written and the run is not finished.
        CheckpointError: If the run is damaged.

    Example:
        >>> resume("runs/wall-neatq-seed0", ticks=100_000)
    """
    path = Path(path).absolute()  # an environment may change the working directory
    load_run(path)
    end = {"ticks": ticks, "steps": steps, "generations": generations, "until": until}
    with open_machines(cluster) as machines:
        go_on = partial(_go_on, path, end, workers, machines, callbacks)
        return _whatever_is_lost(go_on, go_on, path, machines)


def _go_on(
    path: Path,
    end: Mapping[str, Any],
    workers: int | None,
    machines: Machines,
    callbacks: Sequence[Callback],
) -> RunFolder:
    folder = load_run(path)
    with ending_by_signals(), ExitStack() as stack:
        try:
            stack.enter_context(locked(folder.path))
        except OSError as error:
            return _read_only(folder, end, error)
        folder = load_run(path)  # as whoever trained in it has left it
        folder.remove_leftovers()
        state, config = folder.load(**end), folder.config
        states, parts = state["runs"], config.split(len(state["runs"]))
        facts = None if state["facts"] is None else EnvFacts.from_dict(state["facts"])
        everybody = [kind() for kind in BUILT_IN] + [*callbacks]
        crew = _crew(workers, config, machines, len(parts))
        team = stack.enter_context(open_team(parts, states, facts, everybody, crew))
        for change in folder.record.settings():
            team.asked("make", change)
        session = Session(config=config, folder=folder, facts=facts, lengths=state["done"])
        session.migrations = states[0].get("migrations", 0)
        session.score = best_score(state) if config.until is not None else -math.inf
        _train(session, team, everybody)
    return folder


def _read_only(folder: RunFolder, end: Mapping[str, Any], error: OSError) -> RunFolder:
    """A run that is finished needs no folder that can be written."""
    if not folder.is_finished(**end):
        raise RunFolderError(
            f"{folder.path}: cannot be written ({error.strerror}), and its run is not finished; "
            "copy the folder to where you may write, and resume it there"
        ) from error
    folder.notes.append("the run is finished; the folder cannot be written and stays as it is")
    return folder


def default_folder(config: RunConfig) -> Path:
    """Where a run goes if nobody says so."""
    name, arm = file_name(config.world.label), file_name(config.arm)
    return Path("runs") / f"{name}-{arm}-seed{config.seed}"


def _crew(workers: int | None, config: RunConfig, machines: Machines, parts: int = 1) -> Crew:
    """Those who train a run; `parts` are those that it has already."""
    if workers is not None and workers < 1:
        raise ConfigError(f"workers: expected at least 1, got {workers}")
    fitting = workers
    if fitting is None and parts > 1:
        fitting = max(1, min(parts, machines.cores()))
    elif fitting is None:
        fitting = fitting_workers(config, machines)
    if machines.elastic or workers is not None or fitting == 1:
        return Crew(fitting, machines)
    if (script := unguarded_script()) is not None:
        print(
            f"neatq: trains in one process; on {fitting} cores where {script.name} has "
            '`if __name__ == "__main__":` above what it does',
            file=sys.stderr,
        )
        fitting = 1
    return Crew(fitting, machines)


def _train(session: Session, team: Workforce, callbacks: Sequence[Callback]) -> None:
    """Train until the run has its length or is solved, or until somebody stops it.

    Raises:
        KeyboardInterrupt: If Ctrl-C stopped it; what it has so far is in the folder.
        Terminated: If SIGTERM or SIGHUP did.
    """
    unit, total = session.config.length
    # Only ticks are known before they are over, and not where a stride is a generation.
    known = unit == "ticks" and not session.config.generational
    ahead, stride = (
        STRIDES_AHEAD if len(team.hosts) > 1 and known else 1,
        session.config.stride_ticks,
    )
    under_way, unsaved = 0, False
    for callback in callbacks:
        callback.start(session)
    with noting_signals() as signals, _ending_by(signals):
        session.signals = signals
        while True:
            saving = session.stop or signals or (session.wants_checkpoint and unsaved)
            pausing = saving or session.paused or session.wanted
            soon = under_way * stride
            stop = min(session.folder.record.next_tick(), session.next_migration)
            due = session.lengths["ticks"] + soon >= stop
            wanted = not session.over and not due and session.done + soon < total
            if wanted and not pausing and under_way < ahead:
                team.ask("stride")
                under_way += 1
            elif under_way:
                _take(session, team.answers(), callbacks)
                under_way, unsaved = under_way - 1, True
            elif _migrate(session, team) or _change(session, team, callbacks):
                unsaved = True
            elif session.paused and not saving and not session.over:
                for callback in callbacks:
                    callback.idle(session)
            else:  # nobody is at work
                snapshots = team.asked("snapshot")
                session.folder.save(snapshots, session.facts, session.lengths)
                session.wants_checkpoint = unsaved = False
                for callback in callbacks:
                    callback.checkpoint(session)
                if session.stop or signals or session.over:
                    break
    if signals and not session.over:
        raise_for(signals[0])
    judge_champions(session, [one for part in snapshots for one in part.champions])
    for callback in callbacks:
        callback.end(session)


@contextmanager
def _ending_by(signals: Sequence[int]) -> Iterator[None]:
    """If a worker is lost after a signal that ends the run, then the signal has ended it."""
    try:
        yield
    except ProcessEnded:
        if signals:
            raise_for(signals[0])
        raise


def _migrate(session: Session, team: Workforce) -> bool:
    """Let arenas exchange genomes if it is time; whether it was."""
    config, times = session.config, session.migrations
    if session.over or session.lengths["ticks"] < session.next_migration:
        return False
    assert config.migration is not None
    parts = team.asked("emigrants", times)
    leaving = [own for part in parts for own in part]
    ways = routes(config.migration, config.arenas, config.seed, times)
    arriving = arrivals(leaving, ways)
    borders = pairwise([*config.first_arenas(len(parts)), config.arenas])
    team.deal("immigrate", [arriving[first:end] for first, end in borders])
    session.migrations += 1
    return True


def _change(session: Session, team: Workforce, callbacks: Sequence[Callback]) -> bool:
    """Make the next change that is due, recorded or wanted; whether there was any."""
    record = session.folder.record
    if record.next_tick() <= session.lengths["ticks"]:
        change = record.entries[record.made].change
        team.first("check", change)  # it may be the record of a run of another kind
    elif session.wanted:
        change = session.wanted.popleft()
        try:
            team.first("check", change)
            record.add(session.lengths["ticks"], change)
        except REFUSALS as error:
            for callback in callbacks:
                callback.refused(session, change, error)
            return True
    else:
        return False
    for callback in callbacks:
        callback.changing(session, change)
    (team.asked if change.everywhere else team.first)("make", change)
    record.made += 1
    for callback in callbacks:
        callback.changed(session, change)
    return True


def _take(session: Session, came: Sequence[Stride], callbacks: Sequence[Callback]) -> None:
    """Take over what came of a stride of all workers."""
    session.lengths = {unit: min(stride.done(unit) for stride in came) for unit in LENGTHS}
    session.folder.add_poses(came[0].poses)
    firsts = session.config.first_arenas(len(came))
    rows: list[Row] = [
        row._replace(arena=first + row.arena)
        for first, stride in zip(firsts, came, strict=True)
        for row in stride.rows
    ]
    rows.sort(key=lambda row: (row[1], row.arena))
    scores = (row.champion_return for row in rows if isinstance(row, ReturnRow))
    session.score = max([session.score, *scores])
    for callback in callbacks:
        callback.rows(session, rows)
