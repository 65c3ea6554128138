"""Any Gymnasium environment as a TorchRL environment of [arenas, slots]."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torchrl.data import Bounded, Unbounded

from neatq_envs.episodes import TRAINING, EpisodeRows, Starts, episode_seed
from neatq_envs.gymnasium_rows import EnvRows
from neatq_envs.gymnasium_task import Interface
from neatq_envs.random_play import ObservationScaling
from neatq_envs.torchrl_env import (
    DONE,
    OBSERVATION,
    REWARD_VECTOR,
    STEP_COUNT,
    TERMINATED,
    TRUNCATED,
    RowsEnv,
    single,
)

LIVING, EPISODE = "living", "episode"


class GymnasiumRows(RowsEnv):
    """Rows that live one episode after the other of a Gymnasium environment.

    ## Description
    Resetting a row [arena, slot] at the end of an episode, or before, begins its next one. Episode
    e of a row begins with the seed `episode_seed(seed of the arena, generation, e)`.

    With a number of `episodes` a row that had its last one is idle until `begin`: `living` is
    false, it is not stepped, its reward is 0, its observation stays, and it is not done. Without,
    rows live for ever, and the slot is in the generation's place: rows of a generation are judged
    on equal episodes, those that live on see different ones.

    ## Observation space
    `observation`, float32 [arenas, slots, inputs], scaled; `living`, bool [.., 1]; `episode`
    and `step_count`, int64 [.., 1]; `reward_vector`, float64 [.., 1], the reward of the last step
    in double precision, 0 where an episode begins.

    ## Action space
    `action`, float32 [arenas, slots, actions]: a point in the environment's box, or the number of
    one of its choices, counted from 0.

    ## Rewards and episode end
    `reward`, float32 [arenas, slots, 1], is summed up by `episodes.returns`. `terminated` and
    `truncated` are the environment's own: a value may be bootstrapped over the second only.

    Args:
        rows: The environments, as `make_rows` makes them; whoever made them closes them.
        interface: What is read and done in them.
        scaling: Of the observations.
        shape: (arenas, slots).
        seeds: Of the arenas, one each; 0, 1, 2 and so on by default.
        episodes: Of each row; None: without end.
        purpose: What the episodes are for; see `episode_seed`.
        name: What messages call the environment.
        first_slot: The number of the first slot, where others live elsewhere.

    Attributes:
        elsewhere: What gives the state of the rows where these live elsewhere and this environment
            is not stepped; None where they live here. `begin` ends it.
        replays_late: Whether a loaded state is replayed with the next reset or step only, as others
            may go on with it.
    """

    replays_late = False

    def __init__(
        self,
        rows: EnvRows,
        interface: Interface,
        scaling: ObservationScaling,
        *,
        shape: Sequence[int],
        seeds: Sequence[int] | None = None,
        episodes: int | None = None,
        purpose: int = TRAINING,
        name: str = "the environment",
        first_slot: int = 0,
    ) -> None:
        super().__init__(device=None, batch_size=torch.Size(shape))
        self.interface, self.scaling = interface, scaling
        slots = shape[1]

        def slot_of(row: int) -> str:
            return f"slot {first_slot + row % slots} of arena {row // slots}"

        self.episodes = EpisodeRows(rows, name, slot_of)
        self.seeds = self._checked(range(shape[0]) if seeds is None else seeds)
        self._number, self._purpose, self._first_slot = episodes, purpose, first_slot
        inputs = self._size(interface.inputs)
        observed = {
            OBSERVATION: Bounded(
                -scaling.largest, scaling.largest, shape=inputs, dtype=torch.float32
            ),
            REWARD_VECTOR: Unbounded(shape=self._size(1), dtype=torch.float64),
            LIVING: self._truth(),
            EPISODE: self._count(),
            STEP_COUNT: self._count(),
        }
        self._declare(interface.bounds, observed, Unbounded(shape=self._size(1)))
        self.begin()

    def begin(self, generation: int = 0, *, starts: ArrayLike | None = None) -> None:
        """Have the next reset, with a mask or without, begin the first episode of every row.

        Args:
            generation: Whose episodes they are.
            starts: Their seeds, int64 [arenas x slots, episodes], in place of the generation's.
        """
        given = None if starts is None else np.array(starts, np.int64)
        rows = self.batch_size.numel()
        if given is not None and (given.ndim != 2 or len(given) != rows or not given.size):
            words = f"of {rows} rows, got the shape {list(given.shape)}"
            raise ValueError(f"starts: expected the seeds of the episodes {words}")
        self.generation, self._given = generation, given
        self._pending, self._restored, self._stepped = True, False, False
        self._saved: Mapping[str, Any] | None = None  # from where they go on with the next reset
        self.elsewhere: Callable[[], dict[str, np.ndarray]] | None = None

    def rebuild(self) -> None:
        """Nothing needs it; the worlds of `ArenaEnv` do."""

    def world_state(self) -> dict[str, Any]:
        """All that the rows are, as in `ArenaEnv`; see `EpisodeRows.state`."""
        return {
            "seeds": list(self.seeds),
            "generation": self.generation,
            "starts": self._given,
            "rows": self._rows_state(),
        }

    def _rows_state(self) -> dict[str, np.ndarray] | None:
        """See `EpisodeRows.state`; None where no step was taken, so that `begin` says it all."""
        if self.elsewhere is not None:
            return self.elsewhere()
        if self._saved is not None:
            return {name: np.array(value) for name, value in self._saved.items()}
        return self.episodes.state() if self._stepped else None

    def load_world_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a `world_state`; `reset()` without a mask then returns it until a step."""
        self.seeds = self._checked(state["seeds"])
        self.begin(state["generation"], starts=state["starts"])
        rows, own = state["rows"], self.batch_size.numel()
        if rows is None:
            return
        if len(rows["living"]) != own:
            raise ValueError(f"the state has {len(rows['living'])} rows, this has {own}")
        self._saved, self._pending, self._restored = rows, False, True
        if not self.replays_late:
            self._replay()

    def _replay(self) -> None:
        """Bring the environments to where a loaded state has them, if they are not there yet."""
        if self._saved is not None:
            self.episodes.load_state(self._saved, self._starts())
            self._saved, self._stepped = None, True

    def _starts(self) -> Starts:
        if self._given is not None:
            return Starts.given(self._given)
        seeds, slots, generation = self.seeds, self.batch_size[1], self.generation

        def seed(row: int, episode: int) -> int:
            slot = self._first_slot + row % slots
            group = slot if self._number is None else generation
            return episode_seed(seeds[row // slots], group, episode, purpose=self._purpose)

        return Starts(len(seeds) * slots, self._number, seed)

    def _checked(self, seeds: Sequence[int]) -> tuple[int, ...]:
        if len(seeds) != self.batch_size[0]:
            words = f"one for each of {self.batch_size[0]} arenas, got {len(seeds)}"
            raise ValueError(f"seeds: expected {words}")
        return tuple(int(seed) for seed in seeds)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self._replay()
        if self._pending or (mask is None and not self._restored):
            self.episodes.begin(self._starts())
            self._pending = self._stepped = False
            if tensordict is not None and mask is not None:
                tensordict.set("_reset", torch.ones_like(mask))
        elif mask is not None:
            self.episodes.go_on(mask.reshape(-1).numpy())
            self._stepped = True
        return self._tensordict(self._observe())

    def _act(self, actions: np.ndarray) -> torch.Tensor:
        if self._pending:
            raise RuntimeError("step: after begin, reset the environment before the next step")
        self._replay()
        self._restored, self._stepped = False, True
        self.episodes.step(actions.reshape(self.batch_size.numel(), -1))
        return single(self.episodes.reward).view(self._size(1))

    def _observe(self) -> dict[str, torch.Tensor]:
        now, one = self.episodes, self._size(1)
        seen = torch.from_numpy(self.scaling(now.observation))
        return {
            OBSERVATION: seen.unflatten(0, self.batch_size),
            REWARD_VECTOR: torch.from_numpy(now.reward).view(one),
            LIVING: torch.from_numpy(now.living).view(one),
            EPISODE: torch.from_numpy(now.episode).view(one),
            STEP_COUNT: torch.from_numpy(now.step_count).view(one),
            DONE: torch.from_numpy(now.terminated | now.truncated).view(one),
            TERMINATED: torch.from_numpy(now.terminated).view(one),
            TRUNCATED: torch.from_numpy(now.truncated).view(one),
        }

    def _set_seed(self, seed: int | None) -> None:
        first = 0 if seed is None else seed
        self.seeds = tuple(range(first, first + self.batch_size[0]))
        self.begin()
