"""Observations on a common scale, fixed before a run begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

LARGEST = 10.0
"""Scaled observations are clipped to [-LARGEST, LARGEST]."""
_SANE = 1e4  # a bound beyond this says nothing of the values that occur
_LEAST_SHARE = 0.2  # of the reach that bounds allow
_STEADY = 1e-6  # a standard deviation below this is that of a value that never changed


@dataclass(frozen=True)
class ObservationScaling:
    """What a network reads: (observation - offset) / scale, clipped, in single precision."""

    offset: NDArray[np.float64]  # [observations]
    scale: NDArray[np.float64]  # [observations], positive

    def __call__(self, observation: NDArray[np.float64]) -> NDArray[np.float32]:
        """Scale observations [..., observations]."""
        scaled = (observation - self.offset) / self.scale
        return np.clip(scaled, -LARGEST, LARGEST).astype(np.float32)

    @classmethod
    def fit(cls, space: spaces.Space[Any], seen: ArrayLike) -> Self:
        """The scaling of a space, Box or Discrete, in which [times, observations] were seen.

        Entries of a Box with sane bounds are measured from the middle between them, in units of how
        far they were seen to go, but at least of a fifth of how far they may go: some environments
        state bounds that nothing ever reaches. Other entries get mean 0 and standard deviation 1
        over what was seen. The ones and zeros of a Discrete space stay.
        """
        seen = np.asarray(seen, np.float64)
        offset, scale = np.zeros(seen.shape[1]), np.ones(seen.shape[1])
        if isinstance(space, spaces.Box):
            low, high = (b.astype(np.float64).ravel() for b in (space.low, space.high))
            with np.errstate(all="ignore"):
                sane = (np.abs(low) < _SANE) & (np.abs(high) < _SANE) & (high > low)
            spread = seen.std(0)
            offset = np.where(sane, 0, seen.mean(0))
            scale = np.where(spread > _STEADY, spread, 1.0)
            offset[sane] = (low[sane] + high[sane]) / 2
            half = (high[sane] - low[sane]) / 2
            reach = np.abs(seen[:, sane] - offset[sane]).max(0)
            scale[sane] = np.clip(reach, half * _LEAST_SHARE, half)
        return cls(offset, scale)

    def to_dict(self) -> dict[str, list[float]]:
        """JSON values from which `from_dict` makes the same scaling, bit for bit."""
        return {"offset": self.offset.tolist(), "scale": self.scale.tolist()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Read what `to_dict` wrote."""
        return cls(np.array(values["offset"], np.float64), np.array(values["scale"], np.float64))
