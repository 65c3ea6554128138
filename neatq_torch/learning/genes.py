"""How fast a robot learns, how often it explores and how far it looks ahead, as genes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from neatq_torch.evolution import Replacement, RtNEAT
from neatq_torch.evolution.chance import generator_from
from neatq_torch.learning.exploration import EpsilonGreedy
from neatq_torch.learning.learner import State, TDLearner
from neatq_torch.learning.objectives import discount_of

WIDEST = 10.0
"""How many times more or less than at the start a gene may become."""


class LearningGenes:
    """Learning rate, epsilon and discount of every robot, inherited and mutated like weights.

    After OMPAC (Elfwing, Uchibe & Doya 2018), which evolves settings of learning in a population
    that learns; here rtNEAT selects. A newborn has the genes of its fitter parent, multiplied by
    exp(power * N(0, 1)) each; the gene of the discount gamma is 1 - gamma. They stay within a tenth
    and ten times what founders are mutated from, and epsilon and 1 - gamma within 1.

    Whoever explores earns less while it does: if that counted, epsilon would only ever fall. So
    `RtNEAT.record` should be told which ticks count.

    Lessons before the first tick (`ReplayConfig.newborn_updates`) have the configured learning
    rate.

    Args:
        power: Standard deviation of a mutation of the logarithm of a gene.
        learner: Its learning rates and the discounts of its loss are set; its configured ones are
            what founders start from.
        exploration: Its epsilons are set; those it has are what founders start from.
        populations: The population of each arena.
        seeds: One seed, or sequence of them, for the chance of each arena.

    Attributes:
        values: Learning rate, epsilon and 1 - gamma of each robot, float64 [arenas, robots, 3].

    Raises:
        ValueError: If the power is out of range, or founders would start from 0.
    """

    def __init__(
        self,
        power: float,
        learner: TDLearner,
        exploration: EpsilonGreedy,
        populations: Sequence[RtNEAT],
        seeds: Sequence[int | Sequence[int]],
    ) -> None:
        epsilon = float(exploration.epsilon.flatten()[0])
        start = np.array([learner.config.learning_rate, epsilon, 1 - discount_of(learner.loss)])
        if not 0 < power < np.inf:
            raise ValueError(f"power: expected a finite number above 0, got {power}")
        if not start.all():
            raise ValueError(
                "expected a learning rate and an epsilon above 0 and a discount below 1 for "
                f"founders to start from, got {start[0]}, {epsilon} and {1 - start[2]}: what is 0 "
                "cannot mutate"
            )
        self.power = power
        self.least, self.most = start / WIDEST, np.minimum(start * WIDEST, [np.inf, 1.0, 1.0])
        self._learner, self._exploration = learner, exploration
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self._genome_id = np.array(
            [[genome.genome_id for genome in population.genomes] for population in populations]
        )
        self.values = np.stack(
            [
                self._mutated(np.broadcast_to(start, (len(ids), len(start))), rng)
                for ids, rng in zip(self._genome_id, self.generators, strict=True)
            ]
        )
        self.express()

    def _mutated(self, genes: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Mutated genes [..., 3]."""
        moved = genes * np.exp(self.power * rng.standard_normal(genes.shape))
        return moved.clip(self.least, self.most)

    def inherit(self, arena: int, replacement: Replacement) -> None:
        """Give a newborn its genes; call it for all replacements, in their order."""
        (parent,) = np.flatnonzero(self._genome_id[arena] == replacement.parents[0])
        genes = self._mutated(self.values[arena, parent], self.generators[arena])
        self.values[arena, replacement.slot] = genes
        self._genome_id[arena, replacement.slot] = replacement.genome.genome_id

    def express(self) -> None:
        """Let all robots learn and explore as their genes say."""
        learning_rate, epsilon, impatience = torch.from_numpy(self.values).float().unbind(-1)
        self._learner.learning_rate = learning_rate.flatten().to(self._learner.learning_rate)
        self._exploration.epsilon = epsilon.to(self._exploration.epsilon)
        self._learner.loss.discount = (1 - impatience).to(self._learner.learning_rate)

    def state(self) -> State:
        """Genes and the state of all chance."""
        states = [generator.bit_generator.state for generator in self.generators]
        return {"values": self.values.copy(), "generators": states}

    def load_state(self, state: State) -> None:
        """Go on from `state`, with the populations as they were then."""
        self.values = np.array(state["values"], dtype=np.float64)
        self.generators = [generator_from(one) for one in state["generators"]]
        self.express()
