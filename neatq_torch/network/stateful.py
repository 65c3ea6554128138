"""Networks that remember by themselves what they have seen, for plain loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from neatq_torch.network.population import PopulationNetwork


@runtime_checkable
class Stepping(Protocol):
    """What steps from state to state: a network, or a policy."""

    @property
    def state_size(self) -> int:
        """Values of the state; 0 for none."""
        ...

    def initial_state(self, batch: Sequence[int] = ()) -> Tensor:
        """The state where an episode begins [*batch, state_size]."""
        ...

    def step(self, observation: Any, state: Any) -> tuple[Tensor, Tensor]:
        """The output and the next state."""
        ...


class StatefulNetwork(nn.Module):
    """Networks with a memory: each call goes on from the one before; `reset` begins anew.

    A network that `replace` put in begins with a state of zeros.

    The state is detached between calls: gradients reach the weights through the latest call alone.
    Whoever wants them through time calls `network.step`. The state is no part of `state_dict`.

    Args:
        network: The networks; weights are shared, not copied.

    Attributes:
        state: What the next call reads [*shape, *batch, state_size]; None at the beginning.

    Example:
        >>> network = GenomeNetwork(load_genome("champion.json")).stateful()
        >>> outputs = [network(observation) for observation in episode]
        >>> network.reset()
    """

    def __init__(self, network: PopulationNetwork) -> None:
        super().__init__()
        self.network = network
        self.state: Tensor | None = None
        self._births = list(network.births)

    def forward(self, observation: Any) -> Tensor:
        """Outputs [*shape, *batch, outputs] for observations [*shape, *batch, inputs].

        Raises:
            ValueError: If the batch is another than that of the calls before.
        """
        network, lead = self.network, len(self.network.shape)
        observation = torch.as_tensor(observation, device=network.weight.device)
        batch = observation.shape[lead:-1]
        if self.state is not None and self.state.shape[lead:-1] != batch:
            raise ValueError(
                f"expected a batch {list(self.state.shape[lead:-1])} of observations, as in the "
                f"calls before, got {list(batch)}; call reset() where another batch begins"
            )
        if self._births != network.births:
            self._forget_replaced()
        output, state = network.step(observation, self.state)
        self.state = state.detach()
        return output

    def _forget_replaced(self) -> None:
        """Let networks begin anew that were put in since the call before; one may keep more."""
        network = self.network
        fresh = [now != then for now, then in zip(network.births, self._births, strict=True)]
        self._births = list(network.births)
        if self.state is not None:
            rest = self.state.ndim - len(network.shape)
            begins = torch.tensor(fresh, device=self.state.device).view(*network.shape, *[1] * rest)
            kept = self.state.masked_fill(begins, 0.0)
            self.state = nn.functional.pad(kept, (0, network.state_size - kept.shape[-1]))

    def reset(self, begins: Tensor | None = None) -> None:
        """Forget, all or where `begins` [*shape, *batch] is true: there an episode begins."""
        if begins is None or self.state is None:
            self.state = None
            return
        begins = torch.as_tensor(begins, device=self.state.device)
        if begins.shape != self.state.shape[:-1] or begins.dtype != torch.bool:
            raise ValueError(
                f"expected begins as bools of shape {list(self.state.shape[:-1])}, got "
                f"{begins.dtype} of shape {list(begins.shape)}"
            )
        self.state = self.state.masked_fill(begins.unsqueeze(-1), 0.0)
