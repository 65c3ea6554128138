"""By whom a newborn is taught, as a gene that evolution selects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neatq_torch.evolution import Replacement, RtNEAT, generator_from
from neatq_torch.learning.critic_learner import CriticLearner, Teacher
from neatq_torch.learning.learner import Saved


class Teachers:
    """The teacher of each network, inherited from its fitter parent, now and then drawn anew.

    An explorer's pupil passes on imitation: its offspring shall keep what it found, and the
    explorer would lead them away again. But offspring of a pioneer, whose life was not worth more
    than those of others, learn from the explorer: they shall find more.

    What a newborn learns from is so chosen by the fitness of whole lives, as an evolved evaluation
    is (Ackley & Littman 1991): where a reward leads to the goal the critic's pupils have offspring,
    where it deceives the explorer's find the way and the model's follow. Learning from the fittest
    is the student-teacher form of social learning (compare Tansey, Feasley & Miikkulainen 2012,
    where any agent that succeeds is a teacher). The gene stands beside the genome, not in it: a
    champion does not carry it.

    Args:
        learner: Its `teachers` and `models` are set; who can teach and how often a newborn's
            teacher is drawn anew, each as likely, its configuration says.
        populations: The population of each arena.
        seeds: One seed, or sequence of them, for the chance of each arena.

    Attributes:
        values: The `Teacher` of each network, int64 [arenas, slots]; founders had none, and count
            as the critic's.
        models: Slots of whom the model's pupils imitate, -1 for nobody, int64 [arenas].
    """

    def __init__(
        self,
        learner: CriticLearner,
        populations: Sequence[RtNEAT],
        seeds: Sequence[int | Sequence[int]],
    ) -> None:
        self._learner, self._populations = learner, populations
        self.mutation = learner.config.teacher_mutation or 0.0
        self.choices = [*Teacher]
        if learner.config.novelty is None:
            self.choices.remove(Teacher.EXPLORER)
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self._genome_id = np.array(
            [[genome.genome_id for genome in population.genomes] for population in populations]
        )
        self.values = np.zeros_like(self._genome_id)
        self.models = np.full(len(populations), -1)

    def inherit(self, arena: int, replacements: Sequence[Replacement]) -> None:
        """Give newborns their teachers; call it for all replacements, in their order."""
        values, ids, rng = self.values[arena], self._genome_id[arena], self.generators[arena]
        known = dict(zip(ids.tolist(), values.tolist(), strict=True))
        pioneering = self._populations[arena].pioneering
        for slot, genome, _, (parent, *_) in replacements:
            teacher = known[parent]
            if rng.random() < self.mutation:
                teacher = self.choices[rng.integers(len(self.choices))]
            elif genome.genome_id in pioneering and Teacher.EXPLORER in self.choices:
                teacher = Teacher.EXPLORER
            elif teacher == Teacher.EXPLORER:
                teacher = Teacher.MODEL
            known[genome.genome_id] = values[slot] = int(teacher)
            ids[slot] = genome.genome_id
        champion = self._populations[arena].champion
        self.models[arena] = -1 if champion is None else champion

    def express(self) -> None:
        """Let newborns be taught by whom their genes say."""
        self._learner.teachers, self._learner.models = self.values.copy(), self.models.copy()

    def state_dict(self) -> Saved:
        """Teachers, models and the state of all chance."""
        states = [generator.bit_generator.state for generator in self.generators]
        return {"values": self.values.copy(), "models": self.models.copy(), "generators": states}

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`, with the populations as they were then."""
        self.values = np.array(state["values"], np.int64)
        self.models = np.array(state["models"], np.int64)
        self.generators = [generator_from(one) for one in state["generators"]]
        self.express()
