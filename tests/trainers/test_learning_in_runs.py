"""What the arms do to weights, in real arenas and through the real collector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.learning import LearnerConfig, ReplayConfig, TDLearner
from neatq_trainers.build import Run, build
from neatq_trainers.config import Arm, ConfigError, RunConfig, preset
from neatq_trainers.loop import breed, make_collector


def small(arm: Arm, *, life_ticks: int = 120, robots: int = 10, **changes: object) -> RunConfig:
    config = preset("flag", arm)
    return replace(
        config,
        scenario=config.scenario.replaced(robots=robots, lifetime_ticks=life_ticks),
        evolution=replace(config.evolution, minimum_life_ticks=life_ticks),
        **changes,  # pyright: ignore[reportArgumentType]
    )


def own_ticks(config: RunConfig, **changes: object) -> RunConfig:
    """The same, but every robot learns from its own ticks alone."""
    learning = replace(config.learning, rule="td", replay=ReplayConfig())
    return replace(config, learning=replace(learning, **changes))  # pyright: ignore[reportArgumentType]


def weights(run: Run) -> list[np.ndarray]:
    assert run.network is not None
    return [genome.link_weight for genome in run.network.genomes()]


def td_errors(arm: Arm, *, learning: bool) -> list[float]:
    """TD error (squared, of the median robot) of each batch of one life without evolution."""
    config = small(arm, life_ticks=1000, robots=30)
    if arm == "neatq":  # a return that a thousand ticks are enough to learn
        step = LearnerConfig(learning_rate=0.01, optimizer="adam")
        config = own_ticks(config, discount=0.9, step=step)
    run, errors = build(config), []
    assert isinstance(run.learner, TDLearner)
    if not learning:
        run.learner.learning_rate.zero_()
    for batch in make_collector(run):
        errors.append(run.learner.update(batch).median().item())
        if len(errors) == 25:
            return errors
    raise AssertionError("the collector ended")


@pytest.mark.parametrize("arm", ["described", "neatq"])
def test_td_error_falls_while_a_frozen_population_lives(arm: Arm) -> None:
    learning, control = td_errors(arm, learning=True), td_errors(arm, learning=False)
    assert learning[0] == control[0]
    assert np.mean(learning[-10:]) < 0.8 * np.mean(learning[:3])
    assert np.mean(learning[-10:]) < 0.75 * np.mean(control[-10:])


@pytest.mark.parametrize("arm", ["rtneat", "committed"])
def test_arms_without_learning_change_no_weight_during_life(arm: Arm) -> None:
    run = build(small(arm))
    before = weights(run)
    for number, batch in enumerate(make_collector(run)):
        assert run.learner.update(batch).isnan().all()
        if number == 2:
            break
    assert all(np.array_equal(a, b) for a, b in zip(before, weights(run), strict=True))


@pytest.mark.parametrize("rule", ["td", "wire_fitting"])
def test_wire_fitting_alone_moves_candidate_actions(rule: str) -> None:
    run = build(own_ticks(small("neatq"), rule=rule, epsilon=0.5))
    before = weights(run)
    run.learner.update(next(iter(make_collector(run))))
    genomes = [genome for population in run.populations for genome in population.genomes]
    for genome, old, new in zip(genomes, before, weights(run), strict=True):
        acts = np.isin(genome.link_target, genome.output_ids[: 5 * 2])
        assert (old[acts] != new[acts]).any() == (rule == "wire_fitting")
        assert (old[~acts] != new[~acts]).any()


@pytest.mark.parametrize("inheritance", ["lamarckian", "darwinian"])
def test_genes_change_by_exactly_what_was_learnt_or_not_at_all(inheritance: str) -> None:
    config = small("neatq")
    learning = replace(config.learning, inheritance=inheritance)
    run = build(replace(config, learning=learning))
    population, founders = run.populations[0], weights(run)
    learnt, newborn = founders, torch.zeros(1, 10, dtype=torch.bool)
    for batch in make_collector(run):
        run.tick += batch.shape[-1]
        run.learner.update(batch)
        learnt = weights(run)
        population.record(batch.get(("next", "reward_vector"))[0].numpy())
        newborn = breed(run)
        if newborn.any():
            break
    inherited = learnt if inheritance == "lamarckian" else founders
    for slot in (~newborn[0]).nonzero().flatten().tolist():
        assert population.genomes[slot].link_weight.tobytes() == inherited[slot].tobytes()
        assert learnt[slot].tobytes() != founders[slot].tobytes()


def test_a_newborn_in_a_running_collection_has_a_life_and_a_memory_of_its_own() -> None:
    config = own_ticks(small("neatq", life_ticks=110))
    often = replace(config.evolution, ineligible_fraction=0.5)
    run = build(replace(config, evolution=often))
    assert isinstance(run.learner, TDLearner)
    assert run.network is not None
    collector = make_collector(run)
    births: dict[int, int] = {}  # slot -> batch of its latest birth
    batch, newborn = TensorDict(), torch.zeros(1, 10, dtype=torch.bool)
    for number, batch in enumerate(collector):
        run.tick += batch.shape[-1]
        identity = run.network.genome_id.unsqueeze(-1)
        assert (batch["genome_id"].squeeze(-1) == identity).all()
        for slot, born in births.items():
            assert run.learner.steps[slot] == number - born - 1
            # It began at the spawn, in a life of its own.
            assert (batch["step_count"][0, slot, 0, 0] == 0) == (born == number - 1)
        run.learner.update(batch)
        run.populations[0].record(batch.get(("next", "reward_vector"))[0].numpy())
        newborn = breed(run)
        if len(births) >= 5 and newborn.any():
            break
        if newborn.any():
            collector.reset(index=newborn)
        births |= dict.fromkeys(newborn[0].nonzero().flatten().tolist(), number)
    # Learning the predecessors' batch again teaches the newborn nothing.
    before = run.network.weight.detach().clone()
    run.learner.update(batch)
    changed = (run.network.weight != before).any(1)
    assert torch.equal(changed, ~newborn.flatten())


def test_values_are_read_on_the_range_that_is_asked_for() -> None:
    config = small("neatq")
    network = replace(config.network, value_range=(0.9, 1.0))
    run = build(replace(config, network=network))
    batch = next(iter(make_collector(run)))
    values = batch.get("action_value")
    assert ((values >= 0.9) & (values <= 1.0)).all()
    with pytest.raises(ConfigError, match="value_range: expected low < high"):
        replace(config.network, value_range=(1.0, 1.0))
