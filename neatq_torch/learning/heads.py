"""How the outputs of a network are read: as candidate actions and their Q-values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor, nn

from neatq_torch.network import PopulationNetwork

ValueRange = tuple[float, float]


class Heads(Protocol):
    """What acting and learning ask of heads; they are modules."""

    candidates: int
    """Candidates K among which a robot chooses."""

    actions: int
    """Numbers A that one action consists of."""

    value_range: ValueRange
    """Q-values that the outputs 0 and 1 stand for."""

    @property
    def outputs(self) -> int:
        """Network outputs that these heads read."""
        ...

    def __call__(self, output: Tensor) -> tuple[Tensor, Tensor]:
        """Read outputs [..., outputs] as candidates [..., K, A] and values [..., K]."""
        ...

    def values(self, output: Tensor) -> Tensor:
        """The values [..., K] alone."""
        ...


class CandidateHeads(nn.Module):
    """Reads network outputs as K candidate actions and a Q-value for each.

    Candidate c is outputs [A c, A (c + 1)) and its value is output A K + c, the layout of
    Robertson & Wu (2014). Actions are read on [0, 1], the range of a sigmoid (values outside are
    clipped), and scaled to [low, high]. A single candidate leaves nothing to choose: it has no
    value output, and its value is zero.

    Args:
        candidates: K, at least 1.
        low: Smallest action [A].
        high: Largest action [A].
        value_range: Q-values that the outputs 0 and 1 stand for: Q = low + (high - low) output
            (Whiteson & Stone 2006). A sigmoid cannot leave the range; for outputs without
            bounds keep (0, 1), which reads them as they are.

    Raises:
        ValueError: If K is less than 1 or bounds do not fit each other.
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
        super().__init__()
        if candidates < 1:
            raise ValueError(f"expected at least 1 candidate, got {candidates}")
        if len(low) != len(high) or any(a > b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"expected low <= high for every action, got {low} and {high}")
        self.candidates = candidates
        self.actions = len(low)
        self.value_range = _checked(value_range)
        smallest = torch.tensor(low, dtype=torch.get_default_dtype())
        self.register_buffer("low", smallest, persistent=False)
        self.register_buffer("span", smallest.new_tensor(high) - smallest, persistent=False)

    @property
    def outputs(self) -> int:
        """Network outputs that these heads read."""
        return self.candidates * (self.actions + (self.candidates > 1))

    def forward(self, output: Tensor) -> tuple[Tensor, Tensor]:
        """Split outputs [..., outputs] into candidates [..., K, A] and values [..., K]."""
        unit = output[..., : self.candidates * self.actions].clamp(0, 1)
        unit = unit.unflatten(-1, (self.candidates, self.actions))
        return self.low + unit * self.span, self.values(output)

    def values(self, output: Tensor) -> Tensor:
        """The values [..., K] alone."""
        if self.candidates == 1:
            return torch.zeros_like(output[..., :1])
        values = output[..., self.candidates * self.actions :]
        return values if self.value_range == (0.0, 1.0) else _scaled(values, self.value_range)


class DiscreteHeads(nn.Module):
    """Reads network outputs as the Q-values of discrete actions, as NEAT+Q and DQN have them.

    There are as many candidates K as actions, candidate k is the number k, and its value is
    output k.

    Args:
        actions: How many actions there are, at least 1.
        value_range: Q-values that the outputs 0 and 1 stand for, as in `CandidateHeads`.

    Raises:
        ValueError: If there is no action or the range is empty.
    """

    index: Tensor

    def __init__(self, actions: int, *, value_range: ValueRange = (0.0, 1.0)) -> None:
        super().__init__()
        if actions < 1:
            raise ValueError(f"expected at least 1 action, got {actions}")
        self.candidates = actions
        self.actions = 1
        self.value_range = _checked(value_range)
        index = torch.arange(actions, dtype=torch.get_default_dtype()).unsqueeze(-1)
        self.register_buffer("index", index, persistent=False)

    @property
    def outputs(self) -> int:
        """Network outputs that these heads read."""
        return self.candidates

    def forward(self, output: Tensor) -> tuple[Tensor, Tensor]:
        """The candidates [..., K, 1], numbers from 0, and their values [..., K]."""
        return self.index.expand(*output.shape, 1), self.values(output)

    def values(self, output: Tensor) -> Tensor:
        """The values [..., K] alone."""
        return output if self.value_range == (0.0, 1.0) else _scaled(output, self.value_range)


def _checked(value_range: ValueRange) -> ValueRange:
    low, high = value_range
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ValueError(f"value_range: expected finite low < high, got {low} and {high}")
    return low, high


def _scaled(values: Tensor, value_range: ValueRange) -> Tensor:
    low, high = value_range
    return low + (high - low) * values


def check_heads(network: PopulationNetwork, heads: Heads) -> None:
    """Raise ValueError unless the networks have the outputs that the heads read."""
    if network.outputs != heads.outputs:
        raise ValueError(
            f"{heads.candidates} candidates of {heads.actions} actions need {heads.outputs} "
            f"network outputs; the networks have {network.outputs}"
        )
