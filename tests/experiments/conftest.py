"""Experiments draw their own figures, and no pictures of each run."""

from __future__ import annotations

import pytest

from neatq_experiments import seeds


@pytest.fixture(scope="module", autouse=True)
def nothing_is_drawn(without_pictures: None) -> None:
    """Of runs in this process."""


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run tasks of comparisons in this process; returns the list to which each adds its arm."""
    ran: list[str] = []

    def run_all(runs: seeds.Runs, planned: list[seeds.SeedTask], _: object) -> None:
        for task in planned:
            ran.append(task.arm)
            task.folder.mkdir(parents=True, exist_ok=True)
            seeds._keep(task, runs.run(task))

    monkeypatch.setattr(seeds, "_run", run_all)
    return ran
