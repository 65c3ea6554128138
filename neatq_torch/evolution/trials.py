"""What robots earned: rewards summed over trials, averaged, and turned to fitness."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Kept:
    """Something with a state: the attributes that `kept` names.

    These are numbers, arrays whose shape does not change, and what has such methods itself.
    """

    kept: tuple[str, ...] = ()

    def state_dict(self) -> dict[str, Any]:
        """The state as JSON values and copies of numpy arrays."""
        state: dict[str, Any] = {}
        for name in self.kept:
            own = getattr(self, name)
            state[name] = own.state_dict() if hasattr(own, "state_dict") else deepcopy(own)
        return state

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Take over what `state_dict` gave; ValueError if an array there has another shape."""
        for name in self.kept:
            own, value = getattr(self, name), state[name]
            if hasattr(own, "load_state"):
                own.load_state(value)
                continue
            if isinstance(own, np.ndarray):
                value = np.array(value, dtype=own.dtype)
                if value.shape != own.shape:
                    shapes = f"{list(own.shape)}, got {list(value.shape)}"
                    raise ValueError(f"state of {name}: expected the shape {shapes}.")
            setattr(self, name, value)


TrialAverage = Literal["recent"]
TrialWeight = Literal["growing"]


class Trials(Kept):
    """Ages, reward sums of the running trials and averages over closed ones.

    A trial closes whenever the age of its slot reaches a multiple of `trial_ticks`; its value is
    the sum of its rewards. With the weight "growing" rewards weigh the more the later in a trial
    they come: of n ticks the i-th, from 1, by 2 i / (n + 1), which is 1 on average.

    The average after the trials s1, s2, s3 is OpenNERO's: s1, then s1 + s2/2 (not the mean), then
    half of that plus s3/2. With the average "recent" it is s1, then always half of the old plus
    half of the new.

    With `trial_episodes` a trial closes with the last tick of so many episodes instead, its value
    is their mean sum, the average is "recent", and all ticks weigh the same.

    Attributes:
        age_ticks: int64 [slots].
        sums: float64 [slots, dimensions], rewards of the running trial.
        averages: float64 [slots, dimensions], over closed trials; 0 before the first.
        latest: float64 [slots, dimensions], value of the last closed trial; 0 before the first.
        closed: int64 [slots], number of closed trials.
        running: int64 [slots], ticks of the running trial.
        ended: int64 [slots], episodes of the running trial that ended.
        total: closed trials of all that ever lived.
    """

    ARRAYS = ("age_ticks", "sums", "averages", "latest", "closed", "running", "ended")
    kept = (*ARRAYS, "total")

    def __init__(
        self,
        slots: int,
        dimensions: int,
        trial_ticks: int,
        trial_episodes: int | None = None,
        *,
        average: TrialAverage | None = None,
        weight: TrialWeight | None = None,
    ) -> None:
        self.by_ticks, self.length = trial_episodes is None, trial_episodes or trial_ticks
        self._adds_second = self.by_ticks and average is None
        self._growing = self.by_ticks and weight == "growing"
        self.sums, self.averages, self.latest = np.zeros((3, slots, dimensions))
        counters = np.zeros((4, slots), dtype=np.int64)
        self.age_ticks, self.closed, self.running, self.ended = counters
        self.total = 0

    def record(self, rewards: ArrayLike, done: ArrayLike | None = None) -> NDArray[np.bool_]:
        """Add rewards, see `Population.record`; the ticks with which a trial closes [slots, ticks].

        Only trials made of episodes look at `done`.
        """
        slots, dimensions = self.sums.shape
        rewards = checked("rewards", rewards, slots=slots, ticks=None, dimensions=dimensions)
        slots, ticks = shape = rewards.shape[:2]
        # Every tick is done with where ticks make a trial.
        done = np.ones(shape) if self.by_ticks else done
        done = checked("done", done, bool, slots=slots, ticks=ticks)
        before = self.running if self.by_ticks else self.ended
        ended = before[:, None] + np.add.accumulate(done, axis=1, dtype=np.int64)
        closing = done & (ended % self.length == 0)
        if ticks and not self.by_ticks:
            self.ended = ended[:, -1] % self.length
        borders = np.flatnonzero(closing.any(axis=0)) + 1
        for start, end in pairwise(sorted({0, *borders.tolist(), ticks})):
            earned = rewards[:, start:end]
            if self._growing:
                nth = self.running[:, None] + np.arange(1, end - start + 1)
                earned = earned * (2 * nth / (self.length + 1))[..., None]
            # Adding strictly one after the other (not in pairs, as a sum over an axis may do)
            # makes the result the same for every cut into batches.
            parts = np.concatenate([self.sums[:, None], earned], axis=1)
            self.sums = np.add.accumulate(parts, axis=1)[:, -1]
            self.running += end - start
            self.age_ticks += end - start
            self._close(np.flatnonzero(closing[:, end - 1]))
        return closing

    def _close(self, slots: NDArray[np.intp]) -> None:
        self.total += slots.size
        self.closed[slots] += 1
        closed, old = self.closed[slots, None], self.averages[slots]
        value = self.sums[slots] / (1 if self.by_ticks else self.length)
        added = closed <= (2 if self._adds_second else 1)
        self.averages[slots] = np.where(added, old + value / closed, old + (value - old) / 2)
        self.latest[slots] = value
        self.sums[slots], self.running[slots] = 0.0, 0

    def reset(self, slot: int) -> None:
        """Start a new life in a slot: nothing of the old one is left."""
        for name in self.ARRAYS:
            getattr(self, name)[slot] = 0


