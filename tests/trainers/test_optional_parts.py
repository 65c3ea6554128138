"""Parts of a run that are off unless asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from neatq_torch.learning import CandidatePolicy, ReplayLearner
from neatq_trainers.build import build
from neatq_trainers.compare.variants import changed
from neatq_trainers.config import Arm, ConfigError, RunConfig, preset
from neatq_trainers.loop import make_collector, record, strides


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"learning.inherited_share": 0.0}, r"inherited_share: expected a number within \(0, 1\]"),
        ({"learning.safe_mutation": 0}, "safe_mutation: expected at least 1 observation"),
        ({"learning.genes": 0.0}, "genes: expected a number above 0"),
        ({"learning.genes": 0.1, "learning.epsilon": 0.0}, "genes: .* got 0.0, 0.03 and 0.9"),
        ({"learning.genes": 0.1, "learning.discount": 1.0}, "genes: .* got 0.01, 0.03 and 1.0"),
        ({"learning.separation": 0.0}, "separation: expected a number above 0, or none, got 0.0"),
        (
            {
                "learning.separation": 0.1,
                "learning.rule": "td",
                "learning.replay.updates": 0,
                "learning.replay.newborn_updates": 0,
            },
            "separation: expected none with learning.rule td, got 0.1",
        ),
        (
            {"learning.inherited_share": 0.5, "learning.inheritance": "darwinian"},
            "inherited_share: expected none with inheritance darwinian, got 0.5",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        changed(preset("flag", "neatq"), changes)


def small(arm: Arm, changes: dict[str, Any]) -> RunConfig:
    size = {"scenario.robots": 6, "scenario.lifetime_ticks": 80, "evolution.minimum_life_ticks": 80}
    return changed(preset("flag", arm), size | {"batch_ticks": 40} | changes)


def test_the_behaviour_of_a_robot_is_where_its_life_ends() -> None:
    config = small("rtneat", {"evolution.novelty": 0.5})
    ends = np.zeros((6, 2))
    for number, batch in enumerate(make_collector(build(config))):
        ends = batch.get(("next", "pose"))[0, :, -1, :2].numpy()
        if number == 1:
            assert batch.get(("next", "truncated"))[0, :, -1].all()
            break
    run = build(config)
    for _ in strides(run):
        if run.tick == 80:
            break
    novelty = run.populations[0].novelty
    assert novelty is not None
    assert novelty.latest.tolist() == ends.tolist()
    assert np.ptp(novelty.latest, axis=0).min() > 1  # not at the spawn


def test_where_learning_has_genes_explored_ticks_do_not_count() -> None:
    plain, run = (
        build(small("neatq", {"learning.epsilon": 0.05, "learning.genes": genes}))
        for genes in (None, 0.3)
    )
    batch = next(iter(make_collector(run)))
    explored = batch.get("candidate_index") != batch.get("action_value").argmax(-1)
    assert 0 < explored.sum() < explored.numel() / 2
    for one, ticks in ((plain, 40), (run, 40 - explored[0].sum(-1).numpy())):
        record(one, batch)
        assert (one.populations[0].trials.counted == ticks).all()


def test_genes_of_learning_reach_robots_of_later_generations() -> None:
    config = small("neatq", {"learning.genes": 0.3, "evolution.ineligible_fraction": 0.5})
    run = build(config)
    for _ in strides(run):
        if run.tick >= 400:
            break
    assert run.populations[0].births > 5
    assert run.genes is not None
    assert isinstance(run.learner, ReplayLearner)
    assert isinstance(run.policy, CandidatePolicy)
    rates, epsilons, impatience = run.genes.values[0].T
    assert run.learner.learner.learning_rate.tolist() == pytest.approx(rates.tolist())
    assert run.policy.exploration.epsilon[0].tolist() == pytest.approx(epsilons.tolist())
    assert run.learner.learner.loss.discount is not None
    assert run.learner.learner.loss.discount[0].tolist() == pytest.approx((1 - impatience).tolist())
    assert len(set(rates)) == len(set(impatience)) == 6
