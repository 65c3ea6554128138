"""A window onto a run: a callback that shows it to pages, and takes what they ask for.

The run never waits for a page. What a page asks for is taken between two strides, where a change is
written down before it is made; see `neatq_trainers.changes`.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from neatq_envs.checks import from_json
from neatq_envs.episodes import EpisodeError
from neatq_envs.gymnasium_task import TaskError
from neatq_envs.scenario import REWARD_DIMENSIONS
from neatq_torch.atomic import write_atomic
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.kinds import ConfigError
from neatq_trainers import changes as ch
from neatq_trainers.callbacks import Callback
from neatq_trainers.changes import AnyChange
from neatq_trainers.live.command import ENDLESS_TICKS
from neatq_trainers.live.episode import champion_episode
from neatq_trainers.live.fights import fight, opponents
from neatq_trainers.live.messages import (
    Battle,
    Changing,
    Go,
    Load,
    Pause,
    Save,
    Speed,
    StepOnce,
    Undo,
    Watch,
)
from neatq_trainers.live.scene import FRAMES_PER_SECOND, Scene, state_words
from neatq_trainers.live.server import Asked, Hub
from neatq_trainers.nero.nero_world import NeroConfig
from neatq_trainers.rows import Row, row_kind
from neatq_trainers.run import Run
from neatq_trainers.session import Session
from neatq_trainers.worlds import ArenaConfig, GymnasiumConfig

TEAMS = "teams"
"""The folder of teams that were kept, in a run folder."""
FIRST_SPEED = 60.0
MOST_ROBOTS = 10_000
MOST_ROWS = 2000
"""Of the history that a page gets when it opens."""
_NAME = re.compile(r"[\w][\w .+-]{0,59}")
_IDLE_SECONDS = 0.1
_REFUSALS = (*ch.REFUSALS, CheckpointError, TaskError, EpisodeError, ValueError, OSError)
_REVERSIBLE = (
    ch.ChangeScenario,
    ch.ChangeWeights,
    ch.ChangeExploration,
    ch.ProtectRobot,
    ch.PreferRobot,
)


class Window(Callback):
    """Shows a run to the pages of a hub; give it to `train` or `resume`, with one worker.

    Args:
        hub: The pages, as a `Server` has them.
        ticks_per_second: How fast the run goes at first; None: as fast as it can.
    """

    def __init__(self, hub: Hub, ticks_per_second: float | None = FIRST_SPEED) -> None:
        self.hub, self._speed = hub, ticks_per_second
        self._scene: Scene | None = None
        self._undo: list[AnyChange] = []
        self._reversible: list[AnyChange] = []
        self._inverse: AnyChange | None = None
        self._stepping = False
        self._due = self._last_clip = self._last_table = self._last_robot = 0.0
        self._species: list[dict[str, Any]] = []
        self._rows: deque[dict[str, Any]] = deque(maxlen=MOST_ROWS)
        self._asked = threading.Event()
        hub.listen(self._asked.set)

    def __getstate__(self) -> None:
        """Refuse to be sent to another process.

        Raises:
            ConfigError: Always.
        """
        raise ConfigError(
            "the window looks into one part of a run, and this one was begun in several, which it "
            "keeps; begin a run with --workers 1, or with neatq play"
        )

    # ------------------------------------------------------------------------ while it trains
    def start(self, session: Session) -> None:
        """Read what the run has said so far.

        Raises:
            ConfigError: If it has more robots than a page can show.
        """
        if (robots := session.config.world.slots or 0) > MOST_ROBOTS:
            raise ConfigError(
                f"robots: expected at most {MOST_ROBOTS:,} in a window, got {robots:,}"
            )
        self._session = session
        columns = session.folder.metrics()
        own = np.flatnonzero(columns["arena"] == 0)[-MOST_ROWS:]
        self._rows += [
            state_words({name: float(column[row]) for name, column in columns.items()})
            for row in own
        ]

    def batch(self, run: Run, batch: TensorDictBase, error: Tensor) -> None:
        """Show a batch, and wait for as long as it lasts at the speed that is asked for."""
        scene = self._look_at(run)
        ticks, now = batch.shape[-1], time.monotonic()
        seconds = ticks / self._speed if self._speed else now - self._last_clip
        if not self.hub.watched:
            scene.look_away()
        elif self._speed or seconds >= 1 / FRAMES_PER_SECOND:
            scene.see(batch, error)
            self._show(scene, min(seconds, 2.0), ticks)
            self._last_clip = now
        if self._speed:
            self._due = max(self._due + ticks / self._speed, now)
            while not self._session.signals and (left := self._due - time.monotonic()) > 0:
                if self._asked.wait(min(left, _IDLE_SECONDS)):
                    break

    def _show(self, scene: Scene, seconds: float, ticks: int) -> None:
        now = time.monotonic()
        if scene.has_field:
            frames = max(1.0, min(ticks, seconds * FRAMES_PER_SECOND))
            self.hub.show(scene.clip(seconds, max(1, round(ticks / frames))).pack())
        if now - self._last_robot >= 0.1:
            self._last_robot = now
            for slot in self.hub.chosen():
                if 0 <= slot < scene.run.shape[1]:
                    self._tell_robot(scene, slot)
        if now - self._last_table >= 1.0:
            self._last_table = now
            self.hub.tell({"type": "robots", "robots": scene.table()})

    def _tell_robot(self, scene: Scene, slot: int) -> None:
        self.hub.tell(scene.robot(slot), about=slot)

    def advance(self, run: Run, newborn: Tensor) -> None:
        """Remember births."""
        self._look_at(run).note_births()

    def rows(self, session: Session, rows: Sequence[Row]) -> None:
        """Tell new rows, and take what pages ask for."""
        scene = self._scene
        assert scene is not None
        fresh = [state_words(row._asdict()) for row in rows if row.arena == 0]
        self._rows += fresh
        if fresh:
            sizes = {"tick": session.lengths["ticks"], "sizes": scene.species()}
            self._species = [*self._species, sizes][-MOST_ROWS:]
            self.hub.tell({"type": "rows", "rows": fresh})
            self.hub.tell({"type": "species", "species": [sizes]})
        if self._stepping:
            self._stepping, session.paused = False, True
            self._tell_state()
        if session.over:
            self._tell_state()
        self._take_all()

    def idle(self, session: Session) -> None:
        """Wait for somebody to ask for something."""
        self._asked.wait(_IDLE_SECONDS)
        self._take_all()
        self._due = time.monotonic()
        if self._scene is not None and self._scene.seen:
            for slot in self.hub.chosen(fresh=True):
                if 0 <= slot < self._scene.run.shape[1]:
                    self._tell_robot(self._scene, slot)

    def changing(self, session: Session, change: AnyChange) -> None:
        """Remember what takes back what a page has asked for."""
        own = [one for one in self._reversible if one is change]
        self._inverse = self._before(change) if own else None

    def changed(self, session: Session, change: AnyChange) -> None:
        """Tell how everything is now."""
        self._reversible = [one for one in self._reversible if one is not change]
        if self._inverse is not None:
            self._undo.append(self._inverse)
        if self._scene is not None:
            if isinstance(change, ch.ReplaceRobot | ch.BreedRobots | ch.LoadTeam):
                self._scene.note_births()
            self._tell_state()
            self.hub.tell({"type": "robots", "robots": self._scene.table()})

    def refused(self, session: Session, change: AnyChange, error: Exception) -> None:
        """Tell why not."""
        self._reversible = [one for one in self._reversible if one is not change]
        self.hub.tell({"type": "refused", "message": str(error)})
        self._tell_state()

    def end(self, session: Session) -> None:
        """Say that the run has its length."""
        self.hub.tell({"type": "said", "message": "the run has its whole length"})

    # ------------------------------------------------------------------------ what pages ask for
    def _take_all(self) -> None:
        self._asked.clear()
        for asked in self.hub.asked():
            try:
                self._take(asked)
            except _REFUSALS as error:
                asked.answer({"type": "refused", "message": str(error)})

    def _take(self, asked: Asked) -> None:
        session, ask = self._session, asked.ask
        match ask:
            case None:
                asked.answer(self._hello())
                self._last_clip = self._last_table = self._last_robot = 0.0  # all is new to it
            case Pause():
                session.paused = True
            case Go():
                session.paused = False
            case StepOnce():
                session.paused, self._stepping = False, True
            case Speed(ticks_per_second=speed):
                if speed is not None and not 1 <= speed <= 100_000:
                    raise ConfigError(f"speed: expected 1 to 100,000 ticks a second, got {speed:g}")
                self._speed, self._due = speed, time.monotonic()
            case Undo():
                if not self._undo:
                    raise ConfigError("undo: there is nothing that can be taken back")
                session.wanted.append(self._undo.pop())
            case Save(name=name):
                asked.answer({"type": "said", "message": self._save(name)})
                self.hub.tell({"type": "saved", "saved": self._saved()})
            case Load(name=name):
                session.wanted.append(self._team(name))
            case Battle(against=against):
                self.hub.tell(fight(self._run(), against))
            case Watch():
                asked.answer(champion_episode(session.folder))
            case Changing(change=ch.LoadTeam()):
                raise ConfigError("team: only teams that were kept can be loaded; say the name")
            case Changing(change=change):
                self._reversible.append(change)
                session.wanted.append(change)
        if isinstance(ask, Pause | Go | StepOnce | Speed | Undo):
            self._tell_state()

    def _before(self, change: AnyChange) -> AnyChange | None:
        """What takes a change back; None: nothing does."""
        run = self._run()
        if not isinstance(change, _REVERSIBLE):
            return None
        match change:
            case ch.ChangeScenario():
                present = ch.field_of(run).arena.scenario.to_dict()
                own = {name: present[name] for name in change.scenario if name in present}
                return ch.ChangeScenario(own)
            case ch.ChangeWeights():
                present = ch.present_weights(run)
                return ch.ChangeWeights({name: present.get(name, 0.0) for name in change.weights})
            case ch.ChangeExploration():
                return ch.ChangeExploration(getattr(run.config.learner, "epsilon", 0.0))
            case _:
                return msgspec.structs.replace(change, on=not change.on)

    def _save(self, name: str) -> str:
        """Keep the team in the run folder; returns what to say."""
        path = self._team_path(name)
        run = self._run()
        ch.evolving(run)
        genomes = [run.genome(0, slot).to_dict() for slot in range(run.shape[1])]
        path.parent.mkdir(exist_ok=True)
        write_atomic(path, json.dumps({"tick": run.tick, "genomes": genomes}))
        return f"kept as {path}"

    def _team(self, name: str) -> ch.LoadTeam:
        try:
            text = self._team_path(name).read_text(encoding="utf-8")
            team = {"kind": "team", "genomes": from_json(text)["genomes"]}
            return msgspec.convert(team, ch.LoadTeam)
        except FileNotFoundError as error:
            raise ConfigError(f"team: expected one of {', '.join(self._saved())}") from error
        except (ValueError, KeyError, TypeError, msgspec.ValidationError) as error:
            raise ConfigError(f"team {name}: the file is damaged: {error}") from error

    def _team_path(self, name: str) -> Path:
        if not _NAME.fullmatch(name):
            raise ConfigError("name: expected 1 to 60 letters, digits, spaces and . + - _")
        return self._session.folder.path / TEAMS / f"{name}.json"

    def _saved(self) -> list[str]:
        with suppress(OSError):
            return sorted(path.stem for path in (self._session.folder.path / TEAMS).glob("*.json"))
        return []

    # ------------------------------------------------------------------------ what pages are told
    def _look_at(self, run: Run) -> Scene:
        if self._scene is None:
            self._scene = Scene(run)
        return self._scene

    def _run(self) -> Run:
        if self._scene is None:
            raise ConfigError("the run has not begun yet; try again in a moment")
        return self._scene.run

    def _tell_state(self) -> None:
        if self._scene is not None:
            self.hub.tell({"type": "state", "state": self._state()})

    def _state(self) -> dict[str, Any]:
        session, run = self._session, self._run()
        marks = ("protected", "preferred")
        table = {name: [] for name in marks}
        if run.populations:
            for name in marks:
                ids = getattr(run.populations[0], name, ())
                table[name] = [
                    slot
                    for slot, genome in enumerate(run.populations[0].genomes)
                    if genome.genome_id in ids
                ]
        field = self._scene is not None and self._scene.has_field
        return {
            "tick": run.tick,
            "paused": session.paused,
            "over": session.over,
            "ticks_per_second": self._speed,
            "scenario": run.world.env.arena.scenario.to_dict() if field else None,
            "weights": ch.present_weights(run) if field else {},
            "exploration": _exploration(run),
            "undo": len(self._undo),
            **table,
        }

    def _hello(self) -> dict[str, Any]:
        session, run = self._session, self._run()
        unit, total = session.config.length
        scene = self._look_at(run)
        fighting = isinstance(run.config.world, NeroConfig)
        return {
            "type": "hello",
            "task": session.config.task,
            "arm": session.config.arm,
            "seed": session.config.seed,
            "folder": session.folder.path.name,
            "length": {"unit": unit, "total": total if total < ENDLESS_TICKS else None},
            **scene.introduction(),
            "curves": _curves(session),
            "exploration": {
                name: {"value": value, "low": 0.01, "high": 1}
                for name, value in _exploration(run).items()
            },
            "weights": _sliders(run) if scene.has_field else {},
            "can": _abilities(run, scene),
            "saved": self._saved(),
            "opponents": opponents() if fighting else [],
            "state": self._state(),
            "rows": list(self._rows),
            "species": self._species,
        }


def _exploration(run: Run) -> dict[str, float]:
    return {"epsilon": getattr(run.config.learner, "epsilon", 0.0)} if ch.explores(run) else {}


def _sliders(run: Run) -> dict[str, dict[str, float]]:
    """Weights that can be others: where a reward is for coming nearer alone there are none."""
    if isinstance(run.config.world, ArenaConfig) and run.world.env.scenario.reward == "progress":
        return {}
    known = ch.present_weights(run)
    names = known if isinstance(run.config.world, NeroConfig) else REWARD_DIMENSIONS
    return {name: {"value": known.get(name, 0.0), "low": -1, "high": 1} for name in names}


def _abilities(run: Run, scene: Scene) -> list[str]:
    """What can be asked of a run."""
    able = ["pause", "undo"]
    able += ["exploration"] if _exploration(run) else []
    if not scene.has_field:
        return [*able, "watch"] if isinstance(run.config.world, GymnasiumConfig) else able
    able += ["scenario", "lifetime"]
    able += ["weights"] if _sliders(run) else []
    able += ["hit_points", "battle"] if isinstance(run.config.world, NeroConfig) else []
    with suppress(ConfigError):
        ch.evolving(run)
        able += ["replace", "protect", "breed", "prefer", "save", "load"]
    return able


def _curves(session: Session) -> list[str]:
    """Numbers of a row, the one that matters most first."""
    names = list(row_kind(session.config)._fields)
    first = {"mean_distance", "hits", "champion_return"} & {*names}
    hidden = {"arena", "tick", "generation", "steps", "episodes"}
    return [*first, *(name for name in names if name not in hidden | first)]
