"""Evolution and learning joined: neural networks that evolve, and learn while they live.

>>> import neatq_torch as nq
>>> run = nq.train("gym:CartPole-v1", arm="neat", generations=10)
>>> policy = nq.load_policy(run.folder)

Every name is imported when it is first used, so that `import neatq_torch` costs nothing.
"""

from __future__ import annotations

import importlib
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from neatq_experiments.compare.command import compare as compare
    from neatq_torch.evolution import NEAT as NEAT
    from neatq_torch.evolution import FixedConfig as FixedConfig
    from neatq_torch.evolution import FixedPopulation as FixedPopulation
    from neatq_torch.evolution import NEATConfig as NEATConfig
    from neatq_torch.evolution import Replacement as Replacement
    from neatq_torch.evolution import RtNEAT as RtNEAT
    from neatq_torch.evolution import RtNEATConfig as RtNEATConfig
    from neatq_torch.evolution import register_population as register_population
    from neatq_torch.genome import Genome as Genome
    from neatq_torch.genome import load_genome as load_genome
    from neatq_torch.genome import save_genome as save_genome
    from neatq_torch.kinds import ConfigError as ConfigError
    from neatq_torch.learning import CandidateHeads as CandidateHeads
    from neatq_torch.learning import CandidatePolicy as CandidatePolicy
    from neatq_torch.learning import CandidateTDLoss as CandidateTDLoss
    from neatq_torch.learning import CandidateValue as CandidateValue
    from neatq_torch.learning import DiscreteHeads as DiscreteHeads
    from neatq_torch.learning import EpsilonGreedy as EpsilonGreedy
    from neatq_torch.learning import GenomeModule as GenomeModule
    from neatq_torch.learning import ReplayConfig as ReplayConfig
    from neatq_torch.learning import ReplayLearner as ReplayLearner
    from neatq_torch.learning import StepConfig as StepConfig
    from neatq_torch.learning import TDConfig as TDConfig
    from neatq_torch.learning import TDLearner as TDLearner
    from neatq_torch.learning import TraceConfig as TraceConfig
    from neatq_torch.learning import TraceLearner as TraceLearner
    from neatq_torch.learning import WireFittingLoss as WireFittingLoss
    from neatq_torch.learning import register_learner as register_learner
    from neatq_torch.learning import write_back as write_back
    from neatq_torch.network import GenomeNetwork as GenomeNetwork
    from neatq_torch.network import PopulationNetwork as PopulationNetwork
    from neatq_trainers.arms import preset as preset
    from neatq_trainers.callbacks import Callback as Callback
    from neatq_trainers.folder import load_run as load_run
    from neatq_trainers.genome_figure import draw_genome as draw_genome
    from neatq_trainers.policy import load_policy as load_policy
    from neatq_trainers.train import resume as resume
    from neatq_trainers.train import train as train
    from neatq_trainers.worlds import register_world as register_world

_HOMES = {
    "neatq_torch.evolution": "FixedConfig FixedPopulation NEAT NEATConfig Replacement RtNEAT "
    "RtNEATConfig register_population",
    "neatq_torch.genome": "Genome load_genome save_genome",
    "neatq_torch.kinds": "ConfigError",
    "neatq_torch.learning": "CandidateHeads CandidatePolicy CandidateTDLoss CandidateValue "
    "DiscreteHeads EpsilonGreedy GenomeModule ReplayConfig ReplayLearner StepConfig TDConfig "
    "TDLearner TraceConfig TraceLearner WireFittingLoss register_learner write_back",
    "neatq_torch.network": "GenomeNetwork PopulationNetwork",
    "neatq_trainers.arms": "preset",
    "neatq_trainers.callbacks": "Callback",
    "neatq_experiments.compare.command": "compare",
    "neatq_trainers.folder": "load_run",
    "neatq_trainers.genome_figure": "draw_genome",
    "neatq_trainers.policy": "load_policy",
    "neatq_trainers.train": "resume train",
    "neatq_trainers.worlds": "register_world",
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names.split()}
__all__ = sorted(_HOME_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *_HOME_OF]


def _refuse_mixture() -> None:
    """Raise ImportError if another package of the project comes from another copy of it."""
    ours = Path(__file__).resolve().parents[1]
    for folder in ("envs", "trainers", "experiments"):
        name = f"neatq_{folder}"
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            continue
        theirs = Path(spec.origin).resolve().parents[1]
        if theirs not in (ours, ours / folder):
            raise ImportError(
                f"neatq_torch comes from {ours}, but {name} from {theirs}: two copies of the "
                "project are mixed. Leave the folder of the one, or install the other "
                "(pip install --editable . in its folder)"
            )


_refuse_mixture()
