"""What the TorchRL environments of this package have in common: quick steps of many rows."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

ACTION = "action"
DONE = "done"
REWARD = "reward"


class RowsEnv(EnvBase):
    """An environment whose batch dimensions are rows, each with its own `done`.

    Sub-classes give `_advance` and name what they observe in `seen`.
    """

    seen: ClassVar[tuple[str, ...]]
    """Entries that every step and every reset bring up to date, `done` among them."""

    def _advance(self, tensordict: TensorDictBase) -> dict[str, torch.Tensor]:
        """Step with the action of `tensordict`; returns the entries of `seen` and the reward."""
        raise NotImplementedError

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._tensordict(self._advance(tensordict))

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """Do what `EnvBase.step_and_maybe_reset` does, without looking up which keys go where.

        The next root has all entries of this one but the reward, with what this environment
        observes brought up to date. Steps that need more than that are left to TorchRL.
        """
        if not self._is_plain(tensordict):
            return super().step_and_maybe_reset(tensordict)
        values = self._advance(tensordict)
        outdated = {*self.seen, REWARD, "next"}
        root = {key: _carried(value) for key, value in tensordict.items() if key not in outdated}
        root.update((key, values[key]) for key in self.seen)
        preset = tensordict.get("next", None)
        if preset is not None:
            values = {**dict(preset.items()), **values}
        tensordict.set("next", self._tensordict(values))
        upcoming = self._tensordict(root)
        return tensordict, self.maybe_reset(upcoming) if values[DONE].any() else upcoming

    def _is_plain(self, tensordict: TensorDictBase) -> bool:
        """Return whether a step needs nothing but the ordinary."""
        return (
            type(tensordict) is TensorDict
            and tensordict.batch_size == self.batch_size
            and tensordict.device is None
            and not any(tensordict.names)
            and "_step" not in tensordict
            and "_reset" not in tensordict
            and self._post_step_mdp_hooks is None
            and "_compiled_step_and_maybe_reset" not in self.__dict__
        )

    def _tensordict(self, values: dict[str, Any]) -> TensorDict:
        # The public constructor takes eight times as long: it checks what is right by making.
        return TensorDict._new_unsafe(values, self.batch_size)

    def _size(self, features: int) -> torch.Size:
        return torch.Size([*self.batch_size, features])


def _carried(value: Any) -> Any:
    """Return a tensor itself, and of nested entries a copy that shares the tensors."""
    return value if isinstance(value, torch.Tensor) else value.copy()


def single(array: np.ndarray) -> torch.Tensor:
    """Return a tensor of single precision."""
    return torch.from_numpy(array.astype(np.float32))
