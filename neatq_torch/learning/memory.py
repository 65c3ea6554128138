"""What a population remembers of its past, for networks to learn from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from neatq_torch.jit import cached_njit
from neatq_torch.learning.learner import Saved

NOW = ("observation", "action", "steps_to_next_obs")
NEXT = ("observation", "reward", "terminated")


class TransitionMemory:
    """The latest transitions of a population, whoever made them.

    Keeps observation, action, reward, next observation, how many ticks lie between the two
    (`steps_to_next_obs`, 1 where nothing is said) and whether the latter was terminal; of the
    genome that acted it keeps nothing, so that any other can learn from them.

    Args:
        capacity: Transitions kept; the oldest make room.
        device: Where they are kept.

    Raises:
        ValueError: If the capacity is less than 1.
    """

    def __init__(self, capacity: int, device: torch.device | str = "cpu") -> None:
        if capacity < 1:
            raise ValueError(f"capacity: expected at least 1, got {capacity}")
        self.capacity, self.device = capacity, torch.device(device)
        self._columns: dict[str, Tensor] = {}
        self._added = 0

    def __len__(self) -> int:
        return min(self._added, self.capacity)

    def extend(self, batch: TensorDictBase) -> None:
        """Store transitions [...], the first of a flat order first.

        Those with `genome_id` -1 are left out. What arrives in another order is drawn in another
        order, so whoever collects apart must merge in the order of the genomes.
        """
        own = batch.get("genome_id").squeeze(-1) >= 0
        steps = batch.get("steps_to_next_obs", torch.ones_like(batch.get("genome_id")))
        columns = {name: batch.get(name) for name in NOW[:2]} | {NOW[2]: steps}
        columns |= {f"next_{name}": batch.get(("next", name)) for name in NEXT}
        self._store({name: column[own] for name, column in columns.items()})

    def _store(self, rows: dict[str, Tensor]) -> None:
        rows = {name: column[-self.capacity :] for name, column in rows.items()}
        added = len(rows["next_reward"])
        if not self._columns:
            self._columns = {
                name: column.new_zeros(self.capacity, *column.shape[1:], device=self.device)
                for name, column in rows.items()
            }
        rooms = ((self._added + torch.arange(added)) % self.capacity).to(self.device)
        for name, column in rows.items():
            self._columns[name].index_copy_(0, rooms, column.to(self.device))
        self._added += added

    def sample(self, size: int, generator: torch.Generator) -> TensorDictBase:
        """Draw so many transitions with replacement [size]; all chance is the generator's.

        Raises:
            ValueError: If nothing is stored.
        """
        rows = self.draw(size, generator)
        following = {name: rows[f"next_{name}"] for name in NEXT}
        return TensorDict({name: rows[name] for name in NOW} | {"next": following}, [size])

    def draw(self, size: int, generator: torch.Generator, *names: str) -> Saved:
        """As `sample`, but plain columns, those of `next` with that before their names.

        Only those columns that are named, or all.
        """
        if not len(self):
            raise ValueError("expected stored transitions to draw from, got none: extend first")
        return self._rows(torch.randint(len(self), (size,), generator=generator), names)

    def _rows(self, ages: Tensor, names: Sequence[str] = ()) -> Saved:
        """Transitions by age, 0 for the oldest."""
        # Not by where they stand: what is restored stands elsewhere.
        oldest = self._added % self.capacity if self._added > self.capacity else 0
        rooms = ((ages + oldest) % self.capacity).to(self.device)
        # A quarter of the time that brackets take.
        return {name: self._columns[name].index_select(0, rooms) for name in names or self._columns}

    def state_dict(self) -> Saved:
        """All transitions, the oldest first."""
        return self._rows(torch.arange(len(self)))

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        self._columns, self._added = {}, 0
        if state:
            one = torch.ones(len(state["next_reward"]), 1, dtype=torch.long)
            rows = {"steps_to_next_obs": one} | state
            self._store({name: torch.as_tensor(column) for name, column in rows.items()})


def over_horizon(
    batch: TensorDictBase, ticks: int, discount: float | None, *, keep_every: int = 1
) -> TensorDict:
    """Transitions that reach so many ticks ahead, for n-step returns (Sutton 1988).

    The reward is the discounted sum r_1 + gamma r_2 + ... up to the state that is next now; it
    ends early where the life or the batch does, and where somebody else, or nobody, acts from then
    on. How many ticks that were stands in `steps_to_next_obs`, from which TorchRL's estimators take
    the discount of what follows. What was done in these ticks was not the choice of whoever learns
    from it; nothing corrects for that.

    Args:
        batch: [..., ticks] with `observation`, `action`, `genome_id` and
            `("next", observation / reward / terminated / done)`.
        ticks: n, at least 1.
        discount: gamma. None: the rewards are left as they are, a column for each tick and 0 after
            the last, for networks that weigh them by a gamma of their own (`summed_up`).
        keep_every: Of the ticks of the batch, one in so many begins a transition.

    Returns:
        The transitions [..., kept], on the CPU.
    """
    reward, done, owner = (
        batch.get(name).cpu().reshape(-1, batch.shape[-1]).numpy()
        for name in (("next", "reward"), ("next", "done"), "genome_id")
    )
    done = done.copy()
    done[:, :-1] |= owner[:, 1:] != owner[:, :-1]
    own = discount is None
    rewards, steps = _ahead(reward, done, ticks, 1.0 if own else discount, keep_every, own)
    shape = (*batch.shape[:-1], steps.shape[-1], 1)
    ahead = torch.from_numpy(steps).view(shape)
    first = torch.arange(0, batch.shape[-1], keep_every).unsqueeze(-1)

    def at(name: str, ticks: Tensor) -> Tensor:
        values = batch.get(("next", name)).cpu()
        return values.gather(-2, ticks.expand(*shape[:-1], values.shape[-1]))

    following = {name: at(name, first + ahead - 1) for name in ("observation", "terminated")}
    following["reward"] = torch.from_numpy(rewards).view(*shape[:-1], -1)
    names = ("observation", "action", "genome_id")
    now = {name: batch.get(name)[..., ::keep_every, :].cpu() for name in names}
    return TensorDict(now | {"steps_to_next_obs": ahead, "next": following}, shape[:-1])


@cached_njit()
def _ahead(
    reward: NDArray[np.float32],
    done: NDArray[np.bool_],
    ticks: int,
    discount: float,
    keep_every: int,
    by_tick: bool,
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Rewards [robots, kept, 1: the discounted sum, or one a tick], and of how many ticks."""
    robots, length = reward.shape
    kept = (length + keep_every - 1) // keep_every
    rewards = np.zeros((robots, kept, ticks if by_tick else 1), np.float32)
    steps = np.zeros((robots, kept), np.int64)
    for robot in range(robots):
        for begun in range(kept):
            first, weight, total = begun * keep_every, 1.0, 0.0
            for tick in range(first, min(first + ticks, length)):
                if by_tick:
                    rewards[robot, begun, tick - first] = reward[robot, tick]
                total += weight * reward[robot, tick]
                weight *= discount
                steps[robot, begun] += 1
                if done[robot, tick]:
                    break
            if not by_tick:
                rewards[robot, begun, 0] = total
    return rewards, steps


def summed_up(rewards: Tensor, discount: Tensor) -> Tensor:
    """Discounted sums [..., 1] of rewards by tick [..., ticks], by a gamma for each row [...]."""
    weight = discount.unsqueeze(-1) ** torch.arange(rewards.shape[-1], device=discount.device)
    return (weight * rewards).sum(-1, keepdim=True)
