"""Battles and tournaments: which matches there are, and that each is played once."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neatq_envs.processes import ProcessEnded
from neatq_torch.genome import initial_genome
from neatq_torch.interop.opennero import write_team_file
from neatq_torch.kinds import ConfigError
from neatq_trainers.commands import run_command
from neatq_trainers.nero import commands
from neatq_trainers.nero.match import BattleRules, MatchResult
from neatq_trainers.nero.match_table import MATCHES, MatchRow, read_matches, write_matches
from neatq_trainers.nero.schedule import Pairing, check_teams, schedule
from neatq_trainers.nero.teams import Team
from neatq_trainers.nero.tournament import RULES, Hall, play_tournament, team_digest

Play = Callable[..., MatchResult]
HEADER = "blue,red,seed,damage_blue,damage_red,ticks,winner\n"


def team(name: str, seed: int = 0, **changes: Any) -> Team:
    rng = np.random.default_rng(seed)
    genome = initial_genome(18, 2, rng=rng)
    return Team(**({"name": name, "genomes": (genome,), "sensors": "opennero-2011"} | changes))


def teams(*names: str) -> list[Team]:
    return [team(name, seed) for seed, name in enumerate(names)]


@pytest.fixture
def made_up(toy: str) -> Play:
    """Battles that cost nothing; `toy` makes them importable for other processes."""
    assert toy
    return importlib.import_module("toy_battles").made_up


class Counted:
    """Plays as another one, and counts; stops with an error after so many."""

    def __init__(self, play: Play, most: int = 1000) -> None:
        self.play, self.most = play, most
        self.played: list[tuple[str, str, int]] = []

    def __call__(self, blue: Team, red: Team, *, seed: int, rules: BattleRules) -> MatchResult:
        if len(self.played) == self.most:
            raise KeyboardInterrupt
        self.played.append((blue.name, red.name, seed))
        return self.play(blue, red, seed=seed, rules=rules)


def listed(pairings: Sequence[Pairing]) -> list[tuple[str, str, int]]:
    return [(one.blue, one.red, one.seed) for one in pairings]


def test_in_a_battle_colours_change_and_both_colours_have_one_seed() -> None:
    found = listed(schedule(["a", "b"], 5, 7))
    assert found == [("a", "b", 7), ("b", "a", 7), ("a", "b", 8), ("b", "a", 8), ("a", "b", 9)]


def test_in_a_tournament_all_meet_in_both_colours() -> None:
    found = listed(schedule(["a", "b", "c"], 2))
    first = [("a", "b", 0), ("a", "c", 0), ("b", "c", 0)]
    assert found == first + [(red, blue, seed) for blue, red, seed in first]


def test_more_matches_and_more_teams_leave_those_that_there_were() -> None:
    few = set(schedule(["a", "b", "c"], 3, 1))
    assert few < set(schedule(["a", "b", "c"], 4, 1))
    assert few < set(schedule(["a", "b", "c", "d"], 3, 1))


@pytest.mark.parametrize(
    ("matches", "seed", "says"),
    [
        (0, 0, "matches: expected 1 to 10,000, got 0"),
        (10_001, 0, "matches: expected 1 to 10,000, got 10,001"),
        (1, -1, "seed: expected 0 to 2,000,000,000, got -1"),
    ],
)
def test_no_schedule_of_no_matches(matches: int, seed: int, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        schedule(["a", "b"], matches, seed)


def test_teams_must_differ_in_name_and_agree_in_sensors() -> None:
    other = initial_genome(18, 4, rng=np.random.default_rng(0))
    strange = team("c", genomes=(other,), sensors="opennero-2014")
    with pytest.raises(ConfigError, match="expected at least two, got 1"):
        check_teams(teams("a"))
    with pytest.raises(ConfigError, match=r"y/a.gz: a team is called a.gz already \(x/a.gz\)"):
        check_teams(teams("a.gz", "a.gz"), ["x/a.gz", "y/a.gz"])
    with pytest.raises(ConfigError, match="c: its sensors are opennero-2014, those of a opennero-"):
        check_teams([*teams("a", "b"), strange])
    for name in ("two\nlines", "", "\udcff"):
        with pytest.raises(ConfigError, match="expected a name of one line of text"):
            check_teams(teams("a", name))


def test_a_table_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    rows = [
        MatchRow('a, "b"', "ü.gz", 3, 10, 20, 100, "blue"),
        MatchRow("ü.gz", 'a, "b"', 3, 10, 10, 100, "draw"),
    ]
    write_matches(tmp_path / "m.csv", rows)
    text = (tmp_path / "m.csv").read_text("utf-8")
    assert text == HEADER + '"a, ""b""",ü.gz,3,10,20,100,blue\nü.gz,"a, ""b""",3,10,10,100,draw\n'
    assert read_matches(tmp_path / "m.csv") == rows