class BestStretches(Kept):
    """The best hundred ticks in a row of each slot's last trial.

    A trial is cut into stretches from its beginning; what is left over at its end does not count.

    Attributes:
        earned: float64 [slots], in the stretch that runs.
        best: float64 [slots], the most that a stretch of the running trial earned; -inf before.
        latest: float64 [slots], likewise of the last closed trial.
    """

    TICKS = 100
    kept = ("earned", "best", "latest")

    def __init__(self, slots: int) -> None:
        self.earned, self.best, self.latest = np.empty((3, slots))
        self.reset(slice(None))

    def record(
        self,
        rewards: NDArray[np.float64],
        running: NDArray[np.int64],
        closing: NDArray[np.bool_],
    ) -> None:
        """Add rewards [slots, ticks].

        Args:
            rewards: Of each tick.
            running: Ticks of each slot's running trial before them [slots].
            closing: With which ticks a trial closes [slots, ticks].
        """
        running = running.copy()
        for reward, closes in zip(rewards.T, closing.T, strict=True):
            self.earned += reward
            running += 1
            full = running % self.TICKS == 0
            self.best[full] = np.maximum(self.best, self.earned)[full]
            self.earned[full | closes] = 0
            self.latest[closes] = self.best[closes]
            self.best[closes], running[closes] = -np.inf, 0

    def reset(self, slot: int | slice) -> None:
        """Start a new life in a slot."""
        self.earned[slot], self.best[slot], self.latest[slot] = 0, -np.inf, -np.inf


def checked(
    name: str,
    values: ArrayLike | None,
    dtype: type = np.float64,
    mend: str = "",
    **axes: int | None,
) -> NDArray[Any]:
    """Values as an array with these axes, of which None has any length.

    Raises:
        ValueError: its shape is another, or a number is not finite; the message ends with `mend`.
    """
    array = None if values is None else np.asarray(values, dtype)
    lengths = [] if array is None else list(array.shape)
    same = (want in (None, length) for want, length in zip(axes.values(), lengths, strict=False))
    if array is None or len(lengths) != len(axes) or not all(same):
        shape = ", ".join(one if long is None else f"{one} = {long}" for one, long in axes.items())
        got = "nothing" if array is None else lengths
        raise ValueError(f"{name}: expected the shape [{shape}], got {got}.{mend}")
    if not np.isfinite(array).all():
        at = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
        where = ", ".join(f"{one[:-1]} {i}" for one, i in zip(axes, at, strict=True))
        raise ValueError(f"{name}: expected finite numbers, got {array[at]} of {where}.{mend}")
    return array


def weighted(rewards: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rewards [..., dimensions] summed by their weights [dimensions], one after the other."""
    # Unlike a matrix product, always in the same order, whatever stands beside.
    return np.add.accumulate(rewards * weights, axis=-1)[..., -1]


def z_scores(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """(x - mean) / std over [samples, dimensions]; 0 where all samples are equal.

    The standard deviation is that of the population, not the estimate from a sample.
    """
    # The operations of `mean` and `std` of numpy, bit for bit, without going over the data twice.
    centred = samples - np.add.reduce(samples) / len(samples)
    spread = np.sqrt(np.add.reduce(centred * centred) / len(samples))
    # A spread can underflow to 0 for samples that are hardly different.
    centred /= np.where(spread > 0.0, spread, 1.0)
    if (samples[-1] == samples[0]).any():
        centred[:, (samples == samples[0]).all(axis=0)] = 0.0
    return centred


def relative_fitness(
    averages: NDArray[np.float64], eligible: NDArray[np.bool_], reward_weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fitness float64 [slots] >= 0 from averages [slots, dimensions].

    The score of an eligible slot is its z-scores among them, weighted by `reward_weights`
    [dimensions]; fitness is the score above the lowest, so the worst has 0. Others have 0.
    """
    fitness = np.zeros(eligible.size)
    judged = np.flatnonzero(eligible)
    if judged.size:
        scores = z_scores(averages[judged]) @ reward_weights
        fitness[judged] = scores - min(0.0, float(scores.min()))
    return fitness
