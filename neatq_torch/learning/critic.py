"""Two perceptrons that tell what an action is worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from itertools import pairwise

import torch
from torch import Tensor, nn


class TwinCritic(nn.Module):
    """Two perceptrons of Q-values side by side, each of two hidden layers of ReLUs.

    Args:
        inputs: Numbers that they read.
        outputs: Q-values that each puts out.
        width: Nodes of a hidden layer.
        generator: All chance of the first weights, U(-1, 1) / sqrt(numbers read) in each layer.

    Example:
        >>> critic = TwinCritic(4, 1, 64, torch.Generator().manual_seed(0))
        >>> critic(torch.rand(256, 4)).shape
        torch.Size([2, 256, 1])
    """

    def __init__(self, inputs: int, outputs: int, width: int, generator: torch.Generator) -> None:
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for before, after in pairwise((inputs, width, width, outputs)):
            for kept, shape in ((self.weights, (2, before, after)), (self.biases, (2, 1, after))):
                drawn = torch.rand(shape, generator=generator) * 2 - 1
                kept.append(nn.Parameter(drawn / math.sqrt(before)))

    def forward(self, rows: Tensor) -> Tensor:
        """Q-values [2, rows, outputs] of rows [rows, inputs]."""
        layers = zip(self.weights, self.biases, strict=True)
        return _perceptron(torch.baddbmm, rows.expand(2, *rows.shape), layers)

    def first(self, rows: Tensor) -> Tensor:
        """Q-values [rows, outputs] by the first of the two."""
        layers = zip(self.weights, self.biases, strict=True)
        return _perceptron(torch.addmm, rows, ((weight[0], bias[0]) for weight, bias in layers))


def _perceptron(
    times: Callable[[Tensor, Tensor, Tensor], Tensor],
    rows: Tensor,
    layers: Iterable[tuple[Tensor, Tensor]],
) -> Tensor:
    *hidden, (weight, bias) = layers
    for one, constant in hidden:
        rows = torch.relu(times(constant, rows, one))
    return times(bias, rows, weight)
