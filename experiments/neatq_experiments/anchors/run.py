"""Which function runs an anchor."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from neatq_experiments.anchors.anchor import NOVELTY, SB3, AnchorConfig

TrainAnchor = Callable[[AnchorConfig, int], dict[str, Any]]
"""Called with the configuration and a seed: columns of metrics in the arena, else a result."""


def trainer_of(config: AnchorConfig) -> TrainAnchor:
    """What trains an anchor; its libraries are imported here."""
    kind = "sb3" if config.arm.startswith(SB3) else config.arm.removesuffix(NOVELTY)
    module = importlib.import_module(f"neatq_experiments.anchors.{kind}")
    return getattr(module, f"train_{kind}")
