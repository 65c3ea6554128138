"""Battles between teams, and their networks against plain Python and the project's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from neatq_envs.nero import kernels
from neatq_envs.nero.scenario import NERO_ACTIONS, NERO_TASKS, OBSERVATIONS
from neatq_envs.nero.state import NeroLaw, TeamBrains, law_of
from neatq_torch.genome import ACTIVATIONS, Genome, NodeKind, initial_genome
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CandidateHeads
from neatq_torch.network import GenomeNetwork
from neatq_trainers.nero.brains import team_brains
from neatq_trainers.nero.match import BattleRules, Film, MatchResult, filmed, play
from neatq_trainers.nero.teams import Team

Link = tuple[int, int, float, bool, bool]
"""Source, target (node ids), weight, recurrent, enabled."""
SIGMOID = ACTIVATIONS.index("sigmoid")


def genome_of(
    inputs: int, outputs: int, links: Sequence[Link], hidden: int = 0, **changes: Any
) -> Genome:
    """Inputs 1..inputs, the bias, outputs, hidden nodes; all but the sensors are sigmoid."""
    sizes = inputs, 1, outputs, hidden
    kinds = np.repeat([kind.value for kind in NodeKind], sizes)
    columns = list(zip(*links, strict=True)) if links else [()] * 5
    fields: dict[str, Any] = {
        "genome_id": 1,
        "node_id": np.arange(1, sum(sizes) + 1),
        "node_kind": kinds,
        "node_activation": np.where(kinds <= NodeKind.BIAS, 0, SIGMOID),
        "link_innovation": np.arange(1, len(links) + 1),
        "link_source": np.array(columns[0], np.int32),
        "link_target": np.array(columns[1], np.int32),
        "link_weight": np.array(columns[2], np.float32),
        "link_recurrent": np.array(columns[3], bool),
        "link_enabled": np.array(columns[4], bool),
    }
    return Genome(**(fields | changes))


def team_of(*genomes: Genome, **changes: Any) -> Team:
    return Team(**({"name": "mine", "genomes": genomes, "sensors": "opennero-2011"} | changes))


# -------------------------------------------------------------------------------------- networks


@st.composite
def genomes(draw: st.DrawFn, inputs: int, outputs: int) -> Genome:
    """Networks with few links, forward and recurrent, nodes in any order behind the sensors."""
    hidden = draw(st.integers(0, 4))
    ids = list(range(inputs + 2, inputs + 2 + outputs + hidden))
    ranks = draw(st.permutations(ids))  # forward links lead to a higher rank
    order = draw(st.permutations(ids))
    sensors = [1, 2, inputs, inputs + 1]
    chosen: dict[tuple[int, int, bool], Link] = {}
    for _ in range(draw(st.integers(0, 14))):
        source = draw(st.sampled_from(sensors + ids))
        target = draw(st.sampled_from(ids))
        backward = source in ids and ranks.index(source) >= ranks.index(target)
        recurrent = backward or draw(st.booleans())
        weight = draw(st.floats(-4, 4, width=32))
        link = source, target, weight, recurrent, draw(st.sampled_from([True, True, True, False]))
        chosen[source, target, recurrent] = link
    kinds = {
        node: NodeKind.OUTPUT if node < inputs + 2 + outputs else NodeKind.HIDDEN for node in ids
    }
    activation = draw(st.lists(st.integers(0, 4), min_size=len(ids), max_size=len(ids)))
    return genome_of(
        inputs,
        outputs,
        list(chosen.values()),
        hidden,
        node_id=[*range(1, inputs + 2), *order],
        node_kind=[NodeKind.INPUT] * inputs + [NodeKind.BIAS] + [kinds[node] for node in order],
        node_activation=[0] * (inputs + 1) + activation,
    )


def activated(activation: int, total: float) -> float:
    return {
        "identity": lambda: total,
        "sigmoid": lambda: 1 / (1 + math.exp(-total)),
        "steep_sigmoid": lambda: 1 / (1 + math.exp(-4.9 * total)),
        "tanh": lambda: math.tanh(total),
        "relu": lambda: max(total, 0.0),
    }[ACTIVATIONS[activation]]()


class OpenNeroNetwork:
    """A network as OpenNERO activates it, node by node in Python.

    A node is reached if a link leads to it from a sensor or from a node that is reached; nodes are
    asked one after the other. Values go on by one link: all nodes read what was before. Nodes that
    nothing has reached stay at 0. This is done again until every output has been reached once, at
    most 20 times.
    """

    def __init__(self, genome: Genome, bias: float) -> None:
        self.bias = bias
        kinds = dict(zip(genome.node_id.tolist(), genome.node_kind.tolist(), strict=True))
        self.inputs, self.outputs = genome.input_ids.tolist(), genome.output_ids.tolist()
        self.sensors = [node for node, kind in kinds.items() if kind <= NodeKind.BIAS]
        self.others = [node for node, kind in kinds.items() if kind > NodeKind.BIAS]
        self.function = dict(
            zip(genome.node_id.tolist(), genome.node_activation.tolist(), strict=True)
        )
        self.into: dict[int, list[tuple[int, float]]] = {node: [] for node in self.others}
        for link in np.flatnonzero(genome.link_enabled).tolist():
            pair = int(genome.link_source[link]), float(genome.link_weight[link])
            self.into[int(genome.link_target[link])].append(pair)
        self.value = dict.fromkeys(kinds, 0.0)
        self.reached: set[int] = set()
        self.fired: set[int] = set()

    def activate(self, inputs: np.ndarray) -> list[float]:
        for sensor in self.sensors:
            self.value[sensor] = self.bias
        self.value |= dict(zip(self.inputs, inputs.tolist(), strict=True))
        for _ in range(20):
            self.pass_on()
            if self.fired.issuperset(self.outputs):
                break
        return [self.value[node] for node in self.outputs]

    def pass_on(self) -> None:
        total = {}
        for node in self.others:
            sources = [source for source, _ in self.into[node]]
            if any(one in self.sensors or one in self.reached for one in sources):
                self.reached.add(node)
                total[node] = sum(weight * self.value[one] for one, weight in self.into[node])
        for node, amount in total.items():
            self.value[node] = activated(self.function[node], amount)
        self.fired |= total.keys()


def law(sensors: str) -> NeroLaw:
    return law_of(NERO_TASKS["battle"].replaced(sensors=sensors, max_speed=2.0, max_turn_rad=0.3))


def thought(
    brains: TeamBrains, sensors: str, inputs: np.ndarray, robot: int = 0
) -> tuple[np.ndarray, tuple[float, ...]]:
    """Outputs of a robot's network, and what it does."""
    values = np.zeros(32)
    values[: len(inputs)] = inputs
    action = kernels._think(brains, robot, values, len(inputs), law(sensors))
    outputs = brains.outputs[brains.output[robot] : brains.output[robot + 1]]
    return brains.value[outputs], action


