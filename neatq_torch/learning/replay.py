"""Training on stored transitions, before the first tick of a life or during it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from neatq_torch.learning import compiled_wires
from neatq_torch.learning.heads import CandidateHeads
from neatq_torch.learning.learner import LearnerConfig, TDLearner
from neatq_torch.learning.memory import NEXT, NOW, TransitionMemory, summed_up
from neatq_torch.learning.objectives import CandidateTDLoss
from neatq_torch.learning.wire_fitting import WireFittingLoss
from neatq_torch.network import PopulationNetwork

PRETRAINING = LearnerConfig(learning_rate=0.01, optimizer="adam")


def pretrain(
    network: PopulationNetwork,
    loss: CandidateTDLoss,
    memories: Sequence[TransitionMemory],
    config: LearnerConfig = PRETRAINING,
    *,
    steps: int,
    batch: int,
    generators: Sequence[torch.Generator],
    memory_of: Sequence[int] | None = None,
) -> Tensor:
    """Train every network on stored transitions of its arena, before its first tick.

    It costs no sample: newborns begin with what the population has seen (Whiteson & Stone 2006,
    "Sample-efficient evolutionary function approximation"). All networks that learn from a memory
    see the same minibatches, drawn once by the memory's generator alone, and each bootstraps from
    its own values; so the result does not depend on what other networks stand beside. Errors are
    one-step.

    The action of a stored transition is no candidate of another genome. With discrete actions it is
    the candidate of that number. Continuous ones are learnt from by the value that a
    `WireFittingLoss` interpolates for them. Recurrent state counts as empty before every
    transition.

    Args:
        network: Networks of shape (arenas, robots), changed in place.
        loss: A loss over that network, with reduction `sum`.
        memories: One for each arena; or any, if `memory_of` says who learns from which.
        config: Learning rate, for the gradient summed over a minibatch, and optimiser.
        steps: Minibatches.
        batch: Transitions of a minibatch.
        generators: One for each memory, on the CPU.
        memory_of: The place in `memories` from which the robots of each arena learn [arenas].
            None: each arena has its own.

    Returns:
        Mean squared TD error of each network on the last minibatch [*shape].

    Raises:
        ValueError: If steps or batch is less than 1, there is not one memory for each arena and one
            generator for each memory, a memory is empty, or a loss by candidate is asked to learn
            from continuous actions.
    """
    if steps < 1 or batch < 1:
        raise ValueError(f"expected at least 1 step and 1 transition, got {steps} and {batch}")
    rows = list(range(len(memories)) if memory_of is None else memory_of)
    _check(network.shape[0], loss, memories, generators, rows)
    learner = TDLearner(network, loss, config)
    learner.reset(torch.ones_like(network.genome_id, dtype=torch.bool))
    return rehearse(learner, memories, generators, rows, steps=steps, batch=batch)


def rehearse(
    learner: TDLearner,
    memories: Sequence[TransitionMemory],
    generators: Sequence[torch.Generator],
    memory_of: Sequence[int],
    *,
    steps: int,
    batch: int,
) -> Tensor:
    """Let a learner take steps on stored transitions; for the arguments see `pretrain`.

    Compiled code takes the steps where it can (`compiled_wires.serves`), up to rounding the same.

    Returns:
        Mean squared TD error of each network on the last minibatch [*shape].
    """
    drawn = draw(memories, generators, steps * batch)
    network = learner.network
    if compiled_wires.serves(learner):
        own = None if learner.loss.discount is None else learner.loss.discount.flatten()
        shared = [drawn[row] for row in memory_of]
        lessons = compiled_wires.lessons_of(learner, shared, steps, own)
        pupils = compiled_wires.pupils_of(learner)
        return torch.from_numpy(compiled_wires.learn(pupils, learner, lessons)).view(network.shape)
    error = torch.zeros_like(network.genome_id, dtype=torch.float32)
    for step in range(steps):
        part = [rows[step * batch : (step + 1) * batch] for rows in drawn]
        error = learner.update(_for_all(learner, part, memory_of))
    return error


def draw(
    memories: Sequence[TransitionMemory], generators: Sequence[torch.Generator], size: int
) -> list[TensorDictBase]:
    """So many transitions of each memory, by its own generator."""
    pairs = zip(memories, generators, strict=True)
    return [memory.sample(size, generator) for memory, generator in pairs]


def _check(
    arenas: int,
    loss: CandidateTDLoss,
    memories: Sequence[TransitionMemory],
    generators: Sequence[torch.Generator],
    rows: Sequence[int],
) -> None:
    if len(rows) != arenas or len(generators) != len(memories):
        raise ValueError(
            f"expected one memory for each of {arenas} arenas and one generator for each memory, "
            f"got {len(rows)} and {len(generators)}"
        )
    if not all(0 <= row < len(memories) for row in rows):
        raise ValueError(
            f"memory_of: expected numbers from 0 to {len(memories) - 1}, got {list(rows)}"
        )
    candidates = isinstance(loss.value_network.heads, CandidateHeads)
    if candidates and not isinstance(loss, WireFittingLoss):
        raise ValueError(
            "a stored continuous action is no candidate of another genome; use a WireFittingLoss"
        )


def _for_all(
    learner: TDLearner, drawn: Sequence[TensorDictBase], rows: Sequence[int]
) -> TensorDict:
    """A minibatch [size] of each memory as transitions [arenas, robots, size] of every network."""
    network, discount = learner.network, learner.loss.discount
    shape = (*network.shape, len(drawn[0]))

    def spread(name: str | tuple[str, str]) -> Tensor:
        own = torch.stack([each.get(name) for each in drawn])[list(rows)].to(network.weight.device)
        return own.unsqueeze(1).expand(*shape, own.shape[-1])

    now = {name: spread(name) for name in NOW}
    following = {name: spread(("next", name)) for name in NEXT}
    if discount is not None:
        following["reward"] = summed_up(following["reward"], discount.unsqueeze(-1))
    # Every transition is an episode of its own, so that no return goes on into the next row.
    following["done"] = torch.ones_like(following["terminated"])
    now["candidate_index"] = now["action"][..., 0].long()
    now["genome_id"] = network.genome_id[..., None, None].expand(*shape, 1)
    if network.state_size:
        now["network_state"] = network.initial_state(shape[-1:])
        following["network_state"] = network.initial_state(shape[-1:])
    return TensorDict(now | {"next": following}, shape)
