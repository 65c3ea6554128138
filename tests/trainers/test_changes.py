"""Runs with a hand in them: changes are made in order, written down first, and repeated exactly."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_torch.evolution import RtNEAT, RtNEATConfig
from neatq_torch.kinds import ConfigError
from neatq_trainers import changes as ch
from neatq_trainers.callbacks import Callback
from neatq_trainers.changes import AnyChange, Record, read_change
from neatq_trainers.folder import RunFolder
from neatq_trainers.run import Run
from neatq_trainers.train import Session, resume, train

BARRIER = {"x": 400, "y": 330, "width": 200, "height": 8}
ARMS = {"population.minimum_life_ticks": 300}


class Hand(Callback):
    """Asks for changes at ticks, and notes what became of them."""

    def __init__(self, script: Mapping[int, list[AnyChange]]) -> None:
        self._script = dict(script)
        self.refusals: list[str] = []
        self.made: list[tuple[int, str]] = []

    def rows(self, session: Session, rows: Any) -> None:
        session.wanted.extend(self._script.pop(session.lengths["ticks"], []))

    def changed(self, session: Session, change: AnyChange) -> None:
        self.made.append((session.lengths["ticks"], type(change).__name__))

    def refused(self, session: Session, change: AnyChange, error: Exception) -> None:
        self.refusals.append(str(error))


class Stop(Callback):
    """Stops at a tick, as if killed after an earlier checkpoint: the folder is put back to it."""

    def __init__(self, tick: int) -> None:
        self.tick = tick

    def rows(self, session: Session, rows: Any) -> None:
        session.stop |= session.lengths["ticks"] >= self.tick


def steering() -> dict[int, list[AnyChange]]:
    return {
        200: [ch.ChangeScenario({"walls": [BARRIER]}), ch.ProtectRobot(3, on=True)],
        400: [ch.ReplaceRobot(5), ch.PreferRobot(2, on=True), ch.BreedRobots((1, 4))],
        600: [ch.ChangeExploration(0.25)],
        720: [ch.ChangeScenario({"walls": [], "flag": {"positions": [[300, 300]]}})],
    }


def run(out: Path, arm: str = "replay", ticks: int = 1200, **more: Any) -> RunFolder:
    kwargs = {"robots": 12, "lifetime_ticks": 300}
    return train("wall", arm, env_kwargs=kwargs, settings=ARMS, ticks=ticks, out=out, **more)


def same(one: RunFolder, other: RunFolder) -> bool:
    """Whether two runs are equal, bit for bit."""
    files = ("metrics.csv", "champion.json")
    if any((one.path / f).read_bytes() != (other.path / f).read_bytes() for f in files):
        return False
    first, second = (folder.read()["runs"][0] for folder in (one, other))
    world = all(
        np.array_equal(first["world"][name], second["world"][name])
        for name in ("place", "velocity", "observation", "heading_rad", "flag")
    )
    return world and np.array_equal(first["weight"], second["weight"])


@pytest.fixture(scope="module")
def steered(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, Hand]:
    hand = Hand(steering())
    return run(tmp_path_factory.mktemp("steered") / "run", callbacks=[hand]), hand


def test_changes_are_made_at_the_tick_at_which_they_were_asked_for(
    steered: tuple[RunFolder, Hand],
) -> None:
    folder, hand = steered
    assert hand.refusals == []
    asked = [(tick, type(one).__name__) for tick, many in steering().items() for one in many]
    assert hand.made == asked
    lines = [json.loads(line) for line in (folder.path / ch.CHANGES).read_text().splitlines()]
    assert [line["tick"] for line in lines] == [tick for tick, _ in asked]
    world = folder.read()["runs"][0]["world"]
    assert world["scenario"]["walls"] == []
    assert world["flag"].tolist() == [[300.0, 300.0]]


@pytest.mark.parametrize("stopped", [200, 440, 1000])
def test_a_steered_run_that_is_stopped_and_resumed_equals_one_that_is_not(
    stopped: int, steered: tuple[RunFolder, Hand], tmp_path: Path
) -> None:
    first = run(tmp_path / "run", callbacks=[Hand(steering()), Stop(stopped)])
    second = resume(first.path, callbacks=[Hand(steering())])
    assert same(steered[0], second)


def test_a_killed_run_repeats_what_was_changed_after_its_checkpoint(
    steered: tuple[RunFolder, Hand], tmp_path: Path
) -> None:
    killed = run(tmp_path / "run", callbacks=[Hand(steering()), Stop(240)])
    (killed.path / ch.CHANGES).write_bytes((steered[0].path / ch.CHANGES).read_bytes())
    assert same(steered[0], resume(killed.path))  # nobody asks again


def test_a_record_from_which_a_run_begins_repeats_it(
    steered: tuple[RunFolder, Hand], tmp_path: Path
) -> None:
    again = run(tmp_path / "run", changes=steered[0].path / ch.CHANGES)
    assert same(steered[0], again)
    assert (again.path / ch.CHANGES).read_bytes() == (steered[0].path / ch.CHANGES).read_bytes()


def test_several_processes_are_changed_at_the_same_ticks(tmp_path: Path) -> None:
    one = run(tmp_path / "1", ticks=480, arenas=2, callbacks=[Hand(steering())])
    record = one.path / ch.CHANGES
    two = run(tmp_path / "2", ticks=480, arenas=2, workers=2, changes=record)
    assert (one.path / "metrics.csv").read_bytes() == (two.path / "metrics.csv").read_bytes()


REFUSED = {
    "spawns[0]": ch.ChangeScenario({"walls": [{**BARRIER, "y": 266}]}),
    "robots: expected 12, as it was, got 13": ch.ChangeScenario({"robots": 13}),
    "known: name, width": ch.ChangeScenario({"colour": "red"}),
    "finite": ch.ChangeScenario({"walls": [{**BARRIER, "x": float("nan")}]}),
    "walls[0]: it lies outside": ch.ChangeScenario({"walls": [{**BARRIER, "x": 5000}]}),
    "robot: expected 0 to 11, got 12": ch.ReplaceRobot(12),
    "expected two robots, got 3 twice": ch.BreedRobots((3, 3)),
    "epsilon: expected above 0": ch.ChangeExploration(0.0),
    'unknown value "fame"': ch.ChangeWeights({"fame": 1.0}),
    "expected 12 genomes, got 0": ch.LoadTeam([]),
}


def test_what_cannot_be_is_refused_with_a_sentence_and_changes_nothing(tmp_path: Path) -> None:
    hand = Hand({120: list(REFUSED.values())})
    folder = run(tmp_path / "run", ticks=400, callbacks=[hand])
    assert same(folder, run(tmp_path / "untouched", ticks=400))
    assert not (folder.path / ch.CHANGES).exists()
    assert len(hand.refusals) == len(REFUSED)
    for words, said in zip(REFUSED, hand.refusals, strict=True):
        assert words in said


def test_arms_without_such_a_thing_refuse_it(tmp_path: Path) -> None:
    hand = Hand({40: [ch.ReplaceRobot(0), ch.ChangeExploration(0.1)]})
    train("wall", "qlearning", ticks=80, out=tmp_path / "run", callbacks=[hand])
    assert "are not replaced one by one" in hand.refusals[0]
    assert "does not explore by candidates" in hand.refusals[1]


class Archive(Callback):
    """Saves the team at one tick, and asks for it at another."""

    def batch(self, run: Run, batch: Any, error: Any) -> None:
        self.run = run

    def team(self) -> list[dict[str, Any]]:
        return [self.run.genome(0, slot).to_dict() for slot in range(12)]

    def rows(self, session: Session, rows: Any) -> None:
        if session.lengths["ticks"] == 200:
            self.saved = self.team()
        if session.lengths["ticks"] == 600:
            session.wanted.append(ch.LoadTeam(self.saved))

    def changed(self, session: Session, change: AnyChange) -> None:
        self.loaded = self.team()
        self.ages = self.run.world.env.arena.age_ticks[0]


def test_a_saved_team_takes_its_slots_again_and_begins_new_lives(tmp_path: Path) -> None:
    archive = Archive()
    folder = run(tmp_path / "run", ticks=1000, callbacks=[archive])
    before, after = (
        [{**one, "genome_id": 0} for one in team] for team in (archive.saved, archive.loaded)
    )
    assert before == after
    assert not archive.ages.any()
    new = {one["genome_id"] for one in archive.loaded}
    assert len(new) == 12
    assert not new & {one["genome_id"] for one in archive.saved}
    again = run(tmp_path / "again", ticks=1000, changes=folder.path / ch.CHANGES)
    assert same(folder, again)


def test_protected_robots_stay_and_preferred_ones_have_half_of_all_offspring() -> None:
    rng = np.random.default_rng(0)
    config = RtNEATConfig(minimum_life_ticks=10)
    population = RtNEAT.start(config, slots=10, inputs=2, outputs=1, rng=0)
    founders = [genome.genome_id for genome in population.genomes]
    population.protected, population.preferred = {founders[0]}, {founders[0]}
    offspring = 0
    for _ in range(200):
        for one in population.tell(rng.random((10, 10, 1))):
            offspring += one.parents == (founders[0],)
    assert population.genomes[0].genome_id == founders[0]
    assert 0.4 < offspring / population.births < 0.65
    again = RtNEAT.from_state(config, population.state_dict())
    assert (again.protected, again.preferred) == (population.protected, population.preferred)


def test_when_all_are_protected_nobody_is_replaced() -> None:
    population = RtNEAT.start(
        RtNEATConfig(minimum_life_ticks=10), slots=4, inputs=2, outputs=1, rng=0
    )
    population.protected = {genome.genome_id for genome in population.genomes}
    assert population.tell(np.ones((4, 100, 1))) == []
    assert population.births == 0


def test_a_line_that_was_cut_off_was_never_made(tmp_path: Path) -> None:
    path = tmp_path / ch.CHANGES
    record = Record(path)
    record.add(40, ch.ReplaceRobot(1))
    whole = path.read_bytes()
    path.write_bytes(whole + whole[:-5])
    assert [one.tick for one in Record(path).entries] == [40]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "change: "),
        ('{"kind": "fly"}', "Invalid value 'fly'"),
        ('{"kind": "replace", "slot": 1, "too": 2}', "unknown field"),
        ('{"kind": "exploration", "epsilon": "much"}', "Expected `float`"),
    ],
)
def test_a_change_that_is_none_is_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read_change(text)


def test_a_damaged_record_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / ch.CHANGES
    path.write_bytes(b'{"tick":40,"change":{"kind":"replace","slot":1}}\n{"tick":0}\n')
    with pytest.raises(ConfigError, match=r"changes.jsonl:2: not a change"):
        Record(path)


def test_what_a_script_asks_for_again_while_it_is_repeated_is_refused(
    steered: tuple[RunFolder, Hand], tmp_path: Path
) -> None:
    killed = run(tmp_path / "run", callbacks=[Hand(steering()), Stop(240)])
    (killed.path / ch.CHANGES).write_bytes((steered[0].path / ch.CHANGES).read_bytes())
    script = Hand({tick: asked for tick, asked in steering().items() if tick > 240})
    again = resume(killed.path, callbacks=[script])
    assert same(steered[0], again)
    assert "repeats what was changed up to tick 720" in script.refusals[0]


def test_a_change_before_the_first_stride_of_a_resumed_run_keeps_the_worlds(
    tmp_path: Path,
) -> None:
    script = {240: [ch.ReplaceRobot(5), ch.ChangeScenario({"walls": [BARRIER]})]}
    whole = run(tmp_path / "whole", ticks=600, callbacks=[Hand(script)])
    stopped = run(tmp_path / "stopped", ticks=600, callbacks=[Stop(240)])
    (stopped.path / ch.CHANGES).write_bytes((whole.path / ch.CHANGES).read_bytes())
    assert same(whole, resume(stopped.path))


def test_a_gymnasium_run_repeats_its_changes_at_their_ticks(tmp_path: Path) -> None:
    few = {"world.slots": 6, "world.episodes": 2, "world.every": 2}

    def play(name: str, **how: Any) -> RunFolder:
        out = tmp_path / name
        return train("gym:CartPole-v1", "neat+q", settings=few, generations=3, out=out, **how)

    class Explorer(Hand):
        def rows(self, session: Session, rows: Any) -> None:
            if session.lengths["generations"] == 1 and not self.made:
                session.wanted.append(ch.ChangeExploration(0.5))

    one = play("one", callbacks=[Explorer({})])
    two = play("two", changes=one.path / ch.CHANGES)
    assert (one.path / "metrics.csv").read_bytes() == (two.path / "metrics.csv").read_bytes()
    assert two.record.entries == one.record.entries
    assert two.record.made == 1


def test_the_record_of_a_run_of_another_kind_is_refused_in_a_sentence(
    steered: tuple[RunFolder, Hand], tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="are not replaced one by one"):
        record = steered[0].path / ch.CHANGES
        train("wall", "qlearning", ticks=400, out=tmp_path / "run", changes=record)


def test_a_reader_leaves_a_line_that_is_being_written_alone(tmp_path: Path) -> None:
    path = tmp_path / ch.CHANGES
    record = Record(path)
    record.add(40, ch.ReplaceRobot(1))
    with path.open("ab") as file:
        file.write(b'{"tick":80,"cha')
    before = path.read_bytes()
    assert len(Record(path).entries) == 1
    assert path.read_bytes() == before
    record.add(80, ch.ReplaceRobot(2))
    assert [one.tick for one in Record(path).entries] == [40, 80]


def test_breeding_spares_who_is_protected_and_nobody_is_its_own_heir() -> None:
    config = RtNEATConfig(minimum_life_ticks=10)
    population = RtNEAT.start(config, slots=4, inputs=2, outputs=1, rng=0)
    ids = [genome.genome_id for genome in population.genomes]
    population.protected = {*ids[:3]}
    assert population.replace(parents=(0, 1)).slot == 3
    population.preferred = {ids[0]}
    for _ in range(20):
        assert population.replace(0).parents != (ids[0],)
        population.preferred = {population.genomes[0].genome_id}
        ids[0] = population.genomes[0].genome_id
