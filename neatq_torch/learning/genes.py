"""How fast a robot learns, how often it explores and how far it looks ahead, as genes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from neatq_torch.evolution import Population, Replacement, generator_from
from neatq_torch.learning.exploration import EpsilonGreedy
from neatq_torch.learning.learner import Saved, TDLearner
from neatq_torch.learning.objectives import discount_of

GENE_RANGE = 10.0
"""How many times more or less than at the start a gene may become."""


class LearningGenes:
    """Learning rate, epsilon and discount of every robot, inherited and mutated like weights.

    After OMPAC (Elfwing, Uchibe & Doya 2018), which evolves settings of learning in a population
    that learns; here evolution selects. A newborn has the genes of its fitter parent, multiplied by
    exp(power * N(0, 1)) each; the gene of the discount gamma is 1 - gamma. They stay within a tenth
    and ten times what founders are mutated from, and epsilon and 1 - gamma within 1.

    Whoever explores earns less while it does: if that counted, epsilon would only ever fall. So
    the population should be told which ticks count (`record`).

    What newborns are taught before their first tick (`ReplayConfig.newborn_updates`) has the
    configured learning rate.

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
        populations: Sequence[Population],
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
        self.least = start / GENE_RANGE
        self.most = np.minimum(start * GENE_RANGE, [np.inf, 1.0, 1.0])
        self._learner, self._exploration = learner, exploration
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self._genome_id = np.array(
            [[genome.genome_id for genome in population.genomes] for population in populations]
        )
        founders = np.broadcast_to(start, (self._genome_id.shape[1], len(start)))
        pairs = zip(self._genome_id, self.generators, strict=True)
        self.values = np.stack([self._mutated(founders, rng) for _, rng in pairs])
        self.express()

    def _mutated(self, genes: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Mutated genes [..., 3]."""
        moved = genes * np.exp(self.power * rng.standard_normal(genes.shape))
        return moved.clip(self.least, self.most)

    def inherit(self, arena: int, replacements: Sequence[Replacement]) -> None:
        """Give newborns their genes; call it for all replacements, in their order.

        A parent may have been replaced in the same call, or been born in it. A genome that is its
        own parent lives on, and keeps its genes.
        """
        values, ids = self.values[arena], self._genome_id[arena]
        known = dict(zip(ids.tolist(), values.copy(), strict=True))
        for slot, genome, _, (parent, *_) in replacements:
            genes = known[parent]
            if parent != genome.genome_id:
                genes = self._mutated(genes, self.generators[arena])
            values[slot], ids[slot] = genes, genome.genome_id
            known[genome.genome_id] = genes

    def express(self) -> None:
        """Let all robots learn and explore as their genes say."""
        values = torch.from_numpy(self.values / [self._learner.square, 1.0, 1.0])
        learning_rate, epsilon, impatience = values.float().unbind(-1)
        self._learner.learning_rate = learning_rate.flatten().to(self._learner.learning_rate)
        self._exploration.epsilon = epsilon.to(self._exploration.epsilon)
        self._learner.loss.discount = (1 - impatience).to(self._learner.learning_rate)

    def state_dict(self) -> Saved:
        """Genes and the state of all chance."""
        states = [generator.bit_generator.state for generator in self.generators]
        return {"values": self.values.copy(), "generators": states}

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`, with the populations as they were then."""
        self.values = np.array(state["values"], dtype=np.float64)
        self.generators = [generator_from(one) for one in state["generators"]]
        self.express()
