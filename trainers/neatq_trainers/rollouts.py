"""Batches of a Gymnasium task that are collected where its environments live.

Where these are dealt to others, networks act beside them: a batch is one message to and fro,
however many ticks it has, and who is slow gets fewer slots of the next generation. Batches are
those of one process, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from neatq_envs.episodes import rows_of, side_by_side
from neatq_envs.gymnasium_rows import DealtRows
from neatq_torch.learning import CandidatePolicy
from neatq_torch.learning.exploration import state_of_all, state_of_slots
from neatq_torch.network import PopulationNetwork
from neatq_trainers.collecting import Arrays, Collected, News, Share
from neatq_trainers.run import Run
from neatq_trainers.worlds import GymnasiumWorld


def rollouts_of(run: Run) -> Rollouts | None:
    """The batches of a run, where others collect them: those of one arena, and no other policy.

    Else environments that live elsewhere are stepped from here.
    """
    world, policy, network = run.world, run.policy, run.network
    rows = world.rollout_workers if isinstance(world, GymnasiumWorld) else None
    if rows is None or run.shape[0] > 1 or network is None:
        return None
    return Rollouts(run, rows, network, policy) if type(policy) is CandidatePolicy else None


class Rollouts:
    """A collector of batches [1, slots, ticks], for the training loop.

    The policy of the run has the state of all slots after each batch.
    """

    def __init__(
        self, run: Run, rows: DealtRows, network: PopulationNetwork, policy: CandidatePolicy
    ) -> None:
        self._run, self._network, self._policy = run, network, policy
        self._rows, self._workers = rows, rows.remotes[: run.shape[1]]
        self._speeds = np.full(len(self._workers), np.nan)
        self._work = np.zeros((len(self._workers), 2))  # seconds and steps since they were dealt
        self._slots: list[slice] = []
        self._born: set[int] = set()

    def __iter__(self) -> Iterator[TensorDict]:
        """Batch after batch."""
        while True:
            if not self._slots:
                self._deal()
            yield self._joined(self._told("collect"))

    def reset(self, *, index: Tensor) -> None:
        """Begin new lives in slots (mask [1, slots]): all of a generation, or some."""
        if self._run.config.generational:
            self._slots = []
        else:
            self._born |= set(index[0].nonzero().flatten().tolist())

    def shutdown(self, *, close_env: bool = False) -> None:
        """Nothing: who made the environments closes them."""

    def _deal(self) -> None:
        """Give each worker slots, which begin or go on there."""
        run, env, (seconds, steps) = self._run, self._run.world.env, self._work.T
        speeds = np.divide(steps, seconds, out=self._speeds, where=steps > 0)
        ends = np.cumsum(shares(speeds, run.shape[1])).tolist()
        self._slots = [slice(first, end) for first, end in pairwise([0, *ends])]
        self._work[:] = 0
        state = env.world_state()
        common = {
            "scaling": env.scaling,
            "seeds": state["seeds"],
            "generation": state["generation"],
            "episodes": run.config.population.episodes if run.config.generational else None,
            "ticks": run.config.ticks_per_batch,
            "name": run.config.world.label,
        }
        parts = []
        for own in self._slots:
            rows = None if state["rows"] is None else rows_of(state["rows"], own)
            parts.append(
                Share(policy=self._policy.part(own), first_slot=own.start, rows=rows, **common)
            )
        self._asked("take", parts)
        env.elsewhere = lambda: side_by_side(self._told("rows"))

    def _told(self, method: str) -> list[Any]:
        """What each worker returns that is told the news."""
        state = self._policy.state_dict()
        news = [self._news(own, state) for own in self._slots]
        self._born.clear()
        return self._asked(method, news)

    def _news(self, own: slice, state: dict[str, Any]) -> News:
        genomes, here = self._run.populations[0].genomes, range(own.start, own.stop)
        born = {slot - own.start: genomes[slot] for slot in self._born.intersection(here)}
        weight = self._network.weight.detach()[own].clone() if self._run.config.learns else None
        return News(born, state_of_slots(state, own), weight, self._run.normalization)

    def _joined(self, answers: list[Collected]) -> TensorDict:
        """What all slots went through."""
        self._work += [(answer.seconds, answer.steps) for answer in answers]
        self._policy.load_state_dict(state_of_all([answer.policy for answer in answers]))
        for answer in answers:
            for part in (answer.batch, answer.batch["next"]):
                _fit_state(part, self._network.state_size)
        return _whole_batch([answer.batch for answer in answers])

    def _asked(self, method: str, dealt: Sequence[Any]) -> list[Any]:
        """What each worker returns to its share.

        After an error the workers are closed: what some of them have begun is not known.
        """
        try:
            for worker, own in zip(self._workers, dealt, strict=True):
                worker.ask(method, own)
            return [worker.answer() for worker in self._workers]
        except Exception:
            self._rows.close()
            raise


def shares(speeds: np.ndarray, slots: int) -> list[int]:
    """How many of the slots each worker gets: one, and of the others as many as it is quick.

    Args:
        speeds: Steps in a second, of each worker; NaN where nobody knows.
        slots: To be dealt, at least one for each worker.
    """
    known = np.isfinite(speeds)
    speeds = np.where(known, speeds, np.median(speeds[known]) if known.any() else 1.0)
    exact = speeds / speeds.sum() * (slots - len(speeds))
    given = np.floor(exact).astype(int)
    left = slots - len(speeds) - given.sum()
    given[np.argsort(given - exact, kind="stable")[:left]] += 1
    return (1 + given).tolist()


def _fit_state(part: Arrays, size: int) -> None:
    """Let networks of some slots have states as large as those of all; what is beside is zero."""
    own = part.pop("network_state", None)
    if size:
        fit = np.zeros((*part["observation"].shape[:-1], size), np.float32)
        if own is not None:
            common = min(size, own.shape[-1])
            fit[..., :common] = own[..., :common]
        part["network_state"] = fit


def _whole_batch(parts: Sequence[Arrays]) -> TensorDict:
    """Batches [1, slots, ticks] of some slots as one of all."""
    values: dict[str, Any] = {}
    for key, first in parts[0].items():
        columns = [part[key] for part in parts]
        if isinstance(first, dict):
            values[key] = _whole_batch(columns)
        else:
            values[key] = torch.from_numpy(np.concatenate(columns, axis=1))
    return TensorDict(values, batch_size=values["observation"].shape[:3])
