"""Parts of a run that are off unless asked for."""

from __future__ import annotations

from typing import Any

import pytest

from neatq_torch.kinds import ConfigError
from neatq_torch.learning import CandidatePolicy, ReplayLearner
from neatq_trainers.arms import preset
from neatq_trainers.build import build
from neatq_trainers.config import RunConfig
from neatq_trainers.loop import judge, make_collector, strides


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"learner.genes": 0.0}, r"genes: expected \(0, inf\) or None"),
        ({"learner.genes": 0.1, "learner.epsilon": 0.0}, "genes: .* got 0.0, 0.03 and 0.9"),
        ({"learner.genes": 0.1, "learner.discount": 1.0}, "genes: .* got 0.01, 0.03 and 1.0"),
        ({"learner.target_tau": 0.0}, r"target_tau: expected \(0, 1\] or None"),
    ],
)
def test_what_makes_no_sense_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        preset("flag", "replay").changed(changes)


def small(arm: str, changes: dict[str, Any]) -> RunConfig:
    config = preset("flag", arm, env_kwargs={"robots": 6, "lifetime_ticks": 80})
    return config.changed({"batch_ticks": 40} | changes)


def test_where_learning_has_genes_explored_ticks_do_not_count() -> None:
    plain, run = (
        build(small("replay", {"learner.epsilon": 0.05, "learner.genes": genes}))
        for genes in (None, 0.3)
    )
    batch = next(iter(make_collector(run)))
    explored = batch.get("candidate_index") != batch.get("action_value").argmax(-1)
    assert 0 < explored.sum() < explored.numel() / 2
    for one, ticks in ((plain, 40), (run, 40 - explored[0].sum(-1).numpy())):
        judge(one, batch)
        population: Any = one.populations[0]
        assert (population.trials.counted == ticks).all()


def test_genes_of_learning_reach_robots_of_later_generations() -> None:
    config = small("replay", {"learner.genes": 0.3, "population.ineligible_fraction": 0.5})
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
