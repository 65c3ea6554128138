"""The values of candidate actions, and the policy that takes one of them."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, dispatch
from torch import Tensor

from neatq_torch.learning.exploration import ActionNoise, EpsilonGreedy, Seeds, state_of_slots
from neatq_torch.learning.heads import Heads, check_heads
from neatq_torch.learning.normalization import RunningNormalization
from neatq_torch.network import PopulationNetwork, fitted

NOBODY = -1
"""The genome id of transitions that nobody learns from."""


class CandidateValue(TensorDictModuleBase):
    """The Q-values of all candidates of every robot, as a `CandidateTDLoss` needs them.

    Reads `observation` [*shape, *batch, inputs] and `network_state`; without one, every
    observation is the first of its episode. Writes `action_value` [..., K] and
    `chosen_action_value` [..., 1], the largest of them. `shape` is that of the networks: [] of a
    `GenomeNetwork`, so that any batch is one of its observations.

    Args:
        network: The networks of all robots, or the one of a genome.
        heads: How outputs are read.
        propose: Also write the `candidates` [..., K, A], as a `WireFittingLoss` needs them.

    Example:
        >>> value = CandidateValue(network, heads)
    """

    def __init__(self, network: PopulationNetwork, heads: Heads, *, propose: bool = False) -> None:
        super().__init__()
        self.in_keys = ["observation"]
        self.out_keys = ["action_value", "chosen_action_value", *["candidates"] * propose]
        self.propose = propose
        check_heads(network, heads)
        self.network = network
        self.heads = heads

    @dispatch  # pyright: ignore[reportArgumentType]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Add the values of the candidates to `tensordict`."""
        observation, state = tensordict.get("observation"), tensordict.get("network_state", None)
        output, _ = self.network.step(observation, state)
        if self.propose:
            candidates, values = self.heads(output)
            tensordict.set("candidates", candidates)
        else:
            values = self.heads.values(output)
        tensordict.set("action_value", values)
        return tensordict.set("chosen_action_value", values.amax(-1, keepdim=True))


