"""Compiled descent: Adam's steps, where there is nothing to learn for long, too."""

from __future__ import annotations

import numpy as np
import torch

from neatq_torch.learning.compiled_descent import descend
from neatq_torch.learning.learner import ADAM_BETAS, ADAM_EPSILON

RATE, STEPS, LEARNT = 1e-3, 1500, 100
"""Of a gradient that comes for a while, and then is 0."""


def test_a_gradient_that_is_0_for_long_leaves_adams_weights_and_no_subnormal_moment() -> None:
    rng = np.random.default_rng(0)
    weight = rng.normal(size=(2, 8)).astype(np.float32)
    wanted = torch.nn.Parameter(torch.tensor(weight))
    adam = torch.optim.Adam([wanted], lr=RATE, betas=ADAM_BETAS, eps=ADAM_EPSILON)
    first, second = np.zeros_like(weight), np.zeros_like(weight)
    second[:, :2] = 1e-38  # from long ago
    steps, rates = np.zeros(2, np.float32), np.full(2, RATE, np.float32)
    for step in range(STEPS):
        gradient = rng.normal(size=weight.shape).astype(np.float32)
        gradient[:, : 4 if step < LEARNT else 6] = 0
        wanted.grad = torch.tensor(gradient)
        adam.step()
        descend(weight, gradient, (first, second), steps, rates, True)
    np.testing.assert_allclose(weight, wanted.detach().numpy(), atol=2e-5)
    for moment in (first, second):
        assert (np.abs(moment[moment != 0]) >= np.finfo(np.float32).tiny).all()
    assert (first[:, 4:6] == 0).all()  # it faded
    assert first[:, 6:].all()
