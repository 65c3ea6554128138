"""How new a place is, and what explorers are rewarded for."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor

from neatq_torch.learning.learner import Saved
from neatq_torch.learning.normalization import RunningNormalization

CELL_UNITS = 25.0
"""Sides of the squares in which visits are counted."""
HALF_LIFE_TICKS = 5_000
"""After which a visit counts half."""


class ExplorerReward:
    """What explorers are rewarded for: a share for being where few were, the rest as all.

    Robots of an arena count their visits to the squares of its field, and forget them slowly. A
    place is worth 1 / sqrt(1 + visits), the one just made included (compare Strehl & Littman 2008),
    so that whoever comes late to what all know gets nearly nothing. Both parts are divided by their
    running standard deviation.

    Args:
        share: Of the new in the reward, in [0, 1].

    Attributes:
        visits: By square, float64 [columns, rows]; grows as robots go farther.
    """

    def __init__(self, share: float) -> None:
        self.share, self.visits = share, np.zeros((0, 0))
        self._scale = RunningNormalization(1, 2, least=1e-6)

    def of(self, batch: TensorDictBase) -> Tensor:
        """The rewards of a batch [slots, ticks] with poses in units, float32 [slots, ticks, 1]."""
        following = batch.get("next")
        novelty = self._visit(following.get("pose")[..., :2].cpu().numpy())
        both = torch.cat([torch.from_numpy(novelty), following.get("reward").double().cpu()], -1)
        self._scale.add(both[None], batch.get("genome_id")[None, ..., 0] >= 0)
        weight = both.new_tensor([self.share, 1 - self.share])
        return (both / self._scale.deviation[0] * weight).sum(-1, keepdim=True).float()

    def _visit(self, position: NDArray[np.floating]) -> NDArray[np.float64]:
        """Count where robots came [slots, ticks, 2]; what it is worth [slots, ticks, 1]."""
        square = (position // CELL_UNITS).astype(np.int64).clip(0)
        size = np.array(self.visits.shape)
        more = np.maximum(square.max((0, 1)) + 1 - size, 0)
        self.visits = np.pad(self.visits, [(0, one) for one in more.tolist()])
        worth = np.empty((*square.shape[:2], 1))
        for tick, (column, row) in enumerate(square.transpose(1, 2, 0)):
            self.visits *= 0.5 ** (1 / HALF_LIFE_TICKS)
            np.add.at(self.visits, (column, row), 1.0)
            worth[:, tick, 0] = 1 / np.sqrt(1 + self.visits[column, row])
        return worth

    def state_dict(self) -> Saved:
        """Visits and scale."""
        return {"visits": self.visits.copy(), "scale": self._scale.state_dict()}

    def load_state_dict(self, state: Saved) -> None:
        """Go on from `state`."""
        self.visits = np.array(state["visits"], dtype=np.float64)
        self._scale.load_state_dict(state["scale"])
