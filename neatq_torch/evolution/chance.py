"""Generators of random numbers that go on where they were saved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def generator_from(state: Mapping[str, Any]) -> np.random.Generator:
    """Return the generator whose `bit_generator.state` was saved."""
    bits = getattr(np.random, state["bit_generator"])()
    bits.state = state
    return np.random.Generator(bits)