class CandidatePolicy(TensorDictModuleBase):
    """Acts for every robot: its network proposes candidates, `exploration` takes one of them.

    Rows are [*batch]: those of the networks, such as [arenas, robots], or for a `GenomeNetwork`
    those of the environment, [] of a `GymEnv` or [3] of a `SerialEnv` of three.

    Reads `observation`; writes `candidates` [*batch, K, A], `action_value` [*batch, K],
    `candidate_index` [*batch], `action` [*batch, A], `chosen_action_value` [*batch, 1] and
    `genome_id` [*batch, 1], by which learning knows whose transition it is: nobody's (-1) in slots
    that do not live by an entry `living` [*batch, 1], if there is one. Where networks are recurrent
    it also writes the state that this tick read, `network_state`, and the one that the next tick
    reads, `("next", "network_state")`.

    The state stays with the robot from life to life, as in OpenNERO; a newborn starts afresh
    through `reset`.

    Args:
        network: The networks of all robots, or the one of a genome.
        heads: How outputs are read.
        exploration: How a candidate is taken, of the shape of the rows.
        double_activation: Activate each network a second time, with the observation before, as
            the published rtNEAT+Q did. Outputs are not affected at once, but recurrent state is.
        forgets: Start afresh where an episode begins (`step_count` is 0), too.
        noise: Added to the actions of `CandidateHeads`, in halves of what is allowed of each.
        normalization: Of what the networks read.

    Raises:
        ValueError: If network, heads and exploration do not fit each other.

    Example:
        >>> exploration = EpsilonGreedy(network.shape, seeds=[0], epsilon=0.1)
        >>> policy = CandidatePolicy(network, heads, exploration)
        >>> action = policy(env.reset())["action"]
    """

    memory: Tensor
    previous: Tensor

    def __init__(
        self,
        network: PopulationNetwork,
        heads: Heads,
        exploration: EpsilonGreedy,
        *,
        double_activation: bool = False,
        forgets: bool = False,
        noise: ActionNoise | None = None,
        normalization: RunningNormalization | None = None,
    ) -> None:
        super().__init__()
        self.in_keys = ["observation"]
        values = ["action_value", "chosen_action_value"]
        self.out_keys = ["candidates", "candidate_index", "action", *values, "genome_id"]
        check_heads(network, heads)
        self.network = network
        self.heads = heads
        self.exploration = exploration
        self.double_activation = double_activation
        self.forgets = forgets
        self.noise, self.normalization = noise, normalization
        self._rows, lead = exploration.shape, len(network.shape)
        if self._rows[:lead] != network.shape:
            raise ValueError(
                f"expected exploration of shape {tuple(network.shape)} or more, like the networks, "
                f"got {self._rows}"
            )
        self.register_buffer("memory", self._afresh(), persistent=False)
        previous = self.memory.new_zeros(*self._rows, network.inputs)
        self.register_buffer("previous", previous, persistent=False)

    @dispatch  # pyright: ignore[reportArgumentType]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Add every robot's action, and what led to it, to `tensordict`."""
        observation = tensordict.get("observation")
        if observation.shape[:-1] != self._rows:
            raise ValueError(
                f"expected an observation for each row {list(self._rows)} of the exploration, got "
                f"the shape {list(observation.shape)}"
            )
        if self.forgets and (begins := tensordict.get("step_count").squeeze(-1) == 0).any():
            self._forget(begins)
        if self.normalization is not None:
            observation = self.normalization(observation)
        output, memory = self.network.step(observation, self.memory)
        candidates, values = self.heads(output)
        index = self.exploration(values)
        taken = index.unsqueeze(-1)
        action = candidates.take_along_dim(taken.unsqueeze(-1), -2).squeeze(-2)
        if self.noise is not None:
            action = self.heads.moved(action, self.noise())
        owner, living = self._owner(), tensordict.get("living", None)
        tensordict.set("candidates", candidates)
        tensordict.set("action_value", values)
        tensordict.set("candidate_index", index)
        tensordict.set("action", action)
        tensordict.set("chosen_action_value", values.gather(-1, taken))
        own = owner.clone() if living is None else owner.masked_fill(~living, NOBODY)
        tensordict.set("genome_id", own)
        if self.network.state_size:
            if self.double_activation:
                memory = self.network.step(self.previous, memory)[1]
            tensordict.set("network_state", self.memory)
            tensordict.set(("next", "network_state"), memory)
            self.memory = memory
        if self.double_activation:
            self.previous = observation
        return tensordict

    def part(self, slots: slice) -> CandidatePolicy:
        """Acts for some slots of all arenas as this one does; of networks [arenas, slots]."""
        arenas, robots = self._rows
        own = torch.arange(arenas * robots).view(arenas, robots)[:, slots]
        part = CandidatePolicy(
            self.network.part(own.flatten().tolist(), own.shape),
            self.heads,
            self.exploration.part(slots),
            double_activation=self.double_activation,
            forgets=self.forgets,
            noise=None if self.noise is None else self.noise.part(slots),
            normalization=self.normalization,
        )
        part.load_state_dict(state_of_slots(self.state_dict(), slots))
        return part

    @property
    def explores(self) -> bool:
        """Whether anything is left to chance."""
        return self.noise is not None or bool(self.exploration.epsilon.any())

    def begin(self, seeds: Seeds) -> None:
        """Explore by other chance from here on; see `EpsilonGreedy.begin`."""
        self.exploration.begin(seeds)
        if self.noise is not None:
            self.noise.begin(seeds)

    def reset(self, newborn: Tensor) -> None:
        """Let newborns (mask [*batch]) start afresh: no state or exploration of those before."""
        self.memory = fitted(self.memory, self._afresh())
        self._forget(newborn)

    def _afresh(self) -> Tensor:
        """The state of every row at birth [*batch, state]."""
        return self.network.initial_state(self._rows[len(self.network.shape) :])

    def _owner(self) -> Tensor:
        """Whose network acts in each row [*batch, 1]."""
        owner, rows = self.network.genome_id, self._rows
        return owner.view(*owner.shape, *(1,) * (len(rows) - owner.ndim + 1)).expand(*rows, 1)

    def _forget(self, mask: Tensor) -> None:
        if self.network.state_size:
            self.memory = self.memory.masked_fill(mask.unsqueeze(-1), 0.0)
        if self.double_activation:
            self.previous = self.previous.masked_fill(mask.unsqueeze(-1), 0.0)
        self.exploration.reset(mask)
        if self.noise is not None:
            self.noise.reset(mask)

    def state_dict(self, *args: Any, **settings: Any) -> dict[str, Any]:
        """Recurrent state and exploration; torch's own for a module around it."""
        if args or settings:
            return super().state_dict(*args, **settings)
        own = {"memory": self.memory, "previous": self.previous}
        own |= {"exploration": self.exploration.state_dict()}
        return own if self.noise is None else own | {"noise": self.noise.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Go on from `state`."""
        self.memory = fitted(state["memory"], self._afresh())
        self.previous = fitted(state["previous"], self.previous)
        self.exploration.load_state_dict(state["exploration"])
        if self.noise is not None:
            self.noise.load_state_dict(state["noise"])
