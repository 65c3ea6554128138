"""What the arms do to weights, in real arenas and through the real collector."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from neatq_torch.kinds import ConfigError
from neatq_torch.learning import TDLearner
from neatq_trainers.arms import preset
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.loop import breed, judge, make_collector
from neatq_trainers.run import Run


def small(
    arm: str, changes: dict[str, Any] | None = None, *, life_ticks: int = 120, robots: int = 10
) -> RunConfig:
    size = {"robots": robots, "lifetime_ticks": life_ticks}
    return preset("flag", arm, env_kwargs=size).changed(changes or {})


def own_ticks(config: RunConfig, **changes: Any) -> RunConfig:
    """The same, but every robot learns from its own ticks alone."""
    changes = {f"learner.{name}": value for name, value in changes.items()}
    return config.changed({"learner.kind": "td", **changes})


def weights(run: Run) -> list[np.ndarray]:
    assert run.network is not None
    return [genome.link_weight for genome in run.network.genomes()]


def td_errors(arm: str, *, learning: bool) -> list[float]:
    """TD error (squared, of the median robot) of each batch of one life without evolution."""
    config = small(arm, life_ticks=1000, robots=30)
    if arm == "replay":  # a return that a thousand ticks are enough to learn
        config = own_ticks(config, discount=0.9, learning_rate=0.01)
    run, errors = build(config), []
    assert isinstance(run.learner, TDLearner)
    if not learning:
        run.learner.learning_rate.zero_()
    for batch in make_collector(run):
        errors.append(run.learner.update(batch).median().item())
        if len(errors) == 25:
            return errors
    raise AssertionError("the collector ended")


@pytest.mark.parametrize("arm", ["described", "replay"])
def test_td_error_falls_while_a_frozen_population_lives(arm: str) -> None:
    learning, control = td_errors(arm, learning=True), td_errors(arm, learning=False)
    assert learning[0] == control[0]
    assert np.mean(learning[-10:]) < 0.8 * np.mean(learning[:3])
    assert np.mean(learning[-10:]) < 0.75 * np.mean(control[-10:])


@pytest.mark.parametrize("arm", ["rtneat", "committed"])
def test_arms_without_learning_change_no_weight_during_life(arm: str) -> None:
    run = build(small(arm))
    before = weights(run)
    for number, batch in enumerate(make_collector(run)):
        assert run.learner.update(batch).isnan().all()
        if number == 2:
            break
    assert all(np.array_equal(a, b) for a, b in zip(before, weights(run), strict=True))


@pytest.mark.parametrize("wires", [False, True])
def test_wire_fitting_alone_moves_candidate_actions(wires: bool) -> None:
    run = build(own_ticks(small("replay"), wires=wires, epsilon=0.5))
    before = weights(run)
    run.learner.update(next(iter(make_collector(run))))
    genomes = [genome for population in run.populations for genome in population.genomes]
    for genome, old, new in zip(genomes, before, weights(run), strict=True):
        acts = np.isin(genome.link_target, genome.output_ids[: 5 * 2])
        assert (old[acts] != new[acts]).any() == wires
        assert (old[~acts] != new[~acts]).any()


@pytest.mark.parametrize("inheritance", ["lamarckian", "darwinian"])
def test_genes_change_by_exactly_what_was_learnt_or_not_at_all(inheritance: str) -> None:
    run = build(small("replay", {"learner.inheritance": inheritance}))
    population, founders = run.populations[0], weights(run)
    learnt, newborn = founders, torch.zeros(1, 10, dtype=torch.bool)
    for batch in make_collector(run):
        run.tick += batch.shape[-1]
        run.learner.update(batch)
        learnt = weights(run)
        judge(run, batch)
        newborn = breed(run)
        if newborn.any():
            break
    inherited = learnt if inheritance == "lamarckian" else founders
    for slot in (~newborn[0]).nonzero().flatten().tolist():
        assert population.genomes[slot].link_weight.tobytes() == inherited[slot].tobytes()
        assert learnt[slot].tobytes() != founders[slot].tobytes()


def test_a_newborn_in_a_running_collection_has_a_life_and_a_memory_of_its_own() -> None:
    often = {"population.ineligible_fraction": 0.5}
    run = build(own_ticks(small("replay", often, life_ticks=110)))
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
        judge(run, batch)
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
    run = build(small("replay", {"network.value_range": (0.9, 1.0)}))
    values = next(iter(make_collector(run))).get("action_value")
    assert ((values >= 0.9) & (values <= 1.0)).all()
    with pytest.raises(ConfigError, match="value_range: expected two finite numbers"):
        small("replay", {"network.value_range": (1.0, 1.0)})


@pytest.mark.parametrize("learner", ["td", "replay", "traces"])
def test_networks_with_one_candidate_have_nothing_to_learn(learner: str) -> None:
    config = small("rtneat", {"learner.kind": learner})
    with pytest.raises(ConfigError, match=r"network\.candidates: expected at least 2, got 1"):
        build(config)
