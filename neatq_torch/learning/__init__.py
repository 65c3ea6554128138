"""Acting and temporal-difference learning, as TorchRL parts."""

from neatq_torch.learning.candidates import CandidatePolicy, CandidateValue
from neatq_torch.learning.exploration import EpsilonGreedy
from neatq_torch.learning.genes import LearningGenes
from neatq_torch.learning.heads import CandidateHeads, DiscreteHeads, Heads
from neatq_torch.learning.inheritance import Heirs, Inheritance, PartialInheritance, write_back
from neatq_torch.learning.learner import Learner, LearnerConfig, NoLearning, TDLearner
from neatq_torch.learning.memory import TransitionMemory, over_horizon, summed_up
from neatq_torch.learning.objectives import Bootstrap, CandidateTDLoss
from neatq_torch.learning.replay import PRETRAINING, pretrain
from neatq_torch.learning.shared_replay import ReplayConfig, ReplayLearner
from neatq_torch.learning.table import QTable, TableLearner, TablePolicy
from neatq_torch.learning.traces import TraceConfig, TraceLearner
from neatq_torch.learning.wire_fitting import WireFittingLoss, closeness, wire_fit

__all__ = [
    "PRETRAINING",
    "Bootstrap",
    "CandidateHeads",
    "CandidatePolicy",
    "CandidateTDLoss",
    "CandidateValue",
    "DiscreteHeads",
    "EpsilonGreedy",
    "Heads",
    "Heirs",
    "Inheritance",
    "Learner",
    "LearnerConfig",
    "LearningGenes",
    "NoLearning",
    "PartialInheritance",
    "QTable",
    "ReplayConfig",
    "ReplayLearner",
    "TDLearner",
    "TableLearner",
    "TablePolicy",
    "TraceConfig",
    "TraceLearner",
    "TransitionMemory",
    "WireFittingLoss",
    "closeness",
    "over_horizon",
    "pretrain",
    "summed_up",
    "wire_fit",
    "write_back",
]
