"""What robots earned: rewards summed over trials, trials averaged, averages turned to fitness."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

TrialAverage = Literal["opennero", "exponential"]


class Trials:
    """Ages, reward sums of the running trials and averages over closed ones.

    A trial of a robot closes whenever its age reaches a multiple of `trial_ticks`.
    With "opennero" the average after the trials s1, s2, s3 is s1, then s1 + s2/2 (not the
    mean), then half of that plus s3/2; with "exponential" it is s1, then always half of the
    old average plus half of the new trial.

    Attributes:
        age_ticks: int64 [robots].
        sums: float64 [robots, dimensions], rewards of the running trial.
        averages: float64 [robots, dimensions], over closed trials; 0 before the first.
        closed: int64 [robots], number of closed trials.
        counted: int64 [robots], ticks of the running trial that count.
    """

    def __init__(
        self, robots: int, dimensions: int, trial_ticks: int, average: TrialAverage
    ) -> None:
        """Start with robots of age 0."""
        self.trial_ticks = trial_ticks
        self.average: TrialAverage = average
        self.age_ticks = np.zeros(robots, dtype=np.int64)
        self.sums = np.zeros((robots, dimensions))
        self.averages = np.zeros((robots, dimensions))
        self.closed = np.zeros(robots, dtype=np.int64)
        self.counted = np.zeros(robots, dtype=np.int64)

    @property
    def eligible(self) -> NDArray[np.bool_]:
        """Bool [robots], whether the robot has lived through its first trial."""
        return self.age_ticks >= self.trial_ticks

    def record(self, rewards: ArrayLike, counts: ArrayLike | None = None) -> None:
        """Add rewards; how they are cut into batches is no matter.

        Args:
            rewards: [robots, ticks, dimensions].
            counts: bool [robots, ticks], the ticks that count; those that do not are taken to have
                brought as much as the others of the trial on average, or nothing where none
                counts. None if all count.

        Raises:
            ValueError: a shape is wrong or a reward is not finite.
        """
        rewards = np.asarray(rewards, dtype=np.float64)
        robots, dimensions = self.sums.shape
        if rewards.ndim != 3 or rewards.shape[::2] != (robots, dimensions):
            raise ValueError(
                f"rewards must have the shape [robots = {robots}, ticks, dimensions = "
                f"{dimensions}], not {list(rewards.shape)}."
            )
        if not np.isfinite(rewards).all():
            robot, tick, dimension = np.argwhere(~np.isfinite(rewards))[0]
            raise ValueError(
                f"reward {rewards[robot, tick, dimension]} of robot {robot}, tick {tick}, "
                f"dimension {dimension} is not finite."
            )
        shape = rewards.shape[:2]
        counts = np.ones(shape, bool) if counts is None else np.asarray(counts, bool)
        if counts.shape != shape:
            raise ValueError(
                f"counts must have the shape [robots, ticks] = {list(shape)}, not "
                f"{list(counts.shape)}."
            )
        rewards = np.where(counts[..., None], rewards, 0.0)
        start = 0
        for end in self._borders(rewards.shape[1]):
            self.counted += np.count_nonzero(counts[:, start:end], axis=1)
            self._advance(rewards[:, start:end])
            start = end

    def _borders(self, ticks: int) -> list[int]:
        """Return the ticks of a batch at which some trial closes, and its end."""
        first = self.trial_ticks - self.age_ticks % self.trial_ticks
        closing = first[:, None] + np.arange(0, ticks, self.trial_ticks)
        ends = set(closing[closing <= ticks].tolist())
        return sorted(ends | {ticks}) if ticks else []

    def _advance(self, rewards: NDArray[np.float64]) -> None:
        # Adding strictly one after the other (not in pairs, as a sum over an axis may do)
        # makes the result the same for every cut into batches.
        parts = np.concatenate([self.sums[:, None], rewards], axis=1)
        self.sums = np.add.accumulate(parts, axis=1)[:, -1]
        self.age_ticks += rewards.shape[1]
        closing = np.flatnonzero(self.age_ticks % self.trial_ticks == 0)
        if closing.size:
            self._close(closing)

    def _close(self, robots: NDArray[np.intp]) -> None:
        self.closed[robots] += 1
        closed = self.closed[robots, None]
        # A factor of exactly 1 where all ticks count.
        whole = self.trial_ticks / self.counted[robots, None].clip(1)
        sums, old = self.sums[robots] * whole, self.averages[robots]
        moved = old + (sums - old) / 2
        if self.average == "opennero":
            self.averages[robots] = np.where(closed <= 2, old + sums / closed, moved)
        else:
            self.averages[robots] = np.where(closed == 1, sums, moved)
        self.sums[robots] = 0.0
        self.counted[robots] = 0

    def reset(self, robot: int) -> None:
        """Start a new life in a slot: nothing of the old one is left."""
        self.age_ticks[robot] = 0
        self.sums[robot] = 0.0
        self.averages[robot] = 0.0
        self.closed[robot] = 0
        self.counted[robot] = 0

    def state_dict(self) -> dict[str, Any]:
        """Return copies of the arrays."""
        return {
            "age_ticks": self.age_ticks.copy(),
            "sums": self.sums.copy(),
            "averages": self.averages.copy(),
            "closed": self.closed.copy(),
            "counted": self.counted.copy(),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Take over what `state_dict` gave; ValueError if the population is of another size."""
        # Where nothing is said of it, all ticks of the running trial counted.
        counted = np.array(state["age_ticks"], dtype=np.int64) % self.trial_ticks
        state = {"counted": counted, **state}
        for name in ("age_ticks", "sums", "averages", "closed", "counted"):
            own = getattr(self, name)
            array = np.array(state[name], dtype=own.dtype)
            if array.shape != own.shape:
                raise ValueError(
                    f"state of {name} must have the shape {list(own.shape)}, not "
                    f"{list(array.shape)}."
                )
            setattr(self, name, array)


def z_scores(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (x - mean) / std over [samples, dimensions]; 0 where all samples are equal.

    The standard deviation is that of the population, not the estimate from a sample.
    """
    # The operations of `mean` and `std` of numpy, bit for bit, without going over the data twice.
    centred = samples - np.add.reduce(samples) / len(samples)
    spread = np.sqrt(np.add.reduce(centred * centred) / len(samples))
    # A spread can underflow to 0 for samples that are hardly different.
    centred /= np.where(spread > 0.0, spread, 1.0)
    centred[:, (samples == samples[0]).all(axis=0)] = 0.0
    return centred


def relative_fitness(
    averages: NDArray[np.float64],
    eligible: NDArray[np.bool_],
    reward_weights: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return fitness float64 [robots] >= 0 from averages [robots, dimensions].

    The score of an eligible robot is its z-scores among them, weighted by `reward_weights`
    [dimensions]; fitness is the score above the lowest, so the worst has 0. Others have 0.
    """
    fitness = np.zeros(eligible.size)
    judged = np.flatnonzero(eligible)
    if judged.size:
        scores = z_scores(averages[judged]) @ reward_weights
        fitness[judged] = scores - min(0.0, float(scores.min()))
    return fitness
