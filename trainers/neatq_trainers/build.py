"""All parts of a run, made from its configuration and, to go on, from a saved state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives.utils import ValueEstimators

from neatq_envs.torchrl import ArenaEnv
from neatq_torch.evolution import RtNEAT
from neatq_torch.genome import InnovationLedger, initial_genome
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    CandidateTDLoss,
    CandidateValue,
    EpsilonGreedy,
    Learner,
    LearningGenes,
    NoLearning,
    PartialInheritance,
    QTable,
    ReplayLearner,
    TableLearner,
    TablePolicy,
    TDLearner,
    WireFittingLoss,
)
from neatq_torch.network import PopulationNetwork
from neatq_trainers.config import LearningConfig, RunConfig

EVOLUTION_STREAM, REPLAY_STREAM, GENES_STREAM = 1, 2, 3


class Policy(Protocol):
    """What a run asks of a policy."""

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add every robot's action."""
        ...

    def reset(self, newborn: Tensor) -> None:
        """Let newborns (mask [arenas, robots]) start afresh."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that a checkpoint must keep."""
        ...

    def load_state(self, state: dict[str, Any]) -> None:
        """Go on from `state`."""
        ...


@dataclass(kw_only=True)
class Run:
    """The parts of a run.

    Attributes:
        config: What it was made from.
        env: The worlds.
        policy: Acts for all robots.
        learner: Learns for all robots.
        network: All networks; None if robots learn in tables.
        populations: The genomes of each arena; empty without evolution.
        heritage: Writes a share of what was learnt into the genes; None if all or nothing is.
        genes: How each robot learns and explores; None if all do alike.
        tick: Ticks so far.
    """

    config: RunConfig
    env: ArenaEnv
    policy: Policy
    learner: Learner
    network: PopulationNetwork | None
    populations: list[RtNEAT]
    heritage: PartialInheritance | None = None
    genes: LearningGenes | None = None
    tick: int = 0

    def state(self) -> dict[str, Any]:
        """Everything from which `build` goes on bit for bit; take it between two batches."""
        state = {
            "tick": self.tick,
            "world": self.env.world_state(),
            "policy": self.policy.state(),
            "learner": self.learner.state(),
            "weight": None if self.network is None else self.network.weight,
            "populations": [population.state_dict() for population in self.populations],
        }
        return state | {name: part.state() for name, part in self.optional_parts().items()}

    def optional_parts(self) -> dict[str, PartialInheritance | LearningGenes]:
        """Those that the configuration asks for, by name."""
        parts = {"heritage": self.heritage, "genes": self.genes}
        return {name: part for name, part in parts.items() if part is not None}


def build(config: RunConfig, state: dict[str, Any] | None = None) -> Run:
    """Make a run.

    Args:
        config: What to make.
        state: What `Run.state` gave, to go on from there; None to begin. A run that had no tick
            yet begins, as its worlds are drawn then.
    """
    if state is not None and not state["tick"]:
        state = None
    env = ArenaEnv(config.scenario, arenas=config.arenas, seed=config.seed)
    run = (_table_run if config.learning.rule == "table" else _network_run)(config, env, state)
    if state is not None:
        run.tick = state["tick"]
        run.env.load_world_state(state["world"])
        run.policy.load_state(state["policy"])
        run.learner.load_state(state["learner"])
        for name, part in run.optional_parts().items():
            part.load_state(state[name])
    return run


def _table_run(config: RunConfig, env: ArenaEnv, _: dict[str, Any] | None) -> Run:
    learning = config.learning
    table = QTable(
        config.shape,
        *_action_bounds(env),
        learning_rate=learning.step.learning_rate,
        discount=learning.discount,
    )
    policy = TablePolicy(table, epsilon=learning.epsilon, seeds=_seeds(config))
    return Run(
        config=config,
        env=env,
        policy=policy,
        learner=TableLearner(table),
        network=None,
        populations=[],
    )


