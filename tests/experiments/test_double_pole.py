"""Networks that balance, and runs of NEAT that count what they took."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from neatq_envs.double_pole import PAPER_START_RAD, observe, resting_poles, step
from neatq_experiments import double_pole
from neatq_experiments.balance import BIAS, balance
from neatq_experiments.double_pole import (
    AS_WRITTEN,
    DOUBLE_POLE,
    PUBLISHED_EVALUATIONS,
    SETTINGS,
    Setting,
    balance_poles,
    poles_table,
    run_poles,
)
from neatq_experiments.double_pole_rules import damping_fitness
from neatq_experiments.seeds import SeedTask
from neatq_torch.evolution import NEAT_2002, NEATConfig, Species
from neatq_torch.genome import Genome, InnovationLedger, NodeKind, initial_genome, mutate
from neatq_torch.network import PopulationNetwork


def some_genomes(rows: int, inputs: int, recurrent: float = 0.0) -> list[Genome]:
    rng = np.random.default_rng(1)
    genomes = [
        initial_genome(inputs, 1, rng=rng, activation="steep_sigmoid", genome_id=number)
        for number in range(rows)
    ]
    ledger = InnovationLedger.for_genomes(genomes)
    config = replace(
        NEAT_2002.mutation, add_node_prob=0.3, add_link_prob=0.4, recurrent_link_prob=recurrent
    )
    for _ in range(6):
        genomes = [mutate(one, config, ledger, rng) for one in genomes]
    return genomes


@torch.no_grad()
def one_by_one(
    genome: Genome, limit: int, velocities: bool, bias: float
) -> tuple[int, list[float]]:
    """Steps that a network alone survives, and how far from rest it was after each."""
    weights = genome.link_weight.copy()
    weights[genome.link_source == genome.node_id[genome.node_kind == NodeKind.BIAS]] *= bias
    network = PopulationNetwork([genome.with_weights(weights)], evaluation="synchronous").double()
    state, memory = resting_poles(1, PAPER_START_RAD), network.initial_state()
    unrest: list[float] = []
    for _ in range(limit):
        output, memory = network.step(torch.from_numpy(observe(state, velocities)), memory)
        if not step(state, output[:, 0].numpy())[0]:
            break
        unrest.append(float(np.abs(state[0, :4]).sum()))
    return len(unrest), unrest


@pytest.mark.parametrize(("velocities", "bias"), [(True, 1.0), (False, BIAS)])
def test_the_compiled_loop_is_the_synchronous_network(velocities: bool, bias: float) -> None:
    genomes = some_genomes(40, 6 if velocities else 3, recurrent=0.5)
    wobble = np.zeros((40, 100))
    state = resting_poles(40, PAPER_START_RAD)
    steps = balance(genomes, state, 150, velocities=velocities, wobble=wobble, bias=bias)
    alone = [one_by_one(genome, 150, velocities, bias) for genome in genomes]
    assert steps.tolist() == [survived for survived, _ in alone]
    assert len(set(steps.tolist())) > 5
    unrest = [sum(history[-100:]) for _, history in alone]
    assert wobble.sum(1) == pytest.approx(unrest)


def test_a_limit_ends_what_would_balance_on() -> None:
    assert balance(some_genomes(3, 6), resting_poles(3, PAPER_START_RAD), 3).tolist() == [3] * 3


def test_other_activations_are_refused() -> None:
    rng = np.random.default_rng(1)
    genome = initial_genome(6, 1, rng=rng, activation="tanh", genome_id=4)
    with pytest.raises(ValueError, match="genome 4: expected steep sigmoids"):
        balance([genome], resting_poles(1), 3)


def test_balancing_is_learned_and_the_same_seed_gives_the_same_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(double_pole, "SOLVED_STEPS", 300)
    setting = replace(SETTINGS["full"], generations=20)
    first = balance_poles(setting, 6)
    assert first["solved"]
    assert 150 * (first["generations"] - 1) < first["evaluations"] <= 150 * first["generations"]
    assert balance_poles(setting, 6) == first


def test_champions_that_live_on_are_not_simulated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated: list[int] = []

    def counted(genomes: list[Genome], *args: object, **rest: object) -> np.ndarray:
        simulated.extend(one.genome_id for one in genomes)
        return np.array([one.genome_id % 7 for one in genomes])

    monkeypatch.setattr(double_pole, "balance", counted)
    result = balance_poles(Setting(population=20, generations=6), 0)
    assert not result["solved"]
    assert len(simulated) == len(set(simulated)) < 20 * 6


def test_without_velocities_a_winner_must_balance_long_and_from_200_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[tuple[int, int]] = []
    general = [199, 200]

    def pretend(genomes: list[Genome], state: np.ndarray, limit: int, **rest: Any) -> np.ndarray:
        calls.append((len(genomes), limit))
        if len(genomes) == 625:
            return np.where(np.arange(625) < general.pop(0), limit, 3)
        if len(genomes) == 1:
            return np.array([limit])
        rest["wobble"][:] = 1.0
        # The first genome is the fittest until one beyond the 60th is born.
        return np.array([900 + (one.genome_id == 1) + 2 * (one.genome_id > 60) for one in genomes])

    monkeypatch.setattr(double_pole, "balance", pretend)
    config = NEATConfig(speciate=False, elite_members=1000)
    setting = Setting(config=config, population=19, velocities=False, generations=50)
    result = balance_poles(setting, 0)
    assert result["solved"] and result["starts"] == 200
    assert result["evaluations"] == 19 * result["generations"]
    # A network that did not generalise is not tested twice, though it is the fittest again.
    assert calls.count((625, 1000)) == 2 and calls.count((1, 100_000)) == 2


def test_without_velocities_the_best_of_a_species_is_tested_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    genomes = some_genomes(4, 3)
    species = [Species(1, np.array([0, 1])), Species(2, np.array([2, 3]))]
    population: Any = SimpleNamespace(genomes=genomes, species=species)
    fitness, tested = np.array([5.0, 9.0, 7.0, 6.0]), []

    def pretend(some: list[Genome], state: np.ndarray, limit: int, **rest: Any) -> np.ndarray:
        if len(some) == 1:
            tested.append(genomes.index(some[0]))
        return np.zeros(len(some), int)

    monkeypatch.setattr(double_pole, "balance", pretend)
    monkeypatch.setattr(double_pole, "damping_fitness", lambda steps, wobble: fitness)
    judge = double_pole._WithoutVelocities(Setting(velocities=False))
    for _ in range(3):
        assert judge(population)[1] is None
    assert tested == [1, 2]
    fitness[3] = 7.5
    judge(population)
    assert tested == [1, 2, 3]


def test_fitness_without_velocities_rewards_calm() -> None:
    calm = damping_fitness(np.array([1000]), np.full((1, 100), 0.01))
    assert calm.tolist() == pytest.approx([0.1 + 0.9 * 0.75])


@pytest.mark.parametrize("arm", list(SETTINGS))
def test_every_arm_runs(arm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    setting = replace(SETTINGS[arm], population=12)
    monkeypatch.setitem(SETTINGS, arm, setting)
    monkeypatch.setattr(double_pole, "QUICK_POLE_GENERATIONS", 2)
    (result,) = run_poles(SeedTask(arm, (0,), True, tmp_path))
    assert set(result) == {"solved", "evaluations", "generations", "hidden", "links", "starts"}
    assert arm in poles_table({arm: [result, result]})


def test_every_arm_is_in_an_experiment_and_has_published_figures() -> None:
    assert (
        {arm for one in DOUBLE_POLE for arm in one.arms}
        == set(SETTINGS)
        == set(PUBLISHED_EVALUATIONS)
    )


def test_weights_mutate_as_written_in_the_paper() -> None:
    written = AS_WRITTEN.mutation
    assert (written.link_weights_prob, written.weight_replace_prob) == (0.8, 0.1)
    assert written.weight_scheme == "uniform"
