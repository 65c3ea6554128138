"""What somebody changes in a run while it goes on, and the record by which that is repeated.

A change is made where a run can stop and go on exactly. It is written down first, with its tick, so
that a run that is killed and resumed, or begun once more, has the same changes at the same ticks.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from neatq_envs.checks import ScenarioError
from neatq_envs.nero.scenario import REWARD_NAMES, NeroScenario, Stage, find_nero
from neatq_envs.scenario import Scenario, find_scenario
from neatq_envs.torchrl_env import FieldEnv
from neatq_torch.checkpoint import CheckpointError
from neatq_torch.evolution import Replacement, RtNEAT
from neatq_torch.genome import Genome, GenomeError
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CandidatePolicy
from neatq_trainers.loop import introduce, learnt
from neatq_trainers.run import Run

CHANGES = "changes.jsonl"


class Change(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """One change; the sub-classes say which.

    Attributes:
        everywhere: Whether it is made in all arenas, or else in the first one alone.
    """

    everywhere: ClassVar[bool] = False

    def check(self, run: Run) -> None:
        """Refuse it with a sentence if it cannot be made.

        Raises:
            ConfigError: Saying what was expected.
            ScenarioError: If it is a scenario that cannot be.
        """

    def make(self, run: Run) -> None:
        """Make it, after `check`, between two strides."""
        raise NotImplementedError


class ChangeScenario(Change, frozen=True, tag="scenario"):
    """Other walls, spawns, flags and so on: keys of the scenario; those left out stay as they are.

    `CHANGEABLE` says which may be others, and `CHANGEABLE_NERO` on NERO's field.
    """

    everywhere: ClassVar[bool] = True
    scenario: dict[str, Any]

    def check(self, run: Run) -> None:
        """See `Change`."""
        present = field_of(run).arena.scenario
        wanted = self._read(present)
        present.refuse_change(wanted)
        for index, wall in enumerate(wanted.walls):
            ends = (wall.x, wanted.width), (wall.y, wanted.height)
            outside = (max(-at, at - end, 0.0) for at, end in ends)
            if math.hypot(*outside) > math.hypot(wall.width, wall.height) / 2:
                raise ConfigError(f"walls[{index}]: it lies outside of the field; move it in")
        if run.config.generational and not wanted.lifetime_ticks:
            raise ConfigError("lifetime_ticks: expected above 0; generations need lives that end")
        if isinstance(wanted, NeroScenario):
            replace(run.config.world, stages=(Stage(scenario=wanted),))  # which robots must fit

    def make(self, run: Run) -> None:
        """See `Change`."""
        field = field_of(run)
        field.change(self._read(field.arena.scenario))
        for population in run.populations:
            population.weigh(run.world.present_weights)
        run.disturbed = True

    def _read(self, present: Scenario | NeroScenario) -> Any:
        if isinstance(present, NeroScenario):
            return find_nero(present, self.scenario)
        return find_scenario(present, changes=self.scenario)


class ChangeWeights(Change, frozen=True, tag="weights"):
    """Other weights of the rewards, by name; those left out stay as they are."""

    everywhere: ClassVar[bool] = True
    weights: dict[str, float]

    def check(self, run: Run) -> None:
        """See `Change`."""
        present = field_of(run).arena.scenario
        present.replaced(reward_weights=self._all(run))

    def make(self, run: Run) -> None:
        """See `Change`."""
        ChangeScenario({"reward_weights": self._all(run)}).make(run)

    def _all(self, run: Run) -> dict[str, float]:
        return present_weights(run) | self.weights


class ChangeExploration(Change, frozen=True, tag="exploration"):
    """Another share of ticks in which robots take any of their candidates."""

    everywhere: ClassVar[bool] = True
    epsilon: float

    def check(self, run: Run) -> None:
        """See `Change`."""
        if not explores(run):
            raise ConfigError(f"epsilon: the arm {run.config.arm} does not explore by candidates")
        if not 0 < self.epsilon <= 1:
            raise ConfigError(f"epsilon: expected above 0 and at most 1, got {self.epsilon:g}")

    def make(self, run: Run) -> None:
        """See `Change`."""
        assert isinstance(run.policy, CandidatePolicy)
        run.policy.exploration.epsilon.fill_(self.epsilon)
        learner = replace(run.config.learner, epsilon=self.epsilon)  # which rows tell
        run.config = run.config.unchecked(learner=learner)


class _OfRobot(Change, frozen=True):
    """Something about the robot in a slot of the first arena."""

    slot: int

    def check(self, run: Run) -> None:
        """See `Change`."""
        _check_slots(run, self.slot)


class ReplaceRobot(_OfRobot, frozen=True, tag="replace"):
    """A robot makes room for an offspring of others."""

    def make(self, run: Run) -> None:
        """See `Change`."""
        learnt(run, _first_arena(run))
        _begin_again(run, [evolving(run).replace(self.slot)])


class BreedRobots(Change, frozen=True, tag="breed"):
    """Two robots have an offspring together, which replaces the worst one."""

    parents: tuple[int, int]

    def check(self, run: Run) -> None:
        """See `Change`."""
        _check_slots(run, *self.parents)
        if self.parents[0] == self.parents[1]:
            raise ConfigError(f"breed: expected two robots, got {self.parents[0]} twice")
        population = evolving(run)
        if population.slots_of(population.protected).all():
            raise ConfigError("breed: all robots are protected; let one of them go")

    def make(self, run: Run) -> None:
        """See `Change`."""
        learnt(run, _first_arena(run))
        _begin_again(run, [evolving(run).replace(parents=self.parents)])


class ProtectRobot(_OfRobot, frozen=True, tag="protect"):
    """Nobody replaces a robot, or somebody may again."""

    on: bool

    def make(self, run: Run) -> None:
        """See `Change`."""
        _mark(evolving(run), "protected", self.slot, on=self.on)


class PreferRobot(_OfRobot, frozen=True, tag="prefer"):
    """A robot is a good one, and has half of all offspring (with others of whom that is said)."""

    on: bool

    def make(self, run: Run) -> None:
        """See `Change`."""
        _mark(evolving(run), "preferred", self.slot, on=self.on)


class LoadTeam(Change, frozen=True, tag="team"):
    """The genomes of a team that was saved in this run take the slots."""

    genomes: list[dict[str, Any]]

    def check(self, run: Run) -> None:
        """See `Change`."""
        population, slots = evolving(run), run.shape[1]
        field_of(run)
        if len(self.genomes) != slots:
            raise ConfigError(f"team: expected {slots} genomes, got {len(self.genomes)}")
        try:
            genomes = [Genome.from_dict(one) for one in self.genomes]
        except (GenomeError, KeyError, TypeError) as error:
            raise ConfigError(f"team: {error}") from error
        first, ledger = population.genomes[0], population.ledger
        for genome in genomes:
            strange = genome.interface != first.interface
            strange |= genome.observation_schema != first.observation_schema
            strange |= _not_given(genome.node_id, ledger.next_node_id, ledger.step)
            if strange or _not_given(genome.link_innovation, ledger.next_innovation, ledger.step):
                raise ConfigError("team: not of this run; only teams that it saved can be loaded")

    def make(self, run: Run) -> None:
        """See `Change`."""
        population = evolving(run)
        genomes = map(Genome.from_dict, self.genomes)
        replacements = [population.adopt(one, slot) for slot, one in enumerate(genomes)]
        _begin_again(run, replacements)
        assert run.network is not None
        for one in replacements:  # they know what they know, and were not to be taught as newborns
            run.network.replace(one.slot, one.genome)


AnyChange = (
    ChangeScenario
    | ChangeWeights
    | ChangeExploration
    | ReplaceRobot
    | BreedRobots
    | ProtectRobot
    | PreferRobot
    | LoadTeam
)


def field_of(run: Run) -> FieldEnv:
    """The field of a run's robots.

    Raises:
        ConfigError: If its world has none.
    """
    if not isinstance(run.world.env, FieldEnv):
        raise ConfigError(f"{run.config.task} has no field of robots that could be changed")
    return run.world.env


def evolving(run: Run) -> RtNEAT:
    """The population of the first arena, whose members are replaced one by one.

    Raises:
        ConfigError: If it is of another kind.
    """
    population = run.populations[0] if run.populations else None
    if not isinstance(population, RtNEAT):
        raise ConfigError(f"the robots of the arm {run.config.arm} are not replaced one by one")
    return population


def explores(run: Run) -> bool:
    """Whether robots now and then take another candidate than the best."""
    chooses = isinstance(run.policy, CandidatePolicy) and run.heads.candidates > 1
    return chooses and bool(getattr(run.config.learner, "epsilon", 0.0))


def present_weights(run: Run) -> dict[str, float]:
    """Those of the rewards, by name."""
    arena = field_of(run).arena
    if isinstance(arena.scenario, NeroScenario):
        return dict(zip(REWARD_NAMES, arena.weights.tolist(), strict=True))
    return dict(arena.scenario.reward_weights)


def _not_given(numbers: NDArray[Any], following: int, step: int) -> bool:
    """Whether there are numbers that a ledger has not given yet; those of other islands are not."""
    own = numbers[numbers % step == following % step]
    return bool(own.max(initial=0) >= following)


def _check_slots(run: Run, *slots: int) -> None:
    evolving(run)
    field_of(run)
    for slot in slots:
        if not 0 <= slot < run.shape[1]:
            raise ConfigError(f"robot: expected 0 to {run.shape[1] - 1}, got {slot}")


def _mark(population: RtNEAT, name: str, slot: int, *, on: bool) -> None:
    marks, genome_id = getattr(population, name), population.genomes[slot].genome_id
    (marks.add if on else marks.discard)(genome_id)


def _first_arena(run: Run) -> list[bool]:
    return [arena == 0 for arena in range(run.shape[0])]


def _begin_again(run: Run, replacements: list[Replacement]) -> None:
    """Let newborns of the first arena begin their lives."""
    newborn = introduce(run, [replacements])
    field_of(run).begin_lives(newborn.numpy())
    run.disturbed = True


class Recorded(msgspec.Struct, frozen=True):
    """A change, and the tick after which it was made."""

    tick: int
    change: AnyChange


class Record:
    """The changes of a run, in the file `changes.jsonl` of its folder.

    Attributes:
        made: How many of the changes have been made in the run as it stands.
        entries: All of them; those that are not made yet are to be repeated.
    """

    def __init__(self, path: Path, made: int = 0) -> None:
        self._path, self.made = path, made
        content = path.read_bytes() if path.exists() else b""
        # The change of a line that was cut off was never made, or is being written now.
        self._length = content.rfind(b"\n") + 1
        self.entries = _recorded(content[: self._length], path)
        self._repeated = -1
        if len(self.entries) < made:
            raise CheckpointError(
                f"{path}: expected the {made} changes that the run has had, got "
                f"{len(self.entries)}; restore the file"
            )
        self._repeat()

    def _repeat(self) -> None:
        """What was asked for up to the last change that is to be repeated is asked for again."""
        if self.made < len(self.entries):
            self._repeated = self.entries[-1].tick

    def next_tick(self) -> float:
        """When the next change is to be repeated; infinite where there is none."""
        return self.entries[self.made].tick if self.made < len(self.entries) else np.inf

    def begin_with(self, entries: Sequence[Recorded]) -> None:
        """Have the changes of another run to repeat; there are none yet."""
        for entry in entries:
            self._append(entry)
        self._repeat()

    def add(self, tick: int, change: AnyChange) -> None:
        """Write a change down that is about to be made.

        Raises:
            ConfigError: While changes are repeated: what is wanted then was wanted before.
        """
        if tick <= self._repeated:
            raise ConfigError(f"the run repeats what was changed up to tick {self._repeated}")
        self._append(Recorded(tick, change))

    def _append(self, entry: Recorded) -> None:
        with self._path.open("ab") as file:
            file.truncate(self._length)
            self._length += file.write(msgspec.json.encode(entry) + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self.entries.append(entry)

    def settings(self) -> list[AnyChange]:
        """The changes made so far of which a run's state does not hold all: what its rows tell."""
        made = (one.change for one in self.entries[: self.made])
        return [one for one in made if isinstance(one, ChangeExploration)]


def read_record(path: Path) -> list[Recorded]:
    """The changes of a file.

    Raises:
        ConfigError: If it cannot be read, or naming the line that is no change or out of order.
    """
    try:
        return _recorded(path.read_bytes(), path)
    except OSError as error:
        raise ConfigError(f"changes: {path}: cannot be read: {error.strerror}") from error


def _recorded(content: bytes, path: Path) -> list[Recorded]:
    entries: list[Recorded] = []
    for number, line in enumerate(content.splitlines(), 1):
        try:
            entries.append(msgspec.json.decode(line, type=Recorded))
        except msgspec.DecodeError as error:
            raise ConfigError(f"{path}:{number}: not a change: {error}") from error
        if entries[-1].tick < entries[max(0, number - 2)].tick:
            raise ConfigError(f"{path}:{number}: its tick is before that of the line above")
    return entries


def read_change(values: bytes | str) -> AnyChange:
    """A change of a JSON text.

    Raises:
        ConfigError: If it is none.
    """
    try:
        return msgspec.json.decode(values, type=AnyChange)
    except msgspec.DecodeError as error:
        raise ConfigError(f"change: {error}") from error


REFUSALS = (ConfigError, ScenarioError)
"""What a change is refused with."""
