"""Experiments on Gymnasium tasks: equal budgets, honest tables."""

from __future__ import annotations

from pathlib import Path

import pytest

from neatq_experiments import gymnasium_tasks, neat_q
from neatq_experiments.generational import champion_at, run_rows
from neatq_experiments.seeds import Result, SeedTask
from neatq_trainers.config import RunConfig


def lives(config: RunConfig) -> int:
    assert config.generations is not None
    assert config.world.slots is not None
    return config.world.slots * config.population.episodes * config.generations


def result(seed: int, value: float, *curve: tuple[int, float]) -> Result:
    return {"seed": seed, "return": value, "episodes": 400, "steps": 9, "curve": list(curve)}


@pytest.mark.parametrize(
    ("budget", "episodes"), [(neat_q.MOUNTAIN_CAR, 20_000), (neat_q.SERVER_JOBS, 8_000)]
)
def test_all_arms_have_as_many_episodes(budget: neat_q.Budget, episodes: int) -> None:
    configs = [neat_q.budget_config(budget, arm, quick=False) for arm in neat_q.NEAT_Q_ARMS]
    assert {lives(one) for one in configs} == {episodes}


def test_gymnasium_tasks_give_both_arms_as_many_episodes() -> None:
    for name in gymnasium_tasks.CHALLENGES:
        arms = [
            gymnasium_tasks.challenge_config(f"{name}: {one}", quick=False)
            for one in ("neat", "neat+q")
        ]
        assert len({lives(one) for one in arms}) == 1


def test_a_seed_gives_the_same_result_whatever_runs_beside_it(tmp_path: Path) -> None:
    config = neat_q.budget_config(neat_q.MOUNTAIN_CAR, "neat+q", quick=True).changed(
        {
            "world.slots": 6,
            "world.kwargs": {"max_episode_steps": 40},
            "world.every": 1,
            "world.evaluated": 2,
            "world.episodes": 3,
            "world.test_episodes": 4,
            "population.episodes": 2,
            "generations": 2,
        }
    )
    both = run_rows(SeedTask("neat+q", (0, 1), True, tmp_path / "both"), config)
    alone = run_rows(SeedTask("neat+q", (1,), True, tmp_path / "alone"), config)
    assert both[1] == alone[0]
    assert alone[0]["episodes"] == 6 * 2 * 2
    assert [episodes for episodes, _ in alone[0]["curve"]] == [12, 24]
    again = run_rows(SeedTask("neat+q", (1,), True, tmp_path / "alone"), config)
    assert again == alone  # a finished run is read, not run again


def test_the_advantage_is_that_of_paired_seeds() -> None:
    # Seeds 0 and 1 differ by 10 and 20; seed 2 has no partner.
    results = {
        "neat+q": [result(0, -50, (400, -50)), result(1, -60, (400, -60)), result(2, 0, (400, 0))],
        "neat": [result(0, -60, (100, -90), (400, -60)), result(1, -80, (100, -70), (400, -80))],
    }
    results["neat+q"] = [one | {"curve": [(100, -99), *one["curve"]]} for one in results["neat+q"]]
    row = neat_q.mountain_car_table(results).splitlines()[3]
    assert "| neat | 2 | 400 | 9 | -70.0 ± 10.0 | -80.0 | -80.0 ± 10.0 |" in row
    assert row.endswith("| 15.0 (10.0 to 20.0) |")


def test_curves_are_read_at_a_moment() -> None:
    run = result(0, -55, (100, -70), (200, -58))
    assert champion_at([run], 199).tolist() == [-70]


def test_what_counts_as_solved_is_counted() -> None:
    runs = [result(0, 95, (1, 1)), result(1, 80, (1, 1))]
    row = gymnasium_tasks.challenges_table({"MountainCarContinuous-v0: neat": runs}).splitlines()[2]
    assert "| 87.5 ± 7.5 | 80.0 | 1 (>= 90) |" in row


def test_server_jobs_are_shown_beside_the_oracle() -> None:
    text = neat_q.server_jobs_table({"neat": [result(0, -7000, (100, -7100))]})
    assert "| oracle that knows all arrivals | -4,772 ± 32 |" in text
