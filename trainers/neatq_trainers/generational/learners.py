"""How the networks of a generation learn: before their first step, and at every step."""

from __future__ import annotations

import torch

from neatq_torch.learning import (
    CandidateHeads,
    CandidateTDLoss,
    CandidateValue,
    DiscreteHeads,
    LearnerConfig,
    TDLearner,
    TraceLearner,
    TransitionMemory,
    WireFittingLoss,
    pretrain,
)
from neatq_torch.network import PopulationNetwork
from neatq_trainers.generational.config import LifeLearningConfig, PretrainingConfig
from neatq_trainers.generational.recording import Lessons, Transitions


def make_learner(
    network: PopulationNetwork, heads: CandidateHeads | DiscreteHeads, learning: LifeLearningConfig
) -> TraceLearner | TDLearner:
    """What learns at every step, by the rule of a configuration."""
    if learning.rule == "traces":
        return TraceLearner(network, heads, learning.step)
    step = LearnerConfig(learning_rate=learning_rate(heads, learning))
    return TDLearner(network, _loss(network, heads, learning), step)


def learning_rate(heads: CandidateHeads | DiscreteHeads, learning: LifeLearningConfig) -> float:
    """The learning rate as the learner of a rule takes it.

    In a configuration it is in units of the network outputs, as `TraceLearner` has it. The gradient
    of a squared error of Q-values is larger by the square of the span of their range.
    """
    low, high = heads.value_range
    span = 1.0 if learning.rule == "traces" else high - low
    return learning.step.learning_rate / span**2


def pretrain_newborns(
    network: PopulationNetwork,
    heads: CandidateHeads | DiscreteHeads,
    learning: LifeLearningConfig,
    pretraining: PretrainingConfig,
    lessons: Lessons,
) -> torch.Tensor:
    """Train networks [lives, 1] on what the generation before has left to their arenas.

    Returns:
        Mean squared TD error of each life on its last minibatch [lives, 1].
    """
    return pretrain(
        network,
        _loss(network, heads, learning),
        [_memory(transitions) for transitions in lessons.memories],
        LearnerConfig(learning_rate=pretraining.learning_rate, optimizer="adam"),
        steps=pretraining.steps,
        batch=pretraining.batch,
        generators=[torch.Generator().manual_seed(seed) for seed in lessons.seeds.tolist()],
        memory_of=lessons.memory_of.tolist(),
    )


def _loss(
    network: PopulationNetwork, heads: CandidateHeads | DiscreteHeads, learning: LifeLearningConfig
) -> CandidateTDLoss:
    """The TD error of the action that was taken, whoever took it."""
    if isinstance(heads, DiscreteHeads):
        loss = CandidateTDLoss(CandidateValue(network, heads))
    else:
        loss = WireFittingLoss(CandidateValue(network, heads, propose=True))
    return loss.make_value_estimator(gamma=learning.step.discount)


def _memory(transitions: Transitions) -> TransitionMemory:
    memory = TransitionMemory(len(transitions["next_reward"]))
    memory.load_state(transitions)
    return memory