Ticks = st.lists(st.lists(st.floats(0, 1), min_size=3, max_size=3), min_size=1, max_size=5)


def sensed(few: Sequence[float], inputs: int) -> np.ndarray:
    """Inputs of which those that have links are given."""
    values = np.zeros(inputs)
    values[[0, 1, inputs - 1]] = few
    return values


@given(genome=genomes(18, 2), ticks=Ticks)
def test_networks_of_opennero_are_activated_as_it_did(
    genome: Genome, ticks: list[list[float]]
) -> None:
    team = team_of(initial_genome(18, 2, rng=np.random.default_rng(0)), genome, bias=0.3)
    brains, oracle = team_brains([team], 2), OpenNeroNetwork(genome, 0.3)
    for few in ticks:
        inputs = sensed(few, 18)
        expected = oracle.activate(inputs)
        outputs, (speed, turn, fire, ignore) = thought(brains, "opennero-2011", inputs, robot=1)
        assert outputs == pytest.approx(expected, rel=1e-9, abs=1e-12)
        unit = np.clip(expected, 0, 1)
        assert speed == pytest.approx((2 * unit[0] - 1) * 2.0, abs=1e-9)
        assert turn == pytest.approx((2 * unit[1] - 1) * 0.3, abs=1e-9)
        assert fire == ignore == 0


