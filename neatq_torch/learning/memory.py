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
    (`steps_to_next_obs`, 1 where nothing is said) and whether the latter was terminal. Any genome
    can learn from them, whoever made them; with `owners` it can learn from those of one.

    Args:
        capacity: Transitions kept; the oldest make room.
        device: Where they are kept.
        owners: Whether the genome that acted is kept, too (`genome_id`).

    Raises:
        ValueError: If the capacity is less than 1.
    """

    def __init__(
        self, capacity: int, device: torch.device | str = "cpu", *, owners: bool = False
    ) -> None:
        if capacity < 1:
            raise ValueError(f"capacity: expected at least 1, got {capacity}")
        self.capacity, self.device, self.owners = capacity, torch.device(device), owners
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
        if self.owners:
            columns["genome_id"] = batch.get("genome_id")
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

    def draw(
        self, size: int, generator: torch.Generator, *names: str, owner: int | None = None
    ) -> Saved:
        """As `sample`, but plain columns, those of `next` with that before their names.

        Only those columns that are named, or all; with an `owner`, of those that it made.
        """
        ages = None if owner is None else self._ages(owner)
        kept = len(self) if ages is None else len(ages)
        if not kept:
            raise ValueError("expected stored transitions to draw from, got none: extend first")
        drawn = torch.randint(kept, (size,), generator=generator)
        return self._rows(drawn if ages is None else ages[drawn], names)

    def knows(self, owner: int) -> bool:
        """Whether it has transitions that a genome made."""
        return bool(len(self)) and bool(self._own(owner).any())

    def _own(self, owner: int) -> Tensor:
        """Where transitions stand that a genome made, a mask."""
        return self._columns["genome_id"][: len(self)].flatten() == owner

    def _ages(self, owner: int) -> Tensor:
        """Of the transitions that a genome made, the oldest first."""
        rooms = self._own(owner).nonzero().flatten().cpu()
        return ((rooms - self._oldest) % self.capacity).sort().values

    @property
    def _oldest(self) -> int:
        """Where the oldest transition stands."""
        return self._added % self.capacity if self._added > self.capacity else 0

    def _rows(self, ages: Tensor, names: Sequence[str] = ()) -> Saved:
        """Transitions by age, 0 for the oldest."""
        # Not by where they stand: what is restored stands elsewhere.
        rooms = ((ages + self._oldest) % self.capacity).to(self.device)
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
    batch: TensorDictBase, ticks: int, discount: float, *, keep_every: int = 1
) -> TensorDict:
    """Transitions that reach so many ticks ahead, for n-step returns (Sutton 1988).

    The reward is the discounted sum r_1 + gamma r_2 + ... up to the state that is next now; it
    ends early where the life or the batch does, and where somebody else, or nobody, acts from then
    on. How many ticks that were stands in `steps_to_next_obs`, from which TorchRL's estimators take
    the discount of what follows. What was done in these ticks was not the choice of whoever learns
    from it; nothing corrects for that.

    Args:
        batch: [..., ticks] with `observation`, `action`, `genome_id` and
            `("next", observation / reward / terminated / done)`; each column of rewards is summed
            up for itself.
        ticks: n, at least 1.
        discount: gamma.
        keep_every: Of the ticks of the batch, one in so many begins a transition.

    Returns:
        The transitions [..., kept], on the CPU.
    """
    length = batch.shape[-1]
    flags = ("next", "done"), "genome_id"
    done, owner = (batch.get(name).cpu().reshape(-1, length).numpy() for name in flags)
    columns = batch.get(("next", "reward")).cpu()
    reward = columns.reshape(-1, length, columns.shape[-1]).numpy()
    done = done.copy()
    done[:, :-1] |= owner[:, 1:] != owner[:, :-1]
    rewards, steps = _ahead(reward, done, ticks, discount, keep_every)
    shape = (*batch.shape[:-1], steps.shape[-1], 1)
    ahead = torch.from_numpy(steps).view(shape)
    first = torch.arange(0, length, keep_every).unsqueeze(-1)

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
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Discounted sums [robots, kept, columns] of rewards, and of how many ticks [robots, kept]."""
    robots, length, columns = reward.shape
    kept = (length + keep_every - 1) // keep_every
    rewards = np.zeros((robots, kept, columns), np.float32)
    steps = np.zeros((robots, kept), np.int64)
    for robot in range(robots):
        for begun in range(kept):
            first, weight, total = begun * keep_every, 1.0, np.zeros(columns)
            for tick in range(first, min(first + ticks, length)):
                for column in range(columns):
                    total[column] += weight * reward[robot, tick, column]
                weight *= discount
                steps[robot, begun] += 1
                if done[robot, tick]:
                    break
            for column in range(columns):
                rewards[robot, begun, column] = total[column]
    return rewards, steps
