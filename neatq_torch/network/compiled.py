"""The compiled kernels as a differentiable torch function."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch._C._functorch import is_legacy_batchedtensor
from torch.autograd import forward_ad
from torch.nn import Parameter

from neatq_torch.network import kernels
from neatq_torch.network.levels import Plan

_STATELESS = np.empty((1, 1, 0), np.float32)


def accepts(*tensors: Tensor) -> bool:
    """Whether the kernels can stand in for torch operations on these tensors.

    They need plain float32 tensors in the CPU's memory. Whoever traces, transforms or watches
    operations (export, compilation, `torch.jit.trace`, `torch.func`, forward-mode derivatives,
    dispatch modes) must see torch operations.
    """
    for tensor in tensors:
        plain = type(tensor) is Tensor or type(tensor) is Parameter
        if not (plain and tensor.is_cpu and tensor.dtype is torch.float32):
            return False
    return not (
        torch.compiler.is_compiling()
        or torch._C._get_tracing_state() is not None
        or torch._C._are_functorch_transforms_active()
        or torch._C._len_torch_dispatch_stack()
        or forward_ad._current_level >= 0
    )


def evaluate(
    plan: Plan, weight: Tensor, observation: Tensor, state: Tensor
) -> tuple[Tensor, Tensor]:
    """Evaluate every network on its observations, as `Levels.evaluate` does."""
    if torch.is_grad_enabled() and (
        weight.requires_grad or observation.requires_grad or state.requires_grad
    ):
        output, kept = _Evaluate.apply(plan, weight, observation, state)
        return output, state if kept is None else kept
    return _forward(plan, weight, observation, state)


def _forward(
    plan: Plan, weight: Tensor, observation: Tensor, state: Tensor
) -> tuple[Tensor, Tensor]:
    layout = plan.layout
    # torch's own `empty` costs a few percent of a call more.
    output = torch.from_numpy(np.empty((*observation.shape[:-1], layout.outputs), np.float32))
    kept = torch.from_numpy(np.empty(state.shape, np.float32)) if layout.state else state
    batch = _batch(plan, observation, state, output, kept)
    kernels.forward(plan.program, layout.rows, plan.widened(_floats(weight)), *batch)
    return output, kept


def _batch(
    plan: Plan, observation: Tensor, state: Tensor, output: Tensor, kept: Tensor
) -> kernels.Batch:
    layout, networks = plan.layout, len(plan.program.size)
    size = output.numel() // (networks * layout.outputs)
    memory = _floats(state).reshape(networks, size, layout.state) if layout.state else _STATELESS
    return kernels.Batch(
        _floats(observation).reshape(networks, size, layout.inputs),
        memory,
        _floats(output).reshape(networks, size, layout.outputs),
        memory if kept is state else _floats(kept).reshape(memory.shape),
    )


def _floats(tensor: Tensor) -> kernels.Floats:
    """The memory of a tensor, or a copy if it is not contiguous."""
    if tensor.requires_grad:
        tensor = tensor.detach()
    return np.ascontiguousarray(tensor.numpy())


class _Evaluate(torch.autograd.Function):
    """`_forward` with gradients to weights, observations and state."""

    @staticmethod
    def forward(
        ctx: Any, plan: Plan, weight: Tensor, observation: Tensor, state: Tensor
    ) -> tuple[Tensor, Tensor | None]:
        output, kept = _forward(plan, weight, observation, state)
        ctx.plan, ctx.version = plan, plan.version
        ctx.save_for_backward(weight, observation, state, output)
        return output, kept if plan.layout.state else None

    @staticmethod
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, output_gradient: Tensor, kept_gradient: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        weight, observation, state, output = ctx.saved_tensors
        plan: Plan = ctx.plan
        if ctx.version != plan.version:
            raise RuntimeError(
                "a genome was replaced by an inplace operation between forward and backward"
            )
        gradients = output_gradient, state if kept_gradient is None else kept_gradient
        wanted = ctx.needs_input_grad[1:]
        if (
            torch.is_grad_enabled()
            or not accepts(*gradients)
            or is_legacy_batchedtensor(gradients[0])
        ):
            return None, *_by_torch(plan, ctx.saved_tensors[:3], gradients, wanted)
        further = wanted[1] or wanted[2]
        links = plan.widened(_floats(weight))
        change = np.zeros(links.shape, np.float32)
        seen, before = (tensor.new_zeros(tensor.shape) for tensor in (observation, state))
        kernels.backward(
            plan.program,
            plan.layout.rows,
            links,
            _batch(plan, observation, state, output, state),
            change,
            _batch(plan, seen, before, *gradients),
            further,
        )
        found = torch.from_numpy(plan.narrowed(change)), seen, before
        return None, *(g if want else None for g, want in zip(found, wanted, strict=True))


def _by_torch(
    plan: Plan, inputs: tuple[Tensor, ...], gradients: tuple[Tensor, ...], wanted: tuple[bool, ...]
) -> list[Tensor | None]:
    """The gradients of `inputs` by torch operations, which can be differentiated again."""
    graph = torch.is_grad_enabled()
    with torch.enable_grad():
        outputs = plan.levels(inputs[0].device).evaluate(*inputs)
        if not plan.layout.state:
            outputs, gradients = outputs[:1], gradients[:1]
        chosen = [tensor for tensor, want in zip(inputs, wanted, strict=True) if want]
        found = iter(
            torch.autograd.grad(outputs, chosen, gradients, create_graph=graph, allow_unused=True)
        )
    return [next(found) if want else None for want in wanted]
