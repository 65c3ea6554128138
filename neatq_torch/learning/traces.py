"""Q(lambda) on-line: eligibility traces on the weights of every network."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.kinds import check_fields
from neatq_torch.learning.heads import Heads, check_heads
from neatq_torch.learning.learner import Inheritance, Saved, take_over
from neatq_torch.network import PopulationNetwork, fitted


@dataclass(frozen=True, kw_only=True)
class TraceConfig:
    """Q(lambda) with eligibility traces; the defaults are those of NEAT+Q on the mountain car.

    Attributes:
        learning_rate: Step size alpha, in units of the network outputs, see `TraceLearner`.
        discount: Weight gamma of the next tick's reward in the return.
        trace_decay: lambda of the traces; 0 is one-step Q-learning.
        anneal: Let the learning rate fall to 0 over the episodes of a life.
        epsilon: Probability of starting to explore, per tick.
        max_hold_ticks: Longest run of an explored candidate; 1 is plain epsilon-greedy.
        inheritance: lamarckian: children inherit the weights that were learnt; darwinian: those
            of birth.

    Example:
        >>> config = TraceConfig(discount=0.99, trace_decay=0.9)
    """

    learning_rate: float = 0.1
    discount: float = 1.0
    trace_decay: float = 0.6
    anneal: bool = False
    epsilon: float = 0.05
    max_hold_ticks: int = 1
    inheritance: Inheritance = "darwinian"

    def __post_init__(self) -> None:
        check_fields(self, learning_rate="[0, inf)", discount="[0, 1]", trace_decay="[0, 1]")
        check_fields(self, epsilon="[0, 1]", max_hold_ticks="[1, inf]", inheritance=Inheritance)


class TraceLearner:
    """Watkins's Q(lambda) with accumulating traces, one trace for every weight of every network.

    For each tick (s, a, r, s') in turn, with the weights as the tick before left them:

        delta = r + gamma max_k Q(s', k) - Q(s, a)         (no max where s' is terminal)
        e <- gamma lambda e + dQ(s, a)/dw                  (gamma lambda -> 0 if a is not greedy)
        w <- w + alpha delta e
        e <- 0                                             (where the episode is done)

    This is Q-learning, not Sarsa: the target takes the best action of s', whatever is done there
    (Whiteson & Stone 2006, who back-propagate towards r + gamma max Q with traces). The order is
    that of Sutton & Barto (1998, figure 8.9): an exploratory action, one of less than the greatest
    value of s, gets no credit onto what came before it, but is itself learnt from, and opens a new
    trace. The end of an episode by time (truncated) bootstraps and clears the trace; one by
    termination does not bootstrap.

    As in NEAT+Q, errors and gradients are those of the network's outputs, before they are scaled to
    the heads' `value_range`, so that a learning rate means the same at any range.

    The trace belongs to a robot's slot and is cleared when a newborn takes it. Transitions whose
    `genome_id` is not that of the network standing in the slot now change neither weights nor
    trace. An update that would make a weight infinite or NaN is not applied to that robot and
    clears its trace. Gradients do not reach back through recurrent state: the calls before count
    as inputs, as everywhere in this package.

    Args:
        network: The networks.
        heads: How their outputs are read.
        config: Learning rate, discount and trace decay; None for the defaults.
        episodes: Of a life, over which `anneal` lets the learning rate fall.

    Attributes:
        learning_rate: alpha of each robot [networks]; may be changed in place, unless it falls
            with the episodes.
        trace: e [networks, columns], as the weights.

    Raises:
        ValueError: If heads and networks do not fit, or there is nothing to choose.

    Example:
        >>> learner = TraceLearner(network, heads, TraceConfig(discount=0.99))
    """

    def __init__(
        self,
        network: PopulationNetwork,
        heads: Heads,
        config: TraceConfig | None = None,
        *,
        episodes: int | None = None,
    ) -> None:
        check_heads(network, heads)
        if heads.candidates < 2:
            raise ValueError("expected at least 2 candidates, got 1: it has no Q-value to learn")
        self.network = network
        self.heads = heads
        self.config = config or TraceConfig()
        self._episodes = episodes if self.config.anneal else None
        if self.config.anneal and episodes is None:
            raise ValueError(
                "anneal: expected lives of a number of episodes, over which the learning rate can "
                "fall; got lives without end (a generational population has such)"
            )
        weight = network.weight
        self.learning_rate = weight.new_full((len(weight),), self.config.learning_rate)
        self.trace = torch.zeros_like(weight, requires_grad=False)
        low, high = heads.value_range
        self._unit = 1 / (high - low)

    def update(self, batch: TensorDictBase) -> Tensor:
        """Learn from every tick in turn; meant for batches of one.

        Args:
            batch: Transitions [*shape, ticks]: `observation`, `candidate_index`, `genome_id`,
                `("next", observation / reward / terminated / done)`, and `network_state` and
                `("next", "network_state")` where networks are recurrent. If the learning rate
                falls, also `episode` [*shape, ticks, 1], the number of the episode, from 0.

        Returns:
            Mean squared TD error of each robot's own transitions [*shape], in units of Q.
        """
        own = batch.get("genome_id").squeeze(-1) == self.network.genome_id.unsqueeze(-1)
        ticks = range(own.shape[-1])
        errors = torch.stack([self._learn(batch, tick, own[..., tick]) for tick in ticks], -1)
        return torch.where(own, errors.square(), 0).sum(-1) / own.sum(-1).clamp_min(1)

    def _learn(self, batch: TensorDictBase, tick: int, own: Tensor) -> Tensor:
        """One tick of robots `own` [*shape]; returns the TD errors [*shape]."""
        if self._episodes is not None:
            lived = batch.get("episode")[..., tick, 0].double() / self._episodes
            self.learning_rate = (self.config.learning_rate * (1 - lived)).float().flatten()
        values = self._values(batch, tick)
        index = batch.get("candidate_index")[..., tick, None]
        taken = torch.zeros_like(values).scatter_(-1, index, self._unit)
        (gradient,) = torch.autograd.grad(values, self.network.weight, taken)
        with torch.no_grad():
            values = values.detach()
            chosen = values.gather(-1, index).squeeze(-1)
            names = ("reward", "terminated", "done")
            reward, over, done = (batch.get(("next", name))[..., tick, 0] for name in names)
            best = self._values(batch, tick, "next").amax(-1)
            error = reward + torch.where(over, 0, self.config.discount * best) - chosen
            greedy = chosen == values.amax(-1)
            self._step(gradient, error, greedy, own, done)
        return error

    def _step(
        self, gradient: Tensor, error: Tensor, greedy: Tensor, own: Tensor, done: Tensor
    ) -> None:
        """Move traces and weights by gradients [networks, columns]; all else is [*shape]."""
        weight, config = self.network.weight, self.config
        decay = (config.discount * config.trace_decay) * greedy.view(-1, 1)
        trace = self.trace * decay + gradient
        rate = self.learning_rate * (self._unit * error.flatten())
        changed = take_over(weight, weight + rate.unsqueeze(1) * trace, own.reshape(-1, 1))
        lasting = changed & ~done.reshape(-1, 1)
        trace = torch.where(lasting, trace, 0)
        self.trace = torch.where(own.reshape(-1, 1), trace, self.trace)

    def _values(self, batch: TensorDictBase, tick: int, *root: str) -> Tensor:
        """Q(s) of a tick, or with root "next" Q(s') [*shape, K]."""
        state = batch.get((*root, "network_state"), None)
        state = None if state is None else state[..., tick, :]
        observation = batch.get((*root, "observation"))[..., tick, :]
        return self.heads.values(self.network(observation, state))

    def reset(self, newborn: Tensor) -> None:
        """Clear the traces of the genomes before (mask [*shape]), once newborns stand there."""
        trace, newborn = fitted(self.trace, self.network.weight), newborn.reshape(-1)
        self.trace = trace.masked_fill(newborn.unsqueeze(1), 0)
        if self._episodes is not None:
            rate = self.config.learning_rate
            self.learning_rate = self.learning_rate.masked_fill(newborn, rate)

    def state_dict(self) -> Saved:
        """Learning rates and traces."""
        return {"learning_rate": self.learning_rate, "trace": self.trace}

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        for name, own in self.state_dict().items():
            own.copy_(fitted(state[name], own))