def test_hidden_nodes_of_opennero_delay_by_a_tick_after_the_first_activation() -> None:
    # Input 1 -> hidden 22 -> output 20, and the bias, 19, -> output 21.
    links = [(1, 22, 2.0, False, True), (22, 20, 1.0, False, True), (19, 21, 1.0, False, True)]
    brains = team_brains([team_of(genome_of(18, 2, links, hidden=1), bias=0.3)], 1)

    def output(value: float) -> list[float]:
        return thought(brains, "opennero-2011", sensed((value, 0, 0), 18))[0].tolist()

    def sigmoid(x: float) -> float:
        return 1 / (1 + math.exp(-x))

    # The hidden node is reached in the first pass, the output in the second.
    bias = sigmoid(0.3)
    assert output(0.5) == pytest.approx([sigmoid(sigmoid(1)), bias])
    assert output(1.0) == pytest.approx([sigmoid(sigmoid(1)), bias])
    assert output(0.0) == pytest.approx([sigmoid(sigmoid(2)), bias])
    assert output(0.0) == pytest.approx([sigmoid(sigmoid(0)), bias])
    # An output without any link stays at 0 forever.
    lonely = team_brains([team_of(genome_of(18, 2, links[:2], hidden=1))], 1)
    outputs, (_, turn, _, _) = thought(lonely, "opennero-2011", sensed((0.5, 0, 0), 18))
    assert outputs[1] == 0 and turn == -0.3
    # With an output that is never reached each activation has 20 passes: nothing is late.
    outputs, _ = thought(lonely, "opennero-2011", sensed((1.0, 0, 0), 18))
    assert outputs[0] == pytest.approx(sigmoid(sigmoid(2)))


@pytest.mark.parametrize("evaluation", ["settle", "synchronous"])
@given(data=st.data())
def test_networks_of_runs_are_activated_as_in_the_run(
    evaluation: Literal["settle", "synchronous"], data: st.DataObject
) -> None:
    genome, ticks = data.draw(genomes(23, 3)), data.draw(Ticks)
    team = team_of(genome, sensors="nero-1", evaluation=evaluation, bias=1.0)
    brains, network = team_brains([team], 1), GenomeNetwork(genome, evaluation=evaluation).double()
    state = network.initial_state()
    for few in ticks:
        inputs = sensed(few, 23)
        expected, state = network.step(torch.from_numpy(inputs), state)
        outputs, _ = thought(brains, "nero-1", inputs)
        assert outputs == pytest.approx(expected.detach().numpy(), rel=1e-6, abs=1e-9)


def test_the_first_output_is_the_speed_however_deep_it_lies() -> None:
    # Input 1 -> hidden 28 -> output 25, and input 1 -> output 26; output 27 has no link.
    links = [(1, 28, 1.0, False, True), (28, 25, 3.0, False, True), (1, 26, -5.0, False, True)]
    genome = genome_of(23, 3, links, hidden=1)
    team = team_of(genome, sensors="nero-1", evaluation="settle", bias=1.0)
    outputs, (speed, turn, _, _) = thought(team_brains([team], 1), "nero-1", sensed((1, 0, 0), 23))
    expected = 1 / (1 + math.exp(-3 / (1 + math.exp(-1)))), 1 / (1 + math.exp(5)), 0.5
    assert outputs == pytest.approx(expected, abs=1e-9)
    assert speed == pytest.approx((2 * expected[0] - 1) * 2)
    assert turn == pytest.approx((2 * expected[1] - 1) * 0.3)


@given(data=st.data(), sensors=st.sampled_from(list(NERO_ACTIONS)), candidates=st.integers(1, 3))
def test_of_several_candidates_the_one_of_the_greatest_value_acts(
    data: st.DataObject, sensors: str, candidates: int
) -> None:
    actions, inputs = len(NERO_ACTIONS[sensors]), OBSERVATIONS[sensors]
    outputs = candidates * (actions + (candidates > 1))
    genome = data.draw(genomes(inputs, outputs))
    team = team_of(genome, sensors=sensors, evaluation="synchronous", candidates=candidates)
    team = replace(team, bias=1.0)
    low, high = [-2.0, -0.3, 0.0, 0.0][:actions], [2.0, 0.3, 1.0, 1.0][:actions]
    heads = CandidateHeads(candidates, low, high)
    brains = team_brains([team], 1)
    for few in data.draw(Ticks):
        values, action = thought(brains, sensors, sensed(few, inputs))
        read = torch.from_numpy(values.astype(np.float32))
        ranked = np.sort(values[-candidates:])[-2:]
        assume(candidates == 1 or ranked[1] == ranked[0] or ranked[1] - ranked[0] > 1e-5)
        expected = heads.best(read).tolist()
        assert action == pytest.approx([*expected, *[0.0] * (4 - actions)], abs=1e-5)


def test_networks_without_a_bias_node_are_refused() -> None:
    genome = initial_genome(23, 3, rng=np.random.default_rng(2), bias=False)
    with pytest.raises(ConfigError, match="bias"):
        team_of(genome, sensors="nero-1", evaluation="settle", bias=1.0)