@pytest.mark.parametrize("half", ["a,b,1,10,2", "a,b", "a,b,1,10,20,5,red"])
def test_half_a_line_at_the_end_is_left_out(tmp_path: Path, half: str) -> None:
    path = tmp_path / MATCHES
    path.write_text(HEADER + "a,b,0,1,2,5,blue\n" + half)
    assert read_matches(path) == [MatchRow("a", "b", 0, 1, 2, 5, "blue")]


@pytest.mark.parametrize("line", ["a,b,x,1,2,5,blue", "a,b,0,1,2,5,green", "a,b,0,1,2,5", "\0"])
def test_a_damaged_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / MATCHES
    path.write_text(HEADER + "a,b,0,1,2,5,blue\n" + line + "\n")
    with pytest.raises(ConfigError, match=r"matches.csv: line 3 is damaged .*delete the line"):
        read_matches(path)


@pytest.mark.parametrize("content", [b"", b"team,wins\n", b"\xff\n"])
def test_what_is_no_table_of_matches_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / MATCHES).write_bytes(content)
    with pytest.raises(ConfigError, match="expected"):
        read_matches(tmp_path / MATCHES)


def test_a_row_says_who_won_and_by_how_much() -> None:
    row = MatchRow("a", "b", 0, 30, 100, 5, "blue")
    assert (row.score("a"), row.score("b")) == (70, -70)
    assert (row.won("a"), row.won("b")) == (1, 0)
    assert [row._replace(winner="draw").won(one) for one in "ab"] == [0.5, 0.5]
    assert [row._replace(winner="red").won(one) for one in "ab"] == [0, 1]


def test_rows_are_what_matches_gave(made_up: Play) -> None:
    rules = BattleRules(ticks=7)
    rows = play_tournament(teams("a", "b"), matches=3, seed=5, rules=rules, jobs=1, play=made_up)
    assert [row.pairing for row in rows] == schedule(["a", "b"], 3, 5)
    a, b = teams("a", "b")
    for row, (blue, red, seed) in zip(rows, [(a, b, 5), (b, a, 5), (a, b, 6)], strict=True):
        result = made_up(blue, red, seed=seed, rules=rules)
        assert row[3:] == (result.damage_blue, result.damage_red, 7, result.winner)


@pytest.mark.slow
def test_two_jobs_give_the_table_of_one(tmp_path: Path, made_up: Play) -> None:
    for jobs in (1, 2):
        play_tournament(
            teams("a", "b", "c"), matches=3, jobs=jobs, out=tmp_path / f"{jobs}", play=made_up
        )
    one, two = ((tmp_path / jobs / MATCHES).read_bytes() for jobs in "12")
    assert one == two
    assert one.count(b"\n") == 1 + 9


def test_an_interrupted_tournament_goes_on_to_the_table_of_a_whole_one(
    tmp_path: Path, made_up: Play
) -> None:
    own = teams("a", "b", "c")
    whole = play_tournament(own, jobs=1, out=tmp_path / "whole", play=made_up)
    cut, rest = Counted(made_up, most=4), Counted(made_up)
    with pytest.raises(KeyboardInterrupt):
        play_tournament(own, jobs=1, out=tmp_path / "cut", play=cut)
    path = tmp_path / "cut" / MATCHES
    assert len(read_matches(path)) == 4
    with path.open("ab") as file:
        file.write(b"c,b,0,1")  # a kill in the middle of a row
    assert play_tournament(own, jobs=1, out=tmp_path / "cut", play=rest) == whole
    assert path.read_bytes() == (tmp_path / "whole" / MATCHES).read_bytes()
    assert cut.played + rest.played == listed(schedule(["a", "b", "c"], 2))


def test_a_finished_tournament_plays_nothing(tmp_path: Path, made_up: Play) -> None:
    first = play_tournament(teams("a", "b"), jobs=1, out=tmp_path, play=made_up)
    again = Counted(made_up, most=0)
    assert play_tournament(teams("a", "b"), jobs=2, out=tmp_path, play=again) == first


