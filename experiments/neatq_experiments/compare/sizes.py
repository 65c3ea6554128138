"""Size and speed of what comes out of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean, median
from typing import Any

import torch

from neatq_experiments.compare.report import NO_VALUE, markdown_table
from neatq_experiments.forward import forward_us
from neatq_trainers.arms import ANCHORS
from neatq_trainers.folder import RunFolder
from neatq_trainers.policy import ChampionPolicy, load_policy


def size_of_champion(run: RunFolder) -> dict[str, float | int]:
    """Enabled links and nodes of a run's champion, and the time of a forward pass."""
    policy, genome = load_policy(run), run.champion()
    assert isinstance(policy, ChampionPolicy)
    network = policy.network
    seen, state = torch.zeros(network.inputs), network.initial_state()
    return {
        "parameters": int(genome.link_enabled.sum()),
        "nodes": int(genome.node_id.size),
        "forward_us": forward_us(lambda: network.step(seen, state)),
    }


def sizes_table(
    outcomes_of: Callable[[str, str], Sequence[Any]], task: str, arms: Sequence[str]
) -> str:
    """The table of a task, a row for each arm, with a column for each anchor."""
    sizes = {
        arm: [one.parameters for one in outcomes_of(task, arm) if one.parameters is not None]
        for arm in arms
    }
    anchors = [arm for arm in arms if arm in ANCHORS and sizes[arm]]
    rows = []
    for arm in arms:
        own, outcomes = sizes[arm], outcomes_of(task, arm)
        times = [one.forward_us for one in outcomes if one.forward_us is not None]
        cells = [
            arm,
            _with_reach(own),
            _with_reach([o.nodes for o in outcomes if o.nodes is not None]),
        ]
        cells.append(f"{median(times):.1f}" if times else NO_VALUE)
        for anchor in anchors:
            cells.append(f"{fmean(own) / fmean(sizes[anchor]):.2%}" if own else NO_VALUE)
        rows.append(cells)
    heads = ["arm", "parameters", "nodes", "µs a forward pass", *(f"of {a}'s" for a in anchors)]
    return f"Size and speed of what comes out:\n\n{markdown_table(heads, rows)}"


def _with_reach(values: Sequence[int]) -> str:
    """Mean, least and most."""
    if not values:
        return NO_VALUE
    return f"{fmean(values):,.0f} [{min(values):,}, {max(values):,}]"