def test_networks_beside_each_other_do_not_mix() -> None:
    rng = np.random.default_rng(1)
    genomes_ = [initial_genome(18, 2, rng=rng) for _ in range(3)]
    teams = [team_of(*genomes_[:2], bias=0.3), team_of(genomes_[2], bias=0.9)]
    together = team_brains(teams, 2, bare=2)
    assert together.node[-3:].tolist() == [4 * 21] * 3  # two robots without nodes
    inputs = rng.random(18)
    for robot, (genome, bias) in enumerate(
        [(genomes_[0], 0.3), (genomes_[1], 0.3), (genomes_[2], 0.9), (genomes_[2], 0.9)]
    ):
        alone = OpenNeroNetwork(genome, bias).activate(inputs)
        assert thought(together, "opennero-2011", inputs, robot)[0] == pytest.approx(alone)


def test_a_team_of_few_is_cloned_in_turn_and_one_of_many_is_cut() -> None:
    numbers = [genome_of(18, 2, [(19, 20, float(n), False, True)]) for n in range(1, 5)]

    def weights(genomes: list[Genome], robots: int) -> list[float]:
        return team_brains([team_of(*genomes)], robots).weight.tolist()

    assert weights(numbers[:2], 5) == [1, 2, 1, 2, 1]
    assert weights(numbers[:1], 3) == [1, 1, 1]
    assert weights(numbers, 3) == [1, 2, 3]
    assert weights(numbers, 4) == [1, 2, 3, 4]


# --------------------------------------------------------------------------------------- battles


def robot(speed: float, turn: float, inputs: int = 18) -> Genome:
    """A network whose outputs are constant: speed of 1 unit, turn of 0.2 rad a tick at most."""
    bias, actions = inputs + 1, {18: 2, 23: 3}[inputs]

    def weight(share: float) -> float:
        unit = (share + 1) / 2
        return math.log(unit / (1 - unit)) / (0.3 if inputs == 18 else 1.0)

    wanted = weight(speed), weight(turn / 0.2), 9.0
    links = [(bias, bias + 1 + one, wanted[one], False, True) for one in range(actions)]
    return genome_of(inputs, actions, links)


OPEN = {
    "name": "open",
    "width": 2000.0,
    "walls": [],
    "spawns": [{"x": 400, "y": 400}, {"x": 1400, "y": 400}],
}
"""A field on which each shot of 2011 hits, as nobody is nearer than 600."""
FEW = BattleRules(ticks=80, robots=4, hit_points=3, field=OPEN)
GUARD, IDLE = team_of(robot(0, 0.05), name="guard"), team_of(robot(0, 0.0), name="idle")


def same(one: Film, other: Film) -> bool:
    arrays = "pose", "hit_points", "shot", "team"
    equal = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)
    return equal and one.result == other.result


def test_a_battle_is_a_function_of_teams_rules_and_seed() -> None:
    wild = team_of(*(initial_genome(18, 2, rng=np.random.default_rng(n)) for n in range(3)))
    first = filmed(wild, GUARD, seed=4, rules=FEW)
    assert same(filmed(wild, GUARD, seed=4, rules=FEW), first)
    assert play(wild, GUARD, seed=4, rules=FEW) == first.result
    other = filmed(wild, GUARD, seed=5, rules=FEW)
    assert not np.array_equal(other.pose[0], first.pose[0])
    results = {play(wild, GUARD, seed=seed, rules=FEW).damage_blue for seed in range(8)}
    assert len(results) > 1
    assert play(wild, GUARD, seed=4, rules=replace(FEW, ticks=20)).ticks == 20


def test_blue_and_red_keep_their_teams() -> None:
    # Guards look around and shoot; the idle ones hit whoever happens to stand before them.
    for seed in range(3):
        as_blue = play(GUARD, IDLE, seed=seed, rules=FEW)
        as_red = play(IDLE, GUARD, seed=seed, rules=FEW)
        assert as_blue.damage_red > as_blue.damage_blue
        assert as_red.damage_blue > as_red.damage_red
        assert (as_blue.winner, as_red.winner) == ("blue", "red")
    film = filmed(GUARD, IDLE, seed=0, rules=FEW)
    assert film.team.tolist() == [0] * 4 + [1] * 4
    assert (np.abs(film.pose[0, :4, :2] - (400, 400)) <= 20).all()
    assert (np.abs(film.pose[0, 4:, :2] - (1400, 400)) <= 20).all()
    turned = np.diff(film.pose[1:3, :, 2], axis=0) % (2 * math.pi)
    assert turned[0, :4] == pytest.approx(0.05, abs=1e-4)
    assert np.minimum(turned[0, 4:], 2 * math.pi - turned[0, 4:]) == pytest.approx(0, abs=1e-4)


