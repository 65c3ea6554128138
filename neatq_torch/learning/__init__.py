"""Acting and temporal-difference learning, as TorchRL parts."""

from neatq_torch.learning.candidates import CandidatePolicy, CandidateValue
from neatq_torch.learning.critic_learner import CriticLearner, Teacher
from neatq_torch.learning.exploration import ActionNoise, EpsilonGreedy
from neatq_torch.learning.heads import CandidateHeads, DiscreteHeads, Heads
from neatq_torch.learning.learner import (
    Learner,
    NoLearningConfig,
    StepConfig,
    TDConfig,
    TDLearner,
    write_back,
)
from neatq_torch.learning.module import GenomeModule
from neatq_torch.learning.normalization import RunningNormalization
from neatq_torch.learning.objectives import CandidateTDLoss
from neatq_torch.learning.registry import LearnerParts, learner_kinds, register_learner
from neatq_torch.learning.replay import ReplayConfig, ReplayLearner
from neatq_torch.learning.shared_critic import CriticConfig
from neatq_torch.learning.table import TableConfig, TableLearner
from neatq_torch.learning.teachers import Teachers
from neatq_torch.learning.traces import TraceConfig, TraceLearner
from neatq_torch.learning.wire_fitting import WireFittingLoss

__all__ = [
    "ActionNoise",
    "CandidateHeads",
    "CandidatePolicy",
    "CandidateTDLoss",
    "CandidateValue",
    "CriticConfig",
    "CriticLearner",
    "DiscreteHeads",
    "EpsilonGreedy",
    "GenomeModule",
    "Heads",
    "Learner",
    "LearnerParts",
    "NoLearningConfig",
    "ReplayConfig",
    "ReplayLearner",
    "RunningNormalization",
    "StepConfig",
    "TDConfig",
    "TDLearner",
    "TableConfig",
    "TableLearner",
    "Teacher",
    "Teachers",
    "TraceConfig",
    "TraceLearner",
    "WireFittingLoss",
    "learner_kinds",
    "register_learner",
    "write_back",
]
