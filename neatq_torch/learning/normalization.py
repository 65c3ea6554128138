"""Observations brought to mean 0 and standard deviation 1, as they come."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

LEAST_DEVIATION = 0.1


class RunningNormalization:
    """Running mean and variance of what all networks of an arena have seen (Welford 1962).

    What networks read is (observation - mean) / deviation, clipped, where the deviation is the
    standard deviation, but at least 0.1. All genomes of an arena have the same; an arena's does
    not depend on those beside.

    Args:
        arenas: Independent populations.
        inputs: Numbers of an observation.
        least: The least deviation: nothing is stretched by more than its inverse, as what hardly
            ever changed would come out huge.
        largest: What comes out is clipped to [-largest, largest].

    Attributes:
        count: Observations so far, float64 [arenas].
        mean: Of each number, float64 [arenas, inputs].
        spread: Sum of squared distances from the mean, float64 [arenas, inputs].

    Example:
        >>> normalization = RunningNormalization(1, 4)
        >>> normalization.add(torch.rand(1, 50, 20, 4), torch.ones(1, 50, 20, dtype=torch.bool))
        >>> normalization(torch.rand(1, 50, 4)).shape
        torch.Size([1, 50, 4])
    """

    def __init__(
        self, arenas: int, inputs: int, *, least: float = LEAST_DEVIATION, largest: float = np.inf
    ) -> None:
        self.least, self.largest = least, largest
        self.count = torch.zeros(arenas, dtype=torch.float64)
        self.mean, self.spread = torch.zeros(2, arenas, inputs, dtype=torch.float64)

    def add(self, observation: Tensor, counts: Tensor) -> None:
        """Count observations [arenas, ..., inputs], those that a mask [arenas, ...] names."""
        for arena, (seen, counted) in enumerate(zip(observation, counts, strict=True)):
            new = seen[counted].double()
            if not len(new):
                continue
            before, mean = self.count[arena].clone(), new.mean(0)
            total, apart = before + len(new), mean - self.mean[arena]
            self.count[arena] = total
            self.mean[arena] += apart * (len(new) / total)
            self.spread[arena] += (new - mean).square().sum(0)
            self.spread[arena] += apart.square() * (before * len(new) / total)

    @property
    def deviation(self) -> Tensor:
        """By which observations are divided, float64 [arenas, inputs]; 1 before there are any."""
        variance = self.spread / self.count.clamp_min(1).unsqueeze(1)
        counted = self.count.unsqueeze(1) > 0
        return torch.where(counted, variance.sqrt().clamp_min(self.least), 1.0)

    def __call__(self, observation: Tensor, arena: int | None = None) -> Tensor:
        """Observations as networks read them, of the same shape and type.

        Args:
            observation: [arenas, ..., inputs]; of one `arena` [..., inputs].
            arena: Whose they are; None: those of all.
        """
        mean, deviation = self.mean.to(observation.device), self.deviation.to(observation.device)
        if arena is not None:
            mean, deviation = mean[arena], deviation[arena]
        else:
            shape = (len(mean), *(1,) * (observation.ndim - 2), mean.shape[1])
            mean, deviation = mean.view(shape), deviation.view(shape)
        normal = (observation.double() - mean) / deviation
        return normal.clamp(-self.largest, self.largest).to(observation.dtype)

    def state_dict(self) -> dict[str, Any]:
        """All numbers."""
        return {"count": self.count, "mean": self.mean, "spread": self.spread}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state`."""
        for name, own in self.state_dict().items():
            own.copy_(torch.as_tensor(np.asarray(state[name])))
