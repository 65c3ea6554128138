"""The baselines that results of server jobs are measured by, and the bound."""

from __future__ import annotations

import numpy as np
import pytest

from neatq_envs.server_jobs import draw_jobs
from neatq_experiments import server_jobs_reference
from neatq_experiments.server_jobs_reference import (
    best_returns,
    greedy_policy,
    oldest_policy,
    ordered_policy,
    play_jobs,
    random_policy,
    urgent_policy,
)


def test_baselines_stand_where_the_table_says() -> None:
    seeds = range(100)
    within = 200  # three standard errors of 100 episodes
    random = play_jobs(random_policy(np.random.default_rng(0)), seeds)
    assert random.mean() == pytest.approx(-11_161, abs=within)
    assert play_jobs(oldest_policy, seeds).mean() == pytest.approx(-14_395, abs=within)
    assert play_jobs(greedy_policy, seeds).mean() == pytest.approx(-12_505, abs=within)
    assert play_jobs(urgent_policy, seeds).mean() == pytest.approx(-6_903, abs=within)
    assert play_jobs(ordered_policy, seeds).mean() == pytest.approx(-5_585, abs=within)


def test_nobody_beats_the_oracle() -> None:
    seeds = range(30)
    best = best_returns(seeds)
    assert best.mean() == pytest.approx(-4_772, abs=300)
    for policy in (ordered_policy, urgent_policy, oldest_policy):
        assert (play_jobs(policy, seeds) <= best).all()


def test_the_oracle_does_no_job_before_it_arrives() -> None:
    prices = server_jobs_reference._prices(draw_jobs(np.random.default_rng(0)))
    for job, arrival in ((0, 0), (99, 0), (100, 1), (199, 100)):
        assert (prices[job, :arrival] == 1e6).all()
        assert (prices[job, arrival:] <= 150).all() and prices[job, arrival] == 0
