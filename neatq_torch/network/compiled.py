"""The compiled kernels as a differentiable torch function."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import Parameter

from neatq_torch.network import kernels
from neatq_torch.network.population_plan import Plan


def serves(*tensors: Tensor) -> bool:
    """Whether the kernels can stand in for torch operations on these tensors.

    They need plain float32 tensors in the CPU's memory. Whoever traces, transforms or watches
    operations (export, compilation, `torch.func`, forward-mode derivatives, dispatch modes) must
    see torch operations.
    """
    for tensor in tensors:
        plain = type(tensor) is Tensor or type(tensor) is Parameter
        if not (plain and tensor.is_cpu and tensor.dtype is torch.float32):
            return False
    return not (
        torch.compiler.is_compiling()
        or torch._C._are_functorch_transforms_active()
        or torch._C._len_torch_dispatch_stack()
        or forward_ad._current_level >= 0
    )


def evaluate(
    plan: Plan, weight: Tensor, observation: Tensor, state: Tensor
) -> tuple[Tensor, Tensor]:
    """Evaluate every network on its observations: what `Levels.evaluate` computes.

    Args:
        plan: The evaluation order.
        weight: [networks, columns].
        observation: [networks, batch, inputs].
        state: [networks, batch, state], from the call before.

    Returns:
        Outputs [networks, batch, outputs] and the state for the next call.
    """
    if torch.is_grad_enabled() and (
        weight.requires_grad or observation.requires_grad or state.requires_grad
    ):
        return _Evaluate.apply(plan, weight, observation, state)
    return _forward(plan, weight, observation, state)


def _forward(
    plan: Plan, weight: Tensor, observation: Tensor, state: Tensor
) -> tuple[Tensor, Tensor]:
    networks, batch = observation.shape[:2]
    output = observation.new_empty(networks, batch, plan.layout.outputs)
    kept = state.new_empty(state.shape)
    kernel = kernels.forward_one if batch == 1 else kernels.forward
    arrays = kernels.Batch(*map(_array, (observation, state, output, kept)))
    kernel(plan.program, plan.layout.rows, _array(weight), arrays)
    return output, kept


def _array(tensor: Tensor) -> kernels.Floats:
    return tensor.detach().contiguous().numpy()


class _Evaluate(torch.autograd.Function):
    """`_forward` with gradients to weights, observations and state."""

    @staticmethod
    def forward(
        ctx: Any, plan: Plan, weight: Tensor, observation: Tensor, state: Tensor
    ) -> tuple[Tensor, Tensor]:
        output, kept = _forward(plan, weight, observation, state)
        ctx.plan, ctx.version = plan, plan.version
        ctx.save_for_backward(weight, observation, state, output)
        return output, kept

    @staticmethod
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, output_gradient: Tensor, kept_gradient: Tensor
    ) -> tuple[Tensor | None, ...]:
        weight, observation, state, output = ctx.saved_tensors
        if ctx.version != ctx.plan.version:
            raise RuntimeError(
                "a genome was replaced by an inplace operation between forward and backward"
            )
        wanted, gradients = ctx.needs_input_grad[1:], (output_gradient, kept_gradient)
        if torch.is_grad_enabled() or not serves(*gradients):
            return None, *_differentiable(ctx.plan, ctx.saved_tensors[:3], gradients, wanted)
        further = wanted[1] or wanted[2]
        weight_gradient = weight.new_zeros(weight.shape)
        into = [t.new_zeros(t.shape) if further else t for t in (observation, state)]
        kernels.backward(
            ctx.plan.program,
            ctx.plan.layout.rows,
            _array(weight),
            kernels.Batch(*map(_array, (observation, state, output, state))),
            _array(weight_gradient),
            kernels.Batch(*map(_array, (*into, *gradients))),
            further,
        )
        found = weight_gradient, *into
        return None, *(g if want else None for g, want in zip(found, wanted, strict=True))


def _differentiable(
    plan: Plan, inputs: tuple[Tensor, ...], gradients: tuple[Tensor, ...], wanted: tuple[bool, ...]
) -> list[Tensor | None]:
    """The gradients of `inputs` by torch operations, which can be differentiated again."""
    graph = torch.is_grad_enabled()
    with torch.enable_grad():
        outputs = plan.levels(inputs[0].device).evaluate(*inputs)
        chosen = [tensor for tensor, want in zip(inputs, wanted, strict=True) if want]
        found = iter(
            torch.autograd.grad(outputs, chosen, gradients, create_graph=graph, allow_unused=True)
        )
    return [next(found) if want else None for want in wanted]
