"""What every rule of learning does with weights: change them, and keep up with their columns."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn


def take_over(weight: Tensor, changed: Tensor, wanted: Tensor | None = None) -> Tensor:
    """Put changed weights in place, but no network's of which one is infinite or NaN.

    Args:
        weight: [networks, columns], changed in place.
        changed: What shall stand there [networks, columns].
        wanted: Networks that shall change at all [networks, 1]; None for every one.

    Returns:
        The networks that changed [networks, 1].
    """
    finite = torch.isfinite(changed).all(1, keepdim=True)
    if wanted is not None:
        finite &= wanted
    weight.copy_(torch.where(finite, changed, weight))
    return finite


def widened(values: Tensor, weight: Tensor) -> Tensor:
    """Values [networks, old] with zeros for the columns that `weight` has got since."""
    missing = weight.shape[1] - values.shape[1]
    return nn.functional.pad(values, (0, missing)) if missing else values


def fitted(saved: Tensor | np.ndarray, own: Tensor) -> Tensor:
    """A saved tensor on the device of `own`, cut or padded to as many columns.

    Columns that only one of them has belong to no link and hold zeros.
    """
    saved = torch.as_tensor(saved).to(own)
    return nn.functional.pad(saved, (0, own.shape[-1] - saved.shape[-1]))
