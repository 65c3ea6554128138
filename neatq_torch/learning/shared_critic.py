"""One critic for a whole population: it learns from everybody's steps, and teaches everybody."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.kinds import check_fields
from neatq_torch.learning import compiled_critic
from neatq_torch.learning.critic import Minibatch, TwinCritic
from neatq_torch.learning.heads import CandidateHeads, Heads
from neatq_torch.learning.learner import Inheritance, Saved, adam, take_over
from neatq_torch.learning.memory import TransitionMemory
from neatq_torch.learning.normalization import RunningNormalization

SMOOTHING_LIMIT = 0.5
"""Noise on the actions of targets is cut off here, in halves of what is allowed."""
_AT_ONCE = 32
"""Minibatches drawn at once, at most."""


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
        teacher_mutation: Probability that a newborn's teacher is drawn anew instead of inherited:
            the critic, the fittest as a model or an explorer's critic (`Teachers`). None: the
            critic teaches all.
        novelty: Share of the new in an explorer's reward (`ExplorerReward`). None: no explorers.
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
    teacher_mutation: float | None = None
    novelty: float | None = None
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
        check_fields(self, updates_per_step="(0, inf)", newborn_updates="[0, inf]")
        check_fields(self, teacher_mutation="(0, 1]", novelty="[0, 1]")
        for name in ("every", "size", "policy_size", "horizon", "capacity", "warmup", "width"):
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
        beside: A critic whose memory it shares; it learns from the second column of rewards there.
    """

    def __init__(
        self,
        config: CriticConfig,
        heads: Heads,
        inputs: int,
        slots: int,
        seed: int,
        beside: SharedCritic | None = None,
    ) -> None:
        self.config, self.heads, self._beside = config, heads, beside is not None
        self.generator = torch.Generator().manual_seed(seed)
        boxed = isinstance(heads, CandidateHeads)
        sizes = (inputs + heads.actions, 1) if boxed else (inputs, heads.candidates)
        device = torch.device(config.device or "cpu")
        self.critic = TwinCritic(*sizes, config.width, self.generator).to(device)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        weight = self.critic.weight.detach()
        self.first_moment, self.second_moment = torch.zeros_like(weight), torch.zeros_like(weight)
        owners = config.teacher_mutation is not None
        own = TransitionMemory(config.capacity, device, owners=owners)
        self.memory = own if beside is None else beside.memory
        self.returns = torch.zeros(slots, dtype=torch.float64)
        self.spread = RunningNormalization(1, 1, least=1e-6)
        self.steps, self.due = 0, 0.0

    def remember(self, ahead: TensorDictBase, batch: TensorDictBase) -> None:
        """Store what an arena's slots went through.

        Args:
            ahead: Its transitions, summed up over the horizon [slots, ticks].
            batch: The same tick by tick [slots, ticks].
        """
        self.memory.extend(ahead.reshape(-1))
        self.watch(batch, batch.get(("next", "reward")))

    def watch(self, batch: TensorDictBase, rewards: Tensor) -> None:
        """Note how far apart returns are, and what is due, for a batch whose ticks are remembered.

        Args:
            batch: [slots, ticks].
            rewards: Of these ticks [slots, ticks, 1].
        """
        lived, done = batch.get("genome_id").squeeze(-1) >= 0, batch.get(("next", "done"))
        earned, ends, running = rewards.numpy(), done.numpy(), self.returns.numpy()
        returns = np.empty(earned.shape)
        for tick in range(earned.shape[1]):  # numpy: torch takes four times as long for so few
            running = self.config.discount * running + earned[:, tick, 0]
            returns[:, tick, 0] = running
            running = np.where(ends[:, tick, 0], 0, running)
        self.returns = torch.from_numpy(running)
        self.spread.add(torch.from_numpy(returns)[None], lived[None])
        if len(self.memory) >= self.config.warmup:
            self.due += self.config.updates_per_step * int(lived.sum())

    def unit(self, action: Tensor) -> Tensor:
        """Actions in a box [..., A], as the critic reads them: within [-1, 1]."""
        heads = self.heads
        assert isinstance(heads, CandidateHeads)
        span = torch.where(heads.span > 0, heads.span, 1).to(action.device)
        return (action - heads.low.to(action.device)) / span * 2 - 1

    @property
    def soon(self) -> int:
        """Steps to take at once: those that are due, up to the next one of those alive."""
        due, every = min(int(self.due), _AT_ONCE), self.config.every
        return due if every is None else min(due, every - self.steps % every)

    def learn(self, rows: Saved, outputs: Tensor) -> Tensor:
        """A step on each minibatch; returns the mean squared TD error of the last one.

        Args:
            rows: Columns of all transitions [rows, ...], observations as networks read them.
            outputs: Of networks of the arena, of the next observations [rows, outputs].
        """
        given, error = self._given(rows, outputs), torch.zeros(())
        for part in zip(*(column.split(self.config.size) for column in given), strict=True):
            error = self._step(Minibatch(*part))
            self.due, self.steps = self.due - 1, self.steps + 1
        return error

    def _given(self, rows: Saved, outputs: Tensor) -> tuple[Tensor, ...]:
        """The columns of a `Minibatch`, of all transitions together."""
        now, following = rows["observation"], rows["next_observation"]
        ahead = self.config.discount ** rows["steps_to_next_obs"].squeeze(-1).float()
        ahead = torch.where(rows["next_terminated"].squeeze(-1), 0, ahead)
        reward = rows["next_reward"][..., int(self._beside)] / self.spread.deviation.item()
        taken = rows["action"][..., 0].long()
        if isinstance(self.heads, CandidateHeads):
            now = torch.cat([now, self.unit(rows["action"])], -1)
            action = self.unit(self.heads.best(outputs))
            noise = self.config.smoothing * torch.randn(action.shape, generator=self.generator)
            action = action + noise.clamp(-SMOOTHING_LIMIT, SMOOTHING_LIMIT).to(action)
            following = torch.cat([following, action.clamp(-1, 1)], -1)
            taken = torch.zeros_like(taken)
        return now, taken, reward.float(), following, ahead

    def _step(self, given: Minibatch) -> Tensor:
        weight, rate = self.critic.weight, self.config.critic_learning_rate
        adams = weight.new_full((2,), self.steps), self.first_moment, self.second_moment
        if compiled_critic.accepts(weight):
            sizes = self.target.weight, self.config.width
            error = compiled_critic.step(weight, *sizes, adams, given, rate)
        else:
            error = self._error(given)
            (gradient,) = torch.autograd.grad(error, weight)
            with torch.no_grad():
                take_over(weight, weight - rate * adam(gradient, *adams))
        self.target.weight.lerp_(weight.detach(), self.config.critic_tau)
        return error.detach() / 2

    def _error(self, given: Minibatch) -> Tensor:
        """The sum of both mean squared TD errors."""
        with torch.no_grad():
            best = self.critic(given.following).mean(0).argmax(-1, keepdim=True)
            worth = self.target(given.following).amin(0).gather(-1, best).squeeze(-1)
            target = given.reward + torch.where(given.ahead > 0, given.ahead * worth, 0)
        taken = given.taken.expand(2, -1).unsqueeze(-1)
        wrong = self.critic(given.rows).gather(-1, taken).squeeze(-1) - target
        return wrong.square().mean(1).sum()

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

    def _weights(self) -> dict[str, Tensor]:
        moments = {"first_moment": self.first_moment, "second_moment": self.second_moment}
        return {"critic": self.critic.weight, "target": self.target.weight, **moments}

    def state_dict(self) -> Saved:
        """Everything that a checkpoint must keep."""
        own = {name: one.detach() for name, one in self._weights().items()}
        return own | {
            "memory": {} if self._beside else self.memory.state_dict(),
            "returns": self.returns,
            "spread": self.spread.state_dict(),
            "generator": self.generator.get_state(),
            "steps": self.steps,
            "due": self.due,
        }

    @torch.no_grad()
    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        for name, own in self._weights().items():
            own.copy_(torch.as_tensor(state[name]))
        self.steps, self.due = state["steps"], state["due"]
        if not self._beside:
            self.memory.load_state_dict(state["memory"])
        self.returns = torch.as_tensor(state["returns"]).clone()
        self.spread.load_state_dict(state["spread"])
        self.generator.set_state(torch.as_tensor(state["generator"]))
