"""The lives of genomes: act, learn, and count what it was worth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from neatq_envs.gymnasium_rows import make_rows
from neatq_envs.gymnasium_task import Interface
from neatq_envs.torchrl_rows import LIVING, GymnasiumRows
from neatq_torch.genome import Genome, unpack_genomes
from neatq_torch.learning import (
    CandidateHeads,
    CandidatePolicy,
    DiscreteHeads,
    EpsilonGreedy,
    TDLearner,
    TraceLearner,
)
from neatq_torch.network import PopulationNetwork
from neatq_trainers.generational.config import GenerationalConfig
from neatq_trainers.generational.learners import learning_rate, make_learner, pretrain_newborns
from neatq_trainers.generational.purposes import RECORDING
from neatq_trainers.generational.recording import Lessons, Recorder, Transitions
from neatq_trainers.generational.scout import Surroundings

NOBODY = -1
"""The genome id of transitions that nobody learns from."""


class Lives(NamedTuple):
    """What genomes live through, and, if they explore, with which chance.

    Attributes:
        genomes: As `pack_genomes` packs them.
        seeds: Int64 [lives, episodes], of the starts of their episodes.
        exploration: Seeds of their exploration, int64 [lives]; None: no exploration, no learning.
        lessons: What they learn before; None: nothing.
    """

    genomes: dict[str, Any]
    seeds: np.ndarray
    exploration: np.ndarray | None
    lessons: Lessons | None = None


class Outcome(NamedTuple):
    """What came of lives.

    Attributes:
        returns: Float64 [lives, episodes].
        steps: Int64 [lives].
        td_error: Mean squared TD error, float64 [lives]; NaN without learning.
        weights: Of the links of each genome at the end of its life, float32 [links].
        transitions: What each life leaves to the next generation; empty if nothing is asked for.
    """

    returns: np.ndarray
    steps: np.ndarray
    td_error: np.ndarray
    weights: list[np.ndarray]
    transitions: list[Transitions]


def make_heads(
    config: GenerationalConfig, interface: Interface, value_range: tuple[float, float]
) -> CandidateHeads | DiscreteHeads:
    """How the outputs of a network are read in an environment.

    Without learning outputs rank actions and are no values, so they keep their own range.
    """
    learning = config.learning
    chosen = (0.0, 1.0) if learning.rule == "none" else learning.value_range or value_range
    if interface.choices is not None:
        return DiscreteHeads(interface.choices, value_range=chosen)
    return CandidateHeads(config.network.candidates, *interface.bounds, value_range=chosen)


class LifeWorker:
    """Lets genomes live in environments of its own.

    Args:
        config: The run.
        surroundings: What random play has shown.
    """

    def __init__(self, config: GenerationalConfig, surroundings: Surroundings) -> None:
        self._config, self._scaling = config, surroundings.scaling
        self._rows, self.interface = make_rows(config.environment, renewed=surroundings.renewed)
        self.heads = make_heads(config, self.interface, surroundings.value_range)

    def live(self, lives: Lives) -> Outcome:
        """Let genomes live, all side by side; no life depends on another.

        Nor does an episode on the one before, where nothing is learnt and nothing left to chance:
        then they run side by side, too.
        """
        genomes, learning = unpack_genomes(lives.genomes), self._config.learning
        if lives.exploration is not None and (learning.rule != "none" or learning.epsilon):
            return self._live(genomes, lives.seeds, lives.exploration, lives.lessons)
        shape = lives.seeds.shape
        repeated = [genome for genome in genomes for _ in range(shape[1])]
        apart = self._live(repeated, lives.seeds.reshape(-1, 1), None)
        return Outcome(
            apart.returns.reshape(shape),
            apart.steps.reshape(shape).sum(1),
            apart.td_error[:: shape[1]],
            apart.weights[:: shape[1]],
            apart.transitions,
        )

    def _live(
        self,
        genomes: Sequence[Genome],
        seeds: np.ndarray,
        exploration: np.ndarray | None,
        lessons: Lessons | None = None,
    ) -> Outcome:
        config = self._config
        shape = (len(genomes), 1)  # each has seeds of its own, so each is an arena of one row
        network = PopulationNetwork(genomes, shape=shape, evaluation=config.network.evaluation)
        env = GymnasiumRows(
            self._rows,
            self.interface,
            self._scaling,
            shape=shape,
            seeds=seeds,
            name=config.environment.id,
            label=lambda row: f"genome {genomes[row].genome_id}",
        )
        learns = exploration is not None and config.learning.rule != "none"
        policy = CandidatePolicy(network, self.heads, self._exploration(shape, exploration))
        if lessons is not None:
            pretrain_newborns(network, self.heads, config.learning, config.pretraining, lessons)
        learner = make_learner(network, self.heads, config.learning) if learns else None
        recorder = self._recorder(exploration)
        chance = ExplorationType.DETERMINISTIC if exploration is None else ExplorationType.RANDOM
        with set_exploration_type(chance):
            error = self._run(env, policy, learner, recorder)
        steps, weights = env.episodes.steps, list(network.link_weights())
        left = [] if recorder is None else recorder.transitions()
        return Outcome(env.episodes.returns, steps, error / steps, weights, left)

    def _run(
        self,
        env: GymnasiumRows,
        policy: CandidatePolicy,
        learner: TraceLearner | TDLearner | None,
        recorder: Recorder | None,
    ) -> np.ndarray:
        """Until all rows are idle; returns the sum of squared TD errors of each, float64 [rows]."""
        total = np.full(env.batch_size[0], np.nan if learner is None else 0.0)
        now = env.reset()
        while env.episodes.living.any():
            with torch.no_grad():  # act
                lived, now = env.step_and_maybe_reset(policy(now))
            if recorder is not None:
                recorder.add(lived)
            if learner is not None:  # learn
                total = total + learner.update(own_transitions(lived))[:, 0].double().numpy()
            ended = lived.get(("next", "done")).squeeze(-1)
            if ended.any():
                policy.reset(ended)  # an episode remembers nothing of the one before
                if learner is not None and self._config.learning.anneal:
                    learner.learning_rate = self._annealed(env)
        return total

    def _annealed(self, env: GymnasiumRows) -> Tensor:
        """The learning rate of each row: the share of its episodes that are still to come."""
        done = torch.from_numpy(env.episodes.episode / env.episodes.seeds.shape[1])
        return (learning_rate(self.heads, self._config.learning) * (1 - done)).float()

    def _recorder(self, seeds: np.ndarray | None) -> Recorder | None:
        pretraining = self._config.pretraining
        if seeds is None or not pretraining.steps:
            return None
        generators = [np.random.default_rng([seed, RECORDING]) for seed in seeds.tolist()]
        return Recorder(pretraining.transitions // self._config.population, generators)

    def _exploration(self, shape: tuple[int, int], seeds: np.ndarray | None) -> EpsilonGreedy:
        learning = self._config.learning
        return EpsilonGreedy(
            shape,
            seeds=[0] * shape[0] if seeds is None else seeds.tolist(),
            epsilon=0.0 if seeds is None else learning.epsilon,
            max_hold_ticks=learning.max_hold_steps,
        )


def own_transitions(lived: TensorDictBase) -> TensorDictBase:
    """A batch [rows, 1, 1] of one step, in which that of idle rows is nobody's."""
    batch = lived.unsqueeze(-1)
    living, genome_id = batch.get(LIVING), batch.get("genome_id")
    return batch.set("genome_id", genome_id.masked_fill(~living, NOBODY))
