"""One critic for a whole population: it learns from everybody's steps, and teaches everybody."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.kinds import ConfigError, check_fields
from neatq_torch.learning.critic import TwinCritic
from neatq_torch.learning.heads import CandidateHeads, Heads
from neatq_torch.learning.learner import Inheritance, Learner, Saved, adam, take_over
from neatq_torch.learning.memory import TransitionMemory, over_horizon
from neatq_torch.learning.normalization import RunningNormalization
from neatq_torch.network import PopulationNetwork, fitted

SMOOTHING_LIMIT = 0.5
"""Noise on the actions of targets is cut off here, in halves of what is allowed."""
_LEAST_DEVIATION = 1e-6


@dataclass(frozen=True, kw_only=True)
class CriticConfig:
    """A critic shared by all networks of an arena, learnt from a memory of what all of them did.

    Attributes:
        learning_rate: Of the networks (Adam).
        critic_learning_rate: Of the critic (Adam).
        updates_per_step: Steps of the critic for each step of the environment.
        every: Steps of the critic for each step of the networks that are alive; None: they learn
            before their life only.
        newborn_updates: Steps of a newborn before its life.
        size: Transitions of a minibatch of the critic.
        policy_size: Observations of a minibatch of the networks.
        horizon: Steps of reward that a transition sums up before the value of what follows.
        capacity: Transitions that an arena remembers.
        warmup: Remembered transitions before anything is learnt.
        width: Nodes of each of the critic's two hidden layers.
        discount: Weight gamma of the next step's reward in the return.
        critic_tau: Share of the critic that its target takes over at each step.
        smoothing: Noise on the actions of targets, in halves of what is allowed of an action.
        noise: Standard deviation of the noise on actions in a box, likewise.
        persistence: Of that noise from step to step; 0 is white noise.
        epsilon: Probability of starting to explore where there are a few actions, per step.
        max_hold_ticks: Longest run of an explored action; 1 is plain epsilon-greedy.
        inheritance: lamarckian: children inherit the weights that were learnt; darwinian: those
            of birth.
        device: Where memory, critic and networks are while they learn: cpu, cuda. None: cpu.

    Example:
        >>> config = CriticConfig(updates_per_step=0.5, width=256)
    """

    learning_rate: float = 3e-3
    critic_learning_rate: float = 1e-3
    updates_per_step: float = 0.5
    every: int | None = None
    newborn_updates: int = 1_000
    size: int = 256
    policy_size: int = 64
    horizon: int = 3
    capacity: int = 300_000
    warmup: int = 1_000
    width: int = 64
    discount: float = 0.99
    critic_tau: float = 0.01
    smoothing: float = 0.2
    noise: float = 0.1
    persistence: float = 0.0
    epsilon: float = 0.05
    max_hold_ticks: int = 1
    inheritance: Inheritance = "lamarckian"
    device: str | None = None

    def __post_init__(self) -> None:
        check_fields(self, learning_rate="[0, inf)", critic_learning_rate="(0, inf)")
        check_fields(
            self, updates_per_step="(0, inf)", every="[1, inf]", newborn_updates="[0, inf]"
        )
        for name in ("size", "policy_size", "horizon", "capacity", "warmup", "width"):
            check_fields(self, **{name: "[1, inf]"})
        check_fields(self, discount="[0, 1]", critic_tau="(0, 1]", smoothing="[0, inf)")
        check_fields(self, noise="[0, inf)", persistence="[0, 1)", epsilon="[0, 1]")
        check_fields(self, max_hold_ticks="[1, inf]", inheritance=Inheritance)


class SharedCritic:
    """The critic of an arena: its memory, two perceptrons, a slow copy of them, and its chance.

    For a box of actions it is TD3's (Fujimoto, van Hoof & Meger 2018): both read observation and
    action and learn the target r + gamma min(Q1', Q2')(s', a' + noise), where a' is what one of the
    arena's networks, drawn anew for each transition, would do in s'. For a few actions it has an
    output for each and reads the observation alone; a' is the action that is best by the critic
    itself, and its value that of the slow copy (double Q-learning; van Hasselt, Guez & Silver
    2016), again the lower of two. Rewards are divided by the running standard deviation of
    discounted returns.

    Args:
        config: Sizes and rates.
        heads: How outputs of the networks are read.
        inputs: Numbers of an observation.
        slots: Networks of the arena.
        seed: Of all its chance.
    """

    def __init__(
        self, config: CriticConfig, heads: Heads, inputs: int, slots: int, seed: int
    ) -> None:
        self.config, self.heads = config, heads
        self.generator = torch.Generator().manual_seed(seed)
        boxed = isinstance(heads, CandidateHeads)
        sizes = (inputs + heads.actions, 1) if boxed else (inputs, heads.candidates)
        device = torch.device(config.device or "cpu")
        self.critic = TwinCritic(*sizes, config.width, self.generator).to(device)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        rate = config.critic_learning_rate
        self.optimizer = torch.optim.Adam(self.critic.parameters(), rate, fused=True)
        self.memory = TransitionMemory(config.capacity, device)
        self.returns = torch.zeros(slots, dtype=torch.float64)
        self.spread = RunningNormalization(1, 1, least=_LEAST_DEVIATION)
        self.steps, self.due = 0, 0.0

    def remember(self, ahead: TensorDictBase, batch: TensorDictBase) -> None:
        """Store what an arena's slots went through.

        Args:
            ahead: Its transitions, summed up over the horizon [slots, ticks].
            batch: The same tick by tick [slots, ticks].
        """
        lived = batch.get("genome_id").squeeze(-1) >= 0
        following = batch.get("next")
        reward, done = (following.get(name).squeeze(-1) for name in ("reward", "done"))
        returns = torch.zeros_like(reward, dtype=torch.float64)
        for tick in range(reward.shape[-1]):
            self.returns = self.config.discount * self.returns + reward[:, tick]
            returns[:, tick] = self.returns
            self.returns = self.returns.masked_fill(done[:, tick], 0)
        self.spread.add(returns[None, ..., None], lived[None])
        self.memory.extend(ahead.reshape(-1))
        if len(self.memory) >= self.config.warmup:
            self.due += self.config.updates_per_step * int(lived.sum())

    def unit(self, action: Tensor) -> Tensor:
        """Actions in a box [..., A], as the critic reads them: within [-1, 1]."""
        heads = self.heads
        assert isinstance(heads, CandidateHeads)
        span = torch.where(heads.span > 0, heads.span, 1).to(action.device)
        return (action - heads.low.to(action.device)) / span * 2 - 1

    def step(self, rows: Saved, outputs: Tensor) -> Tensor:
        """One step on a minibatch; returns the mean squared TD error of both perceptrons.

        Args:
            rows: Columns of transitions [rows, ...], the observations as networks read them.
            outputs: Of all networks of the arena, of the next observations [slots, rows, outputs].
        """
        self.due, self.steps = self.due - 1, self.steps + 1
        with torch.no_grad():
            following = self._following(rows["next_observation"], outputs)
            following = torch.where(rows["next_terminated"], 0, following)
            gamma = self.config.discount ** rows["steps_to_next_obs"]
            scale = 1 / self.spread.deviation.item()
            target = scale * rows["next_reward"] + gamma * following
        if isinstance(self.heads, CandidateHeads):
            done = self.unit(rows["action"])
            worth = self.critic(torch.cat([rows["observation"], done], -1))
        else:
            taken = rows["action"].long().expand(2, -1, -1)
            worth = self.critic(rows["observation"]).gather(-1, taken)
        error = (worth - target).square().mean(1).sum()
        self.optimizer.zero_grad()
        error.backward()
        self.optimizer.step()
        for slow, own in zip(self.target.parameters(), self.critic.parameters(), strict=True):
            slow.lerp_(own.detach(), self.config.critic_tau)
        return error.detach() / 2

    def _following(self, observation: Tensor, outputs: Tensor) -> Tensor:
        """What the next observations are worth [rows, 1]."""
        if not isinstance(self.heads, CandidateHeads):
            best = self.critic(observation).mean(0).argmax(-1, keepdim=True)
            return self.target(observation).amin(0).gather(-1, best)
        rows = len(observation)
        who = torch.randint(len(outputs), (rows,), generator=self.generator).to(outputs.device)
        every = torch.arange(rows, device=outputs.device)
        action = self.unit(self.heads.best(outputs[who, every]))
        noise = self.config.smoothing * torch.randn(action.shape, generator=self.generator)
        action = action + noise.clamp(-SMOOTHING_LIMIT, SMOOTHING_LIMIT).to(action)
        action = action.clamp(-1, 1)
        return self.target(torch.cat([observation, action], -1)).amin(0)

    @torch.no_grad()
    def lesson(self, observation: Tensor, outputs: Tensor) -> Tensor:
        """By what networks should change their outputs: the gradient of a loss [.., outputs].

        The loss of a network is the mean over rows of -Q1(s, a) for its action in a box. Where
        there are a few actions an output is how much it is inclined to each, and the loss
        -sum_a softmax(outputs)_a Q(s, a).

        Args:
            observation: As networks read it [rows, inputs].
            outputs: Of some networks for it [networks, rows, outputs].
        """
        rows = len(observation)
        if not isinstance(self.heads, CandidateHeads):
            worth, inclined = self.critic(observation).mean(0), torch.softmax(outputs, -1)
            mean = (inclined * worth).sum(-1, keepdim=True)
            return inclined * (mean - worth) / rows
        inside = outputs.clamp(0, 1)
        seen = observation.expand(*outputs.shape[:-1], -1)
        slope = self.critic.slope(torch.cat([seen, 2 * inside - 1], -1).flatten(0, 1))
        slope = slope[:, observation.shape[-1] :].view(outputs.shape)
        return (-2 / rows) * slope * (outputs == inside)

    def state_dict(self) -> Saved:
        """Everything that a checkpoint must keep."""
        moments = [self.optimizer.state.get(one, {}) for one in self.critic.parameters()]
        return {
            "critic": [one.detach() for one in self.critic.parameters()],
            "target": list(self.target.parameters()),
            "moments": [[one["exp_avg"], one["exp_avg_sq"]] for one in moments if one],
            "memory": self.memory.state_dict(),
            "returns": self.returns,
            "spread": self.spread.state_dict(),
            "generator": self.generator.get_state(),
            "steps": self.steps,
            "due": self.due,
        }

    @torch.no_grad()
    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        for name in ("critic", "target"):
            for own, saved in zip(getattr(self, name).parameters(), state[name], strict=True):
                own.copy_(torch.as_tensor(saved))
        self.steps, self.due = state["steps"], state["due"]
        for one, moments in zip(self.critic.parameters(), state["moments"], strict=False):
            first, second = (torch.as_tensor(moment).to(one).clone() for moment in moments)
            steps = torch.tensor(float(self.steps), device=one.device)
            self.optimizer.state[one] = {"step": steps, "exp_avg": first, "exp_avg_sq": second}
        self.memory.load_state_dict(state["memory"])
        self.returns = torch.as_tensor(state["returns"]).clone()
        self.spread.load_state_dict(state["spread"])
        self.generator.set_state(torch.as_tensor(state["generator"]))


class CriticLearner(Learner):
    """Trains networks by the gradient of one critic that all networks of their arena share.

    Evolution with a critic that learns from everybody's steps, after ERL (Khadka & Tumer 2018),
    CEM-RL (Pourchot & Sigaud 2019) and PGA-MAP-Elites (Nilsson & Cully 2021). Newborns learn before
    their first step, which costs none; those alive learn during their lives. Critic and memory end
    with the run: what acts, breeds and is exported are the networks.

    Recurrent state counts as empty in what is learnt.

    Args:
        network: The networks, of shape (arenas, slots).
        heads: How their outputs are read; in a box of actions those of one candidate.
        config: Sizes and rates.
        seeds: One for each arena.
        normalization: Of what networks and critic read; None: that is what the world gives.

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
        slots, weight = network.shape[1], network.weight
        sizes = network.inputs, slots
        self.critics = [SharedCritic(config, heads, *sizes, seed) for seed in seeds]
        self.steps = weight.new_zeros(len(weight))
        self.first_moment = torch.zeros_like(weight, requires_grad=False)
        self.second_moment = torch.zeros_like(weight, requires_grad=False)

    def update(self, batch: TensorDictBase) -> Tensor:
        """Remember a batch [arenas, slots, ticks], and learn as much as is due.

        Returns:
            Mean squared TD error of the critic in its last step [arenas, slots]; 0 without one.
        """
        ahead = over_horizon(batch, self.config.horizon, self.config.discount)
        for arena, critic in enumerate(self.critics):
            critic.remember(ahead[arena], batch[arena])
        errors: dict[int, Tensor] = {}
        with self._on_device(self.network):
            while learning := [arena for arena, one in enumerate(self.critics) if one.due >= 1]:
                errors |= self._step(learning)
        error = torch.zeros(self.network.shape)
        for arena, last in errors.items():  # only here the host waits for the device
            error[arena] = last
        return error

    def _step(self, learning: Sequence[int]) -> dict[int, Tensor]:
        """One step of the critics of some arenas, and of their networks where that is due.

        Returns the error of each critic.
        """
        size = self.config.size
        drawn = {arena: self._drawn(arena, size) for arena in learning}
        following = {arena: rows["next_observation"] for arena, rows in drawn.items()}
        with torch.no_grad():
            outputs = self._outputs(following)
        errors = {
            arena: self.critics[arena].step(rows, outputs[arena]) for arena, rows in drawn.items()
        }
        every = self.config.every
        taught = [one for one in learning if every and self.critics[one].steps % every == 0]
        if not taught:
            return errors
        size = self.config.policy_size
        seen = {arena: self._drawn(arena, size, "observation")["observation"] for arena in taught}
        outputs = self._outputs(seen)
        lesson = torch.zeros_like(outputs)
        for arena, one in seen.items():
            lesson[arena] = self.critics[arena].lesson(one, outputs[arena])
        (gradient,) = torch.autograd.grad(outputs, self.network.weight, lesson)
        slots = self.network.shape[1]
        for arena in taught:
            self._move(self.network.weight, gradient, slice(arena * slots, (arena + 1) * slots))
        return errors

    def _drawn(self, arena: int, size: int, *names: str) -> Saved:
        """Columns of transitions of an arena, with observations as they are read."""
        critic = self.critics[arena]
        rows = critic.memory.draw(size, critic.generator, *names)
        if self.normalization is not None:
            for name in rows.keys() & {"observation", "next_observation"}:
                rows[name] = self.normalization(rows[name], arena)
        return rows

    def _outputs(self, observations: dict[int, Tensor]) -> Tensor:
        """Outputs [arenas, slots, rows, outputs] for observations of some arenas [rows, inputs]."""
        some = next(iter(observations.values()))
        arenas, slots = self.network.shape
        every = [observations.get(arena, some) for arena in range(arenas)]
        return self.network.step(torch.stack(every).unsqueeze(1).expand(-1, slots, -1, -1))[0]

    @torch.no_grad()
    def _move(self, weight: Tensor, gradient: Tensor, rows: slice) -> None:
        own = self.steps[rows], self.first_moment[rows], self.second_moment[rows]
        wanted = weight[rows] - self.config.learning_rate * adam(gradient[rows], *own)
        take_over(weight[rows], wanted)

    def reset(self, newborn: Tensor) -> None:
        """Teach newborns (mask [arenas, slots]), and clear what belonged to those before."""
        weight, born = self.network.weight, newborn.reshape(-1)
        self.steps.masked_fill_(born, 0)
        for name in ("first_moment", "second_moment"):
            moment = fitted(getattr(self, name), weight)
            setattr(self, name, moment.masked_fill(born.unsqueeze(1), 0))
        for arena, critic in enumerate(self.critics):
            critic.returns = critic.returns.masked_fill(newborn[arena], 0)
            if critic.steps and newborn[arena].any():
                self._teach(arena, newborn[arena].nonzero().flatten().tolist())

    def _teach(self, arena: int, slots: Sequence[int]) -> None:
        """Let newborns learn before their first step."""
        first, critic, config = arena * self.network.shape[1], self.critics[arena], self.config
        genomes = [self.network.genome(first + slot) for slot in slots]
        shape = (len(genomes),)
        young = PopulationNetwork(genomes, shape=shape, evaluation=self.network.evaluation)
        weight = young.weight
        steps, moments = weight.new_zeros(len(weight)), torch.zeros(2, *weight.shape)
        with self._on_device(young):
            moments, steps = moments.to(weight.device), steps.to(weight.device)
            size = config.newborn_updates * config.policy_size
            drawn = self._drawn(arena, size, "observation")["observation"]
            for seen in drawn.split(config.policy_size):
                outputs = young.step(seen.expand(*shape, -1, -1))[0]
                lesson = critic.lesson(seen, outputs)
                (gradient,) = torch.autograd.grad(outputs, weight, lesson)
                with torch.no_grad():
                    step = config.learning_rate * adam(gradient, steps, *moments)
                    take_over(weight, weight - step)
        for slot, genome in zip(slots, young.genomes(), strict=True):
            self.network.replace(first + slot, genome)

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
        return {
            "critics": [critic.state_dict() for critic in self.critics],
            "steps": self.steps,
            "first_moment": self.first_moment,
            "second_moment": self.second_moment,
        }

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        for critic, saved in zip(self.critics, state["critics"], strict=True):
            critic.load_state_dict(saved)
        for name in ("steps", "first_moment", "second_moment"):
            own = getattr(self, name)
            own.copy_(fitted(state[name], own) if own.ndim > 1 else torch.as_tensor(state[name]))
