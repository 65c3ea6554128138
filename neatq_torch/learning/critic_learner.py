"""Networks that are taught by the critic that all networks of their arena share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.genome import Genome
from neatq_torch.kinds import ConfigError
from neatq_torch.learning import compiled_critic
from neatq_torch.learning.heads import CandidateHeads, Heads
from neatq_torch.learning.learner import Adams, Learner, Saved, adam, take_over
from neatq_torch.learning.memory import over_horizon
from neatq_torch.learning.normalization import RunningNormalization
from neatq_torch.learning.novelty import ExplorerReward
from neatq_torch.learning.shared_critic import CriticConfig, SharedCritic
from neatq_torch.network import PopulationNetwork, fitted


class Teacher(IntEnum):
    """By whom a newborn is taught before its first step.

    Attributes:
        CRITIC: What the rewards are worth.
        EXPLORER: What the rewards and places where few were lately are worth together.
        MODEL: What the fittest of the arena does, whatever it is worth (social learning).
    """

    CRITIC = 0
    EXPLORER = 1
    MODEL = 2


class CriticLearner(Learner):
    """Trains networks by the gradient of one critic that all networks of their arena share.

    Evolution with a critic that learns from everybody's steps, after ERL (Khadka & Tumer 2018),
    CEM-RL (Pourchot & Sigaud 2019) and PGA-MAP-Elites (Nilsson & Cully 2021). Newborns learn before
    their first step, which costs none; those alive learn during their lives. Critic and memory end
    with the run: what acts, breeds and is exported are the networks.

    With `teacher_mutation` some newborns learn from an explorer's critic, or from what the fittest
    of their arena did, instead: see `Teachers`, which says who.

    Recurrent state counts as empty in what is learnt.

    Args:
        network: The networks, of shape (arenas, slots).
        heads: How their outputs are read; in a box of actions those of one candidate.
        config: Sizes and rates.
        seeds: One for each arena.
        normalization: Of what networks and critic read; None: that is what the world gives.

    Attributes:
        teachers: The `Teacher` of each network, int64 [arenas, slots].
        models: Slots of whom the model's pupils imitate, -1 for nobody, int64 [arenas].

    Raises:
        ConfigError: If there is more than one candidate.

    Example:
        >>> heads = CandidateHeads(1, low=[-1.0], high=[1.0])
        >>> learner = CriticLearner(network, heads, CriticConfig(), seeds=[0])
    """

    def __init__(
        self,
        network: PopulationNetwork,
        heads: Heads,
        config: CriticConfig,
        seeds: Sequence[int],
        normalization: RunningNormalization | None = None,
    ) -> None:
        if isinstance(heads, CandidateHeads) and heads.candidates != 1:
            raise ConfigError(
                f"network.candidates: expected 1, got {heads.candidates}; where a critic judges, a "
                "network has no Q-values of its own to choose by"
            )
        self.network, self.config, self.normalization = network, config, normalization
        sizes, weight = (network.inputs, network.shape[1]), network.weight
        self.critics = [SharedCritic(config, heads, *sizes, seed) for seed in seeds]
        self.explorers: list[SharedCritic] = []
        if config.teacher_mutation is not None and config.novelty is not None:
            self.explorers = [
                SharedCritic(config, heads, *sizes, seed + 1, beside=critic)
                for seed, critic in zip(seeds, self.critics, strict=True)
            ]
        self.new_places = [ExplorerReward(config.novelty or 0) for _ in self.explorers]
        self.teachers = np.zeros(network.shape, np.int64)
        self.models = np.full(len(seeds), -1)
        self.steps = weight.new_zeros(len(weight))
        self.first_moment = torch.zeros_like(weight, requires_grad=False)
        self.second_moment = torch.zeros_like(weight, requires_grad=False)

    def update(self, batch: TensorDictBase) -> Tensor:
        """Remember a batch [arenas, slots, ticks], and learn as much as is due.

        Returns:
            Mean squared TD error of the critic in its last step [arenas, slots]; 0 without one.
        """
        seen = self._with_new_places(batch) if self.explorers else batch
        ahead = over_horizon(seen, self.config.horizon, self.config.discount)
        for arena, critic in enumerate(self.critics):
            critic.remember(ahead[arena], batch[arena])
        for arena, explorer in enumerate(self.explorers):
            explorer.watch(batch[arena], seen.get(("next", "reward"))[arena, ..., 1:])
        errors: dict[int, Tensor] = {}
        with self._on_device(self.network):
            while soon := {arena: n for arena, one in enumerate(self.critics) if (n := one.soon)}:
                errors |= self._learn(soon)
        error = torch.zeros(self.network.shape)
        for arena, last in errors.items():  # only here the host waits for the device
            error[arena] = last
        return error

    def _with_new_places(self, batch: TensorDictBase) -> TensorDictBase:
        """The batch with explorers' rewards in a second column."""
        own = torch.stack([one.of(batch[arena]) for arena, one in enumerate(self.new_places)])
        both = torch.cat([batch.get(("next", "reward")).cpu(), own], -1)
        following = batch.get("next").clone(recurse=False).set("reward", both)
        return batch.clone(recurse=False).set("next", following)

    def _learn(self, soon: dict[int, int]) -> dict[int, Tensor]:
        """So many steps of the critics of some arenas, and one of their networks where it is due.

        Returns the error of each critic.
        """
        size = self.config.size
        drawn = {arena: self._drawn(arena, steps * size) for arena, steps in soon.items()}
        outputs = self._by_turns({arena: rows["next_observation"] for arena, rows in drawn.items()})
        errors = {
            arena: self.critics[arena].learn(rows, outputs[arena]) for arena, rows in drawn.items()
        }
        if self.explorers:
            for arena, rows in drawn.items():
                self.explorers[arena].learn(rows, outputs[arena])
        every, slots = self.config.every, self.network.shape[1]
        for arena in soon:
            if every and self.critics[arena].steps % every == 0:
                own = slice(arena * slots, (arena + 1) * slots)
                adams = self.steps[own], self.first_moment[own], self.second_moment[own]
                self._teach(self.network, arena, arena, adams, 1)
        return errors

    def _by_turns(self, observations: dict[int, Tensor]) -> dict[int, Tensor]:
        """Outputs [rows, outputs] for observations of some arenas [rows, inputs].

        Of one network for each row: all those of the arena take turns, as rows are drawn anew.
        """
        arenas, slots = self.network.shape
        turns = -(-max(map(len, observations.values())) // slots)
        some = next(iter(observations.values()))
        asked = some.new_zeros(arenas, turns * slots, some.shape[-1])
        for arena, rows in observations.items():
            asked[arena, : len(rows)] = rows
        with torch.no_grad():
            asked = asked.view(arenas, turns, slots, -1).transpose(1, 2)
            outputs = self.network.step(asked)[0].transpose(1, 2).flatten(1, 2)
        return {arena: outputs[arena, : len(rows)] for arena, rows in observations.items()}

    def _drawn(self, arena: int, size: int, *names: str, owner: int | None = None) -> Saved:
        """Columns of transitions of an arena, with observations as they are read."""
        critic = self.critics[arena]
        rows = critic.memory.draw(size, critic.generator, *names, owner=owner)
        if self.normalization is not None:
            for name in rows.keys() & {"observation", "next_observation"}:
                rows[name] = self.normalization(rows[name], arena)
        return rows

    def reset(self, newborn: Tensor) -> None:
        """Teach newborns (mask [arenas, slots]), and clear what belonged to those before."""
        weight, born = self.network.weight, newborn.reshape(-1)
        self.steps.masked_fill_(born, 0)
        for name in ("first_moment", "second_moment"):
            moment = fitted(getattr(self, name), weight)
            setattr(self, name, moment.masked_fill(born.unsqueeze(1), 0))
        for arena, critic in enumerate(self.critics):
            for one in (critic, *self.explorers[arena : arena + 1]):
                one.returns = one.returns.masked_fill(newborn[arena], 0)
            for teacher in Teacher if critic.steps and self.config.newborn_updates else ():
                taught = newborn[arena].numpy() & (self.teachers[arena] == teacher)
                if taught.any():
                    self._teach_newborns(arena, np.flatnonzero(taught).tolist(), teacher)

    def _teach_newborns(self, arena: int, slots: Sequence[int], teacher: Teacher) -> None:
        """Let newborns learn before their first step."""
        first = arena * self.network.shape[1]
        genomes = [self.network.genome(first + slot) for slot in slots]
        shape = (1, len(genomes))
        young = PopulationNetwork(genomes, shape=shape, evaluation=self.network.evaluation)
        with self._on_device(young):
            weight = young.weight.detach()
            first_moment, second_moment = weight.new_zeros(2, *weight.shape)
            adams = weight.new_zeros(len(weight)), first_moment, second_moment
            self._teach(young, 0, arena, adams, self.config.newborn_updates, teacher)
        for slot, genome in zip(slots, young.genomes(), strict=True):
            self.network.replace(first + slot, genome)

    def _teach(
        self,
        network: PopulationNetwork,
        row: int,
        arena: int,
        adams: Adams,
        updates: int,
        teacher: Teacher = Teacher.CRITIC,
    ) -> None:
        """Let the networks of a row learn from a teacher of an arena, by so many minibatches.

        From the critic in place of a model of which nothing is remembered.
        """
        critic, slots, rate = self.critics[arena], network.shape[1], self.config.learning_rate
        own, size = slice(row * slots, (row + 1) * slots), self.config.policy_size
        if teacher is Teacher.EXPLORER:
            critic = self.explorers[arena]
        model = self._model(arena) if teacher is Teacher.MODEL else None
        owner = None if model is None else model.genome_id
        drawn = self._drawn(arena, updates * size, "observation", owner=owner)["observation"]
        seen = drawn.view(updates, size, -1)
        wanted = None if model is None else self._outputs(model, drawn).view(updates, size, -1)
        if compiled_critic.accepts(network.weight, seen):
            compiled_critic.teach(network, own, adams, seen, critic.critic, rate, wanted)
            return
        for number, observation in enumerate(seen):
            outputs = network.step(observation.expand(*network.shape, -1, -1))[0]
            lesson = torch.zeros_like(outputs)
            if wanted is None:
                lesson[row] = critic.lesson(observation, outputs[row])
            else:
                lesson[row] = (outputs[row] - wanted[number]) * (2 / size)
            (gradient,) = torch.autograd.grad(outputs, network.weight, lesson)
            with torch.no_grad():
                weight = network.weight[own]
                take_over(weight, weight - rate * adam(gradient[own], *adams))

    def _model(self, arena: int) -> Genome | None:
        """Whom the model's pupils of an arena imitate; None if nothing it did is remembered."""
        slot = int(self.models[arena])
        if slot < 0:
            return None
        genome = self.network.genome(arena * self.network.shape[1] + slot)
        return genome if self.critics[arena].memory.knows(genome.genome_id) else None

    def _outputs(self, genome: Genome, observations: Tensor) -> Tensor:
        """What a genome's network says to observations [rows, inputs], cut off at 0 and 1."""
        network = PopulationNetwork([genome], shape=(1, 1), evaluation=self.network.evaluation)
        network.to(observations.device)
        with torch.no_grad():
            return network.step(observations[None, None])[0][0, 0].clamp(0, 1)

    @contextmanager
    def _on_device(self, network: PopulationNetwork) -> Iterator[None]:
        """Have networks where the critics are; they act where they were before."""
        before, there = network.weight.device, self.critics[0].memory.device
        if there == before:
            yield
            return
        names = ("steps", "first_moment", "second_moment")
        for device in (there, before):
            network.to(device)
            for name in names:
                setattr(self, name, getattr(self, name).to(device))
            if device == there:
                yield

    def state_dict(self) -> Saved:
        """Critics, memories, moments and the state of all chance."""
        state = {
            "critics": [critic.state_dict() for critic in self.critics],
            "steps": self.steps,
            "first_moment": self.first_moment,
            "second_moment": self.second_moment,
        }
        if self.explorers:
            state["explorers"] = [critic.state_dict() for critic in self.explorers]
            state["new_places"] = [one.state_dict() for one in self.new_places]
        return state

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        for critic, saved in zip(self.critics, state["critics"], strict=True):
            critic.load_state_dict(saved)
        for name in ("explorers", "new_places") if self.explorers else ():
            for own, saved in zip(getattr(self, name), state[name], strict=True):
                own.load_state_dict(saved)
        for name in ("steps", "first_moment", "second_moment"):
            own = getattr(self, name)
            own.copy_(fitted(state[name], own) if own.ndim > 1 else torch.as_tensor(state[name]))
