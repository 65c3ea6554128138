"""Two perceptrons that tell what an action is worth."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn


class Minibatch(NamedTuple):
    """What a critic learns from.

    Attributes:
        rows: What it reads of what was done [size, inputs].
        taken: The output that tells its value, int64 [size].
        reward: What it brought [size].
        following: What it reads of what came next [size, inputs].
        ahead: Weight of the value of that, 0 where it was terminal [size].
    """

    rows: Tensor
    taken: Tensor
    reward: Tensor
    following: Tensor
    ahead: Tensor


class TwinCritic(nn.Module):
    """Two perceptrons of Q-values side by side, each of two hidden layers of ReLUs.

    Args:
        inputs: Numbers that they read.
        outputs: Q-values that each puts out.
        width: Nodes of a hidden layer.
        generator: All chance of the first weights, U(-1, 1) / sqrt(numbers read) in each layer.

    Attributes:
        weight: All weights and biases of each [2, numbers].

    Example:
        >>> critic = TwinCritic(4, 1, 64, torch.Generator().manual_seed(0))
        >>> critic(torch.rand(256, 4)).shape
        torch.Size([2, 256, 1])
    """

    def __init__(self, inputs: int, outputs: int, width: int, generator: torch.Generator) -> None:
        super().__init__()
        self.sizes = inputs, width, width, outputs
        drawn = [
            (torch.rand(2, (before + 1) * after, generator=generator) * 2 - 1) / math.sqrt(before)
            for before, after in pairwise(self.sizes)
        ]
        self.weight = nn.Parameter(torch.cat(drawn, 1))

    def layers(self) -> list[Tensor]:
        """The weights of each layer [2, numbers read + 1, nodes], the biases last."""
        shapes = [(before + 1, after) for before, after in pairwise(self.sizes)]
        parts = self.weight.split([math.prod(shape) for shape in shapes], 1)
        return [part.view(2, *shape) for part, shape in zip(parts, shapes, strict=True)]

    def forward(self, rows: Tensor) -> Tensor:
        """Q-values [2, rows, outputs] of rows [rows, inputs]."""
        rows = rows.expand(2, *rows.shape)
        *hidden, last = self.layers()
        for layer in hidden:
            rows = torch.relu(torch.baddbmm(layer[:, -1:], rows, layer[:, :-1]))
        return torch.baddbmm(last[:, -1:], rows, last[:, :-1])

    @torch.no_grad()
    def slope(self, rows: Tensor) -> Tensor:
        """Of the first one's only output, by what it reads: dQ1 / drows [rows, inputs].

        In place of autograd, which takes three times as long for as few rows as a network learns
        from at once.
        """
        *hidden, last = (layer[0] for layer in self.layers())
        active = []
        for layer in hidden:
            rows = torch.relu_(torch.addmm(layer[-1], rows, layer[:-1]))
            active.append(rows > 0)
        slope = last[:-1].T.expand_as(rows)
        for layer, on in zip(reversed(hidden), reversed(active), strict=True):
            slope = (slope * on) @ layer[:-1].T
        return slope
