"""A state of its own for each network, in an optimiser that knows one parameter for all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn
from torch.optim import LBFGS, Optimizer

if TYPE_CHECKING:
    from neatq_torch.network.population import PopulationNetwork


class SeparateStates:
    """Hooks that let an optimiser see each network's row of weights as a parameter of its own.

    The rows share the memory of `weight` and stand in its parameter group, so they have its
    settings. For the time of a step they have the gradient, and `weight` has none. A network that
    was replaced since the step before begins with an empty state, and the states of the others
    grow with their rows.
    """

    def __init__(self, network: PopulationNetwork, optimizer: Optimizer) -> None:
        weight, groups = network.weight, optimizer.param_groups
        holding = [group for group in groups if any(one is weight for one in group["params"])]
        if len(holding) != 1:
            raise ValueError(
                "expected an optimiser over the weight of these networks, such as "
                f"torch.optim.Adam(network.parameters()); got one over {len(groups)} groups of "
                "other parameters"
            )
        if isinstance(optimizer, LBFGS):
            raise ValueError("LBFGS computes with all parameters as one: make one for each network")
        if weight in optimizer.state:
            raise ValueError("expected one that made no step yet; Adagrad has a state at once")
        self.network, self.births = network, list(network.births)
        self.rows = [nn.Parameter(row) for row in weight.detach()]
        self.gradient: Tensor | None = None
        holding[0]["params"].extend(self.rows)
        optimizer.register_step_pre_hook(self._before)
        optimizer.register_step_post_hook(self._after)

    def _before(self, optimizer: Optimizer, given: Any, named: Any) -> Any:
        """Before `optimizer.step(*given, **named)`; returns what it is called with instead."""
        self._deal(optimizer)
        closure = given[1] if len(given) > 1 else named.get("closure")
        if closure is None:
            return None

        def dealing() -> Any:
            self._after()  # gradients are for `weight` while the closure computes them
            loss = closure()
            self._deal(optimizer)
            return loss

        return (optimizer,), {**named, "closure": dealing}

    def _deal(self, optimizer: Optimizer) -> None:
        weight, births = self.network.weight, self.network.births
        self.gradient, weight.grad = weight.grad, None
        for slot, row in enumerate(self.rows):
            row.data = weight.data[slot]
            row.grad = None if self.gradient is None else self.gradient[slot]
            if births[slot] != self.births[slot]:
                optimizer.state.pop(row, None)
            self._grow(optimizer.state.get(row, {}), row)
        self.births = list(births)

    def _grow(self, state: dict[str, Any], row: Tensor) -> None:
        for name, value in state.items():
            if isinstance(value, Tensor) and value.ndim and len(value) != len(row):
                state[name] = nn.functional.pad(value, (0, len(row) - len(value)))

    def _after(self, *_: Any) -> None:
        weight = self.network.weight
        weight.grad, self.gradient = self.gradient, None
        for row in self.rows:
            row.grad = None
        torch.autograd.graph.increment_version(weight)
