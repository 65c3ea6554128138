"""What a life is worth, what is learnt in it, and who becomes champion."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from neatq_envs.torchrl_rows import episode_seeds
from neatq_torch.genome import Genome, identical, pack_genomes
from neatq_torch.network import GenomeNetwork
from neatq_trainers.generational.config import GenerationalConfig, preset
from neatq_trainers.generational.lives import LifeWorker, Lives
from neatq_trainers.generational.loop import train_generation
from neatq_trainers.generational.policy import make_policy
from neatq_trainers.generational.run import Run, begin_run
from neatq_trainers.generational.scout import scout
from neatq_trainers.generational.team import Team, open_team
from neatq_trainers.generational.train import start

Tiny = Callable[..., GenerationalConfig]


def run_of(config: GenerationalConfig) -> Run:
    surroundings = scout(config.environment, config.learning.step.discount)
    return begin_run(config, surroundings, LifeWorker(config, surroundings).interface)


def play(config: GenerationalConfig, run: Run, genome: Genome, seed: int) -> float:
    """The return of an episode, by the policy that a user gets, in a plain environment."""
    policy = make_policy(config, run.surroundings, genome)
    env = config.environment.make()
    observation, _ = env.reset(seed=seed)
    total, done = 0.0, False
    while not done:
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        total += float(reward)
        done = terminated or truncated
    return total


def test_fitness_is_the_mean_return_of_the_episodes_of_a_plain_environment(tiny: Tiny) -> None:
    config = tiny("neat")
    run = run_of(config)
    genomes = list(run.populations[0].genomes)
    seeds = episode_seeds(config.seed, 0, 2)
    by_hand = [np.mean([play(config, run, one, int(s)) for s in seeds]) for one in genomes]
    with open_team(config, run.surroundings, 1) as team:
        (row,) = train_generation(run, team)
    assert row.best_fitness == pytest.approx(max(by_hand), rel=1e-9)
    assert row.mean_fitness == pytest.approx(np.mean(by_hand), rel=1e-9)
    assert (row.episodes, row.generation, row.td_error) == (16, 1, None)


@pytest.mark.parametrize(("by", "weight_of_next"), [("terminated", 0.0), ("truncated", 0.99)])
def test_values_are_bootstrapped_over_an_end_by_time_and_not_over_one_for_good(
    tiny: Tiny, by: str, weight_of_next: float
) -> None:
    """One step of reward 1 from observation 0 to 1, so delta = 1 + w max Q(1) - max Q(0)."""
    config = tiny("neatq", "Ends-v0", env_kwargs=(f"by={by}", "max_episode_steps=9"), episodes=1)
    learning = replace(config.learning, epsilon=0.0, value_range=(-3.0, 5.0))
    config = replace(config, learning=learning)
    run = run_of(config)
    genomes = run.populations[0].genomes
    with open_team(config, run.surroundings, 1) as team:
        outcome = team.live(genomes, np.zeros((8, 1), np.int64), np.arange(8))
    assert np.unique(outcome.steps).tolist() == [1]
    for genome, error in zip(genomes, outcome.td_error, strict=True):
        before, after = (
            -3 + 8 * GenomeNetwork(genome)(torch.eye(2)[place]).max().item() for place in (0, 1)
        )
        assert error == pytest.approx((1 + weight_of_next * after - before) ** 2, rel=1e-4)


@pytest.mark.parametrize("variant", ["neatq", "wires"])
def test_the_learning_rate_falls_to_zero_over_a_life(tiny: Tiny, variant: str) -> None:
    """With the trace empty after each episode, episode e of 4 moves weights by (1 - e/4) alpha."""
    config = tiny(variant, "EndsInBox-v0", episodes=1)
    config = replace(config, learning=replace(config.learning, epsilon=0.0))
    run = run_of(config)
    worker = LifeWorker(config, run.surroundings)
    genome = run.populations[0].genomes[0]
    packed, chance = pack_genomes([genome]), np.zeros(1, np.int64)
    moved = []
    for episodes in (1, 2):
        seeds = np.zeros((1, episodes), np.int64)
        moved.append(worker.live(Lives(packed, seeds, chance)).weights[0])
    # A second life of one episode, from where the first ended, at half the rate.
    half = replace(config.learning.step, learning_rate=config.learning.step.learning_rate / 2)
    config = replace(config, learning=replace(config.learning, step=half))
    again = pack_genomes([genome.with_weights(moved[0])])
    seeds = np.zeros((1, 1), np.int64)
    third = LifeWorker(config, run.surroundings).live(Lives(again, seeds, chance))
    np.testing.assert_allclose(third.weights[0], moved[1], rtol=1e-6)
    assert not np.array_equal(moved[0], moved[1])


@pytest.mark.parametrize("inheritance", ["darwinian", "lamarckian"])
def test_what_was_learnt_is_inherited_only_by_lamarckian_children(
    tiny: Tiny, inheritance: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny("neatq")
    config = replace(config, learning=replace(config.learning, inheritance=inheritance))
    run = run_of(config)
    population = run.populations[0]
    born = list(population.genomes)
    bred: list[Genome] = []
    monkeypatch.setattr(population, "advance", lambda _: bred.extend(population.genomes))
    with open_team(config, run.surroundings, 1) as team:
        train_generation(run, team)
    assert len(bred) == len(born) == 8
    same = [identical(one, two) for one, two in zip(born, bred, strict=True)]
    assert all(same) if inheritance == "darwinian" else not any(same)


def test_the_champion_is_the_best_that_was_evaluated(tiny: Tiny, tmp_path: Path) -> None:
    config = tiny("neat", generations=6)
    folder = start(config, tmp_path / "run")
    with (folder.path / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    evaluated = {int(r["generation"]): r["evaluated_return"] for r in rows}
    assert [number for number, value in evaluated.items() if value] == [1, 2, 4, 6]
    best = max(float(value) for value in evaluated.values() if value)
    run = folder.read()
    champion = run.champions[0]
    assert float(f"{champion.score:.6g}") == best == float(rows[-1]["champion_return"])
    newest = max(n for n, value in evaluated.items() if value and float(value) == best)
    assert champion.generation == newest
    seeds = episode_seeds(config.seed, 0, 3, purpose=1)
    by_hand = np.mean([play(config, run, champion.genome, int(seed)) for seed in seeds])
    assert champion.score == pytest.approx(by_hand, rel=1e-9)


def test_of_two_equal_champions_the_newer_stays(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_of(tiny("neat"))
    live = Team.live

    def level(self: Team, *arguments: object) -> object:
        outcome = live(self, *arguments)  # type: ignore[arg-type]
        return outcome._replace(returns=np.zeros_like(outcome.returns))

    monkeypatch.setattr(Team, "live", level)
    with open_team(run.config, run.surroundings, 1) as team:
        train_generation(run, team)
        assert run.champions[0].generation == 1
        train_generation(run, team)
    assert run.champions[0].generation == 2


def test_a_champion_is_not_replaced_by_a_worse_one(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_of(tiny("neat"))
    with open_team(run.config, run.surroundings, 1) as team:
        train_generation(run, team)
        kept = run.champions[0]._replace(score=1e9)
        run.champions = [kept]
        train_generation(run, team)
    assert run.champions[0] is kept


def test_a_recurrent_network_forgets_between_episodes(tiny: Tiny) -> None:
    """Two episodes with the same start are worth the same."""
    config = tiny("neat")
    run = run_of(config)
    genome = run.populations[0].genomes[0]
    link = {
        "link_innovation": np.append(genome.link_innovation, 99),
        "link_source": np.append(genome.link_source, genome.output_ids[0]),
        "link_target": np.append(genome.link_target, genome.output_ids[0]),
        "link_weight": np.append(genome.link_weight, np.float32(3)),
        "link_enabled": np.append(genome.link_enabled, True),
        "link_recurrent": np.append(genome.link_recurrent, True),
    }
    with open_team(config, run.surroundings, 1) as team:
        returns = [
            team.live([one], np.array([[5, 5]]), None).returns[0]
            for one in (genome, genome.replaced(**link))
        ]
    assert returns[1][0] == returns[1][1]
    assert returns[0][0] != returns[1][0]


def test_neat_learns_cart_pole_in_a_few_generations(tmp_path: Path) -> None:
    config = replace(preset("gym:CartPole-v1", "neat"), population=40, generations=5, episodes=1)
    folder = start(config, tmp_path / "run")
    assert "return 500.0 ± 0.0" in folder.read_result()


def test_q_values_of_random_play_have_a_range_by_hand(toy: str) -> None:
    """Reward 1 for three steps, discount 0.5: returns 1.75, 1.5 and 1; the margin is a tenth."""
    task = replace(preset(f"{toy}Ends-v0", "neatq"), env_kwargs=("steps=3", "max_episode_steps=3"))
    low, high = scout(task.environment, 0.5).value_range
    assert (low, high) == pytest.approx((1 - 0.075, 1.75 + 0.075))


def test_a_network_without_evolution_keeps_what_it_learnt(tiny: Tiny) -> None:
    run = run_of(tiny("qnetwork"))
    (founder,) = run.populations[0].genomes
    with open_team(run.config, run.surroundings, 1) as team:
        train_generation(run, team)
    (later,) = run.populations[0].genomes
    assert later.same_structure(founder)
    assert not identical(later, founder)
    assert identical(run.champions[0].genome, later)
