"""How the outputs of a network are read: as candidate actions and their Q-values."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from neatq_torch.network import PopulationNetwork

ValueRange = tuple[float, float]


class Heads(nn.Module):
    """What acting and learning ask of heads: called, they read candidates and their values.

    The last K outputs are the values.

    Args:
        candidates: Candidates K among which a robot chooses.
        actions: Numbers A that one action consists of.
        value_range: Q-values that the outputs 0 and 1 stand for: Q = low + (high - low) output
            (Whiteson & Stone 2006). A sigmoid cannot leave the range; for outputs without
            bounds keep (0, 1), which reads them as they are.
        outputs: Network outputs that they read; None for the values alone.

    Raises:
        ValueError: If the range is empty.
    """

    def __init__(
        self, candidates: int, actions: int, value_range: ValueRange, outputs: int | None = None
    ) -> None:
        super().__init__()
        low, high = value_range
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"value_range: expected finite low < high, got {low} and {high}")
        self.candidates = candidates
        self.actions = actions
        self.value_range = value_range
        self.outputs = candidates if outputs is None else outputs

    def forward(self, output: Tensor) -> tuple[Tensor, Tensor]:
        """Read outputs [..., outputs] as candidates [..., K, A] and values [..., K]."""
        raise NotImplementedError

    def values(self, output: Tensor) -> Tensor:
        """The values [..., K] alone."""
        values = output[..., self.outputs - self.candidates :]
        low, high = self.value_range
        return values if self.value_range == (0.0, 1.0) else low + (high - low) * values

    def moved(self, action: Tensor, noise: Tensor) -> Tensor:
        """Actions [..., A] with noise of the same shape; those of a few choices as they are."""
        return action

    def best(self, output: Tensor) -> Tensor:
        """The candidate of the greatest value [..., A], of equal ones the first."""
        candidates, values = self(output)
        index = values.argmax(-1, keepdim=True).unsqueeze(-1)
        # Not take_along_dim, which ties what is exported to one size of batch.
        index = index.expand(*index.shape[:-1], self.actions)
        return candidates.gather(-2, index).squeeze(-2)


class CandidateHeads(Heads):
    """Reads network outputs as K candidate actions and a Q-value for each.

    Candidate c is outputs [A c, A (c + 1)) and its value is output A K + c, the layout of
    Robertson & Wu (2014). Actions are read on [0, 1], the range of a sigmoid (values outside are
    clipped), and scaled to [low, high]. A single candidate leaves nothing to choose: it has no
    value output, and its value is zero.

    Args:
        candidates: K, at least 1.
        low: Smallest action [A].
        high: Largest action [A].
        value_range: See `Heads`.

    Raises:
        ValueError: If K is less than 1 or bounds do not fit each other.

    Example:
        >>> heads = CandidateHeads(2, low=[-1.0], high=[3.0])
        >>> candidates, values = heads(torch.tensor([0.0, 1.0, 0.2, 0.7]))
        >>> candidates[values.argmax()].tolist()
        [3.0]
    """

    low: Tensor
    span: Tensor

    def __init__(
        self,
        candidates: int,
        low: Sequence[float],
        high: Sequence[float],
        *,
        value_range: ValueRange = (0.0, 1.0),
    ) -> None:
        outputs = candidates * (len(low) + (candidates > 1))
        super().__init__(candidates, len(low), value_range, outputs)
        if candidates < 1:
            raise ValueError(f"expected at least 1 candidate, got {candidates}")
        if len(low) != len(high) or any(a > b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"expected low <= high for every action, got {low} and {high}")
        smallest = torch.tensor(low, dtype=torch.get_default_dtype())
        self.register_buffer("low", smallest, persistent=False)
        self.register_buffer("span", smallest.new_tensor(high) - smallest, persistent=False)

    def forward(self, output: Tensor) -> tuple[Tensor, Tensor]:
        """Split outputs [..., outputs] into candidates [..., K, A] and values [..., K]."""
        unit = output[..., : self.candidates * self.actions].clamp(0, 1)
        unit = unit.unflatten(-1, (self.candidates, self.actions))
        return self.low + unit * self.span, self.values(output)

    def moved(self, action: Tensor, noise: Tensor) -> Tensor:
        """Actions [..., A] with noise, in halves of the span of each, within the bounds."""
        moved = action + noise * (self.span / 2)
        return moved.maximum(self.low).minimum(self.low + self.span)

    def values(self, output: Tensor) -> Tensor:
        """The values [..., K] alone."""
        return super().values(output) if self.candidates > 1 else torch.zeros_like(output[..., :1])


class DiscreteHeads(Heads):
    """Reads network outputs as the Q-values of discrete actions, as NEAT+Q and DQN have them.

    There are as many candidates K as actions, candidate k is the number k, and its value is
    output k.

    Args:
        actions: How many actions there are, at least 1.
        value_range: See `Heads`.

    Raises:
        ValueError: If there is no action or the range is empty.

    Example:
        >>> candidates, values = DiscreteHeads(3)(torch.tensor([0.1, 0.9, 0.3]))
        >>> candidates[values.argmax()].tolist()
        [1.0]
    """

    index: Tensor

    def __init__(self, actions: int, *, value_range: ValueRange = (0.0, 1.0)) -> None:
        super().__init__(actions, 1, value_range)
        if actions < 1:
            raise ValueError(f"expected at least 1 action, got {actions}")
        index = torch.arange(actions, dtype=torch.get_default_dtype()).unsqueeze(-1)
        self.register_buffer("index", index, persistent=False)

    def forward(self, output: Tensor) -> tuple[Tensor, Tensor]:
        """The candidates [..., K, 1], numbers from 0, and their values [..., K]."""
        return self.index.expand(*output.shape, 1), self.values(output)


def check_heads(network: PopulationNetwork, heads: Heads) -> None:
    """Raise ValueError unless the networks have the outputs that the heads read."""
    if network.outputs != heads.outputs:
        raise ValueError(
            f"{heads.candidates} candidates of {heads.actions} actions need {heads.outputs} "
            f"network outputs; the networks have {network.outputs}"
        )
