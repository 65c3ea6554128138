"""How strongly outputs react to each weight: safe mutation through gradients."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from neatq_torch.genome.genome import Genome
from neatq_torch.network.plan import Evaluation
from neatq_torch.network.population import PopulationNetwork

TICKS = 4
"""Ticks for which a network with a state sees an observation."""
WIDEST = 10.0
"""How many times more or less than that of the median link a perturbation may be."""


def sensitivity(
    genome: Genome, observation: Tensor, *, evaluation: Evaluation = "settle"
) -> NDArray[np.float64]:
    """How strongly the outputs of a genome's network react to each of its weights.

    The measure SM-G-SUM of Lehman et al. (2018), s_i = sqrt(sum_k g_ki^2), where g_ki is the
    gradient of output k by weight i, here its mean over the observations. Networks that read what
    they did before, recurrent or synchronous, see each observation for four ticks.

    Args:
        genome: The genome.
        observation: Observations to react to [observations, inputs].
        evaluation: How its network is evaluated.

    Returns:
        Float64 [links]; 0 for links that are disabled or reach no output.
    """
    network = PopulationNetwork([genome], evaluation=evaluation)
    seen = observation.to(network.weight).unsqueeze(0)
    output = _settled(network, seen).mean((0, 1))
    total = torch.zeros_like(network.weight)
    for one in output:
        total += torch.autograd.grad(one, network.weight, retain_graph=True)[0].square()
    nothing = np.zeros(genome.link_weight.size, np.float32)
    return network.by_link(0, total[0].sqrt().numpy(), nothing).astype(np.float64)


def _settled(network: PopulationNetwork, observation: Tensor) -> Tensor:
    """Outputs [1, observations, outputs], differentiable through all ticks."""
    output, state = network.step(observation, network.initial_state(observation.shape[1:2]))
    for _ in range(TICKS - 1 if network.state_size else 0):
        output, state = network.step(observation, state)
    return output


def perturbation_scales(
    genome: Genome, observation: Tensor, *, evaluation: Evaluation = "settle"
) -> NDArray[np.float64]:
    """Scales by which perturbations of weights change the outputs about as much on every link.

    A scale is the inverse of the link's sensitivity. Relative to the median link's it is clipped to
    [1 / 10, 10], so that a link which does nothing today neither runs away nor stops all others;
    then the mean is made 1, so that a genome mutates neither more nor less than others. Links
    without any sensitivity, of which nothing is known, have the scale 1.

    Args:
        genome: The genome to be mutated.
        observation: See `sensitivity`.
        evaluation: See `sensitivity`.

    Returns:
        Float64 [links] with the mean 1.
    """
    reaction = sensitivity(genome, observation, evaluation=evaluation)
    scales, known = np.ones(reaction.size), reaction > 0
    if known.any():
        inverse = np.median(reaction[known]) / reaction[known]
        inverse = inverse.clip(1 / WIDEST, WIDEST)
        scales[known] = inverse / inverse.mean()
    return scales
