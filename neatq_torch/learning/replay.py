"""Stored transitions, and training on them before the first tick of a life."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import ReplayBuffer, RoundRobinWriter, TensorStorage

from neatq_torch.learning import compiled_wires
from neatq_torch.learning.heads import CandidateHeads
from neatq_torch.learning.learner import LearnerConfig, State, TDLearner
from neatq_torch.learning.objectives import CandidateTDLoss
from neatq_torch.learning.wire_fitting import WireFittingLoss
from neatq_torch.network import PopulationNetwork

_NOW = ("observation", "action", "steps_to_next_obs")
_NEXT = ("observation", "reward", "terminated")

PRETRAINING = LearnerConfig(learning_rate=0.01, optimizer="adam")


class TransitionMemory:
    """The latest transitions of a population, whoever made them.

    Keeps observation, action, reward, next observation and whether that was terminal; of the
    genome that acted it keeps nothing, so that any other can learn from them.

    Args:
        capacity: Transitions kept; the oldest make room.

    Raises:
        ValueError: If the capacity is less than 1.
    """

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"capacity: expected at least 1, got {capacity}")
        self.capacity = capacity
        self._clear()

    def _clear(self) -> None:
        self._buffer: ReplayBuffer | None = None
        self._added = 0

    def __len__(self) -> int:
        return min(self._added, self.capacity)

    def extend(self, batch: TensorDictBase) -> None:
        """Store transitions [...], the first of a flat order first.

        Those with `genome_id` -1 are left out. What arrives in another order is drawn in another
        order, so whoever collects in several places must merge in the order of the genomes.
        """
        if "steps_to_next_obs" not in batch.keys():
            batch = batch.copy().set("steps_to_next_obs", torch.ones_like(batch.get("genome_id")))
        own = batch.get("genome_id").squeeze(-1) >= 0
        now = {name: batch.get(name)[own] for name in _NOW}
        self._store(now, {name: batch.get(("next", name))[own] for name in _NEXT})

    def _store(self, now: dict[str, Tensor], following: dict[str, Tensor]) -> None:
        added = len(following["reward"])
        if added:
            rows = TensorDict(now | {"next": following}, [added])[-self.capacity :]
            if self._buffer is None:
                self._buffer = _buffer(rows[:1].expand(self.capacity).clone())
            self._buffer.extend(rows)
            self._added += len(rows)

    def sample(self, size: int, generator: torch.Generator) -> TensorDictBase:
        """Draw so many transitions with replacement [size]; all chance is the generator's.

        Raises:
            ValueError: If nothing is stored.
        """
        if not len(self):
            raise ValueError("expected stored transitions to draw from, got none: extend first")
        return self._rows(torch.randint(len(self), (size,), generator=generator))

    def _rows(self, ages: Tensor) -> TensorDictBase:
        """Transitions by age, 0 for the oldest."""
        # Not by place: what is restored stands in other places.
        assert self._buffer is not None
        oldest = self._added % self.capacity if self._added > self.capacity else 0
        return self._buffer[(ages + oldest) % len(self)]

    def state(self) -> State:
        """All transitions, the oldest first."""
        if not len(self):
            return {}
        rows = self._rows(torch.arange(len(self)))
        state: State = {name: rows.get(name) for name in _NOW}
        return state | {f"next_{name}": rows.get(("next", name)) for name in _NEXT}

    def load_state(self, state: State) -> None:
        """Go on from `state`."""
        self._clear()
        if state:
            one = torch.ones(len(state["next_reward"]), 1, dtype=torch.long)
            state = {"steps_to_next_obs": one} | state
            now = {name: torch.as_tensor(state[name]) for name in _NOW}
            following = {name: torch.as_tensor(state[f"next_{name}"]) for name in _NEXT}
            self._store(now, following)


def _buffer(space: TensorDict) -> ReplayBuffer:
    """A buffer for as many rows as `space` has.

    Not a lazy storage, which prints a line when it finds out what it holds; and `compilable`, as
    otherwise every count is shared memory with a semaphore, left behind when a process is ended.
    """
    storage = TensorStorage(space, compilable=True)
    return ReplayBuffer(storage=storage, writer=RoundRobinWriter(compilable=True), compilable=True)


def over_horizon(batch: TensorDictBase, ticks: int, discount: float) -> TensorDict:
    """Transitions that reach so many ticks ahead, for n-step returns (Sutton 1988).

    The reward is the discounted sum r_1 + gamma r_2 + ... up to the state that is next now; it
    ends early where the life or the batch does. How many ticks that were stands in
    `steps_to_next_obs`, from which TorchRL's estimators take the discount of what follows. What
    was done in these ticks was not this network's choice; nothing corrects for that.

    Args:
        batch: [..., ticks] with `observation`, `action`, `genome_id` and
            `("next", observation / reward / terminated / done)`.
        ticks: n, at least 1.
        discount: gamma.
    """
    reward, done = (batch.get(("next", name))[..., 0] for name in ("reward", "done"))
    total, steps, alive = reward.clone(), torch.ones_like(done, dtype=torch.long), ~done
    length = reward.shape[-1]
    for ahead in range(1, min(ticks, length)):
        going_on = alive[..., : length - ahead]
        total[..., : length - ahead] += discount**ahead * reward[..., ahead:] * going_on
        steps[..., : length - ahead] += going_on
        going_on &= ~done[..., ahead:]
        alive[..., length - ahead :] = False
    last = torch.arange(length).to(steps.device) + steps - 1
    seen = batch.get(("next", "observation"))
    following = {
        "observation": seen.gather(-2, last.unsqueeze(-1).expand_as(seen)),
        "reward": total.unsqueeze(-1),
        "terminated": batch.get(("next", "terminated"))[..., 0].gather(-1, last).unsqueeze(-1),
    }
    now = {name: batch.get(name) for name in ("observation", "action", "genome_id")}
    now["steps_to_next_obs"] = steps.unsqueeze(-1)
    return TensorDict(now | {"next": following}, batch.batch_size)


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
        lessons = compiled_wires.lessons_of(learner, [drawn[row] for row in memory_of], steps)
        pupils = compiled_wires.pupils_of(learner)
        return torch.from_numpy(compiled_wires.learn(pupils, learner, lessons)).view(network.shape)
    error = torch.zeros_like(network.genome_id, dtype=torch.float32)
    for step in range(steps):
        part = [rows[step * batch : (step + 1) * batch] for rows in drawn]
        error = learner.update(_for_all(network, part, memory_of))
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
    network: PopulationNetwork, drawn: Sequence[TensorDictBase], rows: Sequence[int]
) -> TensorDict:
    """A minibatch [size] of each memory as transitions [arenas, robots, size] of every network."""
    shape = (*network.shape, len(drawn[0]))

    def spread(name: str | tuple[str, str]) -> Tensor:
        own = torch.stack([each.get(name) for each in drawn])[list(rows)].to(network.weight.device)
        return own.unsqueeze(1).expand(*shape, own.shape[-1])

    now = {name: spread(name) for name in _NOW}
    following = {name: spread(("next", name)) for name in _NEXT}
    # Every transition is an episode of its own, so that no return goes on into the next row.
    following["done"] = torch.ones_like(following["terminated"])
    now["candidate_index"] = now["action"][..., 0].long()
    now["genome_id"] = network.genome_id[..., None, None].expand(*shape, 1)
    if network.state_size:
        now["network_state"] = network.initial_state(shape[-1:])
        following["network_state"] = network.initial_state(shape[-1:])
    return TensorDict(now | {"next": following}, shape)