def test_colours_are_no_mirror_of_each_other() -> None:
    wild = team_of(*(initial_genome(18, 2, rng=np.random.default_rng(n)) for n in range(3)))
    results = [play(wild, wild, seed=seed, rules=FEW) for seed in range(6)]
    assert any(one.damage_blue != one.damage_red for one in results)


def test_the_winner_took_less_damage() -> None:
    def winner(blue: int, red: int) -> str:
        return MatchResult(damage_blue=blue, damage_red=red, ticks=1).winner

    assert (winner(3, 4), winner(4, 3), winner(4, 4)) == ("blue", "red", "draw")


def test_a_dead_robot_counts_with_its_hit_points_alone() -> None:
    # So many guards look at the same few enemies that most die of more hits than it takes.
    rules = BattleRules(ticks=60, robots=60, hit_points=2, field=OPEN)
    film = filmed(GUARD, IDLE, seed=1, rules=rules)
    last, left = film.hit_points[-1], film.hit_points.min(axis=0)
    dead = last == -1
    assert 5 < dead[60:].sum() < 60
    wounded = (last == 1) & ~dead
    assert film.result.damage_red == 2 * dead[60:].sum() + wounded[60:].sum()
    assert film.result.damage_blue == 2 * dead[:60].sum() + wounded[:60].sum()
    assert left.shape == (120,)


def test_a_battle_ends_with_the_last_robot_of_a_team() -> None:
    rules = replace(FEW, ticks=2000, robots=1)
    film = filmed(GUARD, IDLE, seed=2, rules=rules)
    assert film.result.ticks < 2000 and film.result.damage_red == 3
    assert len(film.pose) == len(film.shot) == len(film.hit_points) == film.result.ticks
    assert film.hit_points[-1, 1] == -1 and (film.hit_points[:-1, 1] >= 0).all()
    assert film.hit_points[0].tolist() == [3, 3]
    shots = film.shot[:, 0] == 1
    assert shots.sum() >= 3  # the last may come while it is leaving
    heading = film.pose[:-1, 0, 2][shots[1:]]  # it looks along x when it shoots
    assert np.abs(np.degrees(heading)).max() < 7


def test_without_a_target_nobody_shoots_and_nothing_happens() -> None:
    film = filmed(IDLE, IDLE, seed=3, rules=replace(FEW, robots=1))
    assert film.result == MatchResult(damage_blue=0, damage_red=0, ticks=80)
    assert (film.shot == -1).all() and (film.hit_points == 3).all()
    assert film.result.winner == "draw"


def test_teams_of_other_sensors_do_not_meet() -> None:
    own = team_of(robot(0, 0, inputs=23), sensors="nero-1", name="own")
    with pytest.raises(ConfigError, match=r"guard and own: .*'opennero-2011' and 'nero-1'"):
        play(GUARD, own, seed=0, rules=FEW)


def test_a_team_refuses_genomes_that_do_not_fit_its_robots() -> None:
    with pytest.raises(ConfigError, match="expected 18 inputs and 4 outputs"):
        team_of(robot(0, 0), sensors="opennero-2014")
    with pytest.raises(ConfigError, match="expected 18 inputs and 9 outputs"):
        team_of(robot(0, 0), candidates=3)


def test_each_kind_of_robots_fights_by_its_own_law() -> None:
    for sensors, firing in (
        ("opennero-2011", "2011"),
        ("opennero-2014", "2014"),
        ("nero-1", "aimed"),
    ):
        scenario = BattleRules(robots=7, hit_points=5).scenario(sensors)
        assert (scenario.sensors, scenario.firing) == (sensors, firing)
        assert (scenario.robots, scenario.hit_points, len(scenario.walls)) == (7, 5, 1)


def test_robots_of_2011_shoot_on_a_field_with_another_law() -> None:
    assert BattleRules(field="nero").scenario("opennero-2011").firing == "2011"
    rules = replace(FEW, field=OPEN | {"firing": "aimed"}, ticks=200)
    assert (filmed(GUARD, IDLE, seed=0, rules=rules).shot >= 0).any()


def test_turrets_in_a_battle_shoot_at_both_teams() -> None:
    rules = replace(FEW, field=OPEN | {"turrets": [[1000, 1000 / 3]], "height": 800.0}, ticks=100)
    film = filmed(IDLE, IDLE, seed=3, rules=rules)
    assert film.team.tolist() == [0] * 4 + [1] * 4 + [2]
    at = set(film.shot[:, 8].tolist()) - {-1}
    assert at & {0, 1, 2, 3} and at & {4, 5, 6, 7}