def test_a_tournament_grows(tmp_path: Path, made_up: Play) -> None:
    play_tournament(teams("a", "b"), matches=1, jobs=1, out=tmp_path / "grown", play=made_up)
    more = Counted(made_up)
    grown, fresh = (
        play_tournament(teams("a", "b", "c"), jobs=1, out=tmp_path / name, play=play)
        for name, play in (("grown", more), ("fresh", made_up))
    )
    assert grown == fresh
    assert len(more.played) == 5
    for name in (MATCHES, RULES):
        assert (tmp_path / "grown" / name).read_bytes() == (tmp_path / "fresh" / name).read_bytes()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rules": BattleRules(ticks=999)}, "ticks: the matches there were played with 1000, got"),
        ({"rules": BattleRules(robots=9)}, "robots: the matches there were played with 50, got 9"),
        ({"seed": 1}, "has a match of a as blue against b with seed 0, which is none of those"),
        ({"matches": 1}, "has a match of b as blue against a with seed 0, which is none"),
        ({"teams": teams("c", "b")}, "has a match of a as blue against b"),
        ({"teams": [team("a", 5), team("b", 1)]}, "the team a is not the one that played there"),
    ],
)
def test_rows_of_other_settings_are_not_mixed(
    tmp_path: Path, made_up: Play, changes: dict[str, Any], says: str
) -> None:
    def play(**given: Any) -> None:
        own = given.pop("teams", teams("a", "b"))
        play_tournament(own, jobs=1, out=tmp_path, play=made_up, **given)

    play()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ConfigError, match=says):
        play(**changes)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_all_of_a_team_but_its_name_is_in_its_digest() -> None:
    one = team("a")
    assert team_digest(replace(one, name="b", notes=("mended",))) == team_digest(one)
    genome = one.genomes[0]
    for changes in (
        {"bias": 1.0},
        {"evaluation": "settle"},
        {"genomes": (genome, genome)},
        {"genomes": (genome.with_weights(genome.link_weight * 2),)},
    ):
        assert team_digest(replace(one, **changes)) != team_digest(one), changes


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path, made_up: Play) -> None:
    (tmp_path / "note.txt").write_text("mine")
    for out, says in ((tmp_path, "expected a new or empty"), (tmp_path / "note.txt", "got a file")):
        with pytest.raises(ConfigError, match=says):
            play_tournament(teams("a", "b"), jobs=1, out=out, play=made_up)
    assert [path.name for path in tmp_path.iterdir()] == ["note.txt"]


def test_damaged_rules_are_refused(tmp_path: Path, made_up: Play) -> None:
    (tmp_path / RULES).write_text(json.dumps({"rules": 1}))
    with pytest.raises(ConfigError, match=r"rules.json: damaged"):
        play_tournament(teams("a", "b"), jobs=1, out=tmp_path, play=made_up)


@pytest.mark.slow
def test_a_process_that_dies_costs_none_of_the_finished_matches(
    tmp_path: Path, made_up: Play
) -> None:
    fatal, own = importlib.import_module("toy_battles").fatal, teams("a", "b")
    with pytest.raises(ProcessEnded, match="a process ended with exit code"):
        play_tournament(own, matches=8, jobs=2, out=tmp_path, play=fatal)
    kept = read_matches(tmp_path / MATCHES)
    rest = Counted(made_up)
    rows = play_tournament(own, matches=8, jobs=1, out=tmp_path, play=rest)
    assert len(rest.played) == 8 - len(kept)
    assert rows == play_tournament(own, matches=8, jobs=1, play=made_up)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of three teams, as the commands take them, in an empty folder."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")

    def read(path: Path) -> Team:
        if path.name not in "abc":
            raise ConfigError(f"{path}: no such team")
        return team(path.name, ord(path.name))

    monkeypatch.setattr(commands, "find_team", read)
    return ["t/a", "t/b", "t/c"]


SMALL = ["--ticks", "30", "--robots", "2", "--jobs", "1"]


