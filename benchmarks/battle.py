"""A NERO match of 1,000 ticks with 100 robots: `neatq_trainers.nero.match.play`, CPU time.

Two teams of 50, by the rules of the tournament of 2011: each robot senses, thinks, shoots and moves
in every tick. "compiled loop" is the limit: these rules alone in one loop that can do nothing else
(`benchmarks/battle_reference.py`: one field, one set of sensors, one law of firing, no film), over
networks that lie ready as arrays. Ours begins with teams of genomes, so making such arrays of them
is in its cost.

The teams are evolved, not trained: each descends from a fully connected founder (18 inputs, bias,
2 outputs) by this project's own mutations, a hundred to an ancestor and five more to each robot:
43 to 59 links, some of them recurrent, and 1 to 9 hidden nodes. Of the lines of descent that were
tried these are four that fight for all the 1,000 ticks; the row ends with an error if they do not.
Both engines play the same match, number by number, until they round differently where a robot
touches a wall; `tests/test_battle_reference.py` compares them.

`play_tournament` of these teams with two processes stands beside itself with one: wall time of a
match, between a short and a long tournament, so that the start of the processes does not count.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.battle_reference import Minds, fight, minds_of
from benchmarks.measure import in_rounds, interleaved
from benchmarks.result import Line, compare, times_at_most
from neatq_envs.nero.state import BATTLE_STREAM
from neatq_envs.processes import usable_cores
from neatq_torch.genome import InnovationLedger, MutationConfig, initial_genome, mutate
from neatq_trainers.nero.brains import team_brains
from neatq_trainers.nero.match import BattleRules, play
from neatq_trainers.nero.teams import Team
from neatq_trainers.nero.tournament import play_tournament

RULES = BattleRules()
SEEDS = (1, 5, 14, 21)
"""Of teams; each fights the next one, the last one the first."""
GROWTH = MutationConfig(add_node_prob=0.04, add_link_prob=0.12, recurrent_link_prob=0.3)
"""As in OpenNERO, with more new nodes and links: a hundred mutations are few."""
COMMON_MUTATIONS, OWN_MUTATIONS = 100, 5
JOBS = 2
PAIRS = len(SEEDS) * (len(SEEDS) - 1) // 2
Damage = tuple[int, int, int]
"""Of blue, of red, and the ticks that passed."""


def run(quick: bool) -> list[Line]:
    """Measure matches one by one, and in tournaments where there are two cores."""
    teams = [evolved_team(seed) for seed in SEEDS]
    lines = [_match_line(teams, 3 if quick else 7)]
    if usable_cores() >= JOBS:
        lines.append(_tournament_line(teams, (2, 4), 1) if quick else _tournament_line(teams))
    return lines


def evolved_team(seed: int, robots: int = RULES.robots) -> Team:
    """Robots of one line of descent, their structures and weights somewhat different."""
    rng = np.random.default_rng(seed)
    ancestor = initial_genome(18, 2, rng=rng)
    ledger = InnovationLedger.for_genomes([ancestor])
    for _ in range(COMMON_MUTATIONS):
        ancestor = mutate(ancestor, GROWTH, ledger, rng)
    genomes = [ancestor] * robots
    for index in range(robots):
        for _ in range(OWN_MUTATIONS):
            genomes[index] = mutate(genomes[index], GROWTH, ledger, rng)
    return Team(name=f"line {seed}", genomes=tuple(genomes), sensors="opennero-2011")


def _match_line(teams: list[Team], rounds: int) -> Line:
    """All matches in turn; the cost is that of one."""
    pairs = list(zip(teams, [*teams[1:], teams[0]], strict=True))
    minds = [minds_of([blue.genomes, red.genomes], RULES.robots) for blue, red in pairs]
    harm = _checked_harm(_played(pairs)), _checked_harm(_fought(minds))
    samples = interleaved(
        {
            "ours": lambda: _played(pairs),
            "compiled loop": lambda: _fought(minds),
            "arrays": lambda: [team_brains(pair, RULES.robots) for pair in pairs],
        },
        rounds=rounds,
    )
    millis = {name: seconds / len(pairs) * 1e3 for name, seconds in samples.items()}
    return compare(
        "a match of 1,000 ticks, 2 x 50 robots",
        millis["ours"],
        "compiled loop",
        millis["compiled loop"],
        unit="ms",
        goal=times_at_most(3),
        note=f"A team takes {harm[0]:.0f} of 1,000 damage, {harm[1]:.0f} in the compiled loop. Of "
        f"our cost, {np.median(millis['arrays']):.0f} ms go into arrays of networks.",
    )


def _played(pairs: list[tuple[Team, Team]]) -> list[Damage]:
    """Matches in the library."""
    results = [play(*pair, seed=seed, rules=RULES) for seed, pair in enumerate(pairs)]
    return [(one.damage_blue, one.damage_red, one.ticks) for one in results]


def _fought(minds: list[Minds]) -> list[Damage]:
    """The same matches in the reference."""
    rngs = [np.random.default_rng([seed, BATTLE_STREAM]) for seed in range(len(minds))]
    return [fight(*one, ticks=RULES.ticks) for one in zip(minds, rngs, strict=True)]


def _checked_harm(matches: list[Damage]) -> float:
    """Mean damage of a team; RuntimeError unless matches last long enough and all are hit."""
    for blue, red, ticks in matches:
        if ticks < RULES.ticks or min(blue, red) < 100:
            raise RuntimeError(
                f"expected matches of {RULES.ticks} ticks in which each team takes at least 100 "
                f"damage, got {ticks} ticks, {blue} and {red}: look for other SEEDS"
            )
    return float(np.mean([(blue, red) for blue, red, _ in matches]))


def _tournament_line(teams: list[Team], matches: tuple[int, int] = (2, 6), rounds: int = 3) -> Line:
    """A match in a tournament, with two processes beside one."""

    def seconds_with(jobs: int) -> Callable[[], float]:
        return lambda: _tournament_seconds(teams, jobs, matches)

    samples = in_rounds({"two": seconds_with(JOBS), "one": seconds_with(1)}, rounds=rounds)
    rates = {name: 1 / float(np.median(seconds)) for name, seconds in samples.items()}
    return compare(
        f"a match of a tournament, {JOBS} processes",
        samples["two"] * 1e3,
        "one process",
        samples["one"] * 1e3,
        unit="ms",
        goal=times_at_most(1 / 1.6),
        note=f"{rates['two']:.1f} matches/s with two processes, {rates['one']:.1f} with one.",
    )


def _tournament_seconds(teams: list[Team], jobs: int, matches: tuple[int, int]) -> float:
    """Wall seconds of a match, of what a long tournament has more than a short one."""
    short, long = (_whole_seconds(teams, jobs, number) for number in matches)
    return (long - short) / (PAIRS * (matches[1] - matches[0]))


def _whole_seconds(teams: list[Team], jobs: int, matches: int) -> float:
    begin = time.perf_counter()
    play_tournament(teams, matches=matches, jobs=jobs, rules=RULES)
    return time.perf_counter() - begin
