"""Agents sense, move, eat and learn as published: each number by hand, or by torch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from neatq_experiments.foraging_world import (
    ALONE,
    EGALITARIAN,
    LEARNING_RATE,
    MOMENTUM,
    STUDENT_TEACHER,
    Meadow,
    Walkers,
    brains_of,
    eat,
    live,
    move,
    see,
    standing_walkers,
    study,
    think,
    weights_of,
)
from neatq_torch.evolution import NEAT_2002
from neatq_torch.genome import Genome, InnovationLedger, NodeKind, initial_genome, mutate
from neatq_torch.network import PopulationNetwork

SIZE = 1_000.0


def meadow_with(*plants: tuple[float, float, int], worth: tuple[float, ...] = (100.0,)) -> Meadow:
    """Plants at (x, y) of a kind each."""
    x, y, kind = zip(*plants, strict=True)
    return Meadow(SIZE, np.array(x), np.array(y), np.array(kind, np.int64), np.array(worth))


def polar(distance: float, degrees: float, kind: int = 0) -> tuple[float, float, int]:
    """A plant that is seen from the middle at a distance and an angle."""
    angle = np.deg2rad(degrees)
    return 500 + distance * np.cos(angle), 500 + distance * np.sin(angle), kind


def sensed_by(walkers: Walkers, meadow: Meadow) -> NDArray[np.float64]:
    sensed = np.full(len(meadow.worth) * 8 + 1, 7.0)
    see(walkers, meadow, 0, sensed)
    return sensed


def grown(count: int, activation: str = "sigmoid") -> list[Genome]:
    """Genomes with two outputs and hidden nodes, some of their links disabled."""
    rng = np.random.default_rng(3)
    config = replace(NEAT_2002.mutation, hidden_activation=activation)
    numbers = range(1, count + 1)
    genomes = [
        initial_genome(9, 2, rng=rng, activation=activation, genome_id=one) for one in numbers
    ]
    ledger = InnovationLedger.for_genomes(genomes)
    node, link = replace(config, add_node_prob=1.0), replace(config, add_link_prob=1.0)
    for _ in range(12):
        for mutation in (node, replace(link, add_node_prob=0.0), config):
            genomes = [mutate(one, mutation, ledger, rng) for one in genomes]
    return genomes


def idle(count: int) -> list[Genome]:
    """Genomes whose outputs are both one half: they stand still."""
    rng = np.random.default_rng(0)
    genome = initial_genome(9, 2, rng=rng)
    return [genome.with_weights(np.zeros(20))] * count


def test_each_plant_adds_its_nearness_to_its_sector_and_kind() -> None:
    # From -90 degrees on in steps of 22.5: -80 is in the first sector, 11 in the fifth.
    plants = [polar(20, -80), polar(50, 11), polar(75, 12), polar(90, 80, 1), polar(40, -12, 1)]
    meadow = meadow_with(*plants, worth=(1.0, 2.0))
    expected = np.zeros(17)
    expected[[0, 4, 8 + 7, 8 + 3]] = 0.8, 0.5 + 0.25, 0.1, 0.6
    assert sensed_by(standing_walkers(1, meadow), meadow) == pytest.approx(expected)


@pytest.mark.parametrize("plant", [polar(50, 100), polar(50, -91), polar(50, 180), polar(101, 10)])
def test_what_is_behind_or_far_is_not_seen(plant: tuple[float, float, int]) -> None:
    meadow = meadow_with(plant)
    assert not sensed_by(standing_walkers(1, meadow), meadow).any()


def test_eyes_turn_with_the_head_and_speed_is_the_last_input() -> None:
    meadow = meadow_with(polar(50, 170 + 11))
    walkers = standing_walkers(1, meadow)
    walkers.heading_rad[0], walkers.speed[0] = np.deg2rad(170 - 360), 2.5
    expected = [0, 0, 0, 0, 0.5, 0, 0, 0, 0.25]
    assert sensed_by(walkers, meadow) == pytest.approx(np.array(expected))


def test_the_world_is_a_torus_for_eyes_mouths_and_feet() -> None:
    meadow = meadow_with((998.0, 999.0, 0))
    walkers = standing_walkers(1, meadow)
    walkers.x[0], walkers.y[0], walkers.heading_rad[0] = 8.0, 2.0, np.pi
    seen = sensed_by(walkers, meadow)
    # 10 to the west and 3 to the south: a little to the left of the nose.
    assert seen[4] == pytest.approx(1 - np.hypot(10, 3) / 100) and seen.sum() == seen[4]
    move(walkers, SIZE, 0, 0.5, 1.0)
    assert (walkers.x[0], walkers.y[0]) == pytest.approx((998.0, 2.0))
    assert eat(walkers, meadow, 0) == 100.0
    move(walkers, SIZE, 0, 0.5, 0.5)
    walkers.heading_rad[0] = 0.0
    move(walkers, SIZE, 0, 0.5, 0.5)
    move(walkers, SIZE, 0, 0.5, 0.5)
    assert walkers.x[0] == pytest.approx(8.0)


def test_outputs_turn_by_up_to_30_degrees_and_change_a_speed_from_0_to_10() -> None:
    walkers = standing_walkers(1, meadow_with((0.0, 0.0, 0)))
    move(walkers, SIZE, 0, 1.0, 0.8)
    assert np.rad2deg(walkers.heading_rad[0]) == pytest.approx(30)
    assert walkers.speed[0] == pytest.approx(6)
    assert walkers.y[0] == pytest.approx(500 + 6 * 0.5)
    move(walkers, SIZE, 0, 0.25, 1.0)
    assert np.rad2deg(walkers.heading_rad[0]) == pytest.approx(15)
    assert walkers.speed[0] == 10
    move(walkers, SIZE, 0, 0.5, 0.0)
    move(walkers, SIZE, 0, 0.5, 0.0)
    assert walkers.speed[0] == 0


def test_everybody_eats_each_plant_within_reach_once() -> None:
    plants = [polar(4.9, 200), polar(3, 10, 1), polar(5.1, 0)]
    meadow = meadow_with(*plants, worth=(100.0, -50.0))
    walkers = standing_walkers(2, meadow)
    assert [eat(walkers, meadow, agent) for agent in (0, 1, 0, 1)] == [50.0, 50.0, 0.0, 0.0]
    assert walkers.eaten.tolist() == [[True, True, False]] * 2
    # What one has eaten it does not see any more.
    assert np.count_nonzero(sensed_by(walkers, meadow)) == 1


@pytest.mark.parametrize("activation", ["sigmoid", "steep_sigmoid"])
def test_networks_with_hidden_nodes_are_those_of_the_library(activation: str) -> None:
    genomes = grown(20, activation)
    assert min((one.node_kind == NodeKind.HIDDEN).sum() for one in genomes) >= 12
    assert any(not one.link_enabled.all() for one in genomes)
    sensed = np.random.default_rng(1).uniform(-1, 1, (20, 9))
    with torch.no_grad():
        expected = PopulationNetwork(genomes).double()(torch.from_numpy(sensed)).numpy()
    brains, values = brains_of(genomes), np.zeros(100)
    for agent in range(20):
        think(brains, agent, sensed[agent], values)
        assert values[brains.output[agent]] == pytest.approx(expected[agent], abs=1e-12)


@pytest.mark.parametrize("activation", ["sigmoid", "steep_sigmoid"])
def test_lessons_are_torchs_descent_with_momentum(activation: str) -> None:
    genomes = grown(20, activation)
    rng = np.random.default_rng(1)
    network = PopulationNetwork(genomes).double()
    descent = torch.optim.SGD(network.parameters(), lr=LEARNING_RATE, momentum=MOMENTUM)
    assert (LEARNING_RATE, MOMENTUM) == (0.1, 0.9)
    brains, values, slope = brains_of(genomes), np.zeros(100), np.zeros(100)
    for _ in range(4):
        sensed, acted = rng.uniform(-1, 1, (20, 9)), rng.uniform(0, 1, (20, 2))
        for agent in range(20):
            study(brains, agent, sensed[agent], acted[agent], values, slope)
        descent.zero_grad()
        error = network(torch.from_numpy(sensed)) - torch.from_numpy(acted)
        (0.5 * error.square().sum()).backward()
        descent.step()
    sensed = rng.uniform(-1, 1, (20, 9))
    expected = network(torch.from_numpy(sensed)).detach().numpy()
    before = brains_of(genomes)
    for agent in range(20):
        think(brains, agent, sensed[agent], values)
        assert values[brains.output[agent]] == pytest.approx(expected[agent], abs=1e-10)
    assert (brains.weight != before.weight).mean() > 0.9
    learnt = [one.link_weight for one in network.genomes()]
    for ours, torchs in zip(weights_of(brains, genomes), learnt, strict=True):
        assert ours == pytest.approx(torchs, abs=1e-6)


def test_weights_come_back_to_their_own_links() -> None:
    genomes = grown(5)
    brains = brains_of(genomes)
    for genome, weights in zip(genomes, weights_of(brains, genomes), strict=True):
        assert weights.tolist() == genome.link_weight.tolist()
    brains.weight[:] += 1.0
    for genome, weights in zip(genomes, weights_of(brains, genomes), strict=True):
        assert weights == pytest.approx(genome.link_weight + genome.link_enabled)


def test_other_networks_are_refused() -> None:
    tanh, plain, steep = (
        initial_genome(9, 2, rng=np.random.default_rng(0), activation=one, genome_id=4)
        for one in ("tanh", "sigmoid", "steep_sigmoid")
    )
    for genomes in ([tanh], [plain, steep], [plain, tanh]):
        with pytest.raises(ValueError, match="genome 4: expected a bias, sigmoids of one slope"):
            brains_of(genomes)
    recurrent = plain.replaced(link_recurrent=np.arange(20) == 3)
    with pytest.raises(ValueError, match="no recurrent links"):
        brains_of([recurrent])


def first_step(worth: float, hungry: list[int], teaching: int, steps: int = 1) -> list[int]:
    """Lessons of five agents in groups of three and two that stand on a plant, some hungry."""
    meadow = meadow_with((500.0, 500.0, 0), worth=(worth,))
    walkers = standing_walkers(5, meadow)
    walkers.eaten[[agent for agent in range(5) if agent not in hungry]] = True
    group = np.array([0, 1, 0, 1, 0])
    return live(brains_of(idle(5)), walkers, meadow, group, teaching, steps)[1].tolist()


def test_whoever_is_rewarded_teaches_all_others_of_its_group_once() -> None:
    assert first_step(50.0, [2], EGALITARIAN, 9) == [1, 0, 0, 0, 1]
    assert first_step(50.0, [0, 1, 2, 3, 4], EGALITARIAN) == [2, 1, 2, 1, 2]


def test_nothing_and_pain_teach_nobody() -> None:
    for worth in (0.0, -50.0):
        assert first_step(worth, [0, 1, 2, 3, 4], EGALITARIAN) == [0] * 5
    assert first_step(50.0, [0, 1, 2, 3, 4], ALONE) == [0] * 5


def test_the_best_of_a_group_teaches_its_worst_in_every_step() -> None:
    assert first_step(50.0, [0, 4], STUDENT_TEACHER, 9) == [0, 0, 9, 0, 0]
    assert first_step(-50.0, [3], STUDENT_TEACHER, 9) == [0, 0, 0, 9, 0]


@pytest.mark.parametrize("teaching", [EGALITARIAN, STUDENT_TEACHER])
def test_what_is_taught_is_what_the_teacher_sensed_and_did(teaching: int) -> None:
    genomes = grown(2)
    meadow = meadow_with(polar(0, 0), polar(8, 0), polar(60, 40), polar(30, -70))
    walkers = standing_walkers(2, meadow)
    walkers.eaten[1, :2] = True
    taught, values, slope = brains_of(genomes), np.zeros(100), np.zeros(100)
    sensed = sensed_by(walkers, meadow)
    think(taught, 0, sensed, values)
    acted = values[taught.output[0]]
    study(taught, 1, sensed, acted.copy(), values, slope)
    brains = brains_of(genomes)
    fitness, lessons = live(brains, walkers, meadow, np.zeros(2, np.int64), teaching, 1)
    assert fitness[0] > fitness[1] == 0.0
    assert lessons.tolist() == [0, 1]
    assert brains.weight.tolist() == taught.weight.tolist()
