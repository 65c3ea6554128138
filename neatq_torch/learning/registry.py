"""Every learner by its name, its configuration and how it is made from both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torchrl.objectives.utils import ValueEstimators

from neatq_torch.kinds import ConfigError, Kinds
from neatq_torch.learning.candidates import CandidateValue
from neatq_torch.learning.critic_learner import CriticLearner
from neatq_torch.learning.heads import CandidateHeads, Heads
from neatq_torch.learning.learner import (
    Learner,
    NoLearning,
    NoLearningConfig,
    StepConfig,
    TDConfig,
    TDLearner,
)
from neatq_torch.learning.normalization import RunningNormalization
from neatq_torch.learning.objectives import CandidateTDLoss
from neatq_torch.learning.replay import ReplayConfig, ReplayLearner
from neatq_torch.learning.shared_critic import CriticConfig
from neatq_torch.learning.table import TableConfig, TableLearner
from neatq_torch.learning.traces import TraceConfig, TraceLearner
from neatq_torch.learning.wire_fitting import WireFittingLoss
from neatq_torch.network import PopulationNetwork

REPLAY_STREAM = 2


class LearnerParts(NamedTuple):
    """What a learner is made from.

    Attributes:
        network: The networks of all robots; None if they have none, as with tables.
        heads: How outputs are read.
        shape: (arenas, slots).
        seeds: One for each arena.
        episodes: Of a life; None where slots live on and on.
        normalization: Of what networks read; None where that is what the world gives.
    """

    network: PopulationNetwork | None
    heads: Heads
    shape: tuple[int, int]
    seeds: Sequence[int]
    episodes: int | None = None
    normalization: RunningNormalization | None = None

    def networks(self) -> PopulationNetwork:
        """The networks; ValueError if there are none."""
        if self.network is None:
            raise ValueError("expected networks to learn with, got none; only tables need none")
        return self.network

    def valued(self) -> PopulationNetwork:
        """The networks, whose outputs have Q-values; ConfigError if they have none."""
        if self.heads.candidates < 2:
            raise ConfigError(
                f"network.candidates: expected at least 2, got {self.heads.candidates}; with one "
                "there is no Q-value to learn (the learner none goes without)"
            )
        return self.networks()


def _loss(
    config: StepConfig, network: PopulationNetwork, heads: Heads, *, wires: bool
) -> CandidateTDLoss:
    wires = wires and isinstance(heads, CandidateHeads)
    loss = (WireFittingLoss if wires else CandidateTDLoss)(
        CandidateValue(network, heads, propose=wires),
        delay_value=config.target_tau is not None,
        normalize_return=config.normalize_return,
    )
    decay = config.trace_decay if isinstance(config, TDConfig) else 0.0
    if decay and config.discount:
        # Tick by tick: convolutions give other last bits when other arenas stand beside.
        settings = {"gamma": config.discount, "lmbda": decay, "vectorized": False}
        loss.make_value_estimator(ValueEstimators.TDLambda, **settings)
    else:
        loss.make_value_estimator(ValueEstimators.TD0, gamma=config.discount)
    return loss


def _td(config: TDConfig, parts: LearnerParts) -> TDLearner:
    network = parts.valued()
    return TDLearner(network, _loss(config, network, parts.heads, wires=config.wires), config)


def _traces(config: TraceConfig, parts: LearnerParts) -> TraceLearner:
    return TraceLearner(parts.valued(), parts.heads, config, episodes=parts.episodes)


def _replay(config: ReplayConfig, parts: LearnerParts) -> ReplayLearner:
    def make_loss(network: PopulationNetwork) -> CandidateTDLoss:
        return _loss(config, network, parts.heads, wires=True)

    network = parts.valued()
    learner = TDLearner(network, make_loss(network), config)
    return ReplayLearner(learner, make_loss, config, replay_seeds(parts.seeds))


def replay_seeds(seeds: Sequence[int]) -> list[int]:
    """Seeds of what is drawn from the memory of each arena, which has the seeds given."""
    sequences = (np.random.SeedSequence([seed, REPLAY_STREAM]) for seed in seeds)
    return [int(sequence.generate_state(1)[0]) for sequence in sequences]


def _critic(config: CriticConfig, parts: LearnerParts) -> CriticLearner:
    try:
        torch.empty(0, device=config.device)
    except (RuntimeError, AssertionError) as error:
        first = str(error).partition("\n")[0]
        raise ConfigError(
            f"device: expected one of this machine, such as cpu, got {config.device!r} ({first})"
        ) from error
    seeds = replay_seeds(parts.seeds)
    return CriticLearner(parts.networks(), parts.heads, config, seeds, parts.normalization)


def _table(config: TableConfig, parts: LearnerParts) -> TableLearner:
    if not isinstance(parts.heads, CandidateHeads):
        raise ValueError(
            "a table needs continuous actions with bounds, expected CandidateHeads, got "
            f"{type(parts.heads).__name__}"
        )
    low, high = parts.heads.low, parts.heads.low + parts.heads.span
    return TableLearner(parts.shape, low.tolist(), high.tolist(), config, parts.seeds)


learner_kinds = Kinds("learner")
"""All kinds of learners; `register_learner` adds one."""


def register_learner(name: str, config: type, make: Callable[[Any, LearnerParts], Learner]) -> None:
    """Add a kind of learner, which `train` and the command line then know by its name.

    `make` makes it from a configuration and the parts of a run; see `Kinds.register`.

    Example:
        >>> register_learner("mine", MyConfig, make_mine)
        >>> train("wall", learner="mine")
    """
    learner_kinds.register(name, config, make)


register_learner("none", NoLearningConfig, lambda _, parts: NoLearning(parts.networks()))
register_learner("td", TDConfig, _td)
register_learner("replay", ReplayConfig, _replay)
register_learner("critic", CriticConfig, _critic)
register_learner("traces", TraceConfig, _traces)
register_learner("table", TableConfig, _table)