def _network_run(config: RunConfig, env: ArenaEnv, state: dict[str, Any] | None) -> Run:
    heads = CandidateHeads(
        config.network.candidates,
        *_action_bounds(env),
        value_range=config.network.value_range or (0.0, 1.0),
    )
    if state is None:
        populations = [_founders(config, env, heads.outputs, seed) for seed in _seeds(config)]
    else:
        saved = state["populations"]
        populations = [RtNEAT.from_state(config.evolution, population) for population in saved]
    network = PopulationNetwork(
        [genome for population in populations for genome in population.genomes],
        shape=config.shape,
        evaluation=config.network.evaluation,
    )
    if state is not None:
        network.load_weights(state["weight"])
    exploration = EpsilonGreedy(
        config.shape,
        seeds=_seeds(config),
        epsilon=config.learning.epsilon,
        max_hold_ticks=config.learning.max_hold_ticks,
    )
    policy = CandidatePolicy(
        network, heads, exploration, double_activation=config.network.double_activation
    )
    share = config.learning.inherited_share
    learner = _learner(config, network, heads)
    return Run(
        config=config,
        env=env,
        policy=policy,
        learner=learner,
        network=network,
        populations=populations,
        heritage=None if share is None else PartialInheritance(share, populations),
        genes=_genes(config, learner, exploration, populations),
    )


def _genes(
    config: RunConfig, learner: Learner, exploration: EpsilonGreedy, populations: list[RtNEAT]
) -> LearningGenes | None:
    if config.learning.genes is None:
        return None
    own = learner.learner if isinstance(learner, ReplayLearner) else learner
    assert isinstance(own, TDLearner)  # the configuration has seen to it
    seeds = [(seed, GENES_STREAM) for seed in _seeds(config)]
    return LearningGenes(config.learning.genes, own, exploration, populations, seeds)


def _learner(config: RunConfig, network: PopulationNetwork, heads: CandidateHeads) -> Learner:
    learning = config.learning
    if learning.rule == "none":
        return NoLearning(network)
    loss = _loss(learning, network, heads)
    learner = TDLearner(network, loss, learning.step)
    if not learning.replay.updates:
        return learner
    return ReplayLearner(
        learner,
        lambda young: _loss(learning, young, heads),  # pyright: ignore[reportArgumentType]
        learning.replay,
        [_replay_seed(seed) for seed in _seeds(config)],
    )


def _replay_seed(seed: int) -> int:
    return int(np.random.SeedSequence([seed, REPLAY_STREAM]).generate_state(1)[0])


def _loss(
    learning: LearningConfig, network: PopulationNetwork, heads: CandidateHeads
) -> CandidateTDLoss:
    wires = learning.rule == "wire_fitting"
    settings: dict[str, Any] = {"separation": learning.separation or 0.0} if wires else {}
    loss = (WireFittingLoss if wires else CandidateTDLoss)(
        CandidateValue(network, heads, propose=wires),
        delay_value=learning.step.target_tau is not None,
        normalize_return=learning.normalize_return,
        bootstrap=learning.bootstrap,
        epsilon_greedy=learning.epsilon,
        **settings,
    )
    if learning.trace_decay and learning.discount:
        # Tick by tick: convolutions give other last bits when other arenas stand beside.
        decay = {"lmbda": learning.trace_decay, "vectorized": False}
        loss.make_value_estimator(ValueEstimators.TDLambda, gamma=learning.discount, **decay)
    else:
        loss.make_value_estimator(ValueEstimators.TD0, gamma=learning.discount)
    return loss


def _founders(config: RunConfig, env: ArenaEnv, outputs: int, seed: int) -> RtNEAT:
    rng = np.random.default_rng([seed, EVOLUTION_STREAM])
    founders = [
        initial_genome(
            len(env.arena.schema.observations),
            outputs,
            rng=rng,
            activation=config.network.activation,
            observation_schema=env.arena.schema.name,
            genome_id=number,
        )
        for number in range(1, config.scenario.robots + 1)
    ]
    ledger = InnovationLedger.for_genomes(founders)
    return RtNEAT(config.evolution, founders, rng, ledger, len(founders) + 1)


def _action_bounds(env: ArenaEnv) -> tuple[list[float], list[float]]:
    low, high = env.arena.schema.action_bounds(env.scenario)
    return low.tolist(), high.tolist()


def _seeds(config: RunConfig) -> range:
    return range(config.seed, config.seed + config.arenas)
