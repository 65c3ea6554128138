"""Networks of a team as the arrays that a compiled battle reads."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from neatq_envs.nero.state import TeamBrains
from neatq_torch.genome import Genome
from neatq_torch.genome.heredity import node_levels
from neatq_torch.genome.rules import NodeKind
from neatq_trainers.nero.teams import Team

_ORDER = NodeKind.INPUT, NodeKind.BIAS
KNOWN_GENOMES = 10_000
"""Whose networks are kept: in a tournament each team plays many matches."""


def team_brains(teams: Sequence[Team], robots: int, bare: int = 0) -> TeamBrains:
    """The networks of teams of so many robots each, and of `bare` robots that have none.

    A team of fewer genomes is cloned round-robin, one of more is cut, as in OpenNERO.
    """
    minds = [(team, team.genomes[i % len(team.genomes)]) for team in teams for i in range(robots)]
    parts = [_brain(genome, team.evaluation == "settle") for team, genome in minds]
    nodes = np.cumsum([0, *(len(part["activation"]) for part in parts), *[0] * bare])
    links = np.cumsum([0, *(len(part["weight"]) for part in parts)])
    outputs = np.cumsum([0, *(len(part["outputs"]) for part in parts), *[0] * bare])
    starts = [part["link"] + first for part, first in zip(parts, links[:-1], strict=True)]

    def joined(name: str, shift: np.ndarray | None = None) -> np.ndarray:
        columns = [part[name] for part in parts]
        if shift is not None:
            columns = [one + first for one, first in zip(columns, shift, strict=False)]
        return np.concatenate(columns) if columns else np.empty(0, np.int64)

    of_team = [team for team, _ in minds]
    total = int(nodes[-1])
    return TeamBrains(
        node=nodes,
        link=np.concatenate([*starts, links[-1:]]),
        source=joined("source", nodes),
        weight=joined("weight").astype(np.float64),
        late=joined("late").astype(bool),
        activation=joined("activation"),
        bias=np.array([team.bias for team in of_team] + [0.0] * bare),
        silent=np.array([team.evaluation == "opennero" for team in of_team] + [False] * bare),
        output=outputs,
        outputs=joined("outputs", nodes),
        candidates=np.array([team.candidates for team in of_team] + [1] * bare),
        value=np.zeros(total),
        before=np.zeros(total),
        active=np.zeros(total, bool),
        fired=np.zeros(total, bool),
    )


@lru_cache(KNOWN_GENOMES)
def _brain(genome: Genome, settles: bool) -> dict[str, np.ndarray]:
    """One network: nodes in the order in which they are evaluated, sensors and bias first."""
    order = _evaluated(genome, settles)
    row = np.empty(len(order), np.int64)
    row[order] = np.arange(len(order))
    used = np.flatnonzero(genome.link_enabled)
    target = row[genome.target_index[used]]
    used, target = (one[np.argsort(target, kind="stable")] for one in (used, target))
    sensor = np.isin(genome.node_kind[genome.source_index[used]], _ORDER)
    late = genome.link_recurrent[used] if settles else ~sensor
    return {
        "activation": genome.node_activation[order].astype(np.int64),
        "link": np.searchsorted(target, np.arange(len(order))),
        "source": row[genome.source_index[used]],
        "weight": genome.link_weight[used],
        "late": late,
        "outputs": row[np.flatnonzero(genome.node_kind == NodeKind.OUTPUT)],
    }


def _evaluated(genome: Genome, settles: bool) -> np.ndarray:
    """Node indices [nodes]: inputs, the bias, then all others, by levels where they settle."""
    kind = genome.node_kind
    first = [np.flatnonzero(kind == one) for one in _ORDER]
    rest = np.flatnonzero((kind != NodeKind.INPUT) & (kind != NodeKind.BIAS))
    if settles:
        now = genome.link_enabled & ~genome.link_recurrent
        levels = node_levels(genome.source_index[now], genome.target_index[now], len(kind))
        assert levels is not None, "a valid genome has no cycle of forward links"
        rest = rest[np.argsort(levels[rest], kind="stable")]
    return np.concatenate([*first, rest])