def test_a_battle_writes_its_table_and_its_picture(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(commands.battle_command, [*files[:2], *SMALL, "--matches", "3"]) == 0
    out = Path("runs/battle-a-b")
    assert len(read_matches(out / MATCHES)) == 3
    assert (out / "duel.png").read_bytes()[:4] == b"\x89PNG"
    said = capsys.readouterr().out
    assert "share won" in said
    assert "neatq: runs/battle-a-b: matches.csv, ranking.csv, duel.png" in said


def test_a_tournament_writes_ranking_and_matrix_and_compares(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    published = Path("published.tsv")
    published.write_text("file\twins\tmean_score\na\t3\t10\nb\t2\t5\nc\t1\t-5\n")
    arguments = [*files, *SMALL, "--published", "published.tsv", "--out", "cup"]
    assert run_command(commands.tournament_command, arguments) == 0
    assert sorted(path.name for path in Path("cup").iterdir()) == [
        *("matches.csv", "matrix.png", "ranking.csv", "rules.json")
    ]
    assert "published.tsv: 3 teams of both tables; rank correlation" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["t/a", "t/a"], "a team is called a already"),
        (["t/a", "t/x"], "t/x: no such team"),
        (["t/a", "t/b", "--robots", "0"], "robots: expected 1 to 1,000, got 0"),
        (["t/a", "t/b", "--robots", "5000"], "robots: expected 1 to 1,000, got 5,000"),
        (["t/a", "t/b", "--ticks", "0"], "ticks: expected 1 to 1,000,000, got 0"),
        (["t/a", "t/b", "--ticks", "1000001"], "ticks: expected"),
        (["t/a", "t/b", "--hit-points", "0"], "hit_points: expected 1 to 100,000, got 0"),
        (["t/a", "t/b", "--matches", "0"], "matches: expected 1 to 10,000, got 0"),
        (["t/a", "t/b", "--matches", "-2"], "matches: expected 1 to 10,000, got -2"),
        (["t/a", "t/b", "--seed", "-1"], "seed: expected 0 to 2,000,000,000, got -1"),
        (["t/a", "t/b", "--jobs", "0"], "jobs: expected 1 to 1,000, got 0"),
    ],
)
@pytest.mark.parametrize("command", [commands.battle_command, commands.tournament_command])
def test_bad_input_is_one_sentence_and_nothing_is_written(
    files: list[str],
    capsys: pytest.CaptureFixture[str],
    command: Callable[[list[str]], None],
    arguments: list[str],
    says: str,
) -> None:
    assert files
    assert run_command(command, arguments) == 2
    said = capsys.readouterr()
    assert said.err.startswith("neatq: error: ") and says in said.err
    assert said.err.count("\n") == 1 and not said.out
    assert not list(Path().iterdir())


def test_teams_are_files_of_opennero(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.gz", "b.gz"):
        write_team_file(team(name).genomes, name)
    Path("empty.gz").touch()
    Path("folder").mkdir()
    for bad in ("none.gz", "empty.gz", "folder"):
        assert run_command(commands.battle_command, ["a.gz", bad, "--out", "out"]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"neatq: error: {bad}: ") and said.count("\n") == 1
    assert not Path("out").exists()
    arguments = ["a.gz", "./b.gz", *SMALL, "--matches", "1", "--out", "out"]
    assert run_command(commands.battle_command, arguments) == 0
    assert [row[:3] for row in read_matches(Path("out", MATCHES))] == [("a.gz", "b.gz", 0)]


def test_a_folder_that_cannot_be_made_is_told_without_advice(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("file").touch()
    assert run_command(commands.battle_command, [*files[:2], *SMALL, "--out", "file/x"]) == 2
    assert capsys.readouterr().err == "neatq: error: file/x: Not a directory\n"


def test_a_published_table_is_refused_before_anything_is_played(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("p.tsv").write_text("file\twins\tmean_score\na\t3\t10\nz\t2\t5\n")
    assert run_command(commands.tournament_command, [*files, "--published", "p.tsv"]) == 2
    assert "expected at least three of the teams that play" in capsys.readouterr().err
    assert run_command(commands.tournament_command, [*files, "--published", "none.tsv"]) == 2
    assert "none.tsv: No such file" in capsys.readouterr().err
    assert [path.name for path in Path().iterdir()] == ["p.tsv"]


def test_ctrl_c_says_how_to_go_on_and_keeps_what_is_finished(
    files: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    row, played = Hall.row, []

    def interrupted(hall: Hall, pairing: Pairing) -> MatchRow:
        if len(played) == 2:
            raise KeyboardInterrupt
        played.append(pairing)
        return row(hall, pairing)

    monkeypatch.setattr(Hall, "row", interrupted)
    assert run_command(commands.tournament_command, [*files, *SMALL]) == 130
    says = "neatq: stopped; what is finished is kept: the same command goes on\n"
    assert capsys.readouterr().err == says
    assert len(read_matches(Path("runs/tournament") / MATCHES)) == 2
